"""The surfaces and the stored pull-offs of the study on stickiness."""

import sys
from pathlib import Path

import numpy as np
import pytest
import xarray

import jaxstab as js

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
POINTS = 64


@pytest.fixture
def study(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    import stickiness

    return stickiness


@pytest.fixture(scope="module")
def table():
    return xarray.load_dataset(BENCHMARKS / "results" / "stickiness.nc")


def amplitudes(heights):
    """Return the Fourier coefficients of a surface and the number of waves of each per side."""
    k = np.fft.fftfreq(POINTS, 1 / POINTS)
    return np.fft.fft2(np.asarray(heights)) / POINTS**2, np.hypot(*np.meshgrid(k, k))


def test_waves_are_added_to_a_reference_that_stays(study):
    reference, heights = study.surface(POINTS, 3, 0.7, 1, 16)
    (long, k), (all_, _) = amplitudes(reference), amplitudes(heights)
    assert np.std(reference) == pytest.approx(study.RMS_HEIGHT)
    assert np.allclose(np.where(k <= study.REFERENCE, all_, 0), long, atol=1e-15)
    assert np.abs(all_[k > 16.001]).max() < 1e-15
    # The density falls as k^(-2 - 2 H): rings of many waves tell, within their scatter.
    rings = [np.mean(np.abs(all_[(k > low) & (k <= 2 * low)]) ** 2) for low in (4, 8)]
    assert np.log2(rings[0] / rings[1]) == pytest.approx(2 + 2 * 0.7, abs=0.5)


def test_a_setting_gives_work_and_range(study):
    contact, flattening = study.contact_of(POINTS, 0, 0.8, 1, 8, "Tabor", 0.5, 2.5)
    long, k = amplitudes(study.surface(POINTS, 0, 0.8, 1, 8)[0])
    assert flattening == pytest.approx(np.sum(2 * np.pi * k * np.abs(long) ** 2) / 4)
    law = contact.potential
    assert float(law.surface_energy) == pytest.approx(2.5 * flattening)
    all_, k = amplitudes(contact.heights)
    curvature = np.sqrt(np.sum((2 * np.pi * k) ** 4 * np.abs(all_) ** 2)) / 2
    tabor = (float(law.surface_energy) ** 2 / curvature) ** (1 / 3) / float(law.length)
    assert tabor == pytest.approx(0.5)


def test_the_table_is_whole_and_documented(table, study):
    assert np.all(table.result == "successful")
    assert [name for name in study.VARIABLES if not table[name].attrs["long_name"]] == []
    coordinates = [str(name) for name in table.coords if name != "case"]
    cases = list(zip(*(table[name].values for name in coordinates), strict=True))
    assert len(set(cases)) == len(cases)
    assert np.all(table.pull_off > 0)
    # No tension exceeds the largest attraction, and contacts shrink as they are unloaded.
    assert np.all(table.pull_off < table.work / table["range"])
    assert np.all(table.unloaded_area <= table.pressed_area)
    assert np.all(table.resolution > 4)


@pytest.mark.nightly
def test_a_stored_pull_off_is_where_bisection_ends(table, study):
    """Ever smaller steps of the load, each from the state before, end at the same tension."""
    names = ("points", "seed", "hurst", "longest", "cutoff", "held", "value", "theta")
    row = table.isel(case=2)
    contact, flattening = study.contact_of(*(row[name].item() for name in names))
    state = js.equilibrate(contact, js.MeanPressure(0.5 * flattening / study.RMS_HEIGHT))
    value, step = 0.0, -float(row.pull_off) / 20
    while abs(step) > 1e-6 * float(row.pull_off):
        load = js.MeanPressure(value + step)
        new = js.equilibrate(contact, load, initial=state, throw=False)
        if new.result == "successful":
            state, value = new, value + step
        else:
            step /= 2
    assert -value == pytest.approx(float(row.pull_off), rel=1e-5)

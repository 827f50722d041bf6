"""The solids, the protocol and the stored areas of the study on memory."""

import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from scipy.ndimage import label

import jaxstab as js

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def study(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    import memory

    return memory


@pytest.fixture(scope="module")
def table():
    return xarray.load_dataset(BENCHMARKS / "results" / "memory.nc")


def modulus(solid, seconds):
    """Return the relaxation function of a solid over its relaxed modulus."""
    decays = np.exp(-np.asarray(seconds)[:, None] / np.asarray(solid.times))
    return 1 + decays @ np.asarray(solid.ratios)


def test_the_measured_relaxation_is_the_published_fit(study):
    seconds = np.array([0.0, 3.0, 50.0, 400.0])
    fit = 1429.71 + 184.62 * np.exp(-seconds / 8.93) + 191.06 * np.exp(-seconds / 117.96)
    found = modulus(study.solid_of(js.Grid(8), "relaxation"), seconds)
    assert np.allclose(1429.71 * found, fit, rtol=1e-12)


@pytest.mark.parametrize("name", ["creep", "growth"])
def test_a_strain_that_creeps_leaves_the_stress_constant(study, name):
    """The strain J(t) of a constant stress, put into the series, gives that stress back."""
    solid = study.solid_of(js.Grid(8), name)
    compliance = getattr(study, name)
    # Steps of the strain on a fine grid of times, of which the first holds all strain before it.
    times = np.geomspace(0.01, 1000, 4000)
    steps = np.diff(compliance(times), prepend=0)
    now = np.array([1.0, 10.0, 100.0, 1000.0])
    since = now[:, None] - np.sqrt(times * np.append(times[1:], times[-1]))
    decays = np.exp(-np.maximum(since, 0)[..., None] / np.asarray(solid.times))
    response = np.where(since >= 0, 1 + decays @ np.asarray(solid.ratios), 0)
    stress = response @ steps
    assert np.allclose(stress / stress[-1], 1, atol=0.02)


def test_the_growth_is_the_one_of_the_figure(study):
    area = 2.58 * study.growth(np.array([10.0, 100.0, 1000.0])) / study.growth(10.0)
    assert np.allclose(area, [2.58, 2.895, 3.20], rtol=0.01)


def test_adhesion_follows_from_published_numbers(study):
    """A single wave of the same height and slope needs nearly the same energy to be flattened."""
    assert study.published_theta(1.8e-6) == pytest.approx(0.0028, rel=0.02)
    assert study.published_theta(11e-9) == pytest.approx(0.45, rel=0.02)
    modulus = study.RELAXED_MODULUS / (1 - study.POISSON**2) / 2
    # Of h cos(qx) it is E* q h^2 / 8, with the mean square h^2 / 2 and the slope q h / sqrt(2).
    wave = modulus * 1.8e-6 * study.RMS_SLOPE / 4
    assert study.published_theta(1.8e-6) == pytest.approx(2 * study.SURFACE_ENERGY / wave, rel=0.15)


def test_the_table_is_whole_and_documented(table, study):
    assert np.all(table.result == "successful")
    assert [name for name in study.VARIABLES if not table[name].attrs["long_name"]] == []
    names = [str(name) for name in table.coords if table[name].dims == ("case",) and name != "case"]
    cases = list(zip(*(table[name].values for name in names), strict=True))
    assert len(set(cases)) == len(cases)
    assert np.all(table.resolution > 4)
    assert np.all(np.diff(table.dwell, axis=-1) >= 0)
    net = table.area - table.area.isel(after=0)
    assert np.allclose(net, table.closed - table.opened, atol=1e-12)
    assert np.all(table.shrinking <= table.patches)


def test_no_point_opens_without_adhesion(table):
    """Which is the theorem of arXiv 2511.19402, and what every evolution must obey."""
    without = table.isel(case=np.flatnonzero(table.theta.values == 0))
    assert without.sizes["case"] >= 12
    assert np.all(without.opened == 0)
    assert np.all(np.diff(without.area, axis=-1) >= 0)


@pytest.mark.nightly
def test_patches_are_those_of_another_package(study):
    contact, _ = study.contact_of(32, 0, 0.8, 4, 8, "relaxation", 0.1, 0.4)
    slope = float(js.surfaces.rms_slope(contact.grid, contact.heights))
    before = study.fresh(contact, 0.04 * slope)
    load = js.MeanPressure(jnp.array([0.04, 0.04]) * slope)
    run = js.evolve(contact, load, [0.0, 10.0], initial=before, fields=True)
    now = study.touching(run)
    # On three copies along each side every patch of the periodic surface is whole somewhere.
    copies, _ = label(np.tile(now[0].reshape(32, 32), (3, 3)))
    middle = np.unique(copies[32:64, 32:64])
    whole = {frozenset(map(tuple, np.argwhere(copies == each) % 32)) for each in middle[1:]}
    sizes = study.patch_sizes(run, now)
    assert sorted(sizes[0]) == sorted(map(len, whole))
    assert np.all(sizes.sum(axis=1) <= now.sum(axis=1))


@pytest.mark.nightly
@pytest.mark.parametrize("theta", [0.0, 0.1])
def test_a_stored_area_is_computed_again(table, study, theta):
    case = study.STANDARD | {"seed": 0, "theta": theta, "length": study.LENGTHS[theta]}
    case |= {"spectrum": "relaxation"}
    rows = np.all([table[name].values == value for name, value in case.items()], axis=0)
    stored = table.isel(case=np.flatnonzero(rows)[0])
    found = study.two_steps(**case)
    assert np.abs(found.area.values - stored.area.values).max() * 64**2 <= 1.5

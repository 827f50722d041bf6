import itertools
import warnings

import jax
import numpy as np
import pytest

import jaxstab as js
from jaxstab.lab.report_parts import parts
from jaxstab.lab.report_results import Arguments, results_of


def scan(periodic=True):
    """A wave of 16 x 12 points on 2 x 1.5 µm, with a tilt and a hole."""
    grid = js.Grid((16, 12), (2.0, 1.5))
    heights = np.array(js.surfaces.sinusoid(grid, 0.1, waves=(2, 1)))
    heights += 0.3 * np.linspace(0, 1, 16)[:, None]
    heights[4, 5] = np.nan
    return js.surfaces.Topography(grid, heights, "µm")


def test_a_report_is_made_in_double_precision_and_names_its_call(tmp_path, monkeypatch):
    made = []

    def interrupt(contact, _):
        made.append(contact)
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxstab.lab.report_results.loaded_states", interrupt)
    file = tmp_path / "wave.html"
    with jax.enable_x64(False), pytest.warns(UserWarning, match="points were missing"):
        surface = scan()
        with pytest.raises(KeyboardInterrupt):
            js.lab.report(
                surface,
                1e6,
                0.05,
                file,
                range=4e-7,
                detrend=1,
                wording=js.lab.Wording(title="A <wave>"),
            )
        assert not jax.config.jax_enable_x64
    (contact,) = made
    assert contact.heights.dtype == contact.solid.youngs_modulus.dtype == "float64"
    text = file.read_text()
    assert "<h1>A &lt;wave&gt;</h1>" in text
    assert "This page is not complete" in text and "0.521 % of the points were missing" in text
    call = "js.lab.report(scan, youngs_modulus=1000000.0, surface_energy=0.05, poisson_ratio=0.5, "
    assert call + "range=4e-07, size=16, detrend=1)" in text


@pytest.mark.nightly
def test_a_report_on_a_soft_metal_is_of_the_surface_that_is_left():
    arguments = Arguments(1e9, 0.05, 0.3, 4e-7, None, 0, "as_is", 2e7)
    with jax.enable_x64(True), warnings.catch_warnings(action="ignore"):
        *_, before, results = itertools.islice(results_of(scan(), arguments), 3)
        pressed = before.states[-1].equilibrium
        left = results.contact.after(pressed).elastic
        pull_off = js.pull_off(left)
    assert 0 < pressed.yielded_area < pressed.contact_area
    assert pressed.pressure.max() <= 2e7 * (1 + 1e-6)
    np.testing.assert_allclose(results.pull_off.load.value, pull_off.load.value, rtol=1e-6)
    text = "".join(parts(arguments, results, [], str))
    assert "hardness H" in text and "20 MPa" in text and "yielding" in text
    assert "No viscosity" in text


@pytest.mark.parametrize(
    ("file", "error", "message"),
    [
        ("there.html", FileExistsError, "there.html exists"),
        ("page.pdf", ValueError, "page.pdf has no ending"),
        ("nowhere/page.html", FileNotFoundError, "nowhere does not exist"),
    ],
)
def test_a_page_that_cannot_be_written_is_refused_before_the_work(file, error, message, tmp_path):
    (tmp_path / "there.html").touch()
    with pytest.raises(error, match=message):
        js.lab.report(None, 1e6, 0.05, tmp_path / file)


def test_a_scan_without_a_unit_has_no_report(tmp_path):
    grid = js.Grid((16, 12))
    surface = js.surfaces.Topography(grid, np.zeros((16, 12)))
    with warnings.catch_warnings(), pytest.raises(ValueError, match="has no unit of length"):
        js.lab.report(surface, 1e6, 0.05, tmp_path / "page.html")

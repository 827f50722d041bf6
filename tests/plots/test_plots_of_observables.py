"""Figures of patches, flow and distributions."""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.stats import norm

import jaxstab as js
from jaxstab import plots

NONE = js.potentials.NoAdhesion()


def state_of(potential, load, unit="m"):
    grid = js.Grid((32, 16), (2e-5, 1e-5))
    heights = js.surfaces.self_affine(
        grid, jax.random.key(1), k_low=1, k_rolloff=1, k_high=4, rms_height=2e-7
    )
    contact = js.Contact(js.HalfSpace(grid, 1e9), heights, potential, unit=unit)
    return contact, js.equilibrate(contact, load)


@pytest.fixture(scope="module")
def rough():
    return state_of(NONE, js.MeanPressure(1e7))


@pytest.fixture(scope="module")
def adhesive():
    return state_of(js.potentials.Exponential(0.2, 2e-7), js.MeanPressure(1e7))


@pytest.fixture(scope="module")
def line():
    grid = js.Grid((64,), (2.0,))
    heights = 0.1 * jnp.cos(2 * jnp.pi * 3 * jnp.arange(64) / 64)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, NONE)
    return contact, js.equilibrate(contact, js.MeanGap(0.05))


def labels_of(axes):
    return axes.get_xlabel(), axes.get_ylabel()


@pytest.mark.nightly
def test_patches_have_a_colour_each_and_a_title(rough, line):
    _, given = plt.subplots()
    axes = plots.patches(*rough, axes=given)
    assert axes is given
    assert labels_of(axes) == ("x [µm]", "y [µm]")
    found = js.patches(*rough)
    assert axes.get_title().startswith(f"{int(found.number)} patch")
    image = axes.images[0].get_array()
    np.testing.assert_array_equal(image > 0, np.asarray(rough[1].in_contact).T)
    largest = np.asarray(found.labels).T == 1
    assert set(image[largest].tolist()) == {1}
    axes = plots.patches(*line)
    assert axes.get_title() == "3 patches"
    assert axes.get_xlabel() == "x [length]"


def test_a_percolating_patch_is_named(rough):
    contact, _ = rough
    full = js.equilibrate(contact, js.MeanPressure(1e9))
    assert plots.patches(contact, full).get_title() == "1 patch, percolating along x and y"


def test_a_flow_shows_flux_lines_and_contact(rough):
    contact, state = rough
    leakage = js.leakage(contact, state)
    axes = plots.flow(contact, leakage, state)
    assert labels_of(axes) == ("x [µm]", "y [µm]")
    assert axes.get_title() == "pressure falls along x"
    flux, touches = axes.images
    size = np.hypot(*[(f + np.roll(f, 1, i)) / 2 for i, f in enumerate(leakage.flux[0])])
    np.testing.assert_allclose(flux.get_array().filled(0), size.T)
    assert touches.get_array().count() == state.in_contact.sum()
    assert "m³" in axes.child_axes[0].get_ylabel()
    assert len(axes.collections) == 1
    assert plots.flow(contact, leakage, along="y").get_title() == "pressure falls along y"
    full = js.equilibrate(contact, js.MeanPressure(1e9))
    axes = plots.flow(contact, js.leakage(contact, full), full)
    assert axes.get_title() == "nothing flows along x"


def test_densities_of_pressures_and_gaps_add_up_to_one(rough):
    contact, state = rough
    share = float(state.contact_area)

    def integral(axes):
        values, edges, _ = axes.patches[0].get_data()
        return np.sum(values * np.diff(edges))

    axes = plots.distribution(contact, state)
    assert labels_of(axes) == ("elastic pressure p [MPa]", "density [1/Pa]")
    np.testing.assert_allclose(integral(axes), share, rtol=1e-9)
    axes = plots.distribution(contact, state, "gap", bins=7)
    assert labels_of(axes) == ("gap g [nm]", "density [1/m]")
    np.testing.assert_allclose(integral(axes), 1 - share, rtol=1e-9)


def test_perssons_curve_is_the_difference_of_two_normal_densities(rough, adhesive):
    axes = plots.distribution(*rough)
    (curve,) = axes.lines
    assert curve.get_label() == "Persson, random surface"
    p0, rms = float(rough[1].mean_pressure), float(rough[0].conforming_pressure)
    pressures = np.asarray(curve.get_xdata())
    density = norm.pdf(pressures, p0, rms) - norm.pdf(pressures, -p0, rms)
    np.testing.assert_allclose(curve.get_ydata(), density, atol=1e-12 / rms)
    axes = plots.distribution(*adhesive)
    assert not axes.lines
    assert [text.get_text() for text in axes.get_legend().texts] == ["in contact", "apart"]
    assert axes.get_yscale() == "log"


def test_what_cannot_be_drawn_is_said(rough, line):
    contact, state = rough
    with pytest.raises(ValueError, match="choose one of pressure, gap"):
        plots.distribution(contact, state, "reaction")
    with pytest.raises(ValueError, match="bins is 0"):
        plots.distribution(contact, state, bins=0)
    with pytest.raises(TypeError, match="Equilibrium is no leakage"):
        plots.flow(contact, state)
    leakage = js.leakage(contact, state)
    with pytest.raises(ValueError, match="along is 'z': choose one of x, y"):
        plots.flow(contact, leakage, along="z")
    with pytest.raises(ValueError, match="use the contact that it came from"):
        plots.flow(line[0], leakage)

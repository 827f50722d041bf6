import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxstab as js
from jaxstab import plots
from jaxstab.core.units import NO_UNITS
from jaxstab.plots import style


@pytest.mark.parametrize("kind", ["state", "line"])
def test_with_both_units_no_figure_names_a_dimension(kind, request):
    contact, equilibrium, pair = request.getfixturevalue(kind)
    known = js.Contact(
        contact.solid, contact.heights, contact.potential, unit="um", pressure_unit="MPa"
    )
    axes = plots.pressure(known, equilibrium)
    (bar,) = axes.child_axes or [axes]
    assert bar.get_ylabel() == "elastic pressure p [MPa]"
    assert plots.mode(known, pair).get_title().endswith(" MPa/µm")
    axes = plots.distribution(known, equilibrium)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("elastic pressure p [MPa]", "density [1/MPa]")
    axes = plots.mode(known, pair)
    assert (axes.child_axes or [axes])[0].get_ylabel() == "mode of unit norm"


@pytest.fixture(scope="module")
def pdms():
    """A PDMS-like contact in metres, pascals and joules per square metre, over a load."""
    grid = js.Grid(32, (50e-6, 50e-6))
    heights = js.surfaces.self_affine(grid, jax.random.key(1), k_high=8, rms_height=0.5e-6)
    law = js.potentials.Exponential(0.04, 0.5e-6)
    contact = js.Contact(js.HalfSpace(grid, 2e6, 0.5), heights, law, unit="m")
    return contact, js.sweep(contact, js.MeanGap(jnp.array([0.5e-6, 1e-6])))


def ticks(axis):
    """Return the places of an axis' ticks and the numbers written there."""
    places = axis.get_majorticklocs()
    texts = axis.get_major_formatter().format_ticks(places)
    return places, [float(text.replace("\u2212", "-")) for text in texts]


@pytest.mark.nightly
def test_in_metres_lengths_are_micrometres_and_pressures_kilopascals(pdms):
    contact, sweep = pdms
    state = sweep[0]
    axes = plots.pressure(contact, state)
    (bar,) = axes.child_axes
    assert axes.get_xlabel() == "x [µm]" and axes.get_ylabel() == "y [µm]"
    assert bar.get_ylabel() == "elastic pressure p [kPa]"
    # Data stay in metres and pascals.
    np.testing.assert_array_equal(axes.images[0].get_array(), state.equilibrium.pressure.T)
    for axis, unit in ((axes.xaxis, 1e-6), (bar.yaxis, 1e3)):
        places, texts = ticks(axis)
        np.testing.assert_allclose(texts, places / unit, rtol=1e-6, atol=1e-9)
    title = plots.mode(contact, state.stability.cone).get_title()
    number, unit = title.removeprefix("$\\lambda$ = ").split(" ")
    prefix = {"G": 1e9, "T": 1e12}[unit[0]]
    assert unit[1:] == "Pa/m"
    np.testing.assert_allclose(float(number) * prefix, state.stability.cone.eigenvalue, rtol=1e-3)


def test_every_curve_reads_in_si_units(pdms):
    contact, sweep = pdms
    axes = plots.stability_curve(sweep)
    assert axes.get_xlabel() == "mean gap $g_0$ [µm]"
    assert axes.get_ylabel() == "mean pressure $p_0$ [kPa]"
    assert plots.stability_curve(sweep, "energy").get_ylabel() == "energy [pJ]"
    gaps = jnp.linspace(0, 9e-7, 9)
    axes = plots.potential(contact.potential, gaps, unit="m")
    assert axes.get_xlabel() == "gap g [nm]"
    assert axes.get_ylabel() == "energy per area f(g) [mJ/m²]"
    assert plots.force(contact.potential, gaps, unit="m").get_ylabel() == "attraction f'(g) [kPa]"
    assert plots.force(contact.potential, gaps).get_ylabel() == "attraction f'(g) [pressure]"
    rings = js.surfaces.power_spectrum(contact.grid, contact.heights)
    assert plots.spectrum(rings, unit="m").get_ylabel() == "power spectral density [m⁴]"


def test_a_formatter_of_the_user_stays_on_an_axis_whose_unit_needs_no_prefix():
    _, axes = plt.subplots()
    axes.set_ylim(1.0, 5.0)
    axes.yaxis.set_major_formatter(lambda value, _: f"<{value:g}>")
    style.label_axis(axes.yaxis, "gap [length]", NO_UNITS)
    assert axes.yaxis.get_major_formatter()(2.0, 0) == "<2>"

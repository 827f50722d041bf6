import re
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import rough_contact

import jaxstab as js
from jaxstab.contact import pinning_error

COARSE = js.potentials.Exponential(surface_energy=1e-2, length=0.1)
LOAD = js.MeanGap(0.2)


def test_the_papers_last_figure_is_not_resolved_by_its_grid():
    contact = rough_contact(256, COARSE, youngs_modulus=1e-3)
    shortest_wave = 1e-3 / 2 * np.pi * 256 * np.sqrt(2)
    assert contact.resolution == pytest.approx(shortest_wave / 1.0)
    assert contact.resolution == pytest.approx(0.57, abs=0.005)


def test_the_grid_that_would_do_is_named_and_does():
    contact = rough_contact(32, COARSE, youngs_modulus=2e-3)
    with pytest.warns(
        js.exceptions.ResolutionWarning, match=r"32 x 32 points.*0\.142 of.*256 x 256 would do"
    ):
        js.equilibrate(contact, LOAD, throw=False)
    finer = rough_contact(256, COARSE, youngs_modulus=2e-3)
    assert contact.resolution < 1 < finer.resolution
    assert finer.resolution < 2


@pytest.mark.parametrize("law", [COARSE, js.potentials.NoAdhesion()])
def test_nothing_is_said_of_grids_that_do_and_inside_transformations(law):
    fine = rough_contact(16, law)
    coarse = rough_contact(16, COARSE, youngs_modulus=1e-3)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        js.equilibrate(fine, LOAD)
        jax.eval_shape(lambda contact: js.equilibrate(contact, LOAD, throw=False), coarse)
    assert not said


def test_a_solid_that_no_grid_would_resolve_is_told_apart():
    grid = js.Grid(16)
    foundation = js.solids.Spectral(grid, lambda q: 1e-3 + 0 * q)
    contact = js.Contact(foundation, rough_contact(16, COARSE).heights, COARSE)
    with warnings.catch_warnings():
        # Before anything is solved.
        warnings.simplefilter("error", js.exceptions.ResolutionWarning)
        with pytest.raises(js.exceptions.ResolutionWarning, match="No grid of a size"):
            js.equilibrate(contact, LOAD, throw=False)


def test_a_solid_with_a_stored_stiffness_is_not_told_that_no_grid_would_do():
    contact = rough_contact(16, COARSE, youngs_modulus=1e-3)
    stored = js.Contact(contact.solid.scaled(jnp.array(1.0)), contact.heights, COARSE)
    assert stored.resolution == pytest.approx(contact.resolution)
    with pytest.warns(
        js.exceptions.ResolutionWarning, match=r"artefacts\. Use a finer grid, or a weaker or"
    ):
        js.equilibrate(stored, LOAD, throw=False)


@pytest.mark.nightly
def test_jumps_need_more_and_are_told_how_far_they_may_be_off():
    law = js.potentials.Exponential(0.02, 0.02)
    contact = rough_contact(32, law, rms_height=0.05)
    assert 1 < contact.resolution < 2
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        js.equilibrate(contact, LOAD)
    assert not said
    load = js.MeanGap(jnp.array([0.3, 0.2]))
    with pytest.warns(
        js.exceptions.ResolutionWarning, match=r"be off by 10 %. A grid of 128 x 128 would"
    ):
        js.follow(contact, load)


@pytest.mark.parametrize("stiffness", [None, 1.0])
def test_a_pull_off_warns_once_with_the_range_that_the_grid_resolves(stiffness):
    grid = js.Grid((32,), (1.0,))
    heights = 0.05 * jnp.cos(2 * jnp.pi * grid.coordinates[0])

    def contact(length):
        law = js.potentials.Exponential(0.02, length)
        return js.Contact(js.HalfSpace(grid, 1.0), heights, law)

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        js.pull_off(contact(0.01), spring=stiffness, throw=False)
    (told,) = [warning for warning in told if warning.category is js.exceptions.ResolutionWarning]
    factor = float(re.search(r"a range (\S+) times as long", str(told.message))[1])
    with warnings.catch_warnings(record=True) as longer:
        warnings.simplefilter("always")
        js.pull_off(contact(factor * 0.01), spring=stiffness, throw=False)
    assert not [
        warning for warning in longer if warning.category is js.exceptions.ResolutionWarning
    ]


@pytest.mark.nightly
def test_a_sweep_warns_once():
    coarse = rough_contact(16, COARSE, youngs_modulus=1e-3)
    with pytest.warns(js.exceptions.ResolutionWarning) as told:
        js.sweep(coarse, js.MeanGap(jnp.array([0.3, 0.2])), throw=False)
    assert (
        len([warning for warning in told if warning.category is js.exceptions.ResolutionWarning])
        == 1
    )


@pytest.mark.parametrize(
    "law",
    [
        js.potentials.Exponential(0.02, 0.01),
        js.potentials.Gaussian(0.02, 0.01),
        js.potentials.Dugdale(0.02, 0.01),
        js.potentials.LennardJones(0.02, 0.01),
    ],
)
@pytest.mark.parametrize("resolution", [4, 1.0])
def test_a_law_with_the_resolved_range_has_the_resolution(law, resolution):
    grid = js.Grid((32,), (1.0,))
    contact = js.Contact(js.Layer(grid, 1.0, 0.3, 0.1), jnp.zeros(32), law)
    length = js.resolved_range(contact, resolution)
    assert length > law.length
    resolved = eqx.tree_at(lambda law: law.length, law, length)
    longer = js.Contact(contact.solid, contact.heights, resolved)
    # The largest curvature is known at gaps of 64 an octave.
    assert longer.resolution == pytest.approx(float(resolution), rel=1e-3)


def test_the_resolved_range_of_an_exponential_law_is_known_and_has_derivatives():
    grid = js.Grid((32,), (1.0,))

    def shortest(work):
        law = js.potentials.Exponential(work, 0.01)
        return js.resolved_range(js.Contact(js.HalfSpace(grid, 1.0), jnp.zeros(32), law))

    # K = pi E* / (2 dx), |f''| = w / rho^2.
    expected = np.sqrt(4 * 0.02 / (np.pi / (2 / 32)))
    value, slope = jax.jit(jax.value_and_grad(shortest))(0.02)
    assert value == pytest.approx(expected) and slope == pytest.approx(expected / 0.04)


@pytest.mark.nightly
def test_a_law_without_one_range_is_told_the_factor():
    grid = js.Grid((32,), (1.0,))
    solid, exponential = js.HalfSpace(grid, 1.0), js.potentials.Exponential(0.02, 0.01)
    varying = js.potentials.Varying(
        eqx.tree_at(lambda x: x.length, exponential, jnp.full(32, 0.01))
    )
    for law in (lambda gap: -0.02 * jnp.exp(-100 * gap), varying, exponential + exponential):
        contact = js.Contact(solid, jnp.zeros(32), law)
        factor = float(jnp.sqrt(4 / contact.resolution))
        with pytest.raises(TypeError, match=rf"multiply the lengths of your law by {factor:.6g}"):
            js.resolved_range(contact)
        # In a trace there is no number.
        with pytest.raises(TypeError, match=r"multiply the lengths of your law by f64\[\]"):
            jax.jit(js.resolved_range)(contact)
    with pytest.raises(ValueError, match=r"resolution is -1"):
        js.resolved_range(js.Contact(solid, jnp.zeros(32), exponential), -1)
    with pytest.raises(TypeError, match="HalfSpace"):
        js.resolved_range(solid)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("smoothing", [1e-2, 1e-3, 1e-4])
def test_an_edge_of_the_attraction_counts_however_narrow(smoothing, dtype):
    law = js.potentials.Dugdale(surface_energy=1e-2, length=0.1, smoothing=smoothing)
    contact = rough_contact(16, law)
    contact = js.Contact(contact.solid, contact.heights.astype(dtype), law)
    attraction = 1e-2 / 0.1 / (smoothing * np.logaddexp(0, 1 / smoothing))
    edge = attraction / (4 * smoothing * 0.1)
    expected = np.pi / 2 * 16 * np.sqrt(2) / edge
    assert contact.resolution == pytest.approx(expected, rel=1e-4)
    compiled = jax.jit(lambda contact: contact.resolution)(contact)
    assert compiled == pytest.approx(expected, rel=1e-4)


@pytest.mark.nightly
def test_the_narrowest_edge_counts_where_the_law_varies():
    lengths = jnp.full((16, 16), 0.1).at[3, 5].set(0.05)
    law = js.potentials.Varying(js.potentials.Dugdale(1e-2, lengths, smoothing=1e-3))
    contact = rough_contact(16, law)
    edge = 1e-2 / (4e-3 * 0.05**2)
    assert contact.resolution == pytest.approx(np.pi / 2 * 16 * np.sqrt(2) / edge, rel=1e-4)


@pytest.mark.nightly
def test_a_law_that_is_undefined_far_from_the_surface_has_a_resolution():
    # x log x is NaN where x underflows, at gaps a thousand times the size of the grid.
    def law(gap):
        x = jnp.exp(-gap / 0.1)
        return 1e-2 * x * (jnp.log(x) - 1)

    contact = rough_contact(16, law)
    # f = -w (1 + s) exp(-s), f'' = w (1 - s) exp(-s) / rho^2, largest at s = 0.
    assert contact.resolution == pytest.approx(np.pi / 2 * 16 * np.sqrt(2) * 0.01 / 1e-2, rel=1e-6)
    state = js.equilibrate(contact, LOAD)
    smooth = js.Contact(
        contact.solid, contact.heights, lambda g: -1e-2 * (1 + g / 0.1) * jnp.exp(-g / 0.1)
    )
    assert state.mean_pressure == pytest.approx(js.equilibrate(smooth, LOAD).mean_pressure)


def test_the_error_by_pinning_is_that_of_the_table_of_the_resolution():
    grid = js.Grid((32, 32))
    law = js.potentials.Exponential(0.01, 0.2)
    contact = js.Contact(js.HalfSpace(grid, 1.0), np.zeros(grid.shape), law)
    length = float(js.resolved_range(contact, 8))
    resolved = js.Contact(contact.solid, contact.heights, js.potentials.Exponential(0.01, length))
    assert float(pinning_error(resolved)) == pytest.approx(0.003, rel=0.05)

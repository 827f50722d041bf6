"""Contact under laws that repel at small gaps: the gap of the largest attraction, dense algebra."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js

LINE = js.Grid((64,), 1.0)
WAVE = 0.05 * jnp.cos(2 * jnp.pi * LINE.coordinates[0])
Z0 = 0.01
# Where f'' of the 9-3 law is zero: 90 (z0 / g)^11 = 36 (z0 / g)^5.
PEAK = Z0 * 2.5 ** (1 / 6)


def soft_wall(gap):
    """An attraction, and a spring where the gap is below 0.02: no gap is zero."""
    return -0.002 * jnp.exp(-gap / 0.01) + 200.0 * jnp.maximum(0.02 - gap, 0) ** 2


def solved(law, load, heights=WAVE, solid=js.HalfSpace):
    contact = js.Contact(solid(LINE, 1.0), heights, law)
    return contact, js.equilibrate(contact, load)


LENNARD_JONES = js.potentials.LennardJones(0.002, Z0)
CASES = [
    (LENNARD_JONES, PEAK, js.HalfSpace),
    (LENNARD_JONES, PEAK, js.FreeHalfSpace),
    (soft_wall, 0.02, js.HalfSpace),
]


@pytest.mark.nightly
@pytest.mark.parametrize(("law", "edge", "kind"), CASES)
def test_contact_ends_at_the_largest_attraction_and_conducts_as_dense_algebra_says(law, edge, kind):
    contact, state = solved(law, js.MeanPressure(0.0), solid=kind)
    mask = np.asarray(state.gap) < edge
    assert state.gap.min() > 0
    assert 8 < mask.sum() < 32
    np.testing.assert_array_equal(state.in_contact, mask)
    assert state.contact_area == mask.mean()
    assert js.patches(contact, state).area == mask.mean()
    columns = np.asarray(jax.vmap(contact.solid.displacement)(jnp.eye(64)))
    pressure = np.linalg.solve(columns[np.ix_(mask, mask)], np.ones(mask.sum()))
    found = js.conductance(contact, state)
    np.testing.assert_allclose(found.incremental_stiffness, pressure.sum() / 64, rtol=1e-8)
    compiled = eqx.filter_jit(js.conductance)(contact, state)
    np.testing.assert_allclose(compiled.conductance, found.conductance, rtol=1e-12)


def test_a_core_of_short_range_has_the_contact_of_johnsons_wave():
    half, work = jnp.pi * 0.15, 1e-4
    heights = 0.02 * jnp.cos(2 * jnp.pi * LINE.coordinates[0])
    alpha = jnp.sqrt(2 * work) / (jnp.pi * 0.02)
    pressure = jnp.pi * 0.02 * (jnp.sin(half) ** 2 - alpha * jnp.sqrt(jnp.tan(half)))
    law = js.potentials.LennardJones(work, 0.002)
    state = solved(law, js.MeanPressure(pressure), heights)[1]
    # One point at each edge.
    assert abs(state.contact_area - 0.3) <= 2 / 64
    assert jnp.mean(state.pressure > 0) < 0.25, "the edges are in tension"


def test_flat_surfaces_at_the_minimum_of_their_law_are_in_full_contact():
    contact, state = solved(js.potentials.LennardJones(0.002, Z0), js.MeanGap(Z0), 0 * WAVE)
    assert state.contact_area == 1
    assert js.conductance(contact, state).conductance == jnp.inf
    apart = js.equilibrate(contact, js.MeanGap(2 * Z0))
    assert apart.contact_area == js.conductance(contact, apart).conductance == 0


@pytest.mark.nightly
def test_a_range_that_varies_has_an_edge_at_each_point():
    lengths = jnp.where(LINE.coordinates[0] < 0.5, Z0, 2 * Z0)
    law = js.potentials.Varying(js.potentials.LennardJones(0.002 + 0 * lengths, lengths))
    _, state = solved(law, js.MeanGap(0.06))
    np.testing.assert_array_equal(state.in_contact, state.gap < lengths * 2.5 ** (1 / 6))
    assert state.contact_area > 0


@pytest.mark.parametrize(
    ("law", "edge"),
    [
        (LENNARD_JONES, PEAK),
        (js.potentials.CutOff(LENNARD_JONES, 0.05), PEAK),
        (lambda g: 0.5 * jnp.maximum(0.02 - g, 0) ** 3, 0.02),
        (lambda g: 2 * jnp.exp(-g / 0.01) - 2 * jnp.exp(-g / 0.02), 0.04 * np.log(2)),
        (js.potentials.Exponential(0.002, 0.01), 0),
        (js.potentials.Gaussian(0.002, 0.01), 0),
        (js.potentials.Dugdale(0.002, 0.01), 0),
        (js.potentials.NoAdhesion(), 0),
        (lambda g: -0.002 * jnp.exp(-g / 0.01) + 1e-4 * jnp.exp(-g / 0.1), 0),
    ],
)
def test_only_a_law_that_repels_at_zero_gap_moves_the_edge_of_contact(law, edge):
    found = js.Contact(js.HalfSpace(LINE, 1.0), WAVE, law).profile
    assert edge <= found.contact_gap <= 1.025 * edge
    assert not found.repels_throughout


@pytest.mark.nightly
@pytest.mark.parametrize("law", [lambda g: 1.0 * jnp.exp(-g / 0.01), lambda g: 1e-9 / g**3])
def test_a_law_that_only_repels_has_no_contact_without_a_closed_gap(law):
    contact, state = solved(law, js.MeanGap(0.06))
    assert jnp.isnan(state.contact_area)
    for observable in (js.patches, js.conductance):
        with pytest.raises(ValueError, match=r"repels at every gap.*Give a law"):
            observable(contact, state)
    assert jnp.isnan(eqx.filter_jit(js.conductance)(contact, state).conductance)
    assert js.leakage(contact, state).permeability[0, 0] > 0


def test_contact_under_a_core_closes_the_gap_to_a_fluid():
    grid = js.Grid(16, 1.0)
    x, _ = grid.coordinates
    contact = js.Contact(js.HalfSpace(grid, 1.0), 0.05 * jnp.cos(2 * jnp.pi * x), LENNARD_JONES)
    state = js.equilibrate(contact, js.MeanGap(0.06))
    blocked = js.leakage(contact, state).permeability
    assert blocked[0, 0] == blocked[0, 1] == 0
    # Along the other side all channels lie side by side.
    channels = jnp.where(state.gap < PEAK, 0, state.gap**3 / 12)
    np.testing.assert_allclose(blocked[1, 1], jnp.mean(channels), rtol=1e-8)


@pytest.mark.nightly
def test_a_core_leaves_every_point_free_to_move_in_a_stability_analysis():
    contact, state = solved(LENNARD_JONES, js.MeanGap(0.06))
    assert state.contact_area > 0
    found = js.assess_stability(contact, state)
    hessian = jax.vmap(contact.hessian(state.gap))(jnp.eye(64))
    projector = np.eye(64) - 1 / 64
    lowest = np.linalg.eigvalsh(projector @ np.asarray(hessian) @ projector + 1e6 / 64)[0]
    np.testing.assert_allclose(found.cone.eigenvalue, lowest, rtol=1e-6)
    assert found.complementarity == jnp.inf

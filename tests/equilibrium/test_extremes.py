"""States that a sweep of loads meets at its ends, and laws that hold surfaces apart themselves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from brute_force import check_optimality, smallest_on_critical_cone
from problems import Linear, lennard_jones_force, rough_contact

import jaxstab as js

# Tests on one grid share their programs. Those with a core have one of 16 x 16 points.
N = 32


@pytest.mark.parametrize("pressure", [-0.4, 0.0, 0.5, 50.0])
@pytest.mark.parametrize("youngs_modulus", [1e-3, 1.0, 1e3])
def test_flat_surfaces_settle_where_lennard_jones_says(pressure, youngs_modulus):
    grid = js.Grid(16)
    law = js.potentials.LennardJones(0.02, 0.05)
    contact = js.Contact(js.HalfSpace(grid, youngs_modulus), jnp.zeros(grid.shape), law)
    exact = scipy.optimize.brentq(
        lambda gap: lennard_jones_force(gap, 0.02, 0.05) + pressure, 0.02, 0.058, xtol=1e-15
    )
    by_pressure = js.equilibrate(contact, js.MeanPressure(pressure))
    np.testing.assert_allclose(by_pressure.gap, exact, rtol=1e-8)
    by_gap = js.equilibrate(contact, js.MeanGap(exact))
    np.testing.assert_allclose(by_gap.gap, exact, rtol=1e-12)
    np.testing.assert_allclose(by_gap.mean_pressure, pressure, rtol=1e-8, atol=1e-10)


def test_a_core_holds_rough_surfaces_apart():
    contact = rough_contact(16, js.potentials.LennardJones(1e-2, 0.05))
    for load in (js.MeanGap(0.15), js.MeanGap(0.02), js.MeanPressure(0.2)):
        equilibrium = js.equilibrate(contact, load)
        assert equilibrium.gap.min() > 0
        assert equilibrium.contact_area == jnp.mean(equilibrium.gap < 0.05 * 2.5 ** (1 / 6)) > 0
        check_optimality(contact, equilibrium, 1e-8)
        assert equilibrium.num_steps < 60


@pytest.mark.parametrize("width", [0.0, 1e-3, 1e-6, 1e-15, 1e-30])
def test_a_start_inside_a_core_is_lifted_off_it(width):
    contact, load = rough_contact(16, js.potentials.LennardJones(1e-2, 0.05)), js.MeanGap(0.1)
    reference = js.equilibrate(contact, load)
    touching = js.equilibrate(rough_contact(16, js.potentials.NoAdhesion()), load)
    lifted = js.equilibrate(contact, load, initial=touching.gap + width)
    np.testing.assert_allclose(lifted.gap, reference.gap, atol=1e-8)
    assert js.equilibrate(contact, load, initial=reference).num_steps == 0


@pytest.mark.nightly
def test_a_law_with_a_core_works_in_single_precision_and_si_units():
    grid = js.Grid(16, 1e-6)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=2e-9)
    law = js.potentials.LennardJones(0.05, 3e-9)
    double = js.Contact(js.HalfSpace(grid, 1e9), heights, law)
    single = js.Contact(js.HalfSpace(grid, 1e9), heights.astype(jnp.float32), law)
    for load in (js.MeanPressure(1e7), js.MeanGap(4e-9)):
        reference = js.equilibrate(double, load)
        np.testing.assert_allclose(js.equilibrate(single, load).gap, reference.gap, atol=1e-11)


SYMMETRIC = [
    (lambda grid: jnp.zeros(grid.shape), js.potentials.Exponential(1.0, 0.1), 0.1),
    (lambda grid: js.surfaces.sinusoid(grid, 0.05), js.potentials.Exponential(0.3, 0.1), 0.1),
    (lambda grid: js.surfaces.paraboloid(grid, 2.0), js.potentials.Gaussian(0.3, 0.1), 0.2),
]


@pytest.mark.parametrize(("surface", "law", "mean_gap"), SYMMETRIC)
def test_a_start_without_symmetry_leaves_the_saddle_that_symmetry_holds(surface, law, mean_gap):
    grid = js.Grid(16)
    contact = js.Contact(js.HalfSpace(grid, 1.0), surface(grid), law)
    load = js.MeanGap(mean_gap)
    saddle = js.equilibrate(contact, load)
    assert smallest_on_critical_cone(contact, saddle) < -0.01
    noise = jax.random.uniform(jax.random.key(0), saddle.gap.shape)
    minimum = js.equilibrate(contact, load, initial=saddle.gap * (1 + 1e-2 * noise))
    assert smallest_on_critical_cone(contact, minimum) > 0
    assert minimum.energy < saddle.energy


@pytest.mark.nightly
@pytest.mark.parametrize(
    "law", [js.potentials.NoAdhesion(), js.potentials.Exponential(0.01, 0.1)], ids=type
)
def test_full_contact_and_flat_surfaces_are_met_without_breaking(law):
    contact = rough_contact(N, law)
    for load in (js.MeanPressure(100.0), js.MeanPressure(1e6)):
        pressed = js.equilibrate(contact, load)
        assert pressed.in_contact.all()
        np.testing.assert_allclose(pressed.mean_pressure, load.value)
        check_optimality(contact, pressed, 1e-12)
    for mean_gap in (1e-12, 1e-8, 1e-5):
        closing = js.equilibrate(contact, js.MeanGap(mean_gap))
        assert 0.99 < closing.contact_area < 1
        check_optimality(contact, closing, 1e-8)
    flat = js.Contact(contact.solid, jnp.full((N, N), 0.3), law)
    for load in (js.MeanGap(0.1), js.MeanGap(1e-9)):
        np.testing.assert_allclose(js.equilibrate(flat, load).gap, load.value, rtol=1e-12)
    assert js.equilibrate(flat, js.MeanPressure(0.05)).in_contact.all()


@pytest.mark.parametrize("depth", [1e-5, 1e-7, 1e-9])
def test_the_last_contact_point_carries_what_its_own_stiffness_gives(depth):
    contact = rough_contact(N, js.potentials.NoAdhesion())
    summit = float(contact.heights.max())
    equilibrium = js.equilibrate(contact, js.MeanGap(summit - depth))
    assert equilibrium.in_contact.sum() == 1
    # The displacement under one pressed point, by superposition of waves.
    compliance = contact.solid.displacement(jnp.zeros((N, N)).at[0, 0].set(1.0))[0, 0]
    np.testing.assert_allclose(equilibrium.reaction.max() * compliance, depth, rtol=1e-3)
    parted = js.equilibrate(contact, js.MeanGap(summit + depth))
    assert not parted.in_contact.any()


@pytest.mark.parametrize("strength", [1e-10, 1e4, 1e8])
def test_adhesion_may_vanish_or_prevail(strength):
    contact = rough_contact(N, js.potentials.Exponential(strength, 0.1))
    load = js.MeanGap(0.05)
    equilibrium = js.equilibrate(contact, load)
    if strength < 1:
        bare = js.equilibrate(rough_contact(N, js.potentials.NoAdhesion()), load)
        np.testing.assert_allclose(equilibrium.gap, bare.gap, atol=1e-8)
    else:
        # The gap gathers in few points, so that the rest may close.
        assert equilibrium.contact_area > 0.9
    check_optimality(contact, equilibrium, 1e-8)


def gaps_off(one, other, rms_height):
    """Return how far two gaps are apart, in rms heights."""
    difference = np.asarray(one.gap, float) - np.asarray(other.gap, float)
    return np.sqrt(np.mean(difference**2)) / rms_height


@pytest.mark.parametrize("strength", [10.0, 1e2, 1e5])
@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_a_uniform_attraction_hides_no_imbalance(strength, dtype):
    """Held at a mean gap, the surface does not feel an attraction that is the same everywhere."""
    bare = rough_contact(N, js.potentials.NoAdhesion())
    # Within its range the attraction varies by a part of 5e-7.
    law = js.potentials.Dugdale(strength * 100, 100.0, 1 / 15)
    contact = js.Contact(bare.solid, bare.heights.astype(dtype), law)
    expected = js.equilibrate(bare, js.MeanGap(0.1))
    found = js.equilibrate(contact, js.MeanGap(0.1), throw=False)
    if found.result == "successful":
        # Rounding of the attraction alone moves points by such a part.
        assert gaps_off(found, expected, 0.1) < 1e-3 + strength * jnp.finfo(dtype).eps
    assert found.result == "successful" or (found.result == "stagnated" and dtype == jnp.float32)
    assert found.result == "successful" or strength > 1e2


@pytest.mark.parametrize("tension", [1.0, 1e6])
def test_a_tension_that_cancels_a_linear_law_hides_no_imbalance(tension):
    bare = rough_contact(N, js.potentials.NoAdhesion())
    contact = js.Contact(bare.solid, bare.heights, Linear(tension))
    expected = js.equilibrate(bare, js.MeanPressure(0.1))
    found = js.equilibrate(contact, js.MeanPressure(0.1 - tension))
    assert gaps_off(found, expected, 0.1) < 1e-5


@pytest.mark.parametrize(
    ("dtype", "unit"),
    [(jnp.float64, 1e-155), (jnp.float64, 1e200), (jnp.float32, 1e-30), (jnp.float32, 1e25)],
)
def test_pressures_in_any_unit_give_the_same_state_and_verdict(dtype, unit):
    def solve(unit):
        bare = rough_contact(N, js.potentials.Exponential(0.01 * unit, 0.1), unit)
        contact = js.Contact(bare.solid, bare.heights.astype(dtype), bare.potential)
        state = js.equilibrate(contact, js.MeanGap(0.1))
        return state, js.assess_stability(contact, state)

    expected, expected_stability = solve(1.0)
    found, stability = solve(unit)
    assert gaps_off(found, expected, 0.1) < 100 * jnp.finfo(dtype).eps
    assert found.num_steps == expected.num_steps
    np.testing.assert_allclose(found.mean_pressure / unit, expected.mean_pressure, rtol=1e-5)
    assert stability.verdict == expected_stability.verdict.name
    eigenvalue = stability.cone.eigenvalue / unit
    np.testing.assert_allclose(eigenvalue, expected_stability.cone.eigenvalue, rtol=1e-4)


@pytest.mark.parametrize(("dtype", "start"), [(jnp.float64, 1e307), (jnp.float32, 1e37)])
def test_a_start_of_any_size_meets_the_load(dtype, start):
    bare = rough_contact(N, js.potentials.Exponential(0.01, 0.1))
    contact = js.Contact(bare.solid, bare.heights.astype(dtype), bare.potential)
    found = js.equilibrate(contact, js.MeanGap(0.1), initial=jnp.full((N, N), start, dtype))
    np.testing.assert_allclose(found.gap.mean(), 0.1, rtol=100 * jnp.finfo(dtype).eps)
    assert gaps_off(found, js.equilibrate(bare, js.MeanGap(0.1)), 0.1) < 1e-3


@pytest.mark.parametrize(
    ("seed", "surface_energy", "length", "mean_gap"),
    [(42, 2.29, 1.2e-8, 4.4e-8), (3, 0.013, 4e-9, 5e-8), (19, 0.1, 8e-9, 4e-8)],
)
def test_in_single_precision_errors_cover_what_is_in_doubt(seed, surface_energy, length, mean_gap):
    grid = js.Grid(N, 1e-5)
    heights = js.surfaces.self_affine(grid, jax.random.key(seed), k_high=8, rms_height=1e-7)
    pairs = []
    for dtype in (jnp.float64, jnp.float32):
        law = js.potentials.Exponential(surface_energy, length)
        contact = js.Contact(js.HalfSpace(grid, 1e9, 0.3), heights.astype(dtype), law)
        state = js.equilibrate(contact, js.MeanGap(mean_gap))
        pairs.append(js.assess_stability(contact, state).critical)
    exact, found = pairs
    distance = abs(float(exact.eigenvalue) - float(found.eigenvalue))
    assert distance <= float(exact.error) + float(found.error)


@pytest.mark.parametrize(("dtype", "pressure"), [(jnp.float64, 1e-8), (jnp.float32, 1e-5)])
def test_a_light_pressure_is_carried_by_a_contact(dtype, pressure):
    bare = rough_contact(N, js.potentials.NoAdhesion())
    contact = js.Contact(bare.solid, bare.heights.astype(dtype), bare.potential)
    found = js.equilibrate(contact, js.MeanPressure(pressure))
    assert found.in_contact.any()
    np.testing.assert_allclose(found.reaction.mean(), pressure, rtol=1e-2)


def test_a_stiffness_out_of_range_is_refused():
    solid = js.HalfSpace(js.Grid(N, 1e9), 1e-32)
    heights = rough_contact(N, js.potentials.NoAdhesion()).heights * 1e9
    contact = js.Contact(solid, heights.astype(jnp.float32), js.potentials.NoAdhesion())
    found = js.equilibrate(contact, js.MeanPressure(1e-34), throw=False)
    assert found.result == "invalid_contact"


@pytest.mark.nightly
def test_a_long_line_in_single_precision_ends_where_double_precision_does():
    # Rounding of the gap alone leaves a residual of 3e-4 of the pressures here.
    grid = js.Grid((32768,))
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=16, rms_height=0.05)
    states = []
    for dtype in ("float32", "float64"):
        unit = jnp.ones((), dtype)
        solid = js.HalfSpace(js.Grid(grid.shape, unit), unit)
        law = js.potentials.Exponential(2e-3 * unit, 0.05 * unit)
        contact = js.Contact(solid, heights.astype(dtype), law)
        states.append(js.equilibrate(contact, js.MeanGap(0.05 * unit)))
    single, double = states
    assert single.gap.dtype == "float32"
    assert single.num_steps < 20
    np.testing.assert_allclose(single.mean_pressure, double.mean_pressure, rtol=1e-4)
    np.testing.assert_allclose(single.gap, double.gap, atol=1e-4 * heights.std())

"""States that a sweep of loads meets at its ends, and laws that hold surfaces apart themselves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from conftest import rough_contact, smallest_on_critical_cone
from test_equilibrium import check_optimality
from test_potentials import lennard_jones_force

import jaxstab as js


@pytest.mark.parametrize("pressure", [-0.4, 0.0, 0.5, 50.0])
@pytest.mark.parametrize("youngs_modulus", [1e-3, 1.0, 1e3])
def test_flat_surfaces_settle_where_lennard_jones_says(pressure, youngs_modulus):
    grid = js.Grid((16, 12))
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
    contact = rough_contact(64, js.potentials.LennardJones(1e-2, 0.05))
    for load in (js.MeanGap(0.15), js.MeanGap(0.02), js.MeanPressure(0.2)):
        equilibrium = js.equilibrate(contact, load)
        assert equilibrium.gap.min() > 0
        assert not equilibrium.in_contact.any()
        check_optimality(contact, equilibrium, 1e-8)
        assert equilibrium.num_steps < 60


@pytest.mark.parametrize("width", [0.0, 1e-3, 1e-6, 1e-15, 1e-30])
def test_a_start_inside_a_core_is_lifted_off_it(width):
    contact, load = rough_contact(32, js.potentials.LennardJones(1e-2, 0.05)), js.MeanGap(0.1)
    reference = js.equilibrate(contact, load)
    touching = js.equilibrate(rough_contact(32, js.potentials.NoAdhesion()), load)
    lifted = js.equilibrate(contact, load, initial=touching.gap + width)
    np.testing.assert_allclose(lifted.gap, reference.gap, atol=1e-8)
    assert js.equilibrate(contact, load, initial=reference).num_steps == 0


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


def test_the_residual_is_fine_where_the_displacement_is_large_and_even():
    contact = rough_contact(64, js.potentials.NoAdhesion())
    high = js.Contact(contact.solid, (contact.heights + 1e3).astype(jnp.float32), contact.potential)
    equilibrium = js.equilibrate(high, js.MeanGap(0.1))
    reference = js.equilibrate(contact, js.MeanGap(0.1))
    np.testing.assert_allclose(equilibrium.gap, reference.gap, atol=1e-3)


LAWS = [
    js.potentials.NoAdhesion(),
    js.potentials.Exponential(0.01, 0.1),
    js.potentials.Gaussian(0.01, 0.1),
    js.potentials.Dugdale(0.01, 0.1),
]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_full_contact_and_flat_surfaces_are_met_without_breaking(law):
    contact = rough_contact(32, law)
    for load in (js.MeanPressure(100.0), js.MeanPressure(1e6)):
        pressed = js.equilibrate(contact, load)
        assert pressed.in_contact.all()
        np.testing.assert_allclose(pressed.mean_pressure, load.value)
        check_optimality(contact, pressed, 1e-12)
    for mean_gap in (1e-12, 1e-8, 1e-5):
        closing = js.equilibrate(contact, js.MeanGap(mean_gap))
        assert 0.99 < closing.contact_area < 1
        check_optimality(contact, closing, 1e-8)
    flat = js.Contact(contact.solid, jnp.full((32, 32), 0.3), law)
    for load in (js.MeanGap(0.1), js.MeanGap(1e-9)):
        np.testing.assert_allclose(js.equilibrate(flat, load).gap, load.value, rtol=1e-12)
    assert js.equilibrate(flat, js.MeanPressure(0.05)).in_contact.all()


@pytest.mark.parametrize("depth", [1e-5, 1e-7, 1e-9])
def test_the_last_contact_point_carries_what_its_own_stiffness_gives(depth):
    contact = rough_contact(32, js.potentials.NoAdhesion())
    summit = float(contact.heights.max())
    equilibrium = js.equilibrate(contact, js.MeanGap(summit - depth))
    assert equilibrium.in_contact.sum() == 1
    # The displacement under one pressed point of 32 x 32, by superposition of waves.
    compliance = contact.solid.displacement(jnp.zeros((32, 32)).at[0, 0].set(1.0))[0, 0]
    np.testing.assert_allclose(equilibrium.reaction.max() * compliance, depth, rtol=1e-3)
    parted = js.equilibrate(contact, js.MeanGap(summit + depth))
    assert not parted.in_contact.any()


@pytest.mark.parametrize("strength", [1e-10, 1e4, 1e8])
def test_adhesion_may_vanish_or_prevail(strength):
    contact = rough_contact(32, js.potentials.Exponential(strength, 0.1))
    load = js.MeanGap(0.05)
    equilibrium = js.equilibrate(contact, load)
    if strength < 1:
        bare = js.equilibrate(rough_contact(32, js.potentials.NoAdhesion()), load)
        np.testing.assert_allclose(equilibrium.gap, bare.gap, atol=1e-8)
    else:
        # The gap gathers in few points, so that the rest may close.
        assert equilibrium.contact_area > 0.9
    check_optimality(contact, equilibrium, 1e-8)

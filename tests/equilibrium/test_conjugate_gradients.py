import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import check_optimality, periodic_stiffness, smallest_on_critical_cone
from problems import Linear, flat_contact, rough_contact

import jaxstab as js
from jaxstab.references import westergaard

# One size for most tests, so that they share programs.
N = 16
LAWS = [
    js.potentials.NoAdhesion(),
    js.potentials.Exponential(0.01, 0.1),
    js.potentials.Gaussian(0.02, 0.1),
]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
@pytest.mark.parametrize("mean_gap", [1e-3, 0.1, 1.0])
def test_it_finds_the_state_that_the_reference_solver_finds(law, mean_gap):
    contact, load = rough_contact(N, law), js.MeanGap(mean_gap)
    equilibrium = js.equilibrate(contact, load)
    reference = js.equilibrate(contact, load, js.solvers.PolonskyKeerRey())
    assert equilibrium.num_steps <= reference.num_steps
    np.testing.assert_allclose(equilibrium.gap, reference.gap, atol=1e-7)
    np.testing.assert_array_equal(equilibrium.in_contact, reference.in_contact)
    if equilibrium.in_contact.any():
        check_optimality(contact, equilibrium, 1e-7)


def random_problem(seed):
    """Return a contact and a load: any law, strengths over four decades, from closed to apart."""
    random = np.random.default_rng(seed)
    rms_height = 10 ** random.uniform(-2.5, -0.5)
    contact = rough_contact(N, js.potentials.NoAdhesion(), seed=seed, rms_height=rms_height)
    stress = float(contact.conforming_pressure) * 10 ** random.uniform(-2, 2)
    length = rms_height * 10 ** random.uniform(-1, 1)
    names = ("Exponential", "Gaussian", "Rational", "Dugdale", "LennardJones")
    law = getattr(js.potentials, names[seed % 5])(stress * length, length)
    load = js.MeanGap(rms_height * 10 ** random.uniform(-3, 0.7))
    return js.Contact(contact.solid, contact.heights, law), load


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
@pytest.mark.parametrize(
    "seed", [*range(10), *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(10, 30))]
)
def test_random_problems_end_at_a_minimum_by_way_of_falling_energies(seed):
    contact, load = random_problem(seed)
    equilibrium = js.equilibrate(contact, load)
    energies = np.asarray(equilibrium.history.values["energy"])
    energies = energies[np.isfinite(energies)]
    assert (np.diff(energies) <= 1e-12 * np.abs(energies).max()).all()
    final = float(contact.energy(equilibrium.gap) / contact.grid.cell_area)
    assert energies[-1] == pytest.approx(final, rel=1e-9, abs=1e-9 * np.abs(energies).max())

    stiffest = contact.solid.max_stiffness + jnp.max(jnp.abs(contact.curvature(equilibrium.gap)))
    assert smallest_on_critical_cone(contact, equilibrium) > -1e-8 * stiffest


def dense_steps(heights, energy, length, gap, number):
    """Return gaps after steps of the algorithm of Polonsky, Keer and Rey at a mean gap."""
    stiffness = periodic_stiffness(heights.shape, (1.0,), 1.0)
    stiffest = np.linalg.eigvalsh(stiffness)[-1]
    mean, direction, before = gap.mean(), 0 * gap, 0.0
    for _ in range(number):
        attraction = energy / length * np.exp(-gap / length)
        curvature = -attraction / length
        free = gap > 0
        net = stiffness @ (gap + heights) + attraction
        net -= net[free].mean()
        square = np.sum(net[free] ** 2)
        momentum = square / before if before else 0.0
        direction = free * (net / stiffest + momentum * direction)
        elastic = direction @ stiffness @ direction
        both = elastic + curvature @ direction**2
        gap = np.maximum(gap - net @ direction / (both if both > 0 else elastic) * direction, 0)
        pulled = (gap == 0) & (net < 0)
        # No attraction of this law stiffens.
        gap = np.where(pulled, -net / stiffest, gap)
        gap *= mean / gap.mean()
        before = 0.0 if pulled.any() else square
        yield gap, pulled.any()


def test_steps_of_the_reference_solver_are_the_dense_ones():
    x = 2 * np.pi * np.arange(N) / N
    heights = 0.1 * np.cos(x) + 0.05 * np.sin(3 * x)
    start = np.maximum(0.05 - heights, 0)
    start[6:9] = 0
    energy, length = 0.01, 0.1
    law = js.potentials.Exponential(energy, length)
    contact = js.Contact(js.HalfSpace(js.Grid((N,), (1.0,)), 1.0), heights, law)
    load = js.MeanGap(start.mean())
    steps = list(dense_steps(heights, energy, length, start, 5))
    assert sum(is_pulled for _, is_pulled in steps) in (1, 2, 3)
    for number, (gap, _) in enumerate(steps, start=1):
        solver = js.solvers.PolonskyKeerRey(max_steps=number)
        found = js.equilibrate(contact, load, solver, initial=start, throw=False)
        np.testing.assert_allclose(found.gap, gap, atol=1e-12)


class Springs(eqx.Module):
    """The law stiffness (g - 1)^2 / 2."""

    stiffness: jax.Array

    def __call__(self, gap):
        return self.stiffness * (gap - 1) ** 2 / 2


def test_a_quadratic_energy_takes_as_many_steps_as_there_are_points():
    x = 2 * np.pi * np.arange(16) / 16
    heights = 0.1 * np.cos(x) + 0.05 * np.sin(3 * x)
    stiffness = np.where(np.arange(16) < 4, 300.0, 1.0)
    law = js.potentials.Varying(Springs(jnp.asarray(stiffness)))
    contact = js.Contact(js.HalfSpace(js.Grid((16,), (1.0,)), 1.0), heights, law)
    found = js.equilibrate(contact, js.MeanPressure(0.0))
    elastic = periodic_stiffness((16,), (1.0,), 1.0)
    exact = np.linalg.solve(elastic + np.diag(stiffness), stiffness - elastic @ heights)
    np.testing.assert_allclose(found.gap, exact, atol=1e-8)
    # Conjugate directions, but for rounding and the last step; others take hundreds.
    assert found.num_steps <= 16 + 4


@pytest.mark.nightly
def test_its_steps_hardly_grow_with_the_grid():
    def steps(n):
        grid = js.Grid(n)
        heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=8, rms_slope=0.1)
        contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.NoAdhesion())
        load = js.MeanGap(js.surfaces.rms_height(heights))
        return int(js.equilibrate(contact, load).num_steps)

    assert steps(128) <= 1.5 * steps(32)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_pressure_control_returns_to_the_state_that_gap_control_found(law):
    contact = rough_contact(N, law)
    by_gap = js.equilibrate(contact, js.MeanGap(0.05))
    near = by_gap.gap * (1 + 0.02 * jnp.cos(2 * jnp.pi * contact.grid.coordinates[0]))
    load = js.MeanPressure(by_gap.mean_pressure)
    by_pressure = js.equilibrate(contact, load, initial=near)
    np.testing.assert_allclose(by_pressure.gap, by_gap.gap, atol=1e-6)
    np.testing.assert_allclose(by_pressure.mean_pressure, by_gap.mean_pressure, rtol=1e-6)


def test_a_sinusoid_closes_at_westergaards_pressure():
    grid = js.Grid((256,))
    heights = js.surfaces.sinusoid(grid, 0.05)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.NoAdhesion())
    closing = westergaard.full_contact_pressure(0.05, 1.0, 1.0)
    areas = [
        js.equilibrate(contact, js.MeanPressure(factor * closing)).contact_area
        for factor in (0.5, 0.99, 1.01)
    ]
    assert areas[0] == pytest.approx(0.5, abs=0.01)
    assert areas[1] < 1
    assert areas[2] == 1


def test_a_load_past_pull_off_is_announced():
    contact = rough_contact(N, js.potentials.Exponential(0.01, 0.1))
    strongest = 0.01 / 0.1
    with pytest.raises(
        js.exceptions.SolverError, match=r"MeanPressure\(-0.11\).*pulled_off.*Pull less"
    ):
        js.equilibrate(contact, js.MeanPressure(-1.1 * strongest))
    held = js.equilibrate(contact, js.MeanPressure(-0.01 * strongest))
    assert held.in_contact.any()
    assert held.mean_pressure == pytest.approx(-0.001, rel=1e-6)
    adhesionless = rough_contact(N, js.potentials.NoAdhesion())
    apart = js.equilibrate(adhesionless, js.MeanPressure(-1e-6), throw=False)
    assert apart.result == js.RESULTS.pulled_off


def test_what_a_law_holds_further_out_is_not_announced_as_pulled_off():
    repulsive = flat_contact(lambda gap: jnp.exp(-(gap**2) / 2))
    pressed = js.equilibrate(repulsive, js.MeanPressure(0.1), initial=0.5 * jnp.ones((8, 8)))
    attraction = float(jax.grad(repulsive.potential)(pressed.gap[0, 0]))
    assert attraction == pytest.approx(-0.1, rel=1e-8)
    waves = flat_contact(lambda gap: -0.1 * jnp.cos(6 * gap) * jnp.exp(-gap / 3))
    caught = js.equilibrate(waves, js.MeanPressure(-0.01), initial=0.75 * jnp.ones((8, 8)))
    np.testing.assert_allclose(caught.gap, 1.0419, atol=1e-4)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("law", "pressure"),
    [
        (lambda gap: -0.02 * jnp.exp(-gap / 0.05) + 0.001 / (1 + gap) ** 2, -0.5),
        (Linear(0.01), -0.1),
        (js.potentials.LennardJones(0.01, 0.05), -1.0),
    ],
)
def test_what_no_law_can_hold_is_pulled_off_in_few_steps(law, pressure):
    apart = js.equilibrate(rough_contact(N, law), js.MeanPressure(pressure), throw=False)
    assert apart.result == js.RESULTS.pulled_off
    assert apart.num_steps < 20


def test_full_contact_is_a_start_for_the_next_pressure():
    contact = rough_contact(N, js.potentials.NoAdhesion())
    full = js.equilibrate(contact, js.MeanPressure(50.0))
    assert full.in_contact.all()
    eased = js.equilibrate(contact, js.MeanPressure(0.5), initial=full)
    fresh = js.equilibrate(contact, js.MeanPressure(0.5))
    np.testing.assert_allclose(eased.gap, fresh.gap, atol=1e-8)


def test_the_reference_solver_refuses_a_pressure():
    contact = rough_contact(N, js.potentials.NoAdhesion())
    with pytest.raises(ValueError, match="PreconditionedConjugateGradient"):
        js.equilibrate(contact, js.MeanPressure(0.1), js.solvers.PolonskyKeerRey())
    coded = js.equilibrate(contact, js.MeanPressure(jnp.nan), throw=False)
    assert coded.result == js.RESULTS.infeasible_load


def test_moves_of_another_precision_are_taken_and_none_below_zero():
    contact = rough_contact(16, js.potentials.Exponential(0.01, 0.1))
    law = js.potentials.Exponential(np.float32(0.01), np.float32(0.1))
    solid = js.HalfSpace(contact.grid, np.float32(1))
    single = js.Contact(solid, contact.heights.astype(np.float32), law)
    solver = js.solvers.PreconditionedConjugateGradient(max_move=np.float64(0.1))
    assert js.equilibrate(single, js.MeanGap(0.08), solver).result == "successful"
    for max_move in (0, -0.1):
        with pytest.raises(ValueError, match="max_move"):
            js.solvers.PreconditionedConjugateGradient(max_move=max_move)


@pytest.mark.nightly
def test_a_touch_without_adhesion_takes_no_more_steps_than_a_contact():
    """Its energy is smaller than what rounding of the gap leaves in that."""
    grid = js.Grid((64,))
    rough = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.005)
    heights = js.surfaces.paraboloid(grid, radius=1.0) + rough
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.NoAdhesion())
    touch = jnp.max(heights) - jnp.mean(heights)
    gaps = touch * (1 - np.logspace(-6, -2, 17))
    found = js.sweep(contact, js.MeanGap(gaps), stability=False).equilibrium
    assert (found.result == "successful").all()
    assert (found.mean_pressure > 0).all() and found.num_steps.max() <= 20

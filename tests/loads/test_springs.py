"""A machine in series: against NumPy, dense algebra, its limits and finite differences."""

import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import check_optimality, periodic_stiffness
from problems import TIGHT, rough_contact
from programs import on_the_cpu

import jaxstab as js

N = 16
LAW = js.potentials.Exponential(0.01, 0.1)
# The softest wave of the unit square is stiff by pi.
STIFFNESSES = [1e-3, 1.0, 30.0, 1e4]


@pytest.fixture(scope="module")
def contact():
    return rough_contact(N, LAW)


def hessian(contact, gap, stiffness):
    """Return A with the spring's part k / N, of rank one."""
    law = contact.potential
    gap = np.asarray(gap).ravel()
    curvature = -law.surface_energy / law.length**2 * np.exp(-gap / law.length)
    return periodic_stiffness((N, N), (1.0, 1.0), 1.0) + np.diag(curvature) + stiffness / gap.size


@pytest.mark.parametrize("stiffness", STIFFNESSES)
@pytest.mark.parametrize("pressure", [0.02, -0.005])
def test_it_presses_with_its_stretch_and_is_part_of_the_hessian(contact, stiffness, pressure):
    position = 0.1 - pressure / stiffness
    equilibrium = js.equilibrate(contact, js.Spring(position, stiffness))
    check_optimality(contact, equilibrium, 1e-8)
    stretch = np.mean(equilibrium.displacement) - position
    np.testing.assert_allclose(equilibrium.mean_pressure, stiffness * stretch, rtol=1e-6)
    stability = js.assess_stability(contact, equilibrium)
    matrix = hessian(contact, equilibrium.gap, stiffness)
    free = ~np.asarray(equilibrium.in_contact).ravel()
    assert free.any()
    exact = np.linalg.eigvalsh(matrix)[0], np.linalg.eigvalsh(matrix[np.ix_(free, free)])[0]
    found = stability.lower_bound.eigenvalue, stability.critical.eigenvalue
    np.testing.assert_allclose(found, exact, atol=1e-8)


@pytest.mark.parametrize(("stiffness", "mean_gap"), [(1.0, 1.0), (30.0, 0.5)])
def test_a_stiff_spring_keeps_the_mean_of_a_gap_that_is_cut_and_a_soft_one_does_not(
    contact, stiffness, mean_gap
):
    control = contact.control(js.Spring(0.1, stiffness))
    gap = jnp.where(jnp.arange(N) < N // 2, 2.0, -1.0) * jnp.ones((N, 1))
    cut = control.admissible(gap)
    np.testing.assert_allclose(cut, jnp.where(gap > 0, 2 * mean_gap, 0))
    # Of a gap that is nowhere open there is no mean to keep.
    np.testing.assert_array_equal(control.admissible(-jnp.abs(gap)), 0)


def test_traced_springs_that_are_none_have_no_equilibrium(contact):
    @jax.jit
    def found(position, stiffness):
        state = js.equilibrate(contact, js.Spring(position, stiffness), throw=False)
        return state.result, state.mean_pressure

    assert found(0.1, 1.0)[0] == "successful"
    for position, stiffness in ((0.1, 0.0), (0.1, -1.0), (jnp.nan, 1.0), (0.1, jnp.inf)):
        result, pressure = found(position, stiffness)
        assert result == "infeasible_load" and jnp.isnan(pressure)


@pytest.mark.nightly
def test_a_stiff_spring_holds_the_displacement_and_a_soft_one_the_pressure(contact):
    def outcome(load):
        equilibrium = js.equilibrate(contact, load, TIGHT)
        numbers = equilibrium.mean_pressure, equilibrium.energy
        return np.array([*equilibrium.gap.ravel(), *equilibrium.reaction.ravel(), *numbers])

    stiff, held = outcome(js.Spring(0.08, 1e10)), outcome(js.MeanDisplacement(0.08))
    np.testing.assert_allclose(stiff, held, atol=1e-8)
    for pressure in (0.05, -0.005):
        soft = outcome(js.Spring(-pressure / 1e-9, 1e-9))
        np.testing.assert_allclose(soft, outcome(js.MeanPressure(pressure)), atol=1e-8)


@on_the_cpu
def test_a_sweep_over_positions_gives_what_each_gives_alone(contact):
    springs = js.Spring(jnp.linspace(0.0, 0.3, 4), 2.0)
    swept = js.sweep(contact, springs)
    for state, spring in zip(swept, springs, strict=True):
        alone = js.equilibrate(contact, spring)
        assert (state.equilibrium.gap == alone.gap).all()
        assert state.load.position == spring.position
        assert state.load.stiffness == 2.0


def test_units_do_not_matter(contact):
    pascals, metres = 70e9, 1e-6
    grid = js.Grid(N, metres)
    law = js.potentials.Exponential(0.01 * pascals * metres, 0.1 * metres)
    scaled = js.Contact(js.HalfSpace(grid, pascals), contact.heights * metres, law)
    spring = js.Spring(0.05 * metres, 2.0 * pascals / metres)
    found, expected = js.equilibrate(scaled, spring), js.equilibrate(contact, js.Spring(0.05, 2.0))
    assert found.num_steps == expected.num_steps
    np.testing.assert_allclose(found.gap / metres, expected.gap, atol=1e-10)
    verdicts = (js.assess_stability(scaled, found), js.assess_stability(contact, expected))
    assert verdicts[0].verdict == verdicts[1].verdict


def test_a_spring_without_a_stiffness_is_refused():
    with pytest.raises(ValueError, match=r"stiffness of the spring is 0\.0: it must be positive"):
        js.Spring(0.1, 0.0)
    with pytest.raises(ValueError, match=r"positions have shape \(2,\), the stiffnesses \(3,\): "):
        js.Spring([0.1, 0.2], [1.0, 2.0, 3.0])


# On a line the constant belongs to a strip of unit width [pressure].
@pytest.mark.parametrize(("lengths", "constant"), [((1e-6, 2e-6), 20.0), ((3e-6,), 2e8)])
def test_a_cantilever_presses_with_its_constant_times_its_deflection(lengths, constant):
    grid = js.Grid((16,) * len(lengths), lengths)
    heights = js.surfaces.sinusoid(grid, 1e-8)
    law = js.potentials.Exponential(0.05, 1e-8)
    contact = js.Contact(js.HalfSpace(grid, 1e9), heights, law)
    position = -3e-8
    load = js.Spring.cantilever(position, constant, contact.grid)
    state = js.equilibrate(contact, load)
    force = float(state.mean_pressure) * np.prod(lengths)
    deflection = float(jnp.mean(state.displacement)) - position
    assert deflection > 1e-9
    np.testing.assert_allclose(force, constant * deflection, rtol=1e-6)


def test_cantilevers_can_be_traced_and_must_be_stiff():
    grid = js.Grid(16, (2.0, 3.0))
    constants = jnp.array([6.0, 12.0])
    loads = jax.jit(jax.vmap(lambda c: js.Spring.cantilever(0.1, c, grid)))(constants)
    np.testing.assert_allclose(loads.stiffness, [1, 2])
    assert jax.grad(lambda c: js.Spring.cantilever(0.1, c, grid).stiffness)(1.0) == 1 / 6
    disc = js.Rings(10, 2.0)
    assert js.Spring.cantilever(0.1, 1.0, disc).stiffness == pytest.approx(1 / (4 * np.pi))
    with pytest.raises(ValueError, match="constant of the cantilever is -1"):
        js.Spring.cantilever(0.1, -1.0, grid)
    with pytest.raises(TypeError, match=r"int is no grid: give the grid of the contact"):
        js.Spring.cantilever(0.1, 1.0, 16)


def micrometre_tip(youngs_modulus):
    grid = js.Grid(16, (1e-6, 1e-6))
    heights = js.surfaces.paraboloid(grid, radius=1e-6)
    law = js.potentials.Exponential(0.05, 5e-8)
    return js.Contact(js.FreeHalfSpace(grid, youngs_modulus), heights, law)


def test_newtons_per_metre_that_are_taken_for_pascals_per_metre_are_told_once():
    contact = micrometre_tip(2e6)
    load = js.Spring(jnp.array([0.0, 1e-7]), 1.0)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        js.sweep(contact, load, stability=False)
        js.equilibrate(contact, js.Spring.cantilever(0.0, 1.0, contact.grid), throw=False)
    (message,) = (
        str(x.message) for x in said if issubclass(x.category, js.exceptions.MachineWarning)
    )
    stiffness, softest = map(float, re.findall(r"(?:is|wave) ([0-9.e+]+)[ :]", message)[:2])
    # The padded cell is twice as long: its softest wave is stiff by about E* pi / (2 L).
    assert stiffness == 1 and softest == pytest.approx(2e6 * np.pi / 2e-6, rel=0.2)
    assert "Spring.cantilever(position, 1, contact.grid)" in message and "1e-12" in message


def test_soft_cantilevers_on_stiff_solids_and_machines_under_jit_are_not_warned_of():
    silica = micrometre_tip(7e10)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        js.equilibrate(silica, js.Spring.cantilever(0.0, 0.01, silica.grid), throw=False)
        jax.eval_shape(lambda k: js.equilibrate(silica, js.Spring(0.0, k), throw=False), 1.0)
    assert not any(issubclass(x.category, js.exceptions.MachineWarning) for x in said)


def test_a_pull_off_through_a_machine_far_too_soft_is_warned_of():
    grid = js.Grid((16,))
    heights = js.surfaces.sinusoid(grid, 0.1)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.05, 0.2))
    with warnings.catch_warnings():
        # Before anything is solved with it.
        warnings.simplefilter("error", js.exceptions.MachineWarning)
        with pytest.raises(js.exceptions.MachineWarning, match=r"2e-09 \[pressure/length\]"):
            js.pull_off(contact, spring=2e-9)


def electrodes():
    """Two flat ones of unit stiffness, with a dielectric."""
    grid = js.Grid(16)
    law = js.potentials.Electrostatic(1.0, 0.02, 0.1)
    return js.Contact(js.HalfSpace(grid, 1.0), jnp.zeros(grid.shape), law)


@pytest.mark.nightly
def test_a_soft_spring_far_away_begins_apart():
    load = js.Spring([1.0, 0.05], 1.0)
    swept = js.sweep(electrodes(), load, order="continuation", stability=False)
    np.testing.assert_array_equal(swept.equilibrium.contact_area, [0, 1])


@pytest.mark.nightly
def test_a_path_under_a_soft_spring_far_away_begins_apart():
    # They are pulled in at a third of the way, dielectric included.
    contact, load = electrodes(), js.Spring([1.0, 0.05], 1.0)
    pull_in = (27 / 8 * 0.02) ** (1 / 3) - 0.1
    path = js.follow(contact, load)
    np.testing.assert_allclose(path.jumps.load.value, [pull_in], rtol=1e-5)
    assert path.equilibrium.contact_area[0] == 0 and path.equilibrium.contact_area[-1] == 1
    np.testing.assert_allclose(js.critical_load(contact, load).load.value, pull_in, rtol=1e-7)
    # A spring that pulls harder than the law at no gap begins in contact.
    near = js.follow(contact, js.Spring([0.2, 0.3], 1.0))
    assert near.equilibrium.contact_area[0] == 1


@pytest.mark.parametrize("solid", ["free", "layer"])
def test_the_far_side_stands_where_a_held_one_presses_as_much(solid):
    grid = js.Grid(N)
    solid = js.FreeHalfSpace(grid, 1.0) if solid == "free" else js.Layer(grid, 1.0, 0.3, 0.2)
    contact = js.Contact(solid, js.surfaces.paraboloid(grid, radius=2.0), LAW)
    held = js.FarDisplacement(-0.05)
    pressure = js.equilibrate(contact, held, TIGHT).mean_pressure
    spring = js.Spring(held.value - pressure / 3.0, 3.0)
    state = js.equilibrate(contact, spring, TIGHT)
    np.testing.assert_allclose(state.mean_pressure, pressure, rtol=1e-8)
    np.testing.assert_allclose(spring.far_displacement(state.mean_pressure), -0.05, rtol=1e-8)
    assert js.MeanPressure(1.0).far_displacement(pressure) is None

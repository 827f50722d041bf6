"""Paths through jumps: against bisection, the energy balance, and each state against NumPy."""

import re
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import on_zero_mean, periodic_stiffness
from problems import bisected, rough_contact
from scipy.integrate import simpson

import jaxstab as js


def touches(state):
    return state.in_contact.any()


@pytest.mark.nightly
def test_hertz_jumps_into_contact_at_the_fold_and_lets_go_where_a_reaction_vanishes(hertz, loop):
    into, *_, out = loop.jumps
    np.testing.assert_allclose(into.load.value, 1.2974855, atol=1e-6)
    assert into.kind == "fold"
    assert not into.before.in_contact.any() and into.after.in_contact.any()
    assert out.kind == "release"
    expected = bisected(hertz, js.MeanDisplacement, 1.2, 0.01, touches)
    np.testing.assert_allclose(out.load.value, expected, atol=1e-5)
    least = jnp.min(jnp.where(out.before.in_contact, out.before.reaction, jnp.inf))
    assert least < 1e-4 * hertz.conforming_pressure
    # The mode that leads away opens a contact point, at no cost but to second order.
    assert (jnp.where(out.before.in_contact, out.mode, 0) >= 0).any()
    np.testing.assert_allclose(jnp.linalg.norm(out.mode), 1)
    turns = js.MeanDisplacement(jnp.array([1.6, 1.2, 1.6]))
    still = js.follow(hertz, turns, disturbance=0.0, fields=True)
    np.testing.assert_allclose(still.jumps.load.value, loop.jumps.load.value, atol=2e-6)


@pytest.mark.parametrize(
    "load", ["displacement", pytest.param("spring", marks=pytest.mark.nightly)]
)
def test_around_a_loop_the_work_is_what_the_jumps_lose(hertz, loop, load):
    if load == "spring":
        loop = js.follow(hertz, js.Spring(jnp.array([1.8, 1.3, 1.8]), 20.0), smallest_jump=1e-5)
    assert (loop.jumps.dissipation > 0).all()
    states = loop.equilibrium
    np.testing.assert_allclose(states.energy[-1], states.energy[0], rtol=1e-6)
    # By a quadrature of its own: the load over what is prescribed.
    quadrature = -np.trapezoid(states.mean_pressure, loop.load.value)
    np.testing.assert_allclose([loop.work, loop.jumps.dissipation.sum()], quadrature, rtol=2e-2)


@pytest.mark.nightly
def test_every_state_of_a_rough_path_is_an_equilibrium_and_every_jump_goes_down(rough_path):
    contact, path = rough_path
    assert len(path.jumps) >= 3
    stiffness = periodic_stiffness((32, 32), (1.0, 1.0), 1.0)
    for value, gap, pressure in zip(
        path.load.value, path.equilibrium.gap, path.equilibrium.mean_pressure, strict=True
    ):
        gap = np.asarray(gap).ravel()
        elastic = stiffness @ (gap + np.asarray(contact.heights).ravel())
        net = elastic + pressure + np.exp(-gap / 0.06)
        missed = np.where(gap > 0, net, np.minimum(net, 0))
        np.testing.assert_allclose(missed, 0, atol=1e-6)
        np.testing.assert_allclose(gap.mean(), value, rtol=1e-9)
    for jump in path.jumps:
        assert jump.dissipation > 0
        assert jump.before.energy > jump.after.energy
        verdict = js.assess_stability(contact, jump.before, throw=False).verdict
        assert verdict != "unstable"
    assert set(path.jumps.kind.name) == {"fold", "release"}


def work_by_quadrature(path):
    """Return the integral of the mean pressure over the mean gap, by Simpson's rule.

    In each step that has jumped the trapezoid is as good.
    """
    loads, pressures = np.asarray(path.load.value), np.asarray(path.equilibrium.mean_pressure)
    ends = {0, len(loads), *(np.asarray(path.jumps.state) + 1), int(np.argmin(loads)) + 1}
    work = -np.trapezoid(pressures, loads)
    for first, last in pairwise(sorted(ends)):
        part = slice(first, last)
        if last - first > 2:
            smooth = simpson(pressures[part], x=loads[part])
            work += np.trapezoid(pressures[part], loads[part]) - smooth
    return work


def test_the_work_of_a_rough_loop_is_that_of_its_pressures(rough_path):
    _, path = rough_path
    quadrature = work_by_quadrature(path)
    np.testing.assert_allclose(path.work, quadrature, rtol=0.02)
    change = path.equilibrium.energy[-1] - path.equilibrium.energy[0]
    np.testing.assert_allclose(path.dissipation, quadrature - change, rtol=0.02)
    np.testing.assert_allclose(path.dissipation, path.jumps.dissipation.sum())


@pytest.mark.nightly
def test_a_reversible_contact_loses_nothing(rough_path):
    energy = 0.01
    contact, _ = rough_path
    law, units = js.potentials.Exponential(energy, 0.04), {"unit": "µm", "pressure_unit": "MPa"}
    contact = js.Contact(contact.solid, contact.heights, law, **units)
    path = js.follow(contact, js.MeanDisplacement(jnp.array([0.25, 0.02, 0.25])), fields=True)
    # Both legs lead through the same states.
    between = js.MeanDisplacement(0.1)
    way_back = js.equilibrate(contact, between, initial=path.equilibrium.gap[-1])
    way_in = js.equilibrate(contact, between, initial=path.equilibrium.gap[0])
    np.testing.assert_allclose(way_back.gap, way_in.gap, atol=1e-9)
    assert len(path.jumps) == 0 and path.dissipation == 0
    assert abs(path.unlocated) <= path.unlocated_error
    np.testing.assert_allclose(path.work, 0, atol=1e-9 * energy)
    assert re.search(r"MeanDisplacement 0\.25 µm to 0\.25 µm in(?s:.*)work  \S+ .J\n", repr(path))
    # Rounding is compared with the losses: both are in one unit.
    assert re.search(r"work  \S+ (\w+)\n  lost in 0 jumps  0 \1$", repr(path))


@pytest.mark.nightly
def test_a_tension_pulls_apart_where_bisection_says_and_a_pressure_brings_back():
    contact = rough_contact(32, js.potentials.Exponential(0.02, 0.08), rms_height=0.05)
    path = js.follow(contact, js.MeanPressure(jnp.array([0.0, -0.2, 0.05])))
    apart, touch = path.jumps
    expected = bisected(contact, js.MeanPressure, 0.0, -0.03, touches, resolution=1e-8)
    np.testing.assert_allclose(apart.load.value, expected, rtol=1e-5)
    # Of surfaces that are apart nothing is known but that.
    for state in (apart.after, touch.before):
        assert state.result == "pulled_off" and state.contact_area == 0
        assert jnp.isnan(state.gap).all() and jnp.isnan(state.mean_pressure)
    assert touch.kind == "touch"
    np.testing.assert_allclose(touch.load.value, 0, atol=1e-6 * 0.25)
    assert touch.load.value <= 0
    assert touch.after.load.value > 0 and touch.after.in_contact.any()
    assert jnp.isnan(apart.dissipation) and jnp.isnan(touch.dissipation)
    assert jnp.isfinite(apart.barrier_law.range) and jnp.isnan(touch.barrier_law.range)
    # Of a path without fields the last state alone has a gap.
    assert path.equilibrium.gap is None and path[0].equilibrium.gap is None
    last = path[-1].equilibrium
    np.testing.assert_allclose(jnp.mean(last.gap), last.mean_gap)
    # Of what falls apart no work is known.
    assert jnp.isnan(path.work) and jnp.isfinite(path.equilibrium.work[5])


@pytest.mark.nightly
def test_in_single_precision_rounding_deep_inside_a_core_is_no_jump():
    grid = js.Grid((32,))
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=8, rms_height=0.02)
    law = js.potentials.LennardJones(0.005, 0.02)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights.astype(jnp.float32), law)
    path = js.follow(contact, js.MeanGap(jnp.array([0.2, 0.01])))
    assert (path.jumps.dissipation > 0).all()
    # Where gaps are as wide as the law reaches, and not where they are squeezed.
    assert path.jumps.load.value.min() > 0.02
    squeezed = js.equilibrate(contact, path.load[-1])
    np.testing.assert_allclose(
        path.equilibrium.mean_pressure[-1], squeezed.mean_pressure, rtol=1e-3
    )


@pytest.mark.nightly
def test_of_a_path_the_loads_of_jumps_have_derivatives(hertz):
    # Points that are mirror images of each other would let go at once.
    heights = hertz.heights + 1e-3 * jax.random.normal(jax.random.key(0), hertz.heights.shape)

    def follow(energy, end=1.2, throw=True):
        law = js.potentials.Exponential(energy, 1.0)
        contact = js.Contact(hertz.solid, heights, law)
        turns = js.MeanDisplacement(jnp.stack([1.6, end, 1.6]))
        path = js.follow(contact, turns, smallest_jump=1e-5, throw=throw)
        return path.jumps.load.value[jnp.array([0, -1])]

    def release(energy):
        law = js.potentials.Exponential(energy, 1.0)
        contact = js.Contact(hertz.solid, heights, law)
        turns = js.MeanDisplacement(jnp.array([1.2, 1.6]))
        path = js.follow(
            contact, turns, smallest_jump=1e-5, max_states=128, max_jumps=1, throw=False
        )
        return path.jumps.load.value[0]

    rates = jax.jacrev(follow)(10.0)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(release))(10.0), rates[1], rtol=1e-8)
    differences = (follow(10.01) - follow(9.99)) / 0.02
    # Jumps are located to 4e-7.
    np.testing.assert_allclose(rates, differences, atol=8e-5, rtol=0)
    assert (jnp.abs(rates) > 1e-2).all()


@pytest.mark.nightly
def test_of_a_path_nothing_else_has_a_derivative_nor_where_two_points_let_go_at_once(hertz):
    def last_jump(energy):
        law = js.potentials.Exponential(energy, 1.0)
        contact = js.Contact(hertz.solid, hertz.heights, law)
        turns = js.MeanDisplacement(jnp.array([1.6, 1.2, 1.6]))
        return js.follow(contact, turns, smallest_jump=1e-5).jumps.load.value[-1]

    def work(end):
        turns = js.MeanDisplacement(jnp.stack([1.6, end]))
        return js.follow(hertz, turns, max_states=64, max_jumps=4).work

    assert jnp.isnan(jax.grad(last_jump)(10.0))
    assert jnp.isnan(jax.grad(work)(1.4))


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning", "ignore::UserWarning")
@pytest.mark.parametrize(
    "first",
    [
        -4700.0,
        -1000.0,
        -10.0,
    ],
)
def test_a_very_soft_machine_pulls_a_line_off_and_loses_what_a_dead_load_does(first):
    heights = 0.1 * np.cos(2 * np.pi * np.arange(12) / 12)
    law = js.potentials.Exponential(0.05, 0.1)
    contact = js.Contact(js.HalfSpace(js.Grid((12,)), 1.0), heights, law)
    turns = jnp.array([first, first + 1e4, first])
    path = js.follow(contact, js.Spring(turns, 1e-4))
    pull = js.pull_off(contact)
    jump = path.jumps[-1]
    # Over its own length the spring is a dead load: at the pull-off it holds p0^2 / 2k, and loses
    # that but for what is left of the attraction.
    assert jump.kind == pull.kind
    np.testing.assert_allclose(jump.before.mean_pressure, pull.load.value, rtol=1e-3)
    held = float(pull.load.value) ** 2 / 2e-4
    np.testing.assert_allclose(path.dissipation, held, rtol=2e-3)
    # No more than 1 % of it is in doubt, where the line comes into contact within a step.
    assert abs(path.unlocated) <= path.unlocated_error < 0.01 * held


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_with_a_core_it_stays_on_each_branch_until_that_loses_its_stability():
    law = js.potentials.LennardJones(0.12, 0.1)
    heights = 0.1 * np.cos(4 * np.pi * np.arange(12) / 12)
    contact = js.Contact(js.HalfSpace(js.Grid((12,)), 1.0), heights, law)
    path = js.follow(contact, js.MeanDisplacement(jnp.array([0.5, 0.19, 0.5])), fields=True)
    stiffness = periodic_stiffness((12,), (1.0,), 1.0)

    def lowest(gap):
        curvature = jax.vmap(jax.grad(jax.grad(law)))(gap)
        return on_zero_mean(stiffness + np.diag(curvature))[0]

    assert len(path.jumps) == 12
    assert set(path.jumps.kind.name.tolist()) == {"fold", "bifurcation"}
    # Both waves are alike at 0.331722741, and at 0.341208 each of the two that hold one summit.
    assert jnp.abs(path.jumps.load.value - 0.331722741).min() < 1e-5
    assert jnp.abs(path.jumps.load.value - 0.34120832).min() < 1e-5
    for gap in path.jumps.before.gap:
        assert abs(lowest(gap)) < 0.3
    # Each state comes back from itself, however much lower another one lies.
    for state, gap in zip(path[20::20], path.equilibrium.gap[20::20], strict=True):
        again = js.equilibrate(contact, state.load, initial=gap)
        np.testing.assert_allclose(again.gap, gap, atol=1e-6)
    # Back at the first load nothing is left but the loss.
    np.testing.assert_allclose(path.equilibrium.energy[-1], path.equilibrium.energy[0], rtol=1e-6)
    quadrature = -np.trapezoid(path.equilibrium.mean_pressure, path.load.value)
    np.testing.assert_allclose(path.dissipation, quadrature, rtol=0.02)
    assert "a symmetry was broken at 5 bifurcations" in repr(path)


@pytest.mark.nightly
def test_every_jump_of_a_march_of_small_steps_is_found():
    grid = js.Grid((64,), (1.0,))
    heights = js.surfaces.self_affine(grid, jax.random.key(3), k_high=8, rms_height=0.05)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.05, 0.05))

    @jax.jit
    def march(gap, values):
        def step(gap, value):
            state = js.equilibrate(contact, js.MeanGap(value), initial=gap, throw=False)
            return state.gap, (state.energy, state.mean_pressure)

        return jax.lax.scan(step, gap, values)

    turns, jumps = (0.3, 0.02, 0.3), []
    gap = js.equilibrate(contact, js.MeanGap(turns[0])).gap
    for first, last in pairwise(turns):
        values = np.linspace(first, last, 4001)
        gap, (energy, pressure) = march(gap, values)
        work = -np.diff(values) * np.asarray(pressure[1:] + pressure[:-1]) / 2
        lost = work - np.diff(energy)
        jumps += [(values[i + 1], lost[i]) for i in np.flatnonzero(lost > 1e-7)]
    loads, losses = np.array(jumps).T
    assert len(loads) >= 3
    path = js.follow(contact, js.MeanGap(jnp.array(turns)))
    for load, loss in zip(loads, losses, strict=True):
        if loss > 0.01 * losses.sum():
            assert jnp.abs(path.jumps.load.value - load).min() < 1e-4
    np.testing.assert_allclose(path.dissipation, losses.sum(), rtol=0.06)


@pytest.mark.nightly
def test_a_flat_surface_leaves_the_state_that_is_no_longer_stable():
    grid, law = js.Grid(16), js.potentials.Exponential(0.06, 0.06)
    contact = js.Contact(js.HalfSpace(grid, 1.0), jnp.zeros(grid.shape), law)
    path = js.follow(contact, js.MeanGap(jnp.array([0.3, 0.05])), fields=True)
    # The softest wave has the stiffness pi E / L.
    end = 0.06 * np.log(0.06 / 0.06**2 / np.pi)
    np.testing.assert_allclose(path.jumps.load.value[0], end, rtol=1e-2)
    uniform = path.load.value > end * 1.01
    spread = jnp.std(path.equilibrium.gap, axis=(1, 2))
    assert (spread[uniform] < 1e-4).all() and (spread[path.load.value < end * 0.99] > 1e-3).all()
    last = js.equilibrate(contact, path.load[-1], initial=path.equilibrium.gap[-1])
    assert js.assess_stability(contact, last).verdict != "unstable"

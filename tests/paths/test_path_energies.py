"""What a path loses: against quadrature of its loads, a march of small steps and closed forms."""

import re
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import simpson

import jaxstab as js


def smooth_contact(law):
    grid = js.Grid(32)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.05)
    return js.Contact(js.HalfSpace(grid, 1.0), heights, law)


@pytest.fixture(scope="module")
def loop():
    contact = smooth_contact(js.potentials.Exponential(0.06, 0.06))
    return js.follow(contact, js.MeanGap(jnp.array([0.25, 0.02, 0.25])))


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


def assert_balances(path):
    """Assert that the work, and what is lost of it, are those of the recorded pressures."""
    quadrature = work_by_quadrature(path)
    np.testing.assert_allclose(path.work, quadrature, rtol=0.02)
    change = path.equilibrium.energy[-1] - path.equilibrium.energy[0]
    np.testing.assert_allclose(path.dissipation, quadrature - change, rtol=0.02)


def test_the_work_of_a_loop_is_that_of_its_pressures(loop):
    assert_balances(loop)
    assert (loop.jumps.dissipation > 0).all()
    np.testing.assert_allclose(loop.dissipation, loop.jumps.dissipation.sum())


def test_a_reversible_contact_loses_nothing():
    energy = 0.01
    contact = smooth_contact(js.potentials.Exponential(energy, 0.04))
    turns = jnp.array([0.25, 0.02, 0.25])
    units = {"unit": "µm", "pressure_unit": "MPa"}
    contact = js.Contact(contact.solid, contact.heights, contact.potential, **units)
    path = js.follow(contact, js.MeanGap(turns), fields=True)
    # Both legs lead through the same states.
    way_back = js.equilibrate(contact, js.MeanGap(0.1), initial=path.equilibrium.gap[-1])
    way_in = js.equilibrate(contact, js.MeanGap(0.1), initial=path.equilibrium.gap[0])
    np.testing.assert_allclose(way_back.gap, way_in.gap, atol=1e-9)
    assert len(path.jumps) == 0 and path.dissipation == 0
    assert abs(path.unlocated) <= path.unlocated_error
    np.testing.assert_allclose(path.work, 0, atol=1e-9 * energy)
    # Rounding is compared with the losses: both are in one unit.
    assert re.search(r"work  \S+ (\w+)\n  lost in 0 jumps  0 \1$", repr(path))


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

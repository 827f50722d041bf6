"""Equilibria and verdicts of shifted, transposed and scaled contacts, which Hypothesis chooses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import state_of

import jaxstab as js

pytestmark = pytest.mark.nightly

N = 6
seeds = st.integers(0, 2**32)
shifts = st.tuples(st.integers(0, N - 1), st.integers(0, N - 1))
scales = st.floats(1e-6, 1e6)


def contact_of(heights, work, length, side, modulus):
    grid = js.Grid(N, jnp.stack([side, 1.5 * side]))
    law = js.potentials.Exponential(work, length)
    return js.Contact(js.HalfSpace(grid, modulus), heights, law)


@jax.jit
def solved(heights, work, length, gap, side, modulus):
    contact = contact_of(heights, work, length, side, modulus)
    return js.equilibrate(
        contact, js.MeanGap(gap), js.solvers.PreconditionedConjugateGradient(1e-12)
    )


def solve(heights, work, length, gap, side=1.0, modulus=1.0):
    return solved(heights, *map(jnp.float64, (work, length, gap, side, modulus)))


@jax.jit
def assessed(gap, reaction, curvature, length, pressure):
    """Assess a state with any gap and any curvature of the law."""
    grid = js.Grid(N, jnp.stack([length, length]))
    law = js.potentials.Varying(js.potentials.Exponential(curvature, jnp.ones((N, N)) * length))
    contact = js.Contact(js.HalfSpace(grid, pressure), jnp.zeros((N, N)), law)
    return js.assess_stability(*state_of(contact, gap, reaction), throw=False)


def assess(gap, reaction, curvature, length=1.0, pressure=1.0):
    return assessed(gap, reaction, curvature, jnp.float64(length), jnp.float64(pressure))


def rough(seed):
    """Return heights and a weak law, with which there is one equilibrium for each mean gap."""
    random = np.random.default_rng(seed)
    heights = 0.05 * random.normal(size=(N, N))
    return heights, (random.uniform(0, 0.3), random.uniform(0.4, 1.0), random.uniform(0.01, 0.2))


def state(seed):
    random = np.random.default_rng(seed)
    gap = random.uniform(0.01, 2, (N, N)) * (random.random((N, N)) > random.uniform(0, 0.5))
    return gap, random.uniform(0, 0.1, (N, N)), random.uniform(0, 8, (N, N))


@given(seeds, shifts)
def test_a_shifted_surface_has_a_shifted_equilibrium(seed, shift):
    heights, parameters = rough(seed)
    one = solve(heights, *parameters)
    other = solve(np.roll(heights, shift, (0, 1)), *parameters)
    np.testing.assert_allclose(other.mean_pressure, one.mean_pressure, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(other.gap, np.roll(one.gap, shift, (0, 1)), atol=1e-9)


@given(seeds, scales, scales)
def test_an_equilibrium_scales_with_lengths_and_pressures(seed, length, pressure):
    heights, (work, range_, gap) = rough(seed)
    one = solve(heights, work, range_, gap)
    other = solve(
        length * heights,
        length * pressure * work,
        length * range_,
        length * gap,
        length,
        pressure,
    )
    atol = 1e-8 * np.abs(one.pressure).max()
    np.testing.assert_allclose(other.pressure / pressure, one.pressure, rtol=0, atol=atol)
    np.testing.assert_allclose(other.gap / length, one.gap, rtol=0, atol=1e-9)
    assert other.contact_area == one.contact_area


def assert_same_verdict(one, other, factor=1.0):
    assert other.verdict == one.verdict
    for name in ("lower_bound", "critical"):
        found, expected = (getattr(each, name).eigenvalue for each in (other, one))
        np.testing.assert_allclose(found / factor, expected, rtol=1e-7, atol=1e-8)


@given(seeds, shifts, st.booleans())
def test_a_shifted_or_transposed_state_has_the_same_verdict(seed, shift, transposes):
    fields = state(seed)

    def move(field):
        rolled = np.roll(field, shift, (0, 1))
        return rolled.T if transposes else rolled

    assert_same_verdict(assess(*fields), assess(*map(move, fields)))


@given(seeds, scales, scales)
def test_a_verdict_does_not_depend_on_units(seed, length, pressure):
    gap, reaction, work = state(seed)
    scaled = length * gap, pressure * reaction, length * pressure * work, length, pressure
    one = assess(gap, reaction, work)
    assert_same_verdict(one, assess(*scaled), pressure / length)

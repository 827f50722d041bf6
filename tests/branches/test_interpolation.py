"""Checks of a step along a curve, against SciPy's cubics."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from jaxstab.branches.curve import BorderedVector, Place
from jaxstab.branches.interpolation import Cubics, stays_positive

LENGTH = 0.5
COSINE = 0.8


@jax.jit
@jax.vmap
def judged(is_free, value, rate, end, end_rate):
    """Return whether the gap of one free point, or its reaction in contact, stays positive."""
    nothing = jnp.zeros(1)
    gaps = [jnp.where(is_free, number, nothing) for number in (value, rate, end, end_rate)]
    nets = [jnp.where(is_free, nothing, number) for number in (value, rate, end, end_rate)]
    mask = jnp.full(1, is_free)
    pressure = jnp.zeros(())
    old, new = (
        Place(BorderedVector(gap, pressure), mask, BorderedVector(slope, pressure))
        for gap, slope in (gaps[:2], gaps[2:])
    )
    cubics = Cubics(old, new, jnp.array(LENGTH), jnp.array(COSINE))
    contact = SimpleNamespace(has_core=jnp.array(False))
    curve = SimpleNamespace(contact=contact, stiffness=jnp.array(2.0))
    changes = SimpleNamespace(net=nets[0], net_rate=nets[1], tied=jnp.zeros(1, bool))
    return stays_positive(curve, cubics, changes, False, tuple(nets[2:]), jnp.ones(()))


def test_gaps_and_reactions_stay_positive_where_the_cubics_do():
    random = np.random.default_rng(0)
    number = 200
    is_free = random.random(number) < 0.5
    value = random.uniform(0.1, 1, number)
    end = random.uniform(-0.5, 1, number)
    rate, end_rate = random.uniform(-8, 8, (2, number))
    # From zero a gap falls at once.
    value[:5], end[:5] = 0, -0.3
    # The distance of the end is measured along the first tangent.
    slopes = np.stack([rate, end_rate / COSINE])
    cubic = CubicHermiteSpline([0, LENGTH], np.stack([value, end]), slopes)
    least = cubic(np.linspace(0, LENGTH, 200)).min(axis=0)
    clear = (np.abs(least) > 0.02) | (value == 0)
    stays, share = judged(is_free, value, rate, end, end_rate)
    np.testing.assert_array_equal(stays[clear], least[clear] > 0)
    dips = (least < 0) & (end > 0)
    assert np.sum(dips & clear) > 10 and np.sum(end < 0) > 10 and np.sum(least > 0) > 10
    # Up to where the line between both ends falls to zero.
    expected = np.where(end < 0, value / (value - end), np.where(dips, 0.5, 1))
    expected[value == 0] = 0.5
    np.testing.assert_allclose(share[clear], expected[clear])

"""Half spaces graded by a power of the depth: against fine stacks, and the theory of JKR."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.solids import Film, Graded, Layered

GRID = js.Grid(8)


def stack_of(exponent, nu, number, depth=0.3):
    """Return layers of the modulus in their middle, thinner and thinner to the surface."""
    edges = np.concatenate([[0], np.geomspace(1e-10, 40, number)])
    middles = np.concatenate([edges[1:2] / 2, np.sqrt(edges[1:-1] * edges[2:])])
    moduli = 2.0 * (middles / depth) ** exponent
    layers = [Film((e, nu), h) for e, h in zip(moduli, np.diff(edges), strict=True)]
    return Layered(GRID, layers, (moduli[-1], nu))


@pytest.mark.nightly
@pytest.mark.parametrize(("exponent", "nu"), [(0.5, 0.3), (0.3, 0.5), (-0.3, 0.3)])
def test_a_graded_solid_is_the_limit_of_fine_stacks(exponent, nu):
    q = jnp.array([0.5, 1.0, 2.0])
    exact = np.asarray(Graded(GRID, 2.0, nu, 0.3, exponent).stiffness_at(q))
    errors = [
        abs(np.asarray(stack_of(exponent, nu, n).stiffness_at(q)) / exact - 1).max()
        for n in (80, 160)
    ]
    assert errors[1] < 2e-3
    # The error falls as the square of the thickness.
    assert 3 < errors[0] / errors[1] < 5


def test_without_a_gradient_it_is_a_half_space():
    q = jnp.geomspace(1e-3, 1e3, 7)
    exact = js.HalfSpace(GRID, 2.0, 0.3).stiffness_at(q)
    np.testing.assert_allclose(Graded(GRID, 2.0, 0.3, 0.7, 0.0).stiffness_at(q), exact, rtol=1e-13)


def test_derivatives_agree_with_differences():
    q = jnp.array([0.5, 2.0])
    call = jax.jit(lambda p: Graded(GRID, *p).stiffness_at(q))
    point, step = jnp.array([2.0, 0.3, 0.7, 0.4]), 1e-5
    slopes = jax.jacrev(call)(point)
    for i, unit in enumerate(np.eye(4)):
        difference = (call(point + step * unit) - call(point - step * unit)) / (2 * step)
        np.testing.assert_allclose(slopes[:, i], difference, rtol=1e-7)


def test_what_is_not_graded_by_a_power_is_refused():
    for exponent in (-1.0, 1.0, np.nan):
        with pytest.raises(ValueError, match=rf"exponent is {exponent}: it must lie in \(-1, 1\)"):
            Graded(GRID, 1.0, 0.3, 0.1, exponent)
    with pytest.raises(ValueError, match=r"depth is 0.0"):
        Graded(GRID, 1.0, 0.3, 0.0, 0.5)
    assert not jax.jit(lambda k: Graded(GRID, 1.0, 0.3, 0.1, k).is_valid)(1.5)

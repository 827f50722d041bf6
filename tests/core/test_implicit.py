"""Implicit derivatives that exist or not, with a sine that stands in for a solver."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstab.core.implicit import attach, tangent_of

X = jnp.array([1.0, 2.0])


def rule(values, is_undefined, inputs, changes):
    # Like those of solvers, which do not compute with numbers that they have not found.
    moved = tangent_of(jnp.sin, inputs, changes)
    return jnp.where(is_undefined, 0, moved), is_undefined


def sine(x, is_undefined):
    """Return sin(x), as if a solver had found it."""
    return attach(rule, jnp.sin(jax.lax.stop_gradient(x)), jnp.array(is_undefined), (x,))


def total(x, is_undefined=True):
    return jnp.sum(sine(x, is_undefined))


FIRST = [
    jax.grad,
    lambda f: lambda x: jax.value_and_grad(f)(x)[1],
    lambda f: lambda x: jax.jvp(f, (x,), (jnp.ones_like(x),))[1],
    jax.jacfwd,
    jax.jacrev,
    lambda f: lambda x: jax.vmap(jax.grad(f))(jnp.stack([x, x])),
    lambda f: jax.jit(jax.grad(f)),
    lambda f: jax.jit(jax.jacfwd(f)),
]
SECOND = [
    jax.hessian,
    lambda f: jax.jacrev(jax.jacfwd(f)),
    lambda f: jax.jacrev(jax.jacrev(f)),
    lambda f: jax.jacfwd(jax.jacfwd(f)),
]


@pytest.mark.parametrize("transform", FIRST)
def test_an_undefined_derivative_is_nan(transform):
    assert jnp.isnan(transform(total)(X)).all()


@pytest.mark.parametrize("transform", SECOND)
def test_so_is_its_derivative(transform):
    assert jnp.isnan(jnp.diag(transform(total)(X))).all()


@pytest.mark.parametrize("transform", SECOND)
def test_second_derivatives_that_exist_are_right(transform):
    second = transform(lambda x: total(x, is_undefined=False))(X)
    np.testing.assert_allclose(second, -jnp.diag(jnp.sin(X)), atol=1e-15)


def test_zero_tangents_and_cotangents_give_zero():
    assert (jax.grad(lambda x: 0 * total(x))(X) == 0).all()
    assert jax.jvp(total, (X,), (jnp.zeros(2),))[1] == 0


def test_tangents_and_cotangents_that_sum_to_zero_give_nan():
    apart = jnp.array([1.0, -1.0])
    assert jnp.isnan(jax.jvp(total, (X,), (apart,))[1])
    assert jnp.isnan(jax.grad(lambda x: apart @ sine(x, True))(X)).all()


def test_an_entry_of_a_batch_without_a_derivative_leaves_the_others_alone():
    is_undefined = jnp.array([False, True])

    def both(scale):
        return jax.vmap(total)(scale * jnp.stack([X, X]), is_undefined)

    rates = jax.vmap(jax.grad(total))(jnp.stack([X, X]), is_undefined)
    np.testing.assert_allclose(rates[0], jnp.cos(X))
    assert jnp.isnan(rates[1]).all()
    expected = X @ jnp.cos(X)
    np.testing.assert_allclose(jax.jacfwd(both)(1.0), [expected, jnp.nan])
    # Also where all share a parameter, if the sum leaves that entry out.
    masked = jax.grad(lambda scale: jnp.sum(jnp.where(is_undefined, 0, both(scale))))(1.0)
    np.testing.assert_allclose(masked, expected)


@pytest.mark.parametrize("transform", [jax.grad, jax.jacfwd])
def test_nan_stays_nan_in_a_chain(transform):
    for first, last in ((True, False), (False, True)):
        assert jnp.isnan(transform(lambda x, a=first, b=last: total(sine(x, a), b))(X)).all()


@pytest.mark.parametrize("transform", [jax.jacrev, jax.jacfwd])
def test_a_rule_that_gives_nan_gives_nan(transform):
    def unsolved(values, is_undefined, inputs, changes):
        return tangent_of(lambda x: x * jnp.nan, inputs, changes), is_undefined

    rates = transform(lambda x: attach(unsolved, jnp.zeros(2), jnp.array(False), (x,)))(X)
    assert jnp.isnan(jnp.diag(rates)).all()


@pytest.mark.parametrize("transform", SECOND)
def test_second_derivatives_in_a_loop_are_right_or_nan(transform):
    def scaled(values, _, inputs, changes):
        return values * changes[0], jnp.array(False)

    def exponential(x):
        return attach(scaled, jnp.exp(jax.lax.stop_gradient(x)), None, (x,))

    second = transform(lambda x: jnp.sum(jax.lax.map(exponential, x)))(X)
    expected = jnp.diag(jnp.exp(X))
    np.testing.assert_allclose(jnp.where(jnp.isnan(second), expected, second), expected)
    inner_is_forward = transform in SECOND[1::2]
    assert not (inner_is_forward and np.any(np.isnan(second)))

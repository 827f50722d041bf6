"""Derivatives that do not exist, of a law of sines that stands in for a solver."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.core.implicit import attach, pushed
from jaxstab.core.no_derivative import Obstacle

X = jnp.array([1.0, 2.0])
SENTENCE = "^The derivative does not exist: it is in the way."


def rule(values, is_refused, inputs, changes):
    return pushed(jnp.sin, inputs, changes), [Obstacle(is_refused, "it is in the way")]


def sine(x, is_refused, throw):
    """Return sin(x), as if a solver had found it."""
    return attach(rule, throw, jnp.sin(jax.lax.stop_gradient(x)), jnp.array(is_refused), (x,))


def total(x, is_refused=True, throw=True):
    return jnp.sum(sine(x, is_refused, throw))


FIRST = [
    jax.grad,
    lambda f: lambda x: jax.value_and_grad(f)(x)[1],
    lambda f: lambda x: jax.jvp(f, (x,), (jnp.ones_like(x),))[1],
    jax.jacfwd,
    jax.jacrev,
    lambda f: lambda x: jax.vmap(jax.grad(f))(jnp.stack([x, x])),
]
SECOND = [
    jax.hessian,
    lambda f: jax.jacrev(jax.jacfwd(f)),
    lambda f: jax.jacrev(jax.jacrev(f)),
    lambda f: jax.jacfwd(jax.jacfwd(f)),
]


@pytest.mark.parametrize("transform", FIRST + SECOND)
def test_asking_is_an_error_that_begins_with_its_sentence(transform):
    with pytest.raises(js.SolverError, match=SENTENCE):
        transform(total)(X)


@pytest.mark.parametrize("transform", FIRST)
def test_or_else_it_is_nan(transform):
    assert jnp.isnan(transform(lambda x: total(x, throw=False))(X)).all()


@pytest.mark.parametrize("transform", SECOND)
def test_second_derivatives_of_what_has_no_first_are_nan_too(transform):
    assert jnp.isnan(jnp.diag(transform(lambda x: total(x, throw=False))(X))).all()


@pytest.mark.parametrize("transform", SECOND)
def test_second_derivatives_that_exist_are_right(transform):
    second = transform(lambda x: total(x, is_refused=False))(X)
    np.testing.assert_allclose(second, -jnp.diag(jnp.sin(X)), atol=1e-15)


def test_what_is_not_asked_for_is_not_refused():
    assert (jax.grad(lambda x: 0 * total(x))(X) == 0).all()
    assert jax.jvp(total, (X,), (jnp.zeros(2),))[1] == 0


@pytest.mark.parametrize("throw", [True, False])
def test_only_the_lanes_that_are_asked_are_refused(throw):
    refused = jnp.array([False, True])

    def masked(x, is_refused):
        return jnp.where(is_refused, 0, total(x, is_refused, throw))

    rates = jax.vmap(jax.grad(masked))(jnp.stack([X, X]), refused)
    np.testing.assert_allclose(rates, [jnp.cos(X), [0, 0]])
    if throw:
        with pytest.raises(js.SolverError, match=SENTENCE):
            jax.vmap(jax.grad(total))(jnp.stack([X, X]), refused)


@pytest.mark.parametrize("transform", [jax.grad, jax.jacfwd])
def test_what_is_nan_already_stays_so(transform):
    def chain(x, first, last):
        return total(sine(x, first, throw=not first), last, throw=not last)

    assert jnp.isnan(transform(lambda x: chain(x, True, False))(X)).all()
    assert jnp.isnan(transform(lambda x: chain(x, False, True))(X)).all()


def test_a_rule_that_gives_nan_of_itself_is_refused():
    def root(x):
        return attach(root_rule, True, jnp.zeros(2), jnp.array(False), (x,))

    def root_rule(values, is_refused, inputs, changes):
        return pushed(lambda x: x * jnp.nan, inputs, changes), [Obstacle(is_refused, "no")]

    for transform in (jax.jacrev, jax.jacfwd):
        with pytest.raises(js.SolverError, match="its linear system was not solved"):
            transform(root)(X)


def test_under_jit_the_error_of_the_runtime_holds_the_sentence():
    with pytest.raises(Exception, match=SENTENCE.strip("^")):
        jax.block_until_ready(jax.jit(jax.grad(total))(X))

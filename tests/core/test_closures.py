"""Functions as pytrees: which are told apart or compiled anew, and which cannot be one."""

import copy
import math
import pickle
import sys
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstab.core.closures import as_pytree

X = 0.7
RATES = np.arange(1.0, 4.0)
TABLES = [np.array([1.0, 2.0, 3.0]), np.array([5.0, -1.0, 2.0])]


def pytree(function, dtype=jnp.float64):
    return as_pytree("f", function, "give a real scalar.", jax.ShapeDtypeStruct((), dtype))


def plain(table):
    return lambda x: table @ jnp.exp(-x * RATES)


def in_a_jit(table):
    return jax.jit(plain(table))


def in_a_jit_of_a_jit(table):
    inner = in_a_jit(table)
    return jax.jit(lambda x: inner(x) + 0 * table[0])


def in_a_branch(table):
    return lambda x: jax.lax.cond(x > 0, plain(table), lambda x: x, x)


def in_a_custom_rule(table):
    function = jax.custom_jvp(plain(table))
    function.defjvp(lambda x, dx: (plain(table)(*x), jax.jvp(plain(table), x, dx)[1]))
    return function


HIDDEN = [plain, in_a_jit, in_a_jit_of_a_jit, in_a_branch, in_a_custom_rule]


@pytest.mark.parametrize("hide", HIDDEN)
def test_functions_of_different_tables_are_told_apart(hide):
    value_and_slope = jax.jit(lambda function, x: jax.value_and_grad(function)(x))
    for table in TABLES:
        value, slope = value_and_slope(pytree(hide(jnp.asarray(table))), X)
        np.testing.assert_allclose(value, table @ np.exp(-X * RATES))
        np.testing.assert_allclose(slope, -(RATES * table) @ np.exp(-X * RATES))


def test_a_table_is_a_leaf_and_a_function_in_another_holder_compiles_nothing(monkeypatch):
    function = of_this_module
    run = jax.jit(lambda function, x: function(x))
    for table in TABLES:
        monkeypatch.setattr(sys.modules[__name__], "TABLE", jnp.asarray(table))
        found = pytree(function)
        np.testing.assert_allclose(run(found, X), table @ np.exp(-X * RATES))
        assert any(np.array_equal(leaf, table) for leaf in jax.tree.leaves(found))
        assert run._cache_size() == 1


@pytest.mark.parametrize("hide", HIDDEN)
def test_a_function_that_reads_another_table_than_before_is_told_apart(hide):
    run = jax.jit(lambda function, x: function(x))
    tables = {}

    def law(x):
        return hide(tables["now"])(x)

    for table in TABLES:
        tables["now"] = jnp.asarray(table)
        np.testing.assert_allclose(run(pytree(law), X), table @ np.exp(-X * RATES))


def test_a_function_written_anew_compiles_nothing_unless_it_reads_another_number():
    def law(factor):
        return lambda x: factor * x + TABLES[0] @ jnp.exp(-x * RATES)

    run = jax.jit(lambda function, x: function(x))
    for number, factor in ((1, 0.5), (2, 0.7), (2, 0.5)):
        for _ in range(3):
            found = run(pytree(law(factor)), X)
            np.testing.assert_allclose(found, factor * X + TABLES[0] @ np.exp(-X * RATES))
            assert run._cache_size() == number


def test_a_function_of_a_library_rule_compiles_nothing_and_one_of_its_own_only_when_it_is_new():
    run = jax.jit(lambda function, x: function(x))
    for _ in range(2):
        np.testing.assert_allclose(
            run(pytree(lambda x: jax.nn.softplus(x)), X), np.log1p(np.exp(X))
        )
    assert run._cache_size() == 1
    own = by_a_jvp(2.0)
    for function in (own, own, by_a_jvp(2.0)):
        run(pytree(function), X)
    assert run._cache_size() == 3


def test_functions_of_other_code_are_told_apart():
    run = jax.jit(lambda function, x: function(x))
    forms = [lambda x: 2 * x, lambda x: x / 2, partial(pow, 2.0), Doubled(3.0).law]
    found = [run(pytree(form), X) for form in forms]
    np.testing.assert_allclose(found, [2 * X, X / 2, 2.0**X, 3 * X])
    # A method of another object has the same code, and reads another number.
    np.testing.assert_allclose(run(pytree(Doubled(5.0).law), X), 5 * X)
    # So has a function with another default value.
    for factor in (2.0, 3.0):
        np.testing.assert_allclose(run(pytree(lambda x, factor=factor: factor * x), X), factor * X)


def by_a_jvp(factor):
    function = jax.custom_jvp(jnp.sin)
    function.defjvp(lambda x, dx: (jnp.sin(*x), factor * dx[0]))
    return lambda x: function(x)


def by_a_vjp_in_a_jit(factor):
    function = jax.custom_vjp(jnp.sin)
    function.defvjp(lambda x: (jnp.sin(x), None), lambda _, dy: (factor * dy,))
    return lambda x: jax.jit(function)(x)


@pytest.mark.parametrize("rule", [by_a_jvp, by_a_vjp_in_a_jit])
def test_a_number_that_only_a_derivative_rule_reads_counts(rule):
    value_and_slope = jax.jit(lambda function, x: jax.value_and_grad(function)(x))
    for factor in (2.0, 3.0):
        found = value_and_slope(pytree(rule(factor)), X)
        np.testing.assert_allclose(found, [math.sin(X), factor])


def test_a_number_that_only_a_callback_reads_counts():
    run = jax.jit(lambda function, x: function(x))

    def law(table):
        return lambda x: jax.pure_callback(table.law, jax.ShapeDtypeStruct((), x.dtype), x)

    for factor in (2.0, 3.0):
        np.testing.assert_allclose(run(pytree(law(Anonymous(factor))), X), factor * X)


class Doubled:
    def __init__(self, factor):
        self.factor = factor

    def law(self, x):
        return self.factor * x


@pytest.mark.parametrize("law", [partial(partial, jnp.multiply), lambda a: Doubled(a).law])
def test_a_partial_function_or_a_method_of_another_array_compiles_nothing(law):
    run = jax.jit(lambda function, x: function(x))
    for factor in (2.0, 3.0):
        np.testing.assert_allclose(run(pytree(law(jnp.asarray(factor))), X), factor * X)
    assert run._cache_size() == 1


class Anonymous(Doubled):
    def __repr__(self):
        return "anonymous"


def test_the_place_of_an_array_counts():
    first, second = map(jnp.asarray, TABLES)
    run = jax.jit(lambda function, x: function(x))
    forms = (
        lambda x: (first * first * second).sum() * x,
        lambda x: (first * second * second).sum() * x,
    )
    found = [run(pytree(function), X) for function in forms]
    a, b = TABLES
    np.testing.assert_allclose(found, [(a * a * b).sum() * X, (a * b * b).sum() * X])


@pytest.mark.parametrize("hide", HIDDEN[:3])
def test_a_table_that_is_traced_can_be_differentiated(hide):
    gradient = jax.grad(lambda table: pytree(hide(table))(X))(jnp.asarray(TABLES[0]))
    np.testing.assert_allclose(gradient, np.exp(-X * RATES))


def test_a_law_of_a_traced_value_works_under_every_transformation():
    def force(scale, x):
        law = pytree(lambda x: scale * jax.nn.softplus(x))
        return jax.jit(lambda function, x: function(x))(law, x)

    scales, slope = jnp.array([0.5, 2.0]), math.log1p(math.exp(X))
    np.testing.assert_allclose(jax.jit(force)(0.5, X), 0.5 * slope)
    np.testing.assert_allclose(jax.vmap(force, (0, None))(scales, X), scales * slope)
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.grad(force), (0, None)))(scales, X), slope)
    np.testing.assert_allclose(jax.jacfwd(force)(0.5, X), slope)
    # An integer can be closed over as well.
    raised = jax.jit(lambda n: pytree(lambda x: x**2 * n)(X))(3)
    np.testing.assert_allclose(raised, 3 * X**2)


def test_a_number_that_a_function_reads_counts():
    run = jax.jit(lambda function, x: function(x))
    numbers = {}

    def law(x):
        return numbers["factor"] * x

    for factor, programs in ((0.1, 1), (0.1 + 1e-16, 2), (0.1, 2)):
        numbers["factor"] = factor
        np.testing.assert_allclose(run(pytree(law), X), factor * X)
        assert run._cache_size() == programs


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_a_function_answers_in_the_precision_that_it_is_asked_in(dtype):
    function = pytree(plain(jnp.asarray(TABLES[0])))
    assert function(jnp.asarray(X, dtype)).dtype == dtype


TABLE = TABLES[0]


def of_this_module(x):
    return TABLE @ jnp.exp(-x * RATES)


@pytest.mark.parametrize("function", [of_this_module, plain(TABLES[0])])
def test_a_function_is_copied_and_where_it_has_a_name_pickled(function):
    run = jax.jit(lambda function, x: function(x))
    copies = [function := pytree(function), copy.deepcopy(function)]
    if function.formula.function is of_this_module:
        copies.append(pickle.loads(pickle.dumps(function)))
    for twin in copies:
        np.testing.assert_allclose(run(twin, X), TABLES[0] @ np.exp(-X * RATES))
    assert run._cache_size() == 1


class Labelled(eqx.Module):
    """A module with fields of which JAX makes nothing."""

    energy: jax.Array
    name: str
    shape: object
    rates: object = eqx.field(static=True)

    def __call__(self, x):
        return self.energy * sum(self.shape(-rate * x) for rate in self.rates)


def test_a_module_may_have_fields_that_are_no_arrays():
    run = jax.jit(lambda function, x: function(x))
    for energy in (1.0, 2.0):
        law = Labelled(jnp.array(energy), "named", jnp.exp, (1.0, 2.0))
        found = run(pytree(law), X)
        np.testing.assert_allclose(found, energy * (np.exp(-X) + np.exp(-2 * X)))


@pytest.mark.parametrize(
    "function",
    [
        lambda x: np.exp(-x),
        lambda x: math.exp(x),
        lambda x: x if x > 1 else 0 * x,
        lambda x: X[int(x)],
    ],
)
def test_a_function_that_asks_for_the_value_is_told_how_to_be_written(function):
    with pytest.raises(TypeError, match=r"f needs the value.*jax.numpy.*jnp.where"):
        pytree(function)

from unittest import mock

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstab.core import control_flow
from jaxstab.core.control_flow import by_entries, first_good


def iterate(start, factor):
    """A loop whose length depends on the entry, with a result that depends on its rounding."""

    def step(carry):
        value, count = carry
        return jnp.sin(factor * value) + value / 3, count + 1

    value, count = jax.lax.while_loop(lambda c: (c[0] > 0.1) & (c[1] < 99), step, (start, 0))
    return {"value": value, "count": count}


STARTS = jnp.linspace(0.2, 3.0, 5)
FACTORS = jnp.linspace(0.1, 0.9, 3)


def assert_equal(left, right):
    for name in ("value", "count"):
        np.testing.assert_array_equal(left[name], right[name])


@pytest.mark.parametrize("transform", [lambda f: f, jax.jit])
def test_an_entry_has_the_same_result_as_alone(transform):
    solve = transform(jax.jit(by_entries(iterate)))
    apart = [jax.jit(iterate)(start, FACTORS[1]) for start in STARTS]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *apart)
    assert_equal(transform(jax.vmap(solve, in_axes=(0, None)))(STARTS, FACTORS[1]), stacked)
    assert_equal(jax.vmap(lambda start: solve(start, FACTORS[1]))(STARTS), stacked)


def test_batches_nest():
    solve = by_entries(iterate)
    nested = jax.vmap(lambda f: jax.vmap(lambda s: solve(s, f))(STARTS))(FACTORS)
    plain = jax.vmap(lambda f: jax.vmap(lambda s: iterate(s, f))(STARTS))(FACTORS)
    np.testing.assert_array_equal(nested["count"], plain["count"])
    np.testing.assert_allclose(nested["value"], plain["value"], rtol=1e-12)


def test_a_program_has_a_loop_over_entries_on_the_cpu_alone():
    solve = jax.jit(jax.vmap(by_entries(iterate), in_axes=(0, None)))
    with mock.patch.object(control_flow, "has_accelerator", lambda: True):
        for platform, loops in (("cuda", 1), ("cpu", 2)):
            program = jax.export.export(solve, platforms=[platform])(STARTS, FACTORS[1])
            assert program.mlir_module().count("stablehlo.while") == loops


@pytest.mark.parametrize(("least", "expected", "number"), [(2, 2, 2), (5, 5, 3), (6, 1, 3)])
def test_the_first_good_result_of_several_choices_is_taken(least, expected, number):
    choices = [jnp.array(number) for number in (1, 2, 5)]
    computed = []

    def square(number):
        computed.append(number)
        return number**2

    def found():
        return first_good(square, lambda result: result >= least**2, choices)

    assert found() == expected**2
    assert len(computed) == number
    assert jax.jit(found)() == expected**2

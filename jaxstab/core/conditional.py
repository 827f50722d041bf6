"""Parts of a computation that are needed only sometimes, traced or not."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.core.checks import is_traced, is_transformed

Out = TypeVar("Out")


def if_needed(is_needed: Any, compute: Callable[[], Out], otherwise: Out) -> Out:
    """Return the value of `compute()` if it is needed, else `otherwise`.

    If `is_needed` is concrete, a part that is not needed is neither traced nor compiled.
    """
    if is_traced(is_needed):
        return jax.lax.cond(is_needed, compute, lambda: otherwise)
    return compute() if is_needed else otherwise


def first_good(compute: Callable[[Any], Out], is_good: Callable[[Out], Array]) -> Out:
    """Return `compute(0)` if it is good, or else `compute(1)`, or the first if neither is.

    In a trace `compute` is traced once; outside of one, the second is computed only if needed.
    """
    if not is_transformed(()):
        first = compute(0)
        if is_good(first):
            return first
        second = compute(1)
        return second if is_good(second) else first

    def is_needed(state: tuple[Array, Out]) -> Array:
        number, found = state
        return (number == 0) | ((number == 1) & ~is_good(found))

    def look(state: tuple[Array, Out]) -> tuple[Array, Out]:
        number, first = state
        found = compute(number)
        is_told_of = (number == 0) | is_good(found)
        return number + 1, jax.tree.map(partial(jnp.where, is_told_of), found, first)

    zero = jnp.array(0)
    like = jax.eval_shape(compute, zero)
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like)
    return jax.lax.while_loop(is_needed, look, (zero, nothing))[1]

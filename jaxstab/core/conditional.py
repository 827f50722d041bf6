"""Conditional computation, traced or not."""

from collections.abc import Callable
from functools import partial
from itertools import chain
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, PyTree

from jaxstab.core.batching import on_platform
from jaxstab.core.checks import is_traced, is_transformed
from jaxstab.core.types import ArrayLike

Out = TypeVar("Out")


def if_needed(is_needed: ArrayLike, compute: Callable[[], Out], otherwise: Out) -> Out:
    """Return `compute()` if it is needed, else `otherwise`.

    If `is_needed` is concrete, a computation that is not needed is neither traced nor compiled.
    """
    if is_traced(is_needed):
        return jax.lax.cond(is_needed, compute, lambda: otherwise)
    return compute() if is_needed else otherwise


def choose(condition: ArrayLike, one: Out, other: Out) -> Out:
    """Return one of two trees of arrays; both are computed."""
    return jax.tree.map(partial(jnp.where, condition), one, other)


def either(
    is_first: ArrayLike, first: Callable[..., Out], second: Callable[..., Out], *args: Array
) -> Out:
    """Return the result of one of two functions of the same arguments.

    In a trace that is a branch on a CPU. An accelerator computes both and selects, since there a
    branch waits until the host has read which one is taken.
    """
    if not is_traced(is_first):
        return (first if is_first else second)(*args)

    def both(*args: Array) -> Out:
        return choose(is_first, first(*args), second(*args))

    return on_platform(partial(jax.lax.cond, is_first, first, second), both, *args)


def first_good(compute: Callable[..., Out], is_good: Callable[[Out], Array], number: int) -> Out:
    """Return the first good result of `compute(0)` to `compute(number - 1)`, else the first one.

    In a trace `compute` is traced once; outside of a trace, no more are computed than needed.
    """
    if not is_transformed(()):
        first = compute(0)
        others = map(compute, range(1, number))
        return next(filter(is_good, chain([first], others)), first)

    def goes_on(state: tuple[Array, Out]) -> Array:
        count, found = state
        return (count == 0) | ((count < number) & ~is_good(found))

    def try_next(state: tuple[Array, Out]) -> tuple[Array, Out]:
        count, first = state
        found = compute(count)
        is_kept = (count == 0) | is_good(found)
        return count + 1, choose(is_kept, found, first)

    zero = jnp.array(0)
    return jax.lax.while_loop(goes_on, try_next, (zero, zeros_of(compute, zero)))[1]


def zeros_of(function: Callable[..., Out], *args: PyTree) -> Out:
    """Return zeros in the shape of a function's result, which is not computed."""
    like = jax.eval_shape(function, *args)
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like)

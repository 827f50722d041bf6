"""Loops and branches of searches, and batches, which a CPU and an accelerator run differently.

A search is written once, as loops and branches around compiled programs. Outside of a trace they
run in Python, so that a program that several searches need is compiled once, and one that none
needs is not compiled at all. In a trace the same text is one program.

A CPU gains nothing from wide arrays: there the entries of a batch run one after another, none waits
for the slowest, and each gives the same result as alone, bit for bit.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.backend import backends
from jaxtyping import Array, Int, PyTree

from jaxstab.core.checks import is_traced, is_transformed
from jaxstab.core.stack import stack_of
from jaxstab.core.types import ArrayLike, Flag

Out = TypeVar("Out")
Tree = TypeVar("Tree")


def by_entries(function: Callable[..., Out]) -> Callable[..., Out]:
    """Return `function` of pytrees of arrays, such that `jax.vmap` runs entries in this way.

    A program that is lowered for another platform runs them together, unless JAX finds the CPU
    alone.
    """
    alone = jax.custom_batching.custom_vmap(function)

    @alone.def_vmap
    def run(axis_size: int, in_batched: PyTree, *args: PyTree) -> tuple[Out, PyTree]:
        mapped, shared = eqx.partition(args, tuple(in_batched))

        def call(callee: Callable[..., Out], mapped: PyTree) -> Out:
            return callee(*eqx.combine(mapped, shared))

        # An entry may be a batch itself.
        one_by_one = partial(jax.lax.map, partial(call, alone))
        out = on_platform(one_by_one, jax.vmap(partial(call, function)), mapped)
        return out, jax.tree.map(lambda _: True, out)

    return alone


def entry_of(batch: Tree, i: Int[Array, ""]) -> Tree:
    """Return one entry of a batch; the index is not checked."""

    def entry(leaf: Array) -> Array:
        return jax.lax.dynamic_index_in_dim(leaf, i, keepdims=False, allow_negative_indices=False)

    return jax.tree.map(entry, batch)


def with_entry(batch: Tree, i: Int[Array, ""], entry: Tree, axis: int = 0) -> Tree:
    """Return a batch with one entry along an axis replaced; the index is not checked."""

    def put(leaf: Array, new: Array) -> Array:
        new = jnp.asarray(new, leaf.dtype)
        return jax.lax.dynamic_update_index_in_dim(leaf, new, i, axis, allow_negative_indices=False)

    return jax.tree.map(put, batch, entry)


def while_loop(goes_on: Callable[[Tree], Flag], step: Callable[[Tree], Tree], state: Tree) -> Tree:
    """Return the first state that does not go on; a loop of Python outside of a trace.

    There the condition should only read a flag of the state, as each operation is compiled.
    """
    if is_transformed(state):
        return jax.lax.while_loop(goes_on, step, state)
    while goes_on(state):
        state = step(state)
    return state


def cond(condition: ArrayLike, one: Callable[[], Out], other: Callable[[], Out]) -> Out:
    """Return the result of one of two functions; a branch of Python if the condition is known."""
    if is_traced(condition):
        return jax.lax.cond(condition, one, other)
    if condition:
        return one()
    return other()


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

    def one(*args: Array) -> Out:
        return cond(is_first, partial(first, *args), partial(second, *args))

    def both(*args: Array) -> Out:
        return choose(is_first, first(*args), second(*args))

    return on_platform(one, both, *args)


def first_good(
    compute: Callable[[Tree], Out], is_good: Callable[[Out], Flag], choices: Sequence[Tree]
) -> Out:
    """Return the first good result of a function of several choices, else that of the first one.

    In a trace the function is traced once; outside of a trace, no more is computed than needed.
    """
    if not is_transformed(()):
        first = compute(choices[0])
        others = map(compute, choices[1:])
        return next(filter(is_good, chain([first], others)), first)

    table = jax.tree.map(lambda *leaves: jnp.stack(leaves), *choices)

    def goes_on(state: tuple[Array, Out]) -> Array:
        count, found = state
        return (count == 0) | ((count < len(choices)) & ~is_good(found))

    def try_next(state: tuple[Array, Out]) -> tuple[Array, Out]:
        count, first = state
        found = compute(entry_of(table, count))
        is_kept = (count == 0) | is_good(found)
        return count + 1, choose(is_kept, found, first)

    start = jnp.array(0), zeros_of(compute, choices[0])
    return jax.lax.while_loop(goes_on, try_next, start)[1]


def each(function: Callable[[Tree], Out], entries: Sequence[Tree]) -> Out:
    """Return the results for several entries, computed one after another, along a leading axis."""
    if is_transformed(entries):
        return jax.lax.map(function, jax.tree.map(lambda *leaves: jnp.stack(leaves), *entries))
    found = [function(entry) for entry in entries]
    return stack_of(found, found[0])


def zeros_of(function: Callable[..., Out], *args: PyTree) -> Out:
    """Return zeros in the shape of a function's result, which is not computed."""
    like = jax.eval_shape(function, *args)
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like)


def on_platform(on_cpu: Callable[..., Out], elsewhere: Callable[..., Out], *args: PyTree) -> Out:
    """Evaluate one function on a CPU, and another elsewhere."""
    if not has_accelerator():
        # Tracing the other branch would take time, and it cannot run here.
        return on_cpu(*args)
    return jax.lax.platform_dependent(*args, cpu=on_cpu, default=elsewhere)


def has_accelerator() -> bool:
    """Return whether JAX finds anything but the CPU."""
    return set(backends()) != {"cpu"}

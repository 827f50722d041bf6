"""Batches: entries run one after another on a CPU, all together elsewhere.

The CPU gains nothing from wide arrays. There no entry waits for the slowest, and each gives the
same result as alone, bit for bit.
"""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax
from jax.extend.backend import backends
from jaxtyping import Array, Int, PyTree

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
        leaves, tree = jax.tree.flatten(args)
        is_mapped = jax.tree.leaves(in_batched)
        mapped = [leaf for leaf, m in zip(leaves, is_mapped, strict=True) if m]

        def call(callee: Callable[..., Out], mapped: list[Array]) -> Out:
            rest = iter(mapped)
            merged = [next(rest) if m else leaf for leaf, m in zip(leaves, is_mapped, strict=True)]
            return callee(*jax.tree.unflatten(tree, merged))

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


def with_entry(batch: Tree, i: Int[Array, ""], entry: Tree) -> Tree:
    """Return a batch with one entry replaced; the index is not checked."""

    def replaced(leaf: Array, new: Array) -> Array:
        new = jax.numpy.asarray(new, leaf.dtype)
        return jax.lax.dynamic_update_index_in_dim(leaf, new, i, 0, allow_negative_indices=False)

    return jax.tree.map(replaced, batch, entry)


def on_platform(on_cpu: Callable[..., Out], elsewhere: Callable[..., Out], *args: PyTree) -> Out:
    """Evaluate one function on a CPU, and another elsewhere."""
    if not has_accelerator():
        # Tracing the other branch would take time, and it cannot run here.
        return on_cpu(*args)
    return jax.lax.platform_dependent(*args, cpu=on_cpu, default=elsewhere)


def has_accelerator() -> bool:
    """Return whether JAX finds anything but the CPU."""
    return set(backends()) != {"cpu"}

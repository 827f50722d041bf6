"""How a solver runs on many problems: lane by lane where that is faster."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
from jax.extend.backend import backends
from jaxtyping import Array

In = TypeVar("In")
Out = TypeVar("Out")


def map_lanes(function: Callable[[In], Out], lanes: In) -> Out:
    """Return what a function gives on each lane, along the leading axis of all arrays.

    On the CPU, which gains nothing from wide arrays, they run one after another: none waits for
    the slowest, and each gives what it gives alone, to the last bit. Elsewhere all run together;
    also a program that is made for elsewhere, unless JAX finds nothing but the CPU.
    """
    return _map(function, function, lanes)


def by_lanes(function: Callable[..., Out]) -> Callable[..., Out]:
    """Return `function`, of arrays in pytrees, such that `jax.vmap` runs it like `map_lanes`."""
    lane = jax.custom_batching.custom_vmap(function)

    @lane.def_vmap
    def run(axis_size: int, in_batched: Any, *args: Any) -> tuple[Out, Any]:
        leaves, tree = jax.tree.flatten(args)
        is_mapped = jax.tree.leaves(in_batched)
        mapped = [leaf for leaf, m in zip(leaves, is_mapped, strict=True) if m]

        def call(callee: Callable[..., Out], mapped: list[Array]) -> Out:
            rest = iter(mapped)
            merged = [next(rest) if m else leaf for leaf, m in zip(leaves, is_mapped, strict=True)]
            return callee(*jax.tree.unflatten(tree, merged))

        # One after another, lanes may have lanes of their own.
        out = _map(partial(call, lane), partial(call, function), mapped)
        return out, jax.tree.map(lambda _: True, out)

    return lane


def _map(alone: Callable[[In], Out], together: Callable[[In], Out], lanes: In) -> Out:
    one_by_one = partial(jax.lax.map, alone)
    if not _has_accelerator():
        # Most of the time to trace would go into what cannot run here.
        return one_by_one(lanes)
    return jax.lax.platform_dependent(lanes, cpu=one_by_one, default=jax.vmap(together))


def _has_accelerator() -> bool:
    return set(backends()) != {"cpu"}

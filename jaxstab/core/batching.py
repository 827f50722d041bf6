"""How a solver runs on many problems: lane by lane where that is faster."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.extend.backend import backends
from jaxtyping import Array, Int

In = TypeVar("In")
Out = TypeVar("Out")
Lane = TypeVar("Lane")


def map_lanes(function: Callable[[In], Out], lanes: In) -> Out:
    """Return the results of a function on each lane, along the leading axis of all arrays.

    The CPU gains nothing from wide arrays, so there they run one after another. None waits for the
    slowest, and each gives the same as alone, to the last bit. Elsewhere all run together; also a
    program that is made for elsewhere, unless JAX finds nothing but the CPU.
    """
    return _map(function, function, lanes)


def advance_lanes(
    advance: Callable[[Lane, Array], Lane], lanes: Lane, max_steps: Int[Array, " lanes"]
) -> Lane:
    """Return lanes that a function advanced, each by at most so many steps, run as by `map_lanes`.

    Those without steps to take cost nothing on the CPU, not even to be copied.
    """
    if max_steps.size == 1:
        lane = advance(jax.tree.map(lambda leaf: leaf[0], lanes), max_steps[0])
        return jax.tree.map(lambda leaf: leaf[None], lane)

    def one_by_one(lanes: Lane, max_steps: Array) -> Lane:
        def advance_next(state: tuple[Lane, Array]) -> tuple[Lane, Array]:
            lanes, left = state
            i = jnp.argmax(left)
            lane = advance(lane_of(lanes, i), lane_of(left, i))
            return with_lane((lanes, left), i, (lane, jnp.zeros_like(left[0])))

        return jax.lax.while_loop(
            lambda state: jnp.any(state[1] > 0), advance_next, (lanes, max_steps)
        )[0]

    return on_platform(one_by_one, jax.vmap(advance), lanes, max_steps)


def lane_of(lanes: Lane, i: Int[Array, ""]) -> Lane:
    """Return one lane of many, whose number is not checked."""

    def entry(leaf: Array) -> Array:
        return jax.lax.dynamic_index_in_dim(leaf, i, keepdims=False, allow_negative_indices=False)

    return jax.tree.map(entry, lanes)


def with_lane(lanes: Lane, i: Int[Array, ""], lane: Lane) -> Lane:
    """Return many lanes with one of them replaced, whose number is not checked."""

    def replaced(leaf: Array, entry: Array) -> Array:
        entry = jnp.asarray(entry, leaf.dtype)
        return jax.lax.dynamic_update_index_in_dim(leaf, entry, i, 0, allow_negative_indices=False)

    return jax.tree.map(replaced, lanes, lane)


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
    return on_platform(partial(jax.lax.map, alone), jax.vmap(together), lanes)


def on_platform(on_cpu: Callable[..., Out], elsewhere: Callable[..., Out], *args: Any) -> Out:
    """Return what one function gives on a CPU, and another elsewhere."""
    if not has_accelerator():
        # Most of the time to trace would go into what cannot run here.
        return on_cpu(*args)
    return jax.lax.platform_dependent(*args, cpu=on_cpu, default=elsewhere)


def has_accelerator() -> bool:
    """Return whether JAX finds anything but the CPU."""
    return set(backends()) != {"cpu"}

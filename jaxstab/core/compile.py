"""Compiled programs, and room for new ones.

On the CPU a program maps its code into memory in hundreds of pieces, of which Linux gives a process
65 530. A long notebook with many laws would run out of them, and fail for want of memory.
"""

from collections.abc import Callable, Hashable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.core.checks import is_traced, is_transformed

Out = TypeVar("Out")

# The part of all pieces at which the programs are dropped.
_SHARE = 0.3
_programs: list[Any] = []
_kinds: set[Hashable] = set()


def program(function: Callable[..., Any], **options: Any) -> Any:
    """Return `jax.jit(function, **options)`, of which `make_room` can drop what it compiled."""
    compiled = jax.jit(function, **options)
    _programs.append(compiled)
    return compiled


def if_needed(is_needed: Any, compute: Callable[[], Out], otherwise: Out) -> Out:
    """Return what is computed if it is needed, or else something known.

    Outside of a trace nothing is compiled for what is not needed.
    """
    if is_traced(is_needed):
        return jax.lax.cond(is_needed, compute, lambda: otherwise)
    return compute() if is_needed else otherwise


def first_good(compute: Callable[[Any], Out], is_good: Callable[[Out], Array]) -> Out:
    """Return what is computed for 0 if it is good, or else for 1, or for 0 if neither is.

    What both share is compiled once; outside of a trace nothing is for what is not needed.
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


def make_room(kind: Hashable) -> None:
    """Drop what was compiled, if this is a new kind of problem and room is short."""
    if kind in _kinds:
        return
    if num_pieces() > _SHARE * _max_pieces():
        for compiled in _programs:
            compiled.clear_cache()
        _kinds.clear()
    _kinds.add(kind)


def num_pieces() -> int:
    """Return how many pieces of memory are mapped, as far as that is known."""
    path = Path("/proc/self/maps")
    return path.read_bytes().count(b"\n") if path.exists() else 0


def _max_pieces() -> int:
    path = Path("/proc/sys/vm/max_map_count")
    return int(path.read_text()) if path.exists() else 65_530

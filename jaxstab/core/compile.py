"""Compiled programs, and room for new ones.

On the CPU a program maps its code into memory in hundreds of pieces, of which Linux gives a process
65 530. A long notebook with many laws would run out of them, and fail for want of memory.
"""

import os
from collections.abc import Callable, Hashable
from functools import cache, partial, wraps
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.core.batching import has_accelerator
from jaxstab.core.checks import is_traced, is_transformed
from jaxstab.core.stored_programs import StoredProgram

Out = TypeVar("Out")

# The part of all pieces at which the programs are dropped.
_SHARE = 0.3
_programs: list[Any] = []
_kinds: set[Hashable] = set()


def program(function: Callable[..., Any], *, runs_once: bool = False, **options: Any) -> Any:
    """Return `jax.jit(function, **options)`, compiled faster where it is called outside of a trace.

    There its `ahead(*args)` begins to compile it for arguments like these, arrays or shapes, and
    returns the shapes of the results. `make_room` can drop its compiled programs.

    Arguments:
        function: the function.
        runs_once: whether its code need not be fast, since it has no loop and is seldom run.
    """
    # Within another program there can be no options for this one.
    inside = jax.jit(function, **options)
    _programs.append(inside)

    @cache
    def outside() -> Any:
        compiled = StoredProgram(function, compiler_options=_compiler_options(runs_once), **options)
        _programs.append(compiled)
        return compiled

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        compiled = inside if is_transformed((args, kwargs)) else outside()
        return compiled(*args, **kwargs)

    def ahead(*args: Any, **kwargs: Any) -> Any:
        return outside().ahead(*args, **kwargs)

    call.lower, call.ahead = inside.lower, ahead  # pyright: ignore[reportAttributeAccessIssue]
    return call


def _compiler_options(runs_once: bool) -> dict[str, Any]:
    """Return the options by which XLA compiles for the CPU in less time.

    What does not run once is as fast as by default; it may be rounded otherwise than inside of
    `jax.jit` and `jax.vmap`. Flags that the user has set stand.
    """
    if has_accelerator():
        return {}
    options: dict[str, Any] = {
        "xla_backend_optimization_level": 0 if runs_once else 1,
        # Enough for all cores to have one; each costs some time of its own.
        "xla_cpu_parallel_codegen_split_count": min(4 * (os.cpu_count() or 1), 32),
    }
    if jax.__version_info__ < (0, 11):
        # Later ones can be told so for a whole process only.
        options["xla_cpu_use_fusion_emitters"] = False
    flags = os.environ.get("XLA_FLAGS", "")
    return {name: value for name, value in options.items() if name not in flags}


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
    """Drop compiled programs, if this is a new kind of problem and room is short."""
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

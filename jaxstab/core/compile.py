"""Compiled programs, with compiler options that halve the cold compile time on a CPU.

JAX's checks of the user's code are disabled in them, and products of matrices have all digits.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax

from jaxstab.core.checks import is_transformed, require_no_explicit_mesh
from jaxstab.core.control_flow import by_entries, has_accelerator

# Linux gives a process 65 530 memory mappings, of which a compiled program takes hundreds. LLVM
# aborts the process when none is left, so the error must come before.
MOST_MAPPINGS = 0.95
Given = ParamSpec("Given")
Out = TypeVar("Out")


@contextmanager
def own_conventions() -> Iterator[None]:
    """Disable JAX's checks of the user's code: NaN and infinity are answers, numbers broadcast.

    Products of matrices have all digits: by default accelerators take three in float32.
    """
    with (
        jax.debug_nans(False),
        jax.debug_infs(False),
        jax.default_matmul_precision("highest"),
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
    ):
        yield


def program(function: Callable[Given, Out], **options: Any) -> Callable[Given, Out]:
    """Return `jax.jit(function, **options)`, with these compiler options outside of a trace."""

    @wraps(function)
    def call(*args: Given.args, **kwargs: Given.kwargs) -> Out:
        _require_memory_mappings()
        return function(*args, **kwargs)

    @cache
    def with_options() -> Callable[Given, Out]:
        return jax.jit(call, compiler_options=_compiler_options(), **options)

    def outside(*args: Given.args, **kwargs: Given.kwargs) -> Out:
        return with_options()(*args, **kwargs)

    # A program within another one cannot have compiler options.
    return _one_of(jax.jit(call, **options), wraps(function)(outside))


def in_pieces(function: Callable[Given, Out]) -> Callable[Given, Out]:
    """Return `function`, which outside of a trace runs in Python, as the programs that it calls.

    In a trace, or under a transformation, it is one program, by the entries of a batch.
    """
    # Compiled, since `jax.vmap` outside of `jax.jit` would otherwise compile it with each call.
    return _one_of(program(by_entries(function)), function)


def _one_of(inside: Callable[Given, Out], outside: Callable[Given, Out]) -> Callable[Given, Out]:
    """Return the function that calls one of two, the first under a transformation."""

    @wraps(outside)
    @own_conventions()
    def call(*args: Given.args, **kwargs: Given.kwargs) -> Out:
        require_no_explicit_mesh()
        if is_transformed((args, kwargs)):
            return inside(*args, **kwargs)
        return outside(*args, **kwargs)

    return call


def _compiler_options() -> dict[str, Any]:
    if has_accelerator():
        return {}
    parts = min(4 * (os.cpu_count() or 1), 32)
    options = {"xla_backend_optimization_level": 1, "xla_cpu_parallel_codegen_split_count": parts}
    if jax.__version_info__ < (0, 11):
        # Later versions accept it for a whole process only.
        options["xla_cpu_use_fusion_emitters"] = False
    # The user's own flags take precedence.
    flags = os.environ.get("XLA_FLAGS", "")
    return {name: value for name, value in options.items() if name not in flags}


def memory_mappings() -> tuple[int, int] | None:
    """Return how many memory mappings the process has, and may have; None where unknown."""
    maps = Path("/proc/self/maps")
    limit = Path("/proc/sys/vm/max_map_count")
    if not (maps.exists() and limit.exists()):
        return None
    return maps.read_bytes().count(b"\n"), int(limit.read_text())


def _require_memory_mappings() -> None:
    """Raise `MemoryError` if a program to be compiled may exhaust the memory mappings."""
    number, most = memory_mappings() or (0, 1)
    if number > MOST_MAPPINGS * most:
        raise MemoryError(
            f"The process has {number} of at most {most} memory mappings, nearly all of them by "
            "compiled programs. Call jax.clear_caches(), which drops these, and go on; or raise "
            "the limit vm.max_map_count of the system."
        )

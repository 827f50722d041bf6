"""Compiled programs, by compiler options that halve their cold compile time on a CPU."""

import os
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any

import jax

from jaxstab.core.batching import has_accelerator
from jaxstab.core.checks import is_transformed

# Compiled programs map memory in hundreds of pieces. Where no more can be mapped, LLVM aborts.
_MOST_OF_THE_MAPPINGS = 0.95


def program(function: Callable[..., Any], **options: Any) -> Any:
    """Return `jax.jit(function, **options)`, compiled faster where it is called outside of a trace.

    Raises:
        MemoryError: when called, if the process has hardly any memory mappings left.
    """

    @wraps(function)
    def traced(*args: Any, **kwargs: Any) -> Any:
        _require_mappings()
        return function(*args, **kwargs)

    # A program within another one cannot have compiler options.
    inside = jax.jit(traced, **options)
    outside = cache(lambda: jax.jit(traced, compiler_options=_compiler_options(), **options))

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        compiled = inside if is_transformed((args, kwargs)) else outside()
        return compiled(*args, **kwargs)

    call.lower = inside.lower  # pyright: ignore[reportAttributeAccessIssue]
    return call


def _compiler_options() -> dict[str, Any]:
    """Return options by which XLA compiles for the CPU faster; flags of the user stand."""
    if has_accelerator():
        return {}
    options: dict[str, Any] = {
        "xla_backend_optimization_level": 1,
        # Each part of a program can be compiled on a core of its own, and costs some time.
        "xla_cpu_parallel_codegen_split_count": min(4 * (os.cpu_count() or 1), 32),
    }
    if jax.__version_info__ < (0, 11):
        # Later versions accept it for a whole process only.
        options["xla_cpu_use_fusion_emitters"] = False
    flags = os.environ.get("XLA_FLAGS", "")
    return {name: value for name, value in options.items() if name not in flags}


def _require_mappings() -> None:
    maps, limit = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
    if not (maps.exists() and limit.exists()):
        return
    number, most = maps.read_bytes().count(b"\n"), int(limit.read_text())
    if number > _MOST_OF_THE_MAPPINGS * most:
        raise MemoryError(
            f"The process has {number} of at most {most} memory mappings, nearly all of them by "
            "compiled programs. Call jax.clear_caches(), which drops these, and go on; or raise "
            "the limit vm.max_map_count of the system."
        )

"""Compiled programs, by compiler options that halve their cold compile time on a CPU."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from typing import Any

import jax

from jaxstab.core.batching import has_accelerator
from jaxstab.core.checks import is_transformed
from jaxstab.core.memory_mappings import require_memory_mappings


def program(function: Callable[..., Any], **options: Any) -> Any:
    """Return `jax.jit(function, **options)`, compiled faster where it is called outside a trace."""

    @wraps(function)
    def traced(*args: Any, **kwargs: Any) -> Any:
        require_memory_mappings()
        return function(*args, **kwargs)

    # A program within another one cannot have compiler options.
    inside = jax.jit(traced, **options)
    outside = cache(lambda: jax.jit(traced, compiler_options=_compiler_options(), **options))

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        with own_conventions():
            return (inside if is_transformed((args, kwargs)) else outside())(*args, **kwargs)

    call.lower = inside.lower  # pyright: ignore[reportAttributeAccessIssue]
    return call


@contextmanager
def own_conventions() -> Iterator[None]:
    """Set aside JAX's checks of the user's code: here NaN is an answer, and numbers broadcast."""
    with (
        jax.debug_nans(False),
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
    ):
        yield


def _compiler_options() -> dict[str, Any]:
    if has_accelerator():
        return {}
    parts = min(4 * (os.cpu_count() or 1), 32)
    options = {"xla_backend_optimization_level": 1, "xla_cpu_parallel_codegen_split_count": parts}
    if jax.__version_info__ < (0, 11):
        # Later versions accept it for a whole process only.
        options["xla_cpu_use_fusion_emitters"] = False
    # Flags of the user stand.
    flags = os.environ.get("XLA_FLAGS", "")
    return {name: value for name, value in options.items() if name not in flags}

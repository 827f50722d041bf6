"""Python functions as pytrees, so that what holds one can cross any JAX transformation."""

from collections.abc import Callable
from typing import Any

import equinox as eqx

from jaxstab.checks import is_traced


class _Function(eqx.Module):
    """A bare function; code that takes it is compiled anew for each function object."""

    function: Callable[..., Any] = eqx.field(static=True)

    def __call__(self, argument: Any) -> Any:
        return self.function(argument)


class _Closure(eqx.Module):
    """A bare function whose closed-over tracers have become leaves."""

    captured: Any
    rest: Any = eqx.field(static=True)

    def __call__(self, argument: Any) -> Any:
        return eqx.combine(self.captured, self.rest)(argument)


def as_pytree(function: Any, argument: Any) -> Any:
    """Return `function`, to be called on arrays like `argument`, as a pytree of arrays."""
    if isinstance(function, eqx.Module):
        return function
    converted = eqx.filter_closure_convert(function, argument)
    if is_traced(converted):
        return _Closure(*eqx.partition(converted, eqx.is_array))
    return _Function(function)

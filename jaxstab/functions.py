"""Python functions as pytrees, so that what holds one can cross any JAX transformation."""

from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, jaxpr_as_fun
from jaxtyping import Array


class _Formula:
    """What a function computes, equal to another where both read the same.

    Compared by its text, a function written anew, as in a loop over a closed-over array, is not
    compiled anew; and one that reads a global that has changed is. Inner parts whose text tells
    only their names are compared as objects: arrays always, others, such as custom derivative
    rules, unless the function itself is the same.
    """

    def __init__(self, function: Callable[..., Any], closed: ClosedJaxpr):
        self.function = function
        self.jaxpr = closed.jaxpr
        self.text = str(closed.jaxpr)
        self.opaque = list(_opaque_parts(closed.jaxpr))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Formula) or self.text != other.text:
            return False
        is_same_function = self.function is other.function

        def agree(left: Any, right: Any) -> bool:
            if left is right:
                return True
            is_array = isinstance(left, jax.Array | np.ndarray)
            return not is_array and (is_same_function or left == right)

        pairs = zip(self.opaque, other.opaque, strict=False)
        return len(self.opaque) == len(other.opaque) and all(agree(*pair) for pair in pairs)

    def __hash__(self) -> int:
        return hash(self.text)


def _opaque_parts(jaxpr: Jaxpr) -> Iterator[Any]:
    """Yield the arrays and objects inside of a formula that its text does not show in full."""
    for equation in jaxpr.eqns:
        for part in jax.tree.leaves(equation.params):
            if isinstance(part, ClosedJaxpr):
                yield from part.consts
                yield from _opaque_parts(part.jaxpr)
            elif isinstance(part, Jaxpr):
                yield from _opaque_parts(part)
            elif not isinstance(part, int | float | complex | str):
                yield part


class _Function(eqx.Module):
    """A bare function: its formula, and the arrays that it closes over as leaves."""

    captured: list[Array]
    formula: _Formula = eqx.field(static=True)

    def __repr__(self) -> str:
        return getattr(self.formula.function, "__name__", repr(self.formula.function))

    def __call__(self, argument: Any) -> Any:
        closed = ClosedJaxpr(self.formula.jaxpr, self.captured)
        return jaxpr_as_fun(closed)(argument)[0]


def as_pytree(function: Any, argument: Any) -> Any:
    """Return `function`, from arrays like `argument` to one array, as a pytree of arrays."""
    if isinstance(function, eqx.Module):
        return function
    # A new lambda, because tracing is cached by the identity of the function.
    closed = jax.make_jaxpr(lambda x: function(x))(argument)
    return _Function(
        [jnp.asarray(constant) for constant in closed.consts], _Formula(function, closed)
    )

"""Python functions as pytrees, so that what holds one can cross any JAX transformation."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jaxtyping import Array


class _Formula:
    """What a function computes, equal to another where both read the same.

    Compared by its text, a function written anew, as in a loop over a closed-over array, is not
    compiled anew; and one that reads a global that has changed is.
    """

    def __init__(self, closed: ClosedJaxpr):
        self.jaxpr = closed.jaxpr
        self.text = str(closed.jaxpr)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Formula) and self.text == other.text

    def __hash__(self) -> int:
        return hash(self.text)


class _Function(eqx.Module):
    """A bare function: its formula, and the arrays that it closes over as leaves."""

    captured: list[Array]
    formula: _Formula = eqx.field(static=True)

    def __call__(self, argument: Any) -> Any:
        closed = ClosedJaxpr(self.formula.jaxpr, self.captured)
        return jaxpr_as_fun(closed)(argument)[0]


def as_pytree(function: Any, argument: Any) -> Any:
    """Return `function`, from arrays like `argument` to one array, as a pytree of arrays."""
    if isinstance(function, eqx.Module):
        return function
    # A new lambda, because tracing is cached by the identity of the function.
    closed = jax.make_jaxpr(lambda x: function(x))(argument)
    return _Function([jnp.asarray(constant) for constant in closed.consts], _Formula(closed))

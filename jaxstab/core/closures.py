"""Python functions as pytrees of the arrays they close over, for use in any JAX transformation."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, jaxpr_as_fun
from jaxtyping import Array, PyTree

_NEEDS_A_VALUE = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
)
# A jaxpr's text omits some arrays: literals, and constants of a nested function.
_HIDDEN = re.compile(r"\[\.\.\.\]|\{ lambda \w")
# It has no more than the name of a derivative rule, or of a callback, which may read numbers.
_NAMED_ONLY = re.compile(r"custom_\w+\[|callback")


def as_pytree(
    name: str, function: Callable[..., Array], cure: str, *arguments: jax.ShapeDtypeStruct
) -> Callable[..., Array]:
    """Convert a function of arrays of one shape to a pytree; an Equinox module of arrays is kept.

    The arrays that a bare function closes over, traced ones too, become leaves.

    Raises:
        TypeError: if the function needs the value of its argument.
        ValueError: with the `cure`, if it does not return one real array, a scalar or of the
            arguments' shape.
    """
    try:
        closed, value = _trace(function, arguments)
    except _NEEDS_A_VALUE:
        raise TypeError(
            f"{name} needs the value of its argument, which is not known while JAX traces it: "
            "write it with jax.numpy in place of NumPy and math, and jnp.where in place of `if`."
        ) from None
    has_shape = getattr(value, "shape", None) in ((), arguments[0].shape)
    if not (has_shape and jnp.issubdtype(value.dtype, jnp.floating)):
        shown = [eqx.tree_pformat(x, struct_as_array=True) for x in (*arguments, value)]
        given, found = ", ".join(shown[:-1]), shown[-1]
        raise ValueError(f"{name} maps {given} to {found}: {cure}")
    are_arrays = all(map(eqx.is_array_like, jax.tree.leaves(function)))
    if are_arrays and issubclass(type(function), eqx.Module):
        return function
    captured = list(map(jnp.asarray, closed.consts))
    return BareFunction(captured, Formula(function, arguments, closed.jaxpr))


@dataclass(frozen=True)
class Formula:
    """A traced function, equal to another one with the same jaxpr.

    `jax.jit` compares function objects: it compiles anew for a function written anew, and misses a
    changed number that the function reads. A function with a derivative rule or a callback equals
    itself alone.
    """

    function: Callable[..., Array] = field(compare=False)
    arguments: tuple[jax.ShapeDtypeStruct, ...] = field(compare=False)
    jaxpr: Jaxpr = field(compare=False)
    key: tuple[int | None, str | Jaxpr] = field(init=False)

    def __post_init__(self) -> None:
        text = str(self.jaxpr)
        # Otherwise all that the function reads is in the jaxpr or among the captured arrays.
        identity = None
        if _NAMED_ONLY.search(text):
            identity = id(self.function)
        shown: str | Jaxpr = text
        if _HIDDEN.search(text, 1):
            shown = self.jaxpr
        object.__setattr__(self, "key", (identity, shown))

    def __reduce__(self) -> tuple[object, ...]:
        # A jaxpr cannot be pickled; the function is pickled, or imported by its name.
        return _formula, (self.function, self.arguments)


class BareFunction(eqx.Module):
    """A bare function as a pytree; its leaves are the arrays that it closes over."""

    captured: list[Array]
    formula: Formula = eqx.field(static=True)

    def __repr__(self) -> str:
        return getattr(self.formula.function, "__name__", repr(self.formula.function))

    def __call__(self, *arguments: Array) -> Array:
        """Evaluate the function in the precision it was traced in; return the arguments'."""
        jaxpr = self.formula.jaxpr
        avals: list[PyTree] = [variable.aval for variable in (*jaxpr.constvars, *jaxpr.invars)]
        inputs = zip([*self.captured, *arguments], avals, strict=True)
        values = [jnp.asarray(x, aval.dtype) for x, aval in inputs]
        number = len(self.captured)
        (result,) = jaxpr_as_fun(ClosedJaxpr(jaxpr, values[:number]))(*values[number:])
        return jnp.asarray(result, jnp.result_type(*arguments))


def _trace(
    function: Callable[..., Array], arguments: tuple[jax.ShapeDtypeStruct, ...]
) -> tuple[ClosedJaxpr, PyTree]:
    # A new lambda, because tracing is cached by the identity of the function.
    return jax.make_jaxpr(lambda *xs: function(*xs), return_shape=True)(*arguments)


def _formula(
    function: Callable[..., Array], arguments: tuple[jax.ShapeDtypeStruct, ...]
) -> Formula:
    return Formula(function, arguments, _trace(function, arguments)[0].jaxpr)

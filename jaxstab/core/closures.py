"""Python functions as pytrees of the arrays they close over, for use in any JAX transformation."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var, jaxpr_as_fun
from jaxtyping import Array, PyTree

_NEEDS_A_VALUE = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
)


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


@dataclass(frozen=True, eq=False)
class Formula:
    """A traced function, equal to another one that computes the same from its arguments.

    `jax.jit` compares function objects: it compiles anew for a function written anew, and misses a
    changed number that the function reads. What only Python can read, as a derivative rule or a
    callback, must be one and the same, or that of the same function.
    """

    function: Callable[..., Array]
    arguments: tuple[jax.ShapeDtypeStruct, ...]
    jaxpr: Jaxpr
    computation: Hashable = field(init=False)
    opaque: list[Any] = field(init=False, default_factory=list)
    number: int = field(init=False)

    def __post_init__(self) -> None:
        # Otherwise all that the function reads is in the jaxpr or among the captured arrays.
        object.__setattr__(self, "computation", _computation(self.jaxpr, self.opaque))
        # Computed once: each call of a compiled program asks for it.
        object.__setattr__(self, "number", hash(self.computation))

    def __hash__(self) -> int:
        return self.number

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Formula) or self.number != other.number:
            return self is other
        is_same = self.function is other.function or self.opaque == other.opaque
        return self is other or (is_same and self.computation == other.computation)

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


def _computation(jaxpr: Jaxpr, opaque: list[Any]) -> Hashable:
    """Return the computation of a jaxpr, equal for equal ones; add what has none.

    Variables are numbered in order, and the values of constants do not count.
    """
    places: dict[Var, int] = {}

    def place(atom: Any) -> Hashable:
        if isinstance(atom, Literal):
            return atom.aval, _parameter(atom.val, opaque)
        return places.setdefault(atom, len(places)), atom.aval

    inputs = *map(place, jaxpr.constvars), *map(place, jaxpr.invars)
    equations = [
        (
            equation.primitive,
            *map(place, (*equation.invars, *equation.outvars)),
            _parameter(equation.params, opaque),
        )
        for equation in jaxpr.eqns
    ]
    return inputs, tuple(equations), tuple(map(place, jaxpr.outvars))


def _parameter(part: Any, opaque: list[Any]) -> Hashable:
    """Return a parameter of an equation, equal for equal ones, arrays as their bytes."""
    match part:
        # From JAX 0.12 on the two are one class.
        case ClosedJaxpr():
            return _computation(part.jaxpr, opaque), _parameter(part.consts, opaque)
        case Jaxpr():
            return _computation(part, opaque)
        case tuple() | list():
            return tuple(_parameter(each, opaque) for each in part)
        case dict():
            return tuple((name, _parameter(each, opaque)) for name, each in sorted(part.items()))
        case jax.core.Tracer():
            # The jaxpr holds it.
            opaque.append(id(part))
        # Numbers of NumPy before those of Python, which some of them are too. Constants of JAX 0.9
        # are arrays of a class of its own.
        case _ if hasattr(part, "__array__"):
            return str(part.dtype), part.shape, np.asarray(part).tobytes()
        case None | bool() | int() | float() | complex() | str():
            return part
        case _:
            opaque.append(part)
    return type(part)

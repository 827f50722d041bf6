"""Python functions as pytrees, so that their holders can cross any JAX transformation."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun
from jax.extend.core.primitives import jit_p
from jaxtyping import Array

from jaxstab.core.checks import is_traced

_NEEDS_A_VALUE = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
)


def as_pytree(name: str, function: Any, argument: jax.ShapeDtypeStruct, cure: str) -> Any:
    """Return a `function` of one array as a pytree of arrays: itself, if it is a module of them.

    Raises:
        TypeError: if it needs the value of its argument.
        ValueError: naming the `cure`, if it does not return one real array, of the argument's shape
            or scalar.
    """
    try:
        # A new lambda, because tracing is cached by the identity of the function.
        closed, value = jax.make_jaxpr(lambda x: function(x), return_shape=True)(argument)
    except _NEEDS_A_VALUE:
        raise TypeError(
            f"{name} needs the value of its argument, which is not known while JAX traces it: "
            "write it with jax.numpy in place of NumPy and math, and jnp.where in place of `if`."
        ) from None
    has_shape = getattr(value, "shape", None) in ((), argument.shape)
    if not (has_shape and jnp.issubdtype(value.dtype, jnp.floating)):
        raise ValueError(f"{name} maps {argument} to {value}: {cure}")
    if isinstance(function, eqx.Module) and _is_argument_of_jit(function):
        return function
    captured = _captured(closed)
    return _Function(list(map(jnp.asarray, captured.values())), Formula(function, argument, closed))


def is_bare(value: Any) -> bool:
    """Whether `value` is what `as_pytree` made of a bare function."""
    return isinstance(value, _Function)


class _Function(eqx.Module):
    """A bare function: its formula, and the arrays that it closes over as leaves."""

    captured: list[Array]
    formula: "Formula" = eqx.field(static=True)

    def __repr__(self) -> str:
        return getattr(self.formula.function, "__name__", repr(self.formula.function))

    def __call__(self, argument: Any) -> Any:
        # In the precision of the formula, from which those of its holder and argument may differ.
        inputs = zip([*self.captured, argument], self.formula.opened.in_avals, strict=True)
        inputs = (jnp.asarray(value, aval.dtype) for value, aval in inputs)
        (value,) = jaxpr_as_fun(self.formula.opened)(*inputs)
        return jnp.asarray(value, jnp.result_type(argument))


class Formula:
    """What a function computes, equal to another where both compute the same.

    It is compared by its structure. A function written anew, as in a loop over a closed-over array,
    is not compiled anew. One that reads a global that has changed is. Custom derivative rules,
    which tell nothing of what they do, are compared as objects, unless the function itself is the
    same.
    """

    def __init__(
        self, function: Any, argument: jax.ShapeDtypeStruct, closed: ClosedJaxpr | None = None
    ):
        if closed is None:
            closed = jax.make_jaxpr(lambda x: function(x))(argument)
        captured = _captured(closed)

        def opened(arrays: Sequence[Array], argument: Array) -> list[Array]:
            return _evaluate(closed, [argument], dict(zip(captured, arrays, strict=True)))

        self.function, self.argument = function, argument
        self.opened = jax.make_jaxpr(opened)([*captured.values()], argument)
        places = {key: place for place, key in enumerate(captured)}
        self.structure = list(_structure(closed.jaxpr, closed.consts, places))

    def __eq__(self, other: object) -> bool:
        if self is other or not isinstance(other, Formula):
            return self is other
        has_same_rules = self.function is other.function

        def agree(left: Any, right: Any) -> bool:
            are_rules = isinstance(left, _Rule) and isinstance(right, _Rule)
            return (are_rules and has_same_rules) or left == right

        pairs = zip(self.structure, other.structure, strict=False)
        return len(self.structure) == len(other.structure) and all(agree(*pair) for pair in pairs)

    def __reduce__(self) -> tuple[Any, ...]:
        # The function is copied, or found by its name; what it computes cannot be pickled.
        return Formula, (self.function, self.argument)

    def __hash__(self) -> int:
        return hash(tuple(part for part in self.structure if isinstance(part, str)))


@dataclass(frozen=True)
class _Rule:
    """A part of a custom derivative rule."""

    content: Any


def _is_argument_of_jit(module: eqx.Module) -> bool:
    leaves, structure = jax.tree.flatten(module)
    try:
        hash(structure)
    except TypeError:
        return False
    return all(map(eqx.is_array_like, leaves))


def _captured(closed: ClosedJaxpr) -> dict[int, Any]:
    """Return the arrays that a function closes over, also inside of nested jits, by identity.

    Whether JAX keeps them as constants or as literals is a matter of its configuration.
    """
    found = {id(constant): constant for constant in closed.consts}
    atoms = [*closed.jaxpr.outvars, *(atom for eqn in closed.jaxpr.eqns for atom in eqn.invars)]
    for atom in atoms:
        if isinstance(atom, Literal) and (isinstance(atom.val, jax.Array) or np.ndim(atom.val)):
            found[id(atom.val)] = atom.val
    for eqn in closed.jaxpr.eqns:
        if eqn.primitive is jit_p:
            found |= _captured(eqn.params["jaxpr"])
    return found


def _evaluate(
    closed: ClosedJaxpr, arguments: Sequence[Array], captured: Mapping[int, Array]
) -> list[Array]:
    """Return what a formula makes of its arguments, with other arrays for those closed over."""
    jaxpr = closed.jaxpr
    constants = [captured[id(constant)] for constant in closed.consts]
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *arguments], strict=True))

    def value(atom: Any) -> Any:
        if isinstance(atom, Literal):
            return captured.get(id(atom.val), atom.val)
        return values[atom]

    for eqn in jaxpr.eqns:
        inputs = list(map(value, eqn.invars))
        if eqn.primitive is jit_p:
            outputs = _evaluate(eqn.params["jaxpr"], inputs, captured)
        else:
            variables = jax.make_jaxpr(lambda *inputs: inputs)(*inputs).jaxpr.invars
            alone = jaxpr.replace(
                constvars=[],
                invars=variables,
                outvars=eqn.outvars,
                eqns=[eqn.replace(invars=variables)],
            )
            outputs = jaxpr_as_fun(ClosedJaxpr(alone, []))(*inputs)
        values.update(zip(eqn.outvars, outputs, strict=True))
    return list(map(value, jaxpr.outvars))


def _structure(jaxpr: Jaxpr, constants: Sequence[Any], places: Mapping[int, int]) -> Iterator[Any]:
    """Yield all that a formula says, the arrays that it closes over by their places only."""
    numbers: dict[Any, int] = {}

    def content(array: Any) -> Any:
        if id(array) in places:
            return f"captured {places[id(array)]}"
        return array if is_traced(array) else f"{np.asarray(array).tobytes()}"

    def label(atom: Any) -> str:
        is_literal = isinstance(atom, Literal)
        is_what = content(atom.val) if is_literal else numbers.setdefault(atom, len(numbers))
        return f"{atom.aval!r} {is_what}"

    yield from map(label, [*jaxpr.constvars, *jaxpr.invars])
    yield from map(content, constants)
    for eqn in jaxpr.eqns:
        yield eqn.primitive
        yield from map(label, [*eqn.invars, *eqn.outvars])
        parts, tree = jax.tree.flatten(eqn.params)
        yield tree
        for part in parts:
            if isinstance(part, ClosedJaxpr):
                yield from _structure(
                    part.jaxpr, part.consts, places if eqn.primitive is jit_p else {}
                )
            elif isinstance(part, Jaxpr):
                yield from _structure(part, [], {})
            elif isinstance(part, jax.Array | np.ndarray):
                yield content(part)
            else:
                yield _Rule(part) if eqn.primitive.name.startswith("custom_") else part
    yield from map(label, jaxpr.outvars)

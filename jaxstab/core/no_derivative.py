"""Derivatives that do not exist: a NaN or an error, only when the derivative is requested.

A derivative is requested where a tangent, or in reverse mode a cotangent, is not zero. So a failed
batch entry does not affect the others.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

from jaxstab.core.checks import is_spread, known
from jaxstab.core.results import SolverError
from jaxstab.core.types import Flag, Scalar

Tree = TypeVar("Tree")

_UNSOLVED = (
    "its linear system was not solved. It is singular, as at a fold, or singular to within the "
    "residual: give the solver a finer tolerance, or stay away from the fold. Or a derivative of "
    "the potential or the solid is not finite: check them"
)


class Obstacle(eqx.Module):
    """A reason why a derivative does not exist: whether it is there, and how to say it."""

    exists: Flag
    message: str = eqx.field(static=True)


@jax.custom_jvp
def refuse_derivatives(tree: Tree) -> Tree:
    """Return `tree`, for a loop whose derivatives would be of its steps, not of its answer."""
    return tree


@refuse_derivatives.defjvp
def _refuse(primals: tuple[Tree], tangents: tuple[Tree]) -> tuple[Tree, Tree]:
    raise NotImplementedError(
        "lowest_modes, calibrate and continuation cannot be differentiated: apply "
        "jax.lax.stop_gradient to the arguments, or take the derivatives of equilibrate, "
        "assess_stability or critical_load."
    )


def any_exists(obstacles: Sequence[Obstacle]) -> Flag:
    """Return whether there is any reason."""
    return jnp.any(jnp.stack([obstacle.exists for obstacle in obstacles]))


def nan_where(is_refused: Flag, cause: Array, effect: Array) -> Array:
    """Return an effect, linear in its cause, or NaN where it is refused and not of nothing."""
    return jnp.where(is_refused & jnp.any(cause != 0), jnp.nan, effect)


def nan_or(change: Array, obstacles: Sequence[Obstacle], asked: Scalar) -> Float[Array, "..."]:
    """Return a tangent, in both modes of differentiation, or NaN where there is an obstacle.

    Where the tangent cannot be known, `asked` tells whether one is asked for: a linear function of
    all that moves, in general not zero.
    """
    is_refused = any_exists(obstacles)
    cause = jnp.where(is_refused, asked.astype(change.dtype), change)
    return _opaque(lambda b: nan_where(is_refused, b, b), cause)


def nan_if_nan(asked: Scalar) -> Scalar:
    """Return zero, or NaN if the argument is NaN; in reverse mode if the cotangent is."""
    return _opaque(lambda b: jnp.where(jnp.isnan(b), b, 0), asked)


def _opaque(function: Callable[[Array], Array], argument: Array) -> Array:
    """Return a function that counts as linear, and as its own transpose."""
    return jax.lax.custom_linear_solve(
        lambda x: x, argument, lambda _, b: function(b), symmetric=True
    )


def entering(change: Array) -> Array:
    """Return a change on its way to a rule; what comes back from it must not be NaN.

    NaN was refused before, and enters as zero.
    """
    return _guard.bind(change, sentences=_sentences(()), is_leaving=False)


def leaving(change: Array, obstacles: Sequence[Obstacle]) -> Array:
    """Return a change on its way from a rule, or raise `SolverError` where it is refused.

    In reverse mode, where it is requested. Under `jax.jit` the error is one of Equinox's.
    """
    exist = [obstacle.exists for obstacle in obstacles]
    return _guard.bind(change, *exist, sentences=_sentences(obstacles), is_leaving=True)


def _sentences(obstacles: Sequence[Obstacle]) -> tuple[str, ...]:
    messages = *(obstacle.message for obstacle in obstacles), _UNSOLVED
    return tuple(f"The derivative does not exist: {message}." for message in messages)


# The identity, but for NaN that enters. It looks at its number wherever that is known: also at the
# cotangents of an eager `jax.grad`, which custom derivatives in both modes do not show to Python.
# Transposed, what left enters.
_guard = Primitive("guard_derivative")


def _reasons(xp: Any, change: Any, exist: Sequence[Any], is_leaving: bool) -> list[Any]:
    """Return for each sentence whether it is to be said, of any lane."""
    is_asked = change != 0 if is_leaving else xp.abs(change) > 0

    def stops(exists: Any) -> Any:
        lanes = xp.reshape(exists, exists.shape + (1,) * (change.ndim - exists.ndim))
        return xp.any(lanes & is_asked)

    return [*map(stops, exist), xp.any(xp.isnan(change) & is_leaving)]


def _passed(change: Array, is_leaving: bool) -> Array:
    return change if is_leaving else jnp.where(jnp.isnan(change), 0, change)


@_guard.def_impl
def _raise(change: Array, *exist: Array, sentences: tuple[str, ...], is_leaving: bool) -> Array:
    number, xp = known(change), jnp if is_spread(change) else np
    reasons = _reasons(xp, number, [np.asarray(exists) for exists in exist], is_leaving)
    for is_reason, sentence in zip(reasons, sentences, strict=True):
        if is_reason:
            raise SolverError(sentence)
    return _passed(change, is_leaving) if xp.isnan(number).any() else change


@_guard.def_abstract_eval
def _same(change: Any, *exist: Any, **_: Any) -> Any:
    return change


def _raise_when_run(
    change: Array, *exist: Array, sentences: tuple[str, ...], is_leaving: bool
) -> Array:
    reasons = jnp.stack(_reasons(jnp, change, exist, is_leaving))
    change = _passed(change, is_leaving)
    return eqx.branched_error_if(change, jnp.any(reasons), jnp.argmax(reasons), list(sentences))


def _push(primals: Sequence, tangents: Sequence, **static: Any) -> tuple:
    change, *exist = primals
    moved = tangents[0]
    if not isinstance(moved, ad.Zero):
        moved = _guard.bind(moved, *exist, **static)
    return _guard.bind(change, *exist, **static), moved


def _pull(cotangent: Any, _: Any, *exist: Array, sentences: tuple, is_leaving: bool) -> list:
    if not isinstance(cotangent, ad.Zero):
        cotangent = _guard.bind(cotangent, *exist, sentences=sentences, is_leaving=not is_leaving)
    return [cotangent, *(None for _ in exist)]


def _by_lanes(args: Sequence, axes: Sequence, **static: Any) -> tuple[Array, int]:
    (size,) = {arg.shape[axis] for arg, axis in zip(args, axes, strict=True) if axis is not None}
    lanes = [
        jnp.broadcast_to(arg, (size, *arg.shape)) if axis is None else jnp.moveaxis(arg, axis, 0)
        for arg, axis in zip(args, axes, strict=True)
    ]
    return _guard.bind(*lanes, **static), 0


ad.primitive_jvps[_guard] = _push
ad.primitive_transposes[_guard] = _pull
batching.primitive_batchers[_guard] = _by_lanes
mlir.register_lowering(_guard, mlir.lower_fun(_raise_when_run, multiple_results=False))

"""Derivatives of solutions, by the implicit function theorem.

Under a small change the points in contact stay there, and the free ones stay free. On the free
points (K + D) dg = -d(K u + p0 + f') at a fixed gap. The same operator, less an eigenvalue, moves a
mode. Its inverse is applied by preconditioned conjugate gradients and checked.

Solvers run without derivatives; `attach` adds them to the solution.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

from jaxstab.core.grid import total
from jaxstab.core.no_derivative import entering, leaving, nan_if_nan, nan_or, nan_where
from jaxstab.core.types import Field, FieldMap, Flag, Scalar

Tree = TypeVar("Tree")
# Maps values, what is known of them, inputs and changes of these (None for none) to the changes of
# the values, linearly, and to a list of `Obstacle`s for all of them or for each.
Rule = Callable[[Any, Any, Any, Any], tuple[Any, Any]]

# Residuals of a linear system, over its right-hand side: where to stop, and what is too much.
_TOLERANCE = {"float64": 1e-12, "float32": 1e-6}
_LIMIT = {"float64": 1e-7, "float32": 1e-2}
_MAX_STEPS = 2000


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def attach(rule: Rule, throw: bool, values: Tree, known: Any, inputs: Any) -> Tree:
    """Return values that a solver found, as differentiable functions of its inputs.

    Arguments:
        rule: their changes. Its numbers are finite also without a solution, since an infinite one
            affects other lanes.
        throw: whether a derivative that does not exist is an error, or NaN.
        values: the solution, floating-point arrays.
        known: what else the rule needs, constants.
        inputs: the values are functions of these.
    """
    return values


@partial(attach.defjvp, symbolic_zeros=True)
def _differentiate(rule: Rule, throw: bool, primals: tuple, tangents: tuple) -> tuple[Tree, Tree]:
    _, known, inputs = primals
    values = attach(rule, throw, *primals)
    changes = jax.tree.map(
        lambda tangent: None if isinstance(tangent, SymbolicZero) else tangent, tangents[2]
    )
    if not throw:
        return values, _changes(rule, values, known, inputs, changes, changes)[0]
    inside = jax.tree.map(entering, changes)
    moved, obstacles, nothing = _changes(rule, values, known, inputs, inside, changes)
    moved = _each(leaving, moved, obstacles)
    return values, jax.tree.map(lambda leaf: leaf + nothing.astype(leaf.dtype), moved)


# Compiled apart, so that few programs run where derivatives are taken outside of `jax.jit`.
@partial(jax.jit, static_argnums=0)
def _changes(
    rule: Rule, values: Tree, known: Any, inputs: Any, changes: Any, outside: Any
) -> tuple[Tree, Any, Scalar]:
    """Return the changes of the values, their obstacles, and NaN if there is one, or zero.

    The changes of the inputs are asked about as they are outside, where nothing has looked at them.
    """
    moved, obstacles = rule(values, known, inputs, changes)
    asked = _asked(inputs, outside)
    moved = _each(partial(nan_or, asked=asked), moved, obstacles)
    return moved, obstacles, nan_if_nan(asked)


def _asked(inputs: Any, changes: Any) -> Scalar:
    """Return a linear function of changes, whose derivatives do not vanish either."""
    asked = jnp.array(0.0)
    for change, leaf in zip(
        jax.tree.leaves(changes, is_leaf=_is_none), jax.tree.leaves(inputs), strict=True
    ):
        if change is not None:
            phase = jnp.where(jnp.isfinite(leaf), leaf, 0) + _places(leaf)
            asked = asked + jnp.sum(jnp.cos(1 + phase) * change)
    return asked


def _each(function: Callable, moved: Tree, obstacles: Any) -> Tree:
    return jax.tree.map(
        lambda reasons, tree: jax.tree.map(lambda leaf: function(leaf, reasons), tree),
        obstacles,
        moved,
        is_leaf=lambda node: isinstance(node, list),
    )


def pushed(function: Callable[..., Tree], inputs: tuple, changes: tuple) -> Tree:
    """Return how a function changes with its inputs, of which those without a change are None."""
    is_moving = jax.tree.map(lambda change: change is not None, changes, is_leaf=_is_none)
    moving, still = eqx.partition(inputs, is_moving)
    return jax.jvp(lambda moved: function(*eqx.combine(moved, still)), (moving,), (changes,))[1]


def _is_none(leaf: Any) -> bool:
    return leaf is None


def finite(is_found: Flag, tree: Tree) -> Tree:
    """Return a tree as it is, or where nothing was found other floating-point numbers.

    These are sound as parameters of a law or a solid too, and as a field without symmetry.
    """

    def choose(leaf: Array) -> Array:
        if not jnp.issubdtype(leaf.dtype, jnp.floating):
            return leaf
        return jnp.where(is_found, leaf, 0.25 + 0.05 * jnp.cos(_places(leaf)))

    return jax.tree.map(choose, tree)


def _places(like: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the place of each entry in an array, of which devices may hold parts."""
    sides = range(like.ndim)
    places = (jax.lax.broadcasted_iota(like.dtype, like.shape, side) for side in sides)
    strides = (math.prod(like.shape[side + 1 :]) for side in sides)
    ways = (place * stride for place, stride in zip(places, strides, strict=True))
    return sum(ways, jnp.zeros((), like.dtype))


class LinearSystem(eqx.Module):
    """P A x = P b, for the x of a space.

    Attributes:
        operator: A, symmetric, and not singular on the space.
        precondition: roughly its inverse, symmetric and positive.
        project: P, the orthogonal projection onto the space.
    """

    operator: FieldMap
    precondition: FieldMap
    project: FieldMap

    def differentiable_solution(
        self,
        right_side: Field,
        is_sound: Callable[[Field, Field], Flag] = lambda x, b: jnp.array(True),
    ) -> Field:
        """Return x, as a differentiable function of A and b in both modes; NaN if not solved.

        `is_sound` maps x and b to whether x can be trusted.
        """

        def apply(field: Field) -> Field:
            inside = self.project(field)
            # What lies outside is left to the identity.
            return self.project(self.operator(inside)) + field - inside

        def solve(_: FieldMap, b: Field) -> Field:
            x, is_solved = self.solution(b)
            return nan_where(~(is_solved & is_sound(x, b)), b, x)

        right_side = self.project(right_side)
        x = jax.lax.custom_linear_solve(apply, right_side, solve, symmetric=True)
        return self.project(x)

    def solution(self, right_side: Field) -> tuple[Field, Flag]:
        """Return x by preconditioned conjugate gradients, and whether it solves the system.

        Where A is not positive the method may break down, and says so.
        """
        # JAX's own takes up to 1.4 times as long, at 256 x 256 points on the CPU.
        b = self.project(right_side)
        tolerance = _TOLERANCE[b.dtype.name] ** 2 * total(b**2)

        def goes_on(state: _Iterate) -> Flag:
            return (total(state.residual**2) > tolerance) & (state.num_steps < _MAX_STEPS)

        def step(state: _Iterate) -> _Iterate:
            product = self.project(self.operator(state.direction))
            length = state.norm / total(state.direction * product)
            residual = state.residual - length * product
            steepest = self.project(self.precondition(residual))
            norm = total(residual * steepest)
            return _Iterate(
                state.solution + length * state.direction,
                residual,
                steepest + norm / state.norm * state.direction,
                norm,
                state.num_steps + 1,
            )

        steepest = self.project(self.precondition(b))
        start = _Iterate(jnp.zeros_like(b), b, steepest, total(b * steepest), jnp.array(0))
        x = jax.lax.while_loop(goes_on, step, start).solution
        missed = total((self.project(self.operator(x)) - b) ** 2)
        return x, missed <= _LIMIT[b.dtype.name] ** 2 * total(b**2)


class _Iterate(eqx.Module):
    solution: Field
    residual: Field
    direction: Field
    norm: Scalar
    num_steps: Int[Array, ""]

"""Derivatives of what solvers find, by the implicit function theorem.

The points in contact stay there under a small change of anything, and the free ones stay free:
on them (K + D) dg = -d(K u + p0 + f') at a fixed gap. The same operator, less an eigenvalue, moves
a mode. Its inverse is applied by preconditioned conjugate gradients and checked.

Where a derivative does not exist, or cannot be told from rounding, it is an error or NaN; but zero
where nothing asks for it, so that a failed lane of a batch harms no other.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxstab.grid import total

Field = Float[Array, " *grid"]
FieldMap = Callable[[Field], Field]

# Residuals of a linear system, over its right-hand side: where to stop, and what is too much.
_TOLERANCE = {"float64": 1e-12, "float32": 1e-6}
_LIMIT = {"float64": 1e-7, "float32": 1e-2}
_MAX_STEPS = 2000
_UNSOLVED = "its linear system was not solved: it is singular, as at a fold, or too ill-conditioned"


class Obstacle(NamedTuple):
    """A reason why a derivative does not exist: whether it is there, and how to say it."""

    exists: Bool[Array, ""]
    message: str


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
        obstacles: list[Obstacle],
        throw: bool,
        judge: Callable[[Field, Field], list[Obstacle]] = lambda x, b: [],
    ) -> Field:
        """Return x, as a differentiable function of A and b in both modes.

        Arguments:
            right_side: b.
            obstacles: reasons why x is no derivative; with one of them it is not computed.
            throw: whether such a reason, or a failure, is an error or gives NaN.
            judge: maps x and b to further reasons.
        """

        def apply(field: Field) -> Field:
            inside = self.project(field)
            # What lies outside is left to the identity.
            return self.project(self.operator(inside)) + field - inside

        def solve(_: FieldMap, b: Field) -> Field:
            is_known = jnp.any(jnp.stack([False, *(o.exists for o in obstacles)]))
            x, is_solved = self.solution(jnp.where(is_known, 0, b))
            found = [Obstacle(o.exists & ~is_known, o.message) for o in judge(x, b)]
            everything = [*obstacles, *found, Obstacle(~is_solved, _UNSOLVED)]
            return _refuse(everything, total(b**2), x, throw)

        right_side = self.project(right_side)
        x = jax.lax.custom_linear_solve(apply, right_side, solve, symmetric=True)
        return self.project(x)

    def solution(self, right_side: Field) -> tuple[Field, Bool[Array, ""]]:
        """Return x by preconditioned conjugate gradients, and whether it solves the system.

        Where A is not positive the method may break down, and says so.
        """
        b = self.project(right_side)
        tolerance = _TOLERANCE[b.dtype.name] ** 2 * total(b**2)

        def goes_on(state: _State) -> Bool[Array, ""]:
            return (total(state.residual**2) > tolerance) & (state.num_steps < _MAX_STEPS)

        def step(state: _State) -> _State:
            product = self.project(self.operator(state.direction))
            length = state.norm / total(state.direction * product)
            residual = state.residual - length * product
            steepest = self.project(self.precondition(residual))
            norm = total(residual * steepest)
            return _State(
                state.solution + length * state.direction,
                residual,
                steepest + norm / state.norm * state.direction,
                norm,
                state.num_steps + 1,
            )

        steepest = self.project(self.precondition(b))
        start = _State(jnp.zeros_like(b), b, steepest, total(b * steepest), jnp.array(0))
        x = jax.lax.while_loop(goes_on, step, start).solution
        missed = total((self.project(self.operator(x)) - b) ** 2)
        return x, missed <= _LIMIT[b.dtype.name] ** 2 * total(b**2)


class _State(eqx.Module):
    solution: Field
    residual: Field
    direction: Field
    norm: Float[Array, ""]
    num_steps: Int[Array, ""]


def unless(obstacles: list[Obstacle], tangent: Array, throw: bool) -> Array:
    """Return a tangent, in both modes of differentiation, if nothing is in the way.

    Otherwise one that is not zero is an error, or NaN unless `throw`.
    """
    return jax.lax.custom_linear_solve(
        lambda x: x, tangent, lambda _, b: _refuse(obstacles, b, b, throw), symmetric=True
    )


def _refuse(obstacles: list[Obstacle], cause: Array, effect: Array, throw: bool) -> Array:
    exist = jnp.stack([obstacle.exists for obstacle in obstacles])
    is_refused = jnp.any(exist) & jnp.any(jnp.abs(cause) > 0)
    # What is NaN was refused before, and stays so.
    effect = jnp.where(jnp.any(jnp.isnan(cause)), jnp.nan, effect)
    if not throw:
        return jnp.where(is_refused, jnp.nan, effect)
    messages = [f"The derivative does not exist: {obstacle.message}." for obstacle in obstacles]
    return eqx.branched_error_if(effect, is_refused, jnp.argmax(exist), messages)

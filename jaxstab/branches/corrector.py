"""The corrector: Newton's method for a point of the curve that meets one condition more.

Its matrix gives the direction of the curve there as well, with another right-hand side.

Either the free points are given: then the curve is smooth, and the point may lie where a gap or a
reaction is negative, beyond a change of contact. Or they follow the pressures: points in contact
that are pulled become free, and free points whose gap comes out negative touch, as in the method of
primal and dual active sets (semismooth Newton).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxstab.branches.curve import BorderedVector, Curve, Forces, Place
from jaxstab.contact.hessian import Hessian
from jaxstab.core import model
from jaxstab.core.accuracy import ALONG_CURVES, EQUILIBRIUM, EXACT, NEWTON_STEP
from jaxstab.core.checks import as_array
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose, zeros_of
from jaxstab.core.grid import total
from jaxstab.core.types import Field, Flag, Mask, Scalar

# The residual sought at states. In single precision a point within the tolerance of an equilibrium
# may lie as far from the curve as a short step may from its prediction.
AT_STATES = {**EQUILIBRIUM, "float32": EXACT["float32"]}
_MAX_STEPS = 8
# A step that lowers a residual below the tolerance by less ends a search for a smaller one; above
# it, so many steps in turn do. Searches that succeeded had two of them at most.
_LEAST_FALL = 0.5
_MAX_FAILURES = 3
# A step leaves at least this part of the gap over a core.
_LEAST_SHARE = 0.2


class Condition(eqx.Module):
    """A linear function of gap and pressure, and of the net pressure, with a value to meet.

    Attributes:
        row: the gradient of the first part.
        weights: the factors of the net pressure in the second part.
        value: to meet.
        scale: by which the error is divided.
    """

    row: BorderedVector
    weights: Field
    value: Scalar
    scale: Scalar

    def error(self, at: BorderedVector, forces: Forces) -> Scalar:
        """Return the error at a point, over the scale."""
        found = self.row.times(at) + total(self.weights * forces.net)
        return (found - self.value) / self.scale

    def gradient(self, curve: Curve, forces: Forces) -> BorderedVector:
        """Return the gradient of the error, over gap and pressure."""
        pulled = Hessian(curve.contact.solid, forces.curvature)(self.weights)
        gap = self.row.gap + pulled
        pressed = model.load_pressure(self.weights, curve.contact.solid.punch)
        pressure = self.row.pressure + total(pressed)
        return BorderedVector(gap / self.scale, pressure / self.scale)


def on_plane(row: BorderedVector, value: Scalar, scale: Scalar) -> Condition:
    """Return the condition that a linear function of gap and pressure has a value."""
    return Condition(row, jnp.zeros_like(row.gap), value, scale)


def at_change(curve: Curve, point: Mask, opens: Flag, scale: Scalar) -> Condition:
    """Return the condition that a point has lost its reaction, or its gap; scale is a length."""
    one = point.astype(curve.contact.heights.dtype)
    zero = jnp.zeros((), one.dtype)
    row = BorderedVector(jnp.where(opens, 0, one), zero)
    weights = jnp.where(opens, one / curve.contact.solid.max_stiffness, 0)
    return Condition(row, weights, zero, scale)


class CorrectorProblem(eqx.Module):
    """The problem of the corrector: a curve, a condition, and the free points.

    Attributes:
        curve: the curve.
        condition: the condition.
        is_free: the free points.
        follows: whether the free points follow the pressures instead.
    """

    curve: Curve
    condition: Condition
    is_free: Mask
    follows: Flag | bool = False

    def forces(self, point: BorderedVector) -> Forces:
        """Return the pressures at a point."""
        return self.curve.forces(point, self.free_points(point))

    def free_points(self, point: BorderedVector) -> Mask:
        """Return the free points where a point is met."""
        return jnp.where(self.follows, point.gap > 0, self.is_free)

    def residual(self, point: BorderedVector, forces: Forces) -> tuple[Scalar, Scalar]:
        """Return the relative imbalance of pressures, and the error of the condition."""
        net = jnp.where(self.is_free, forces.net, 0)
        net = jnp.where(self.follows, model.imbalance(forces.net, point.gap), net)
        size = jnp.sqrt(total(net**2) / net.size)
        imbalance = size / jnp.where(forces.scale > 0, forces.scale, 1)
        return imbalance, self.condition.error(point, forces)


class CorrectorOutcome(eqx.Module):
    """Where the corrector has ended.

    Attributes:
        place: the point, its free points, and the direction there.
        forces: the pressures there.
        residual: the larger of relative imbalance and error of the condition.
        num_steps: of Newton's method.
        is_found: whether it is a point that meets the condition.
    """

    place: Place
    forces: Forces
    residual: Scalar
    num_steps: Int[Array, ""]
    is_found: Flag


def correct(
    problem: CorrectorProblem,
    start: BorderedVector,
    ahead: BorderedVector,
    near: BorderedVector,
    close: Scalar | float,
    fine: Scalar | float | None = None,
) -> CorrectorOutcome:
    """Return the point of a curve that meets a condition, by Newton's method, and its direction.

    Arguments:
        problem: the curve and the condition.
        start: where the point is sought from.
        ahead: the gradient of a linear function that grows along the direction.
        near: another direction, from which that is sought; where no point is found it is returned.
        close: the residual to reach, if it can be.
        fine: the accuracy of the direction; by default that of tangents.
    """
    dtype = start.gap.dtype
    if fine is None:
        fine = ALONG_CURVES[dtype.name]
    # Numbers of one type, so that all searches share one program.
    return _newton(problem, start, ahead, near, as_array(close, dtype), as_array(fine, dtype))


class Undirected(eqx.Module):
    """A point of the curve before its direction is known.

    Attributes:
        at: the point.
        is_free: its free points.
        condition: a condition that it meets.
        ahead: the gradient of a linear function that grows along the direction.
        near: another direction nearby, from which that is sought, or zero.
    """

    at: BorderedVector
    is_free: Mask
    condition: Condition
    ahead: BorderedVector
    near: BorderedVector


def place_of(curve: Curve, point: Undirected) -> Place:
    """Return a point of a curve with the direction there, by the last step of the corrector."""
    problem = CorrectorProblem(curve, point.condition, point.is_free)
    tangent = correct(problem, point.at, point.ahead, point.near, np.inf).place.tangent
    return Place(point.at, point.is_free, tangent)


@program
def _newton(
    problem: CorrectorProblem,
    start: BorderedVector,
    ahead: BorderedVector,
    near: BorderedVector,
    close: Scalar,
    fine: Scalar,
) -> CorrectorOutcome:
    curve = problem.curve
    dtype = start.gap.dtype
    enough = EQUILIBRIUM[dtype.name]

    def goes_on(state: tuple[CorrectorOutcome, Scalar, Int[Array, ""]]) -> Flag:
        old, _, num_failures = state
        may_succeed = jnp.isfinite(old.residual) & (num_failures < _MAX_FAILURES)
        return ~old.is_found & may_succeed & (old.num_steps <= _MAX_STEPS)

    def step(state: tuple[CorrectorOutcome, Scalar, Int[Array, ""]]) -> tuple:
        old, least_residual, num_failures = state
        at = old.place.at
        follows = problem.follows
        forces = problem.forces(at)
        imbalance, error = problem.residual(at, forces)
        residual = jnp.maximum(imbalance, jnp.abs(error))
        falls = residual <= _LEAST_FALL * old.residual
        is_found = (residual <= close) | ((residual <= enough) & ~falls)
        moves = at.gap > 0, (at.gap > 0) | (forces.net < 0)
        is_free = jnp.where(follows, jnp.where(is_found, *moves), problem.is_free)
        direction = curve.unit_change(near, is_free, ahead)
        rest = curve.residual_of(direction, forces.curvature, ahead)
        change = curve.solution(
            forces.curvature,
            is_free,
            choose(is_found, ahead, problem.condition.gradient(curve, forces)),
            choose(is_found, rest, BorderedVector(-forces.net, -error)),
            jnp.where(is_found, fine, NEWTON_STEP),
            jnp.where(is_found, curve.length(direction), 0),
        )
        least = jnp.where(follows, 0, -jnp.inf)
        least = jnp.where(curve.contact.has_core, _LEAST_SHARE * at.gap, least)
        gap = jnp.where(is_free, jnp.maximum(at.gap + change.gap, least), 0)
        at = choose(is_found, at, BorderedVector(gap, at.pressure + change.pressure))
        tangent = choose(is_found, curve.unit(direction.plus(change)), near)
        place = Place(at, problem.free_points(at), tangent)
        found = CorrectorOutcome(place, forces, residual, old.num_steps + ~is_found, is_found)
        num_failures = jnp.where(residual <= _LEAST_FALL * least_residual, 0, num_failures + 1)
        return found, jnp.minimum(residual, least_residual), num_failures

    infinite = jnp.full((), jnp.finfo(dtype).max, dtype)
    place = Place(start, problem.free_points(start), near)
    none = jnp.array(0)
    first = CorrectorOutcome(
        place, zeros_of(problem.forces, start), infinite, none, jnp.array(False)
    )
    return jax.lax.while_loop(goes_on, step, (first, infinite, none))[0]

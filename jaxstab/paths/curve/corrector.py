"""The corrector: Newton's method for a point of the curve that meets one condition more.

Either the free points are given: then the curve is smooth, and the point may lie where a gap or a
reaction is negative, beyond a change of contact. Or they follow the pressures: points in contact
that are pulled become free, and free points whose gap comes out negative touch, as in the method of
primal and dual active sets (semismooth Newton).
"""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact.hessian import Hessian
from jaxstab.core import model
from jaxstab.core.grid import total
from jaxstab.core.history import Indicators
from jaxstab.core.loop import IterativeSolver, integer_parameter
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.paths.curve.curve import Curve, Forces, Point

# How well a step of Newton's method is solved for.
_ACCURACY = 1e-2
# What a step leaves at least of the gap over a core.
_LEAST_SHARE = 0.2


class Condition(eqx.Module):
    """A linear function of gap and pressure, and of the net pressure, with a value to meet.

    Attributes:
        row: the gradient of the first part.
        weights: the factors of the net pressure in the second part.
        value: to meet.
        scale: by which the error is divided.
    """

    row: Point
    weights: Field
    value: Scalar
    scale: Scalar

    def missed(self, at: Point, forces: Forces) -> Scalar:
        """Return the error at a point, over the scale."""
        found = self.row.times(at) + total(self.weights * forces.net)
        return (found - self.value) / self.scale

    def gradient(self, curve: Curve, forces: Forces) -> Point:
        """Return the gradient of that."""
        pulled = Hessian(curve.contact.solid, forces.curvature)(self.weights)
        gap, pressure = self.row.gap + pulled, self.row.pressure + total(self.weights)
        return Point(gap / self.scale, pressure / self.scale)


def on_plane(row: Point, value: Scalar, scale: Scalar) -> Condition:
    """Return the condition that a linear function of gap and pressure has a value."""
    return Condition(row, jnp.zeros_like(row.gap), value, scale)


def at_corner(curve: Curve, point: Mask, opens: Flag, scale: Scalar) -> Condition:
    """Return the condition that a point has lost its reaction, or its gap; scale is a length."""
    one = point.astype(curve.contact.heights.dtype)
    zero = jnp.zeros((), one.dtype)
    row = Point(jnp.where(opens, 0, one), zero)
    weights = jnp.where(opens, one / curve.contact.solid.max_stiffness, 0)
    return Condition(row, weights, zero, scale)


class Correction(eqx.Module):
    """What the corrector solves: a curve, a condition, and the free points.

    Attributes:
        curve: the curve.
        condition: the condition.
        is_free: the free points.
        follows: whether the free points follow the pressures instead.
    """

    curve: Curve
    condition: Condition
    is_free: Mask
    follows: Flag

    def at(self, point: Point) -> "Iterate":
        """Return a point and how far it is from what is sought."""
        follows, gap = self.follows, point.gap
        forces = self.curve.forces(point, jnp.where(follows, gap > 0, self.is_free))
        net = forces.net
        missed = jnp.where(self.is_free, net, 0)
        missed = jnp.where(follows, model.imbalance(net, gap), missed)
        size = jnp.sqrt(total(missed**2) / gap.size)
        imbalance = size / jnp.where(forces.scale > 0, forces.scale, 1)
        return Iterate(point, forces, imbalance, self.condition.missed(point, forces))


class Iterate(eqx.Module):
    """A point, its pressures, their relative imbalance, and the error of the condition."""

    at: Point
    forces: Forces
    imbalance: Scalar
    missed: Scalar


class CurveNewton(IterativeSolver):
    """Newton's method for a point of the curve that meets a condition."""

    tolerance: Scalar | None = None
    max_steps: Int[Array, ""] = eqx.field(converter=integer_parameter, default=12)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-9, "float32": 1e-4}
    patience: ClassVar[int] = 5

    def init(self, problem: Correction, start: Point) -> Iterate:
        """Return the start and how far it is from what is sought."""
        return problem.at(start)

    def step(self, problem: Correction, state: Iterate) -> Iterate:
        """Return the point after a step."""
        curve, at, forces = problem.curve, state.at, state.forces
        follows = problem.follows
        is_free = jnp.where(follows, (at.gap > 0) | (forces.net < 0), problem.is_free)
        row = problem.condition.gradient(curve, forces)
        right = Point(-forces.net, -state.missed)
        change = curve.solution(forces.curvature, is_free, row, right, _ACCURACY)
        least = jnp.where(follows, 0, -jnp.inf)
        least = jnp.where(curve.contact.has_core, _LEAST_SHARE * at.gap, least)
        gap = jnp.where(is_free, jnp.maximum(at.gap + change.gap, least), 0)
        return problem.at(Point(gap, at.pressure + change.pressure))

    def measure(self, problem: Correction, state: Iterate) -> Indicators:
        """Return how far balance and condition are from being met."""
        return {"residual": jnp.maximum(state.imbalance, jnp.abs(state.missed))}

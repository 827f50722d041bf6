"""The curve of a contact's equilibria, stable or not, in the gap and the mean pressure.

Whatever the load, its equilibria obey K u + p0 + f'(g) = 0 on the free points. With p0 as an
unknown these are curves, which no load is a part of: a load only says where on them it is. They are
smooth where the free points stay the same, and have corners where one touches or lets go.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact
from jaxstab.contact.hessian import Hessian
from jaxstab.contact.residual import missed_pressure
from jaxstab.core.gmres import gmres
from jaxstab.core.grid import mean, mean_over, total
from jaxstab.core.history import Indicators
from jaxstab.core.loop import IterativeSolver, integer_parameter
from jaxstab.core.types import Field, Mask, Scalar
from jaxstab.loads import Load
from jaxstab.potentials import derivatives

# How well a step of Newton's method, and a tangent, are solved, and by how many restarts at most.
_STEP_ACCURACY = 1e-2
_TANGENT_ACCURACY = {"float64": 1e-5, "float32": 1e-4}
_MAX_RESTARTS = 10
# Over the rms elastic pressure of full contact.
_LEAST_SCALE = 1e-2
# What a step leaves at least of the gap over a core.
_LEAST_SHARE = 0.2


class Point(eqx.Module):
    """A gap and a mean pressure, or a change of both."""

    gap: Field
    pressure: Scalar

    def plus(self, change: "Point", length: Scalar) -> "Point":
        """Return the point after so much of a change, its gap cut at zero."""
        gap = jnp.maximum(self.gap + length * change.gap, 0)
        return Point(gap, self.pressure + length * change.pressure)

    def minus(self, other: "Point") -> "Point":
        """Return the change from another point."""
        return Point(self.gap - other.gap, self.pressure - other.pressure)

    def times(self, other: "Point") -> Scalar:
        """Return the sum of products of two changes, or of a gradient and a change."""
        return total(self.gap * other.gap) + self.pressure * other.pressure


class Forces(eqx.Module):
    """The net pressure K u + p0 + f'(g) at a point, f''(g), and the relative residual."""

    net: Field
    curvature: Field
    residual: Scalar


class Curve(eqx.Module):
    """The equilibria of a contact, and where a load is on them.

    Attributes:
        contact: the contact, in units of its own.
        load: the load, at any value.
        least_scale: the pressure below which what is out of balance counts for less.
        load_offset: the value of the load at no gap and no pressure.
        load_gradient: the gradient of its value, which is the same anywhere.
    """

    contact: Contact
    load: Load
    least_scale: Scalar
    load_offset: Scalar
    load_gradient: Point

    @classmethod
    def of(cls, contact: Contact, load: Load) -> "Curve":
        """Return the curve of a contact under a load."""
        least = _LEAST_SCALE * contact.conforming_pressure
        return cls(contact, load, least, *_value_of(contact, load))

    @property
    def stiffness(self) -> Scalar:
        """The pressure that counts as much as a unit of length [pressure/length]."""
        return self.contact.solid.min_stiffness

    def gradient_of(self, change: Point) -> Point:
        """Return the gradient of what a change has in common with another one [1/length].

        The common part is the mean product of the changes of gap, and the product of those of
        pressure over the stiffness squared.
        """
        size = change.gap.size
        return Point(change.gap / size, change.pressure / self.stiffness**2)

    def cosine(self, one: Point, other: Point) -> Scalar:
        """Return the cosine between two changes."""
        lengths = self.length(one) * self.length(other)
        return self.gradient_of(one).times(other) / jnp.where(lengths > 0, lengths, 1)

    def length(self, change: Point) -> Scalar:
        """Return the size of a change [length]."""
        return jnp.sqrt(self.gradient_of(change).times(change))

    def value(self, at: Point) -> Scalar:
        """Return the value of the load at a point."""
        return self.load_offset + self.load_gradient.times(at)

    def forces(self, at: Point) -> Forces:
        """Return the pressures at a point, and how far they are from balance."""
        contact, gap = self.contact, at.gap
        elastic = contact.solid.held_by(0).apply(gap + contact.heights)
        _, attraction, curvature = derivatives(contact.potential, gap)
        net = elastic + attraction + at.pressure
        missed = missed_pressure(net, gap)
        resisting = jnp.where(gap > 0, attraction + at.pressure, 0)
        scale = jnp.sqrt(total(elastic**2 + resisting**2) / gap.size)
        scale = jnp.maximum(scale, self.least_scale)
        return Forces(net, curvature, jnp.sqrt(total(missed**2) / gap.size) / scale)

    def net_rate(self, curvature: Field, change: Point) -> Field:
        """Return how the net pressure follows a change where f'' is this, A dg + dp0."""
        return Hessian(self.contact.solid, curvature)(change.gap) + change.pressure

    def tangent(
        self, at: Point, is_free: Mask, ahead: Point, accuracy: float | None = None
    ) -> Point:
        """Return the direction of the curve at a point, along which a linear function grows."""
        accuracy = accuracy or _TANGENT_ACCURACY[at.gap.dtype.name]
        one = jnp.ones_like(at.pressure)
        curvature = self.contact.curvature(at.gap)
        none = Point(jnp.zeros_like(at.gap), one)
        change = self.solution(curvature, is_free, ahead, none, accuracy)
        length = self.length(change)
        return Point(change.gap / length, change.pressure / length)

    def solution(
        self, curvature: Field, is_free: Mask, row: Point, right: Point, accuracy: float
    ) -> Point:
        """Return the change with A dg + dp0 = r on the free points and a gradient's product s.

        Solved by GMRES, since A need not be positive. The preconditioner is the inverse of K + c on
        changes without a mean. The mean and the pressure are solved for together, by themselves.

        Arguments:
            curvature: f''(g).
            is_free: the points that move.
            row: the gradient.
            right: r and s.
            accuracy: of the solution, as a part of the right-hand side.
        """
        hessian = Hessian(self.contact.solid, curvature, None, is_free)
        inverse = hessian.inverse(self.stiffness + total(jnp.abs(hessian.curvature)) / row.gap.size)

        def inside(field: Field) -> Field:
            return jnp.where(is_free, field, 0)

        row = Point(inside(row.gap), row.pressure)
        uniform = inside(jnp.ones_like(row.gap))
        # The mean has a stiffness of its own, often negative, that K + c does not know.
        stiffness = mean_over(is_free, hessian(uniform))
        along, other = total(row.gap), row.pressure * stiffness
        # Never a small difference, which would blow up what is left of the right-hand side.
        size = jnp.abs(along) + jnp.abs(other)
        along = along - other
        along = jnp.where(jnp.abs(along) < size / 2, jnp.where(along < 0, -size, size), along)
        along = jnp.where(size == 0, 1, along)

        def bordered(change: Point) -> Point:
            moved = inside(change.gap)
            pressure = inside(hessian(moved)) + change.pressure * uniform
            # What does not move is left to the identity.
            return Point(pressure + change.gap - moved, row.times(Point(moved, change.pressure)))

        def precondition(right: Point) -> Point:
            level = mean_over(is_free, right.gap)
            rest = inside(inverse(inside(right.gap - level)))
            rest = rest - mean_over(is_free, rest) * uniform
            missed = right.pressure - total(row.gap * rest) - row.pressure * level
            shift = missed / along
            return Point(rest + shift * uniform, level - stiffness * shift)

        solution = gmres(
            lambda change: precondition(bordered(change)),
            precondition(right),
            accuracy,
            _MAX_RESTARTS,
        )
        return Point(inside(solution.gap), solution.pressure)


def _value_of(contact: Contact, load: Load) -> tuple[Scalar, Point]:
    """Return the value of a load at no gap and no pressure, and its gradient, the same anywhere."""
    gap = jnp.ones_like(contact.heights)
    nothing = jnp.zeros((), gap.dtype)
    fixes_mean = contact.control(load).fixes_mean

    def missed(value: Scalar, level: Scalar) -> Scalar:
        control = contact.control(load.at(value))
        if fixes_mean:
            return level - mean(control.restore(gap))
        return mean(control.net_pressure(0 * gap, level * gap))

    by_value, by_mean = jax.grad(missed, (0, 1))(nothing, nothing)
    by_pressure = 0 * by_value if fixes_mean else -jnp.ones_like(by_value)
    row = Point(-by_mean / by_value * gap / gap.size, -by_pressure / by_value)
    return -missed(nothing, nothing) / by_value, row


class Plane(eqx.Module):
    """The points where a linear function has a value, which others miss by a part of a scale."""

    row: Point
    value: Scalar
    scale: Scalar

    def missed(self, curve: Curve, at: Point, forces: Forces) -> Scalar:
        """Return by how much a point misses it."""
        return (self.row.times(at) - self.value) / self.scale

    def gradient(self, curve: Curve, at: Point, forces: Forces) -> Point:
        """Return the gradient of that."""
        return Point(self.row.gap / self.scale, self.row.pressure / self.scale)


class Corner(eqx.Module):
    """Where a contact point has lost its reaction, or a free one its gap.

    Attributes:
        point: the point.
        opens: whether it is a contact point, that lets go.
    """

    point: Mask
    opens: Array

    def missed(self, curve: Curve, at: Point, forces: Forces) -> Scalar:
        """Return the gap of the point, or its reaction as a length."""
        left = jnp.where(self.opens, forces.net / curve.contact.solid.max_stiffness, at.gap)
        return total(jnp.where(self.point, left, 0)) / curve.length(at)

    def gradient(self, curve: Curve, at: Point, forces: Forces) -> Point:
        """Return the gradient of that."""
        lifted = self.point.astype(at.gap.dtype)
        stiffness = curve.contact.solid.max_stiffness
        pulled = Hessian(curve.contact.solid, forces.curvature)(lifted) / stiffness
        by_pressure = jnp.where(self.opens, 1 / stiffness, 0)
        gap = jnp.where(self.opens, pulled, lifted)
        scale = curve.length(at)
        return Point(gap / scale, by_pressure / scale)


class Iterate(eqx.Module):
    """A point, its pressures, and by how much it misses the condition."""

    at: Point
    forces: Forces
    missed: Scalar


class CurveProblem(eqx.Module):
    """A curve, a condition, and the free points, None where they are as the pressures say."""

    curve: Curve
    condition: Any
    is_free: Mask | None = None

    def at(self, point: Point) -> Iterate:
        """Return a point and how far it is from what is sought."""
        forces = self.curve.forces(point)
        return Iterate(point, forces, self.condition.missed(self.curve, point, forces))


class CurveNewton(IterativeSolver):
    """Newton's method for a point of the curve that meets a condition.

    Points in contact that are pulled off it become free, and free points whose gap comes out
    negative touch: the method of primal and dual active sets.
    """

    tolerance: Scalar | None = None
    max_steps: Int[Array, ""] = eqx.field(converter=integer_parameter, default=12)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-9, "float32": 1e-4}
    patience: ClassVar[int] = 5

    def init(self, problem: CurveProblem, start: Point) -> Iterate:
        """Return the start and how far it is from what is sought."""
        return problem.at(start)

    def step(self, problem: CurveProblem, state: Iterate) -> Iterate:
        """Return the point after a step, its gap cut at zero."""
        curve, at, forces = problem.curve, state.at, state.forces
        is_free = problem.is_free
        if is_free is None:
            is_free = (at.gap > 0) | (forces.net < 0)
        row = problem.condition.gradient(curve, at, forces)
        right = Point(-forces.net, -state.missed)
        change = curve.solution(forces.curvature, is_free, row, right, _STEP_ACCURACY)
        least = jnp.where(curve.contact.has_core, _LEAST_SHARE * at.gap, 0)
        gap = jnp.maximum(at.gap + change.gap, least)
        return problem.at(Point(gap, at.pressure + change.pressure))

    def measure(self, problem: CurveProblem, state: Iterate) -> Indicators:
        """Return how far balance and condition are from being met."""
        return {"residual": jnp.maximum(state.forces.residual, jnp.abs(state.missed))}

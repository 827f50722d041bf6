"""The curve of a contact's equilibria, stable or not, in the gap and the mean pressure.

Whatever the load, its equilibria obey K u + p0 + f'(g) = 0 on the free points. With p0 as an
unknown these are curves, which no load is a part of: a load only says where on them it is. They are
smooth where the free points stay the same, and have kinks where one touches or is released.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.contact.hessian import Hessian
from jaxstab.contact.residual import least_scale, scale_of
from jaxstab.core import model
from jaxstab.core.gmres import gmres
from jaxstab.core.grid import mean, total
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.loads import Load
from jaxstab.potentials.profile import HARDLY_ANY

# Restarts of GMRES at most.
_MAX_RESTARTS = 10


class BorderedVector(eqx.Module):
    """A gap and a mean pressure; a change or a gradient of both; a right-hand side for both."""

    gap: Field
    pressure: Scalar

    def plus(self, change: "BorderedVector", length: Scalar | float = 1.0) -> "BorderedVector":
        """Return the point after so much of a change."""
        return BorderedVector(
            self.gap + length * change.gap, self.pressure + length * change.pressure
        )

    def scale(self, factor: Scalar | float) -> "BorderedVector":
        """Return so much of a change."""
        return BorderedVector(factor * self.gap, factor * self.pressure)

    def minus(self, other: "BorderedVector") -> "BorderedVector":
        """Return the change from another point."""
        return BorderedVector(self.gap - other.gap, self.pressure - other.pressure)

    def times(self, other: "BorderedVector") -> Scalar:
        """Return the sum of products of two changes, or of a gradient and a change."""
        return total(self.gap * other.gap) + self.pressure * other.pressure


class Forces(eqx.Module):
    """The pressures at a point.

    Attributes:
        net: K u + p0 + f'(g) [pressure].
        curvature: f''(g) [pressure/length].
        scale: the size of the pressures that balance each other [pressure].
    """

    net: Field
    curvature: Field
    scale: Scalar


class Curve(eqx.Module):
    """The equilibria of a contact, and where a load is on them.

    Attributes:
        contact: the contact, in its characteristic units.
        load: the load, at any value.
        least_scale: the pressure below which an imbalance counts for less.
        load_offset: the value of the load at no gap and no pressure.
        load_gradient: the gradient of its value, which is the same anywhere.
        farthest: the gap beyond which there is hardly any attraction, under a load that does not
            hold the gap [length]; infinite under others.
    """

    contact: Contact
    load: Load
    least_scale: Scalar
    load_offset: Scalar
    load_gradient: BorderedVector
    farthest: Scalar

    @classmethod
    def of(cls, contact: Contact, load: Load) -> "Curve":
        """Return the curve of a contact under a load."""
        offset, gradient = _value_of(contact, load)
        profile = contact.profile
        conforming = contact.conforming_pressure
        # Over a flat surface nothing but the load balances the attraction.
        least = least_scale(jnp.where(conforming > 0, conforming, profile.max_attraction))
        outermost = profile.outermost_gap(HARDLY_ANY * profile.max_attraction)
        farthest = jnp.where(jnp.any(gradient.gap != 0), jnp.inf, outermost)
        return cls(contact, load, least, offset, gradient, farthest.astype(least.dtype))

    @property
    def stiffness(self) -> Scalar:
        """The pressure that counts as much as a unit of length [pressure/length]."""
        return self.contact.solid.min_stiffness

    def gradient_of(self, change: BorderedVector) -> BorderedVector:
        """Return the gradient of the product of a change with another one [length]."""
        size = change.gap.size
        return BorderedVector(change.gap / size, change.pressure / self.stiffness**2)

    def product(self, one: BorderedVector, other: BorderedVector) -> Scalar:
        """Return the product of two changes, of unit ones the cosine between them [length^2]."""
        pressures = (one.pressure / self.stiffness) * (other.pressure / self.stiffness)
        return mean(one.gap * other.gap) + pressures

    def length(self, change: BorderedVector) -> Scalar:
        """Return the size of a change [length]."""
        return jnp.sqrt(self.product(change, change))

    def value(self, at: BorderedVector) -> Scalar:
        """Return the value of the load at a point."""
        return self.load_offset + self.load_gradient.times(at)

    def rate(self, tangent: BorderedVector) -> Scalar:
        """Return how the value of the load changes along a tangent."""
        return self.load_gradient.times(tangent)

    def forces(self, at: BorderedVector, is_free: Mask) -> Forces:
        """Return the pressures at a point with these free points."""
        solid = self.contact.solid
        gap = at.gap
        pressures = self.contact.pressures(gap)
        pressed = model.load_pressure(at.pressure, solid.punch)
        resisting = jnp.where(is_free, pressures.attraction + pressed, 0)
        balancing = jnp.sqrt(total(pressures.elastic**2 + resisting**2) / gap.size)
        size = jnp.sqrt(mean(gap**2))
        scale = scale_of(balancing, self.least_scale, solid.max_stiffness, size)
        return Forces(pressures.gradient + pressed, pressures.curvature, scale)

    def net_rate(self, curvature: Field, change: BorderedVector) -> Field:
        """Return how the net pressure follows a change where f'' is this, A dg + dp0."""
        pressed = model.load_pressure(change.pressure, self.contact.solid.punch)
        return Hessian(self.contact.solid, curvature)(change.gap) + pressed

    def unit_change(
        self, change: BorderedVector, is_free: Mask, ahead: BorderedVector
    ) -> BorderedVector:
        """Return a change of the free points along which a linear function grows by one.

        It is zero if the function falls along it.
        """
        change = BorderedVector(jnp.where(is_free, change.gap, 0), change.pressure)
        rate = ahead.times(change)
        scale = jnp.where(rate > 0, 1 / jnp.where(rate > 0, rate, 1), 0)
        return BorderedVector(scale * change.gap, scale * change.pressure)

    def residual_of(
        self, direction: BorderedVector, curvature: Field, ahead: BorderedVector
    ) -> BorderedVector:
        """Return how far a change is from one along the curve by which a function grows by one."""
        return BorderedVector(-self.net_rate(curvature, direction), 1 - ahead.times(direction))

    def unit(self, change: BorderedVector) -> BorderedVector:
        """Return a change of unit length."""
        length = self.length(change)
        return BorderedVector(change.gap / length, change.pressure / length)

    def solution(
        self,
        curvature: Field,
        is_free: Mask,
        row: BorderedVector,
        right: BorderedVector,
        accuracy: Scalar | float,
        size: Scalar | float,
    ) -> BorderedVector:
        """Return the change with A dg + dp0 = r on the free points and a gradient's product s.

        Solved by GMRES, since A need not be positive, in numbers without a unit: pressures are over
        the stiffness c of the softest wave, and the gradient over its size. The preconditioner is
        the inverse of K + c + mean |f''| on changes without a mean. The mean and the pressure are
        solved for together, by themselves.

        Arguments:
            curvature: f''(g).
            is_free: the points that move.
            row: the gradient.
            right: r and s.
            accuracy: of the solution, as a part of the right-hand side, or of the size.
            size: of the vector that the solution is added to [length].
        """
        soft = self.stiffness
        number = row.gap.size
        hessian = Hessian(self.contact.solid, curvature, None, is_free)
        inverse = hessian.inverse(soft + total(jnp.abs(hessian.curvature)) / number)

        def inside(field: Field) -> Field:
            return jnp.where(is_free, field, 0)

        # Of all numbers the pressure and the product count as much as the gaps together.
        weight = number**0.5
        row = BorderedVector(inside(row.gap), row.pressure * soft / weight)
        norm = jnp.sqrt(row.times(row))
        row = jax.tree.map(lambda part: part / jnp.where(norm > 0, norm, 1), row)
        uniform = inside(jnp.ones_like(row.gap)) / weight
        pressed = model.load_pressure(uniform, self.contact.solid.punch)
        # The mean has a stiffness of its own, often negative, that K + c does not know.
        share = total(uniform * pressed)
        has_free_points = share > 0
        share = jnp.where(has_free_points, share, 1)
        size_of_uniform = jnp.where(has_free_points, total(uniform**2), 1)
        stiffness = total(uniform * hessian(uniform)) / (soft * share)
        along = total(row.gap * uniform)
        other = row.pressure * stiffness
        # A small difference would blow up the rest of the right-hand side.
        least = (jnp.abs(along) + jnp.abs(other)) / 2
        along = along - other
        along = jnp.where(jnp.abs(along) < least, jnp.where(along < 0, -2, 2) * least, along)
        along = jnp.where(along == 0, 1, along)
        by_pressure = jnp.where(has_free_points | (row.pressure == 0), 1, row.pressure)

        def apply_bordered(change: BorderedVector) -> BorderedVector:
            moved = inside(change.gap)
            pressure = inside(hessian(moved)) / soft + change.pressure * pressed
            # Points that do not move are left to the identity.
            return BorderedVector(
                pressure + change.gap - moved, row.times(BorderedVector(moved, change.pressure))
            )

        def precondition(right: BorderedVector) -> BorderedVector:
            level = total(uniform * right.gap) / share
            rest = soft * inside(inverse(inside(right.gap - level * pressed)))
            rest = rest - total(uniform * rest) / size_of_uniform * uniform
            residual = right.pressure - total(row.gap * rest) - row.pressure * level
            shift = residual / along
            # In full contact there is the pressure alone.
            pressure = jnp.where(has_free_points, level - stiffness * shift, residual / by_pressure)
            return BorderedVector(rest + shift * uniform, pressure)

        wanted = BorderedVector(
            inside(right.gap) / soft, right.pressure / jnp.where(norm > 0, norm, 1)
        )
        wanted = precondition(wanted)
        residual = accuracy * jnp.maximum(jnp.sqrt(wanted.times(wanted)), weight * size)
        solution = gmres(
            lambda change: precondition(apply_bordered(change)), wanted, residual, _MAX_RESTARTS
        )
        return BorderedVector(inside(solution.gap), solution.pressure * soft / weight)


class Place(eqx.Module):
    """A point of the curve, its free points, and the direction in which the branch goes on."""

    at: BorderedVector
    is_free: Mask
    tangent: BorderedVector


class ContinuationProblem(eqx.Module):
    """A curve, the values of the load that begin and end a branch, and the limits of steps on it.

    One to a limit ends with its first unstable state: of negative eigenvalues only few are counted.
    """

    curve: Curve
    first_load: Scalar
    last_load: Scalar
    max_step: Scalar
    min_step: Scalar
    to_limit: bool = eqx.field(static=True)

    def is_beyond(self, at: BorderedVector) -> Flag:
        """Return whether a point has reached the last load."""
        return (self.curve.value(at) - self.last_load) * (self.first_load - self.last_load) <= 0


def _value_of(contact: Contact, load: Load) -> tuple[Scalar, BorderedVector]:
    """Return the value of a load at no gap and no pressure, and its gradient, the same anywhere."""
    gap = jnp.ones_like(contact.heights)
    nothing = jnp.zeros((), gap.dtype)
    fixes_mean = contact.control(load).fixes_mean

    def error(value: Scalar, level: Scalar) -> Scalar:
        control = contact.control(load.at(value))
        if fixes_mean:
            return level - mean(control.restore(gap))
        return mean(control.net_pressure(0 * gap, level * gap))

    by_value, by_mean = jax.grad(error, (0, 1))(nothing, nothing)
    by_pressure = -jnp.ones_like(by_value)
    if fixes_mean:
        by_pressure = 0 * by_value
    weights = model.load_pressure(gap / gap.size, contact.solid.punch)
    row = BorderedVector(-by_mean / by_value * weights, -by_pressure / by_value)
    return -error(nothing, nothing) / by_value, row

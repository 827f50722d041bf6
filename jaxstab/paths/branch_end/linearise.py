"""A branch of equilibria to first order, and Newton's step from it to its fold.

The step takes A + s x x^T in place of A, x being the mode: at a simple fold that is not singular.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact
from jaxstab.contact.hessian import Block
from jaxstab.core.grid import total
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.loop import IterativeSolver, integer_parameter
from jaxstab.core.types import Field, FieldMap, Flag, Mask, Scalar
from jaxstab.equilibrium.derivatives import third_derivative
from jaxstab.equilibrium.equilibrium import fields_of
from jaxstab.loads import Load
from jaxstab.stability import Davidson, Eigenpair
from jaxstab.stability.cones import Subspace
from jaxstab.stability.lowest_pair import on_space

# The residual of a mode: derivatives of the eigenvalue are as good as it is.
_MODE_TOLERANCE = {"float64": 1e-9, "float32": 1e-5}
# Below it a direction lies across the mode.
_LEAST_COSINE = {"float64": 1e-6, "float32": 1e-3}


class NewtonSolver(IterativeSolver):
    """The part that Newton's methods for both kinds of limits share."""

    tolerance: Scalar | None = None
    max_steps: Int[Array, ""] = eqx.field(converter=integer_parameter, default=30)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-9, "float32": 1e-4}
    patience: ClassVar[int] = 8


class Point(eqx.Module):
    """A state of a branch, with the lowest modes on its free points."""

    load: Load
    gap: Field
    modes: Block
    pair: Eigenpair


def point_at(
    contact: Contact,
    load: Load,
    gap: Field,
    modes: Block,
    opened: Mask | bool = False,
) -> Point:
    """Return a state of a branch, its modes sought from a block of others.

    They are those of the free points, and of contact points that are opened.
    """
    space = free_space(contact, load, gap)
    space = replace(space, is_moving=space.is_moving | opened)
    hessian = contact.hessian(gap, contact.control(load))
    solver = Davidson(_MODE_TOLERANCE[gap.dtype.name])
    found = on_space(solver, hessian, space, modes)
    return Point(load, gap, found.modes, found.pair)


def free_space(contact: Contact, load: Load, gap: Field) -> Subspace:
    """Return the moves of the free points that a load allows."""
    return Subspace(gap > 0, contact.control(load).fixes_mean)


def rates(contact: Contact, load: Load, gap: Field) -> tuple[Field, Field, Field]:
    """Return the net pressure of a state, and how its gap and this follow the load.

    That is where no point moves by itself: a load that holds the mean scales the gap to it.
    """

    def at(value: Scalar) -> tuple[Field, Field]:
        fields, net = fields_of(contact, load.at(value), gap)
        return fields["gap"], net

    (_, net), (gap_rate, net_rate) = jax.jvp(at, (load.value,), (jnp.ones_like(load.value),))
    return net, gap_rate, net_rate


def moved_along(
    contact: Contact, load: Load, gap: Field, change: Scalar, move: Field
) -> tuple[Load, Field]:
    """Return load and gap after a step of both, cut short before a free point closes."""
    closes = move < 0
    limit = jnp.min(jnp.where(closes, -gap / jnp.where(closes, move, 1), jnp.inf))
    length = jnp.minimum(1, 0.9 * limit)
    load = load.at(load.value + length * change)
    return load, contact.control(load).restore(gap + length * move)


class Linearisation(NamedTuple):
    """A point of a branch to first order, in the load and in the free points.

    Attributes:
        pair: the lowest eigenvalue on the free points, and its mode x.
        stiffening: s, added to A along the mode: the stiffness of the softest wave.
        imbalance: the net pressure of the free points, less the part that the load balances.
        gap_rate: how the gap follows the load where the free points do not move by themselves.
        imbalance_rate: how the imbalance of the free points does.
        eigenvalue_slope: the gradient of the eigenvalue with respect to the gap.
        operator: A.
        precondition: roughly the inverse of A, without its lowest mode.
        project: the projection onto the moves of the free points that the load allows.
    """

    pair: Eigenpair
    stiffening: Scalar
    imbalance: Field
    gap_rate: Field
    imbalance_rate: Field
    eigenvalue_slope: Field
    operator: FieldMap
    precondition: FieldMap
    project: FieldMap

    @property
    def system(self) -> LinearSystem:
        """The system of A."""
        return LinearSystem(self.operator, self.precondition, self.project)

    @property
    def stiffened(self) -> LinearSystem:
        """The system of A + s x x^T."""

        def operator(field: Field) -> Field:
            mode = self.pair.mode
            return self.operator(field) + self.stiffening * total(mode * field) * mode

        return LinearSystem(operator, self.precondition, self.project)

    @property
    def side(self) -> Scalar:
        """At a fold, to which side of its load the branch lies, of which only the sign counts.

        With g = g_c + s x the load goes as l_c - s^2 (x.d lambda/dg) / (2 x.dr/dl).
        """
        load, eigenvalue = self._along_mode
        return -load * eigenvalue

    @property
    def branches_off(self) -> Flag:
        """Whether the load does not act on the mode, or the eigenvalue does not change along it."""
        least = _LEAST_COSINE[self.pair.mode.dtype.name]
        load, eigenvalue = self._along_mode
        return ~(jnp.minimum(jnp.abs(load), jnp.abs(eigenvalue)) > least)

    @property
    def _along_mode(self) -> tuple[Scalar, Scalar]:
        """How much of dr/dl, and of d lambda/dg, lies along the mode, as cosines."""

        def cosine(field: Field) -> Scalar:
            return total(self.pair.mode * field) / jnp.sqrt(total(field**2))

        return cosine(self.imbalance_rate), cosine(self.eigenvalue_slope)


def linearised(contact: Contact, load: Load, gap: Field, pair: Eigenpair) -> Linearisation:
    """Return a branch to first order at one of its states."""
    space = free_space(contact, load, gap)
    hessian = contact.hessian(gap, contact.control(load)).restricted(space.is_moving)

    net, gap_rate, net_rate = rates(contact, load, gap)
    return Linearisation(
        pair,
        contact.solid.min_stiffness,
        space.project(net),
        gap_rate,
        space.project(net_rate),
        eigenvalue_slope=third_derivative(contact, gap) * pair.mode**2,
        operator=hessian,
        precondition=hessian.preconditioner(pair.mode, pair.eigenvalue),
        project=space.project,
    )


def newton_step(
    linear: Linearisation, conditions: tuple[Field, Scalar], solve: FieldMap
) -> tuple[Scalar, Field]:
    """Return the changes of load and gap that cancel an imbalance and an eigenvalue.

    With B = A + s x x^T the gap moves by d = B^-1 (s (x.d) x - r - l dr/dl). The two numbers x.d
    and l follow from their definition and from the eigenvalue.
    """
    imbalance, eigenvalue = conditions
    pair, stiffening = linear.pair, linear.stiffening
    mode, slope = pair.mode, linear.eigenvalue_slope
    stiffness = pair.eigenvalue + stiffening
    still, moved = -solve(imbalance), -solve(linear.imbalance_rate)
    rate = moved + linear.gap_rate
    matrix = (
        (stiffening * total(mode * moved), -pair.eigenvalue / stiffness),
        (total(slope * rate), total(slope * mode) / stiffness),
    )
    first, second = -stiffening * total(mode * still), -eigenvalue - total(slope * still)
    (a, b), (c, d) = matrix
    determinant = a * d - b * c
    change = (first * d - b * second) / determinant
    along_mode = (a * second - c * first) / determinant
    return change, still + change * rate + along_mode * mode / stiffness

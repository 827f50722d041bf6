"""Releases: the branch ends where the reaction of a contact point vanishes.

Up to there the contact points stay where they are. Let x be the move that opens the point, x_p = 1,
with the free points following at no cost, A x = 0 on them. The condition is x.r = 0, with r the net
pressure K u + p0 + f'(g). x.r does not depend on the imbalance of the free points.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.grid import mean, total
from jaxstab.core.history import Indicators
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.types import Field, Mask, Scalar
from jaxstab.equilibrium import PreconditionedConjugateGradient
from jaxstab.equilibrium.derivatives import free_system
from jaxstab.equilibrium.equilibrium import fields_of
from jaxstab.loads import Load
from jaxstab.paths.branch_end.linearise import NewtonSolver, free_space, moved_along, rates
from jaxstab.stability.cones import Subspace


class Held(eqx.Module):
    """A state of a branch, and the contact point that is about to let go."""

    load: Load
    gap: Field
    point: Mask


class Opening(NamedTuple):
    """A branch to first order, about to lose a contact point.

    Attributes:
        move: x.
        reaction: x.r, that of the point once the free points are in balance [pressure].
        slope: how it follows the load.
        imbalance: r on the free points.
        gap_rate: how the gap follows the load where the free points do not move by themselves.
        net_rate: how r does.
        system: that of A on the free points.
    """

    move: Field
    reaction: Scalar
    slope: Scalar
    imbalance: Field
    gap_rate: Field
    net_rate: Field
    system: LinearSystem


def opening(contact: Contact, load: Load, gap: Field, point: Mask) -> Opening:
    """Return a branch to first order, and the move that opens one of its contact points."""
    space, control = free_space(contact, load, gap), contact.control(load)
    system = free_system(contact, control, gap)
    opened = Subspace(space.is_moving | point, space.fixes_mean)
    lifted = opened.project(point.astype(gap.dtype))
    pulled = contact.hessian(gap, control)(lifted)
    move = lifted - system.differentiable_solution(pulled)
    net, gap_rate, net_rate = rates(contact, load, gap)
    return Opening(
        move,
        total(move * net),
        total(move * net_rate),
        space.project(net),
        gap_rate,
        net_rate,
        system,
    )


def horizon(load: Load, gap: Field, ahead: Scalar) -> Scalar:
    """Return how far ahead the end of a branch may lie, with its sign.

    It is known no better than the states of the branch are: to a part of their mean gap or of the
    pressure. The origin of lengths does not matter.
    """
    tolerance = PreconditionedConjugateGradient().tolerance_in(gap.dtype)
    size = mean(gap) if load.unit == "length" else jnp.abs(load.value)
    return jnp.sign(ahead) * jnp.maximum(jnp.abs(ahead), tolerance * size)


def least_open_closed(gap: Field) -> Field:
    """Return a gap with the least open one of its points closed."""
    return jnp.where(gap == jnp.min(jnp.where(gap > 0, gap, jnp.inf)), 0, gap)


def first_releases(contact: Contact, load: Load, gap: Field, ahead: Scalar) -> Field:
    """Return where each contact point loses its reaction, in units of the `horizon` ahead.

    That is to first order, once the free points are in balance, and infinite for points that are
    pressed the more, or do not touch.
    """
    ahead = horizon(load, gap, ahead)
    control = contact.control(load)
    system = free_system(contact, control, gap)
    imbalance, _, imbalance_rate = rates(contact, load, gap)
    moved, _ = system.solution(-imbalance_rate)
    settled, _ = system.solution(-imbalance)

    def net(value: Scalar, gap: Field) -> Field:
        return fields_of(contact, load.at(value), gap)[1]

    reaction, rate = jax.jvp(net, (load.value, gap), (jnp.ones_like(load.value), moved))
    reaction += contact.hessian(gap, control)(settled)
    loses = (gap == 0) & (rate * ahead < 0)
    distance = -reaction / jnp.where(loses, rate * ahead, 1)
    return jnp.where(loses, distance, jnp.inf)


def first_of(distances: Field) -> Mask:
    """Return the one point that is first to let go."""
    return (jnp.arange(distances.size) == jnp.argmin(distances)).reshape(distances.shape)


class ReleaseNewton(NewtonSolver):
    """Newton's method for a balance of pressures and a reaction of zero."""

    def step(self, problem: Contact, state: Held) -> Held:
        """Return the state after a step of Newton's method."""
        near = opening(problem, state.load, state.gap, state.point)
        change = -near.reaction / near.slope
        move, _ = near.system.solution(-near.imbalance - change * near.net_rate)
        move = move + change * near.gap_rate
        load, gap = moved_along(problem, state.load, state.gap, change, move)
        return Held(load, gap, state.point)

    def measure(self, problem: Contact, state: Held) -> Indicators:
        """Return how far balance and reaction are from zero."""
        net = rates(problem, state.load, state.gap)[0]
        imbalance = jnp.where(state.gap > 0, net, 0)
        reaction = total(jnp.where(state.point, net, 0))
        missed = jnp.sqrt(total(imbalance**2) / net.size)
        return {"residual": jnp.maximum(missed, jnp.abs(reaction)) / problem.conforming_pressure}

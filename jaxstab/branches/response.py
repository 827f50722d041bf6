"""The response of a state of a branch to its load, and to the opening of a contact point."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.types import Field, Mask, Scalar
from jaxstab.equilibrium.derivatives import free_system
from jaxstab.equilibrium.equilibrium import fields_of
from jaxstab.loads import Load
from jaxstab.stability.cones import Subspace


class Response(NamedTuple):
    """The net pressure of a state, and how its gap and this follow the load.

    That is where no point moves by itself: a load that holds the mean scales the gap to it.
    """

    net: Field
    gap_rate: Field
    net_rate: Field


def response(contact: Contact, load: Load, gap: Field) -> Response:
    """Return how a state follows its load."""

    def at(value: Scalar) -> tuple[Field, Field]:
        fields, net = fields_of(contact, load.at(value), gap)
        return fields["gap"], net

    (_, net), rate = jax.jvp(at, (load.value,), (jnp.ones_like(load.value),))
    return Response(net, *rate)


def free_space(contact: Contact, load: Load, gap: Field) -> Subspace:
    """Return the moves of the free points that a load allows."""
    return Subspace(gap > 0, contact.control(load).fixes_mean)


def opening(contact: Contact, load: Load, gap: Field, point: Mask) -> Field:
    """Return the move that opens a contact point, with the free points following at no cost."""
    control = contact.control(load)
    lift = opening_of_point(contact, load, gap, point)
    pulled = contact.hessian(gap, control)(lift)
    return lift - free_system(contact, control, gap).differentiable_solution(pulled)


def opening_of_point(contact: Contact, load: Load, gap: Field, point: Mask) -> Field:
    """Return a move that opens a contact point, and meets the load."""
    space = Subspace((gap > 0) | point, contact.control(load).fixes_mean)
    return space.project(point.astype(gap.dtype))

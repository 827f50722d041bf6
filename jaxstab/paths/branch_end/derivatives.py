"""How the limit of a branch moves with the contact: its linearised conditions."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.grid import total
from jaxstab.core.implicit import attach, finite, pushed
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.equilibrium.derivatives import changing_points
from jaxstab.equilibrium.equilibrium import Fields, fields_of
from jaxstab.loads import Load
from jaxstab.paths.branch_end.linearise import free_space, linearised, newton_step
from jaxstab.paths.branch_end.locate import Limit, locate
from jaxstab.paths.branch_end.release import first_of, first_releases, opening
from jaxstab.paths.kinds import KINDS
from jaxstab.stability.derivatives import differentiable as differentiable_pair

Inputs = tuple[Contact, Load]
Changes = tuple[Scalar, Field]


def differentiable(limit: Limit, contact: Contact) -> tuple[Load, Field]:
    """Return load and gap of a limit as functions of contact and load parameters."""
    load = limit.load
    inputs = contact, load.at(jax.lax.stop_gradient(load.value))
    value, gap = attach(_changes_of_limit, (load.value, limit.gap), limit, inputs)
    return load.at(value), gap


def differentiable_value(
    load: Load,
    gap: Field,
    kind: KINDS,
    ahead: Scalar,
    contact: Contact,
) -> Scalar:
    """Return the load of a state close to a limit as a function of the contact, as that one's is.

    It is located only if a derivative is requested.
    """
    known = gap, kind, ahead
    inputs = contact, load.at(jax.lax.stop_gradient(load.value))
    return attach(_changes_near_limit, load.value, known, inputs)


def differentiable_fields(
    fields: Fields, is_found: Flag, contact: Contact, load: Load, gap: Field
) -> Fields:
    """Return the fields at a limit as functions of the contact, and of its load and gap."""
    return attach(_changes_of_fields, fields, is_found, (contact, load, gap))


def _changes_near_limit(
    value: Scalar, known: tuple[Field, KINDS, Scalar], inputs: Inputs, changes: Inputs
) -> tuple[Scalar, Flag]:
    contact, load = jax.lax.stop_gradient(inputs)
    gap, kind, ahead = known
    point = jax.lax.cond(
        kind == KINDS.release,
        lambda: first_of(first_releases(contact, load, gap, ahead)),
        lambda: jnp.zeros_like(gap, bool),
    )
    limit = locate(contact, load, gap, kind, point, ahead)
    inputs = inputs[0], inputs[1].at(limit.load.value)
    (change, _), is_undefined = _changes_of_limit((value, limit.gap), limit, inputs, changes)
    return change, is_undefined


def _changes_of_limit(
    values: Changes, limit: Limit, inputs: Inputs, changes: Inputs
) -> tuple[Changes, Flag]:
    is_found, is_release = limit.is_found & limit.is_exact, limit.kind == KINDS.release
    inputs, (_, gap), pair = finite(is_found, (inputs, values, limit.critical))
    contact, load = inputs
    space = free_space(contact, load, gap)
    pair = differentiable_pair(pair, space, contact, load, gap)
    linear = linearised(contact, load, gap, pair)
    _, net = fields_of(contact, load, gap)
    coinciding = changing_points(net, gap, contact.solid) & ~limit.point
    is_undefined = ~is_found | (linear.branches_off & ~is_release) | jnp.any(coinciding)

    def pressures(contact: Contact, load: Load) -> tuple[Field, Field, Field]:
        fields, net = fields_of(contact, load, gap)
        moved = contact.hessian(fields["gap"], contact.control(load))(pair.mode)
        return fields["gap"], net, moved

    shift, *missed = pushed(pressures, inputs, changes)

    def missed_if(is_of_kind: Flag) -> list[Field]:
        # A linear system with a zero right-hand side converges at once.
        return [jnp.where(is_of_kind & ~is_undefined, part, 0) for part in missed]

    released = _move_of_release(contact, load, gap, limit.point, missed_if(is_release)[0])
    net_change, moved_change = missed_if(~is_release)
    conditions = linear.project(net_change), total(pair.mode * moved_change)
    folded = newton_step(linear, conditions, linear.stiffened.differentiable_solution)
    change, move = jax.tree.map(partial(jnp.where, is_release), released, folded)
    return (change, shift + move), is_undefined


def _move_of_release(
    contact: Contact, load: Load, gap: Field, point: Mask, net_change: Field
) -> Changes:
    """Return the changes of load and gap that cancel one of the net pressure."""
    near = opening(contact, load, gap, point)
    slope = jnp.where(near.slope == 0, 1, near.slope)
    change = -total(near.move * net_change) / slope
    move = near.system.differentiable_solution(-net_change - change * near.net_rate)
    return change, move + change * near.gap_rate


def _changes_of_fields(
    fields: Fields, is_found: Flag, inputs: tuple, changes: tuple
) -> tuple[Fields, Flag]:
    moved, _ = pushed(fields_of, finite(is_found, inputs), changes)
    return moved, ~is_found

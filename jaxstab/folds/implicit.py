"""How a fold moves with the contact: the linearised conditions of a fold."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxstab.contact import Contact
from jaxstab.derivatives import attach, finite, pushed
from jaxstab.equilibrium.implicit import changing_contact
from jaxstab.equilibrium.state import Fields, fields_of
from jaxstab.folds.branch import (
    Field,
    Linearisation,
    Scalar,
    free_space,
    linearised,
    newton_step,
)
from jaxstab.grid import total
from jaxstab.loads import Load
from jaxstab.refusals import Obstacle, any_exists
from jaxstab.results import RESULTS
from jaxstab.stability import Eigenpair
from jaxstab.stability.implicit import differentiable as differentiable_pair

NOT_FOUND = "no fold was found (look at its result)"
_LEAST_COSINE = {"float64": 1e-6, "float32": 1e-3}
_BIFURCATION = (
    "the branch does not turn back here but branches off, into states without its symmetry. "
    "Differentiate another quantity, or break the symmetry of the surface"
)


def differentiable(
    load: Load, gap: Field, pair: Eigenpair, contact: Contact, throw: bool
) -> tuple[Load, Field]:
    """Return load and gap of a fold as functions of the contact and what else the load has.

    The pair says whether there is one.
    """
    inputs = contact, load.at(jax.lax.stop_gradient(load.value))
    value, gap = attach(_changes_of_fold, throw, (load.value, gap), pair, inputs)
    return load.at(value), gap


def differentiable_fields(
    fields: Fields, is_found: Bool[Array, ""], contact: Contact, load: Load, gap: Field, throw: bool
) -> Fields:
    """Return the fields at a fold as functions of the contact, and of its load and gap."""
    return attach(_changes_of_fields, throw, fields, is_found, (contact, load, gap))


def _changes_of_fold(
    fold: tuple[Scalar, Field],
    pair: Eigenpair,
    inputs: tuple[Contact, Load],
    changes: tuple[Contact, Load],
) -> tuple[tuple[Scalar, Field], list[Obstacle]]:
    is_found = pair.result == RESULTS.successful
    inputs, (_, gap), pair = finite(is_found, (inputs, fold, pair))
    contact, load = inputs
    space = free_space(contact, load, gap)
    pair = differentiable_pair(pair, space, contact, load, gap, throw=False)
    linear = linearised(contact, load, gap, pair)

    def conditions(contact: Contact, load: Load) -> tuple[Field, Field, Scalar]:
        fields, net = fields_of(contact, load, gap)
        moved = contact.hessian(fields["gap"], contact.control(load))(pair.mode)
        return fields["gap"], linear.project(net), total(pair.mode * moved)

    _, net = fields_of(contact, load, gap)
    obstacles = [
        Obstacle(~is_found, NOT_FOUND),
        Obstacle(_is_bifurcation(linear), _BIFURCATION),
        changing_contact(net, gap, contact.hessian(gap, contact.control(load))),
    ]
    shift, *missed = pushed(conditions, inputs, changes)
    imbalance, eigenvalue = (jnp.where(any_exists(obstacles), 0, part) for part in missed)
    solve = linear.stiffened.differentiable_solution
    change, move = newton_step(linear, (imbalance, eigenvalue), solve)
    return (change, shift + move), obstacles


def _changes_of_fields(
    fields: Fields, is_found: Bool[Array, ""], inputs: tuple, changes: tuple
) -> tuple[Fields, list[Obstacle]]:
    moved, _ = pushed(fields_of, finite(is_found, inputs), changes)
    return moved, [Obstacle(~is_found, NOT_FOUND)]


def _is_bifurcation(linear: Linearisation) -> Bool[Array, ""]:
    """Whether the load does not act on the mode, or the eigenvalue does not change along it."""

    mode = linear.pair.mode

    def cosine(field: Field) -> Scalar:
        return jnp.abs(total(mode * field)) / jnp.sqrt(total(field**2))

    least = jnp.minimum(cosine(linear.imbalance_rate), cosine(linear.eigenvalue_slope))
    return ~(least > _LEAST_COSINE[mode.dtype.name])

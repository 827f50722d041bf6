"""How a fold moves with the contact: the linearised conditions of a fold."""

from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxstab.contact import Contact
from jaxstab.derivatives import Obstacle, unless
from jaxstab.equilibrium.implicit import fields_of, verge_of_contact
from jaxstab.folds.branch import (
    Field,
    Linear,
    Scalar,
    free_space,
    linearised,
    newton_step,
)
from jaxstab.grid import total
from jaxstab.loads import Load
from jaxstab.results import RESULTS
from jaxstab.stability import Eigenpair
from jaxstab.stability.implicit import differentiable as differentiable_pair

Tree = TypeVar("Tree")

NOT_FOUND = "no fold was found (look at its result)"
_LEAST_COSINE = {"float64": 1e-6, "float32": 1e-3}
_BIFURCATION = (
    "the branch does not turn back here but branches off, into states without its symmetry. "
    "Differentiate another quantity, or break the symmetry of the surface"
)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def differentiable(
    throw: bool, load: Load, gap: Field, pair: Eigenpair, contact: Contact
) -> tuple[Load, Field]:
    """Return load and gap of a fold as differentiable functions of the contact."""
    return load, gap


@differentiable.defjvp
def _differentiate(
    throw: bool, primals: tuple, tangents: tuple
) -> tuple[tuple[Load, Field], tuple[Load, Field]]:
    _, _, pair, contact = primals
    fold = differentiable(throw, *primals)
    is_found = pair.result == RESULTS.successful
    pair, (load, gap) = where_found(is_found, pair), where_found(is_found, fold)
    pair = differentiable_pair(pair, free_space(contact, load, gap), contact, gap, throw)
    linear = linearised(contact, load, gap, pair)

    def conditions(contact: Contact) -> tuple[Field, Field, Scalar]:
        fields, net = fields_of(contact, load, gap)
        moved = contact.hessian(fields["gap"])(pair.mode)
        return fields["gap"], linear.project(net), total(pair.mode * moved)

    _, (shift, *change) = jax.jvp(conditions, (contact,), tangents[-1:])
    _, net = fields_of(contact, load, gap)
    obstacles = [
        Obstacle(~is_found, NOT_FOUND),
        Obstacle(_is_bifurcation(linear), _BIFURCATION),
        verge_of_contact(net, gap, contact.hessian(gap)),
    ]
    change, move = newton_step(
        linear,
        tuple(change),
        lambda b: linear.stiffened.differentiable_solution(b, obstacles, throw),
    )
    change, move = (unless(obstacles, tangent, throw) for tangent in (change, shift + move))
    return fold, (jax.tree.map(lambda _: change, load), move)


def where_found(is_found: Bool[Array, ""], tree: Tree) -> Tree:
    """Return finite stand-ins where nothing was found, so that a failed lane does no harm."""

    def choose(leaf: Array) -> Array:
        is_float = jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.where(is_found, leaf, 1) if is_float else leaf

    return jax.tree.map(choose, tree)


def _is_bifurcation(linear: Linear) -> Bool[Array, ""]:
    """Whether the load does not act on the mode, or the eigenvalue does not change along it."""

    mode = linear.pair.mode

    def cosine(field: Field) -> Scalar:
        return jnp.abs(total(mode * field)) / jnp.sqrt(total(field**2))

    least = jnp.minimum(cosine(linear.imbalance_rate), cosine(linear.eigenvalue_slope))
    return ~(least > _LEAST_COSINE[mode.dtype.name])

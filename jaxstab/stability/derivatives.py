"""Derivatives of an eigenvalue and its mode with respect to the contact and its gap."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.contact.contact import Contact
from jaxstab.contact.hessian import Hessian
from jaxstab.core.grid import total
from jaxstab.core.implicit import attach, finite, tangent_of
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.loads.load import Load
from jaxstab.stability.cones import Subspace
from jaxstab.stability.eigenpair import Eigenpair

# An eigenvalue nearer to the next than this many of its errors is taken for a multiple one.
_ERRORS_APART = 10


def differentiable(
    pair: Eigenpair, face: Subspace, contact: Contact, load: Load, gap: Field
) -> Eigenpair:
    """Return a pair whose eigenvalue and mode are functions of contact, load and gap.

    The mode belongs to the smallest eigenvalue on the linear space around the face.
    """
    known = pair.error, pair.result == RESULTS.successful, face
    values = pair.eigenvalue, pair.mode
    eigenvalue, mode = attach(_changes_of_pair, values, known, (contact, load, gap))
    return replace(pair, eigenvalue=eigenvalue, mode=mode)


def _changes_of_pair(
    pair: tuple[Scalar, Field],
    known: tuple[Scalar, Flag, Subspace],
    inputs: tuple[Contact, Load, Field],
    changes: tuple[Contact, Load, Field],
) -> tuple[tuple[Array, Field], Flag]:
    error, is_found, face = known
    inputs = finite(is_found, inputs)
    eigenvalue, mode = finite(is_found & jnp.isfinite(pair[0]), pair)
    hessian = _hessian(*inputs).restriction(face.is_moving)

    def project(field: Field) -> Field:
        field = face.project(field)
        return field - total(field * mode) * mode

    def shift(field: Field) -> Field:
        return hessian(field) - eigenvalue * field

    system = LinearSystem(shift, hessian.preconditioner(mode, eigenvalue), project)
    separation = jax.lax.stop_gradient(_separation(system, mode))
    is_undefined = ~is_found | ~(separation > _ERRORS_APART * error)
    change = tangent_of(lambda *inputs: _hessian(*inputs)(mode), inputs, changes)
    right_side = jnp.where(is_undefined, 0, -change)
    return (total(mode * change), system.differentiable_solution(right_side)), is_undefined


def _hessian(contact: Contact, load: Load, gap: Field) -> Hessian:
    return contact.hessian(gap, contact.control(load))


def _separation(system: LinearSystem, mode: Field) -> Scalar:
    """Return how far the next eigenvalue is, from one step of inverse iteration."""
    probe = jax.random.normal(jax.random.key(0), mode.shape, mode.dtype)
    found, _ = system.solution(probe)
    size = total(found**2)
    # Where the space holds nothing else, the eigenvalue is alone.
    is_alone = size == 0
    quotient = total(found * system.operator(found)) / jnp.where(is_alone, 1, size)
    return jnp.where(is_alone, jnp.inf, quotient)

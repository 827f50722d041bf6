"""Derivatives of an eigenvalue and its mode with respect to the contact and its gap."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.contact import Contact
from jaxstab.contact.hessian import Hessian
from jaxstab.core.grid import total
from jaxstab.core.implicit import LinearSystem, attach, finite, pushed
from jaxstab.core.no_derivative import Obstacle, any_exists
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.loads import Load
from jaxstab.stability.cones import Subspace
from jaxstab.stability.eigenpair import Eigenpair

# An eigenvalue nearer to the next than this many of its errors is taken for a multiple one.
_ERRORS_APART = 10
_NOT_FOUND = "the eigenvalue did not converge, or was not computed (look at its result)"
_MULTIPLE = (
    "the eigenvalue is multiple, to within its error, and splits into several. Differentiate "
    "another quantity, or break the symmetry of the surface"
)


def differentiable(
    pair: Eigenpair, face: Subspace, contact: Contact, load: Load, gap: Field, throw: bool
) -> Eigenpair:
    """Return a pair whose eigenvalue and mode are functions of contact, load and gap.

    Arguments:
        pair: an eigenpair, not to be differentiated itself.
        face: the linear space on which the mode is that of the smallest eigenvalue.
        contact: the contact problem.
        load: the load, whose stiffness is a part of A.
        gap: the gap of the equilibrium.
        throw: whether a derivative that does not exist is an error, or NaN.
    """
    known = pair.error, pair.result == RESULTS.successful, face
    values = pair.eigenvalue, pair.mode
    eigenvalue, mode = attach(_changes_of_pair, throw, values, known, (contact, load, gap))
    return replace(pair, eigenvalue=eigenvalue, mode=mode)


def _changes_of_pair(
    pair: tuple[Scalar, Field],
    known: tuple[Scalar, Flag, Subspace],
    inputs: tuple[Contact, Load, Field],
    changes: tuple[Contact, Load, Field],
) -> tuple[tuple[Array, Field], list[Obstacle]]:
    error, is_found, face = known
    inputs = finite(is_found, inputs)
    eigenvalue, mode = finite(is_found & jnp.isfinite(pair[0]), pair)
    hessian = _hessian(*inputs).restricted(face.is_moving)

    def project(field: Field) -> Field:
        field = face.project(field)
        return field - total(field * mode) * mode

    def shifted(field: Field) -> Field:
        return hessian(field) - eigenvalue * field

    system = LinearSystem(shifted, hessian.preconditioner(mode, eigenvalue), project)
    separation = jax.lax.stop_gradient(_separation(system, mode))
    obstacles = [
        Obstacle(~is_found, _NOT_FOUND),
        Obstacle(~(separation > _ERRORS_APART * error), _MULTIPLE),
    ]
    change = pushed(lambda *inputs: _hessian(*inputs)(mode), inputs, changes)
    right_side = jnp.where(any_exists(obstacles), 0, -change)
    return (total(mode * change), system.differentiable_solution(right_side)), obstacles


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

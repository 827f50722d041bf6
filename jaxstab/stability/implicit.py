"""Derivatives of an eigenvalue and its mode with respect to the contact and its gap."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxstab.contact import Contact
from jaxstab.derivatives import LinearSystem, Obstacle, unless
from jaxstab.grid import total
from jaxstab.results import RESULTS
from jaxstab.stability.cones import Subspace
from jaxstab.stability.eigenpairs import Eigenpair

Field = Float[Array, " *grid"]

# An eigenvalue nearer to the next than this many of its errors is taken for a multiple one.
_ERRORS_APART = 10
_NOT_FOUND = "the eigenvalue did not converge, or was not computed (look at its result)"
_MULTIPLE = (
    "the eigenvalue is multiple, to within its error, and splits into several. Differentiate "
    "another quantity, or break the symmetry of the surface"
)


def differentiable(
    pair: Eigenpair, face: Subspace, contact: Contact, gap: Field, throw: bool
) -> Eigenpair:
    """Return a pair whose eigenvalue and mode are functions of contact and gap.

    Arguments:
        pair: an eigenpair, not to be differentiated itself.
        face: the linear space on which the mode is that of the smallest eigenvalue.
        contact: the contact problem.
        gap: the gap of the equilibrium.
        throw: whether a derivative that does not exist is an error, or NaN.
    """
    is_found = pair.result == RESULTS.successful
    static = throw, face.fixes_mean
    eigenvalue, mode = _eigenpair(
        static, pair.eigenvalue, pair.mode, pair.error, is_found, face.is_moving, contact, gap
    )
    return replace(pair, eigenvalue=eigenvalue, mode=mode)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _eigenpair(
    static: tuple[bool, bool],
    eigenvalue: Float[Array, ""],
    mode: Field,
    error: Float[Array, ""],
    is_found: Bool[Array, ""],
    is_moving: Bool[Array, " *grid"],
    contact: Contact,
    gap: Field,
) -> tuple[Float[Array, ""], Field]:
    return eigenvalue, mode


@_eigenpair.defjvp
def _differentiate(
    static: tuple[bool, bool], primals: tuple, tangents: tuple
) -> tuple[tuple[Array, Field], tuple[Array, Field]]:
    throw, fixes_mean = static
    _, _, error, is_found, is_moving, contact, gap = primals
    pair = eigenvalue, mode = _eigenpair(static, *primals)
    eigenvalue = jnp.where(is_found & jnp.isfinite(eigenvalue), eigenvalue, 0)
    # Stand-ins, so that a failed lane does no harm and what is asked of it is seen.
    anything = jax.random.normal(jax.random.key(1), mode.shape, mode.dtype)
    mode, gap = jnp.where(is_found, mode, anything), jnp.where(is_found, gap, 1)
    hessian = contact.hessian(gap).restricted(is_moving)
    face = Subspace(is_moving, fixes_mean)

    def project(field: Field) -> Field:
        field = face.project(field)
        return field - total(field * mode) * mode

    def shifted(field: Field) -> Field:
        return hessian(field) - eigenvalue * field

    def precondition(field: Field) -> Field:
        return hessian.precondition(field, mode, eigenvalue)

    system = LinearSystem(shifted, precondition, project)
    separation = jax.lax.stop_gradient(_separation(system, mode))
    obstacles = [
        Obstacle(~is_found, _NOT_FOUND),
        Obstacle(~(separation > _ERRORS_APART * error), _MULTIPLE),
    ]
    _, change = jax.jvp(lambda c, g: c.hessian(g)(mode), (contact, gap), tangents[-2:])
    moved = system.differentiable_solution(-change, obstacles, throw)
    return pair, (unless(obstacles, total(mode * change), throw), moved)


def _separation(system: LinearSystem, mode: Field) -> Float[Array, ""]:
    """Return how far the next eigenvalue is, from one step of inverse iteration."""
    probe = jax.random.normal(jax.random.key(0), mode.shape, mode.dtype)
    found, _ = system.solution(probe)
    size = total(found**2)
    # Where the space holds nothing else, the eigenvalue is alone.
    is_alone = size == 0
    quotient = total(found * system.operator(found)) / jnp.where(is_alone, 1, size)
    return jnp.where(is_alone, jnp.inf, quotient)

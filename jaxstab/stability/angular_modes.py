"""Perturbations x(r) cos(m theta) of an axisymmetric contact, m = 1, 2, ...

They move no force, and none of an order acts on another order. A point in contact stays there:
where the perturbation lifts it, the same one turned by pi / m would press it in. So for each order
the critical cone is a linear space, and its smallest eigenvalue that of a dense matrix.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp

from jaxstab.contact.contact import Contact
from jaxstab.core.accuracy import rounding_of_fields
from jaxstab.core.checks import integer
from jaxstab.core.compile import program
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field
from jaxstab.solids.axisymmetric import AxisymmetricSolid, Matrix
from jaxstab.stability.verdict import VERDICTS, AngularMode, Stability


def require_orders(contact: Contact, orders: int) -> int:
    """Return a number of orders, which only an axisymmetric contact has.

    Raises:
        TypeError: for a number that is not an integer.
        ValueError: for a negative one, and for a solid that is not axisymmetric.
    """
    number = integer("The number of orders", orders)
    if number < 0:
        raise ValueError(f"The number of orders is {number}: give 0 or more.")
    if number > 0 and not isinstance(contact.solid, AxisymmetricSolid):
        raise ValueError(
            f"The number of orders is {number}, and the solid a {type(contact.solid).__name__}: "
            "leave it out. Only an AxisymmetricHalfSpace, or Axisymmetric, has orders; on a grid "
            "all perturbations are judged."
        )
    return number


def with_angular_modes(
    stability: Stability, contact: Contact, gap: Field, orders: int
) -> Stability:
    """Return a stability whose verdict rests on the orders up to a number, too.

    Arguments:
        stability: of order zero.
        contact: the contact, on rings.
        gap: of the equilibrium [length].
        orders: the number of orders.
    """
    if orders == 0:
        return stability
    solid = contact.solid
    assert isinstance(solid, AxisymmetricSolid)
    found = [
        _lowest_of_order(m, solid.stiffness_of_order(m), contact, gap) for m in range(1, orders + 1)
    ]
    return _assess(stability, jax.tree.map(lambda *modes: jnp.stack(modes), *found))


@partial(program, static_argnums=0)
def _lowest_of_order(order: int, stiffness: Matrix, contact: Contact, gap: Field) -> AngularMode:
    is_free = gap > 0
    both = is_free[:, None] & is_free
    matrix = jnp.where(both, stiffness + jnp.diag(contact.curvature(gap)), 0)
    bound = jnp.max(jnp.sum(jnp.abs(matrix), axis=0))
    # Held points lie above all others.
    eigenvalues, modes = jnp.linalg.eigh(matrix + jnp.diag(jnp.where(is_free, 0, 2 * bound + 1)))
    return AngularMode(
        order=jnp.array(order),
        eigenvalue=jnp.where(jnp.any(is_free), eigenvalues[0], jnp.inf),
        error=rounding_of_fields(gap.dtype) * bound,
        mode=jnp.where(is_free, modes[:, 0], 0),
    )


@program
def _assess(stability: Stability, angular: AngularMode) -> Stability:
    is_unstable = jnp.any(angular.eigenvalue < -angular.error)
    is_sure = jnp.all(angular.eigenvalue > angular.error)
    is_judged = stability.result == RESULTS.successful
    verdict = VERDICTS.where(is_sure, stability.verdict, VERDICTS.undecided)
    verdict = VERDICTS.where(stability.verdict == VERDICTS.unstable, VERDICTS.unstable, verdict)
    verdict = VERDICTS.where(is_judged & is_unstable, VERDICTS.unstable, verdict)
    proved = (stability.proved & (verdict == stability.verdict)) | (
        (verdict == VERDICTS.unstable) & is_judged
    )
    return replace(stability, angular=angular, verdict=verdict, proved=proved)

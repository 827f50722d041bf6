"""The load at which a branch of equilibria ends, as a differentiable result."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.display import block
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import Stackable
from jaxstab.core.units import Dimensioned
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrium import contact_area, fields_of
from jaxstab.loads import Load
from jaxstab.paths.curve.limit import Limit
from jaxstab.paths.curve.limit_derivatives import differentiable, differentiable_fields
from jaxstab.paths.kinds import KINDS
from jaxstab.stability import Eigenpair
from jaxstab.stability.cones import Subspace
from jaxstab.stability.derivatives import differentiable as differentiable_pair


class CriticalLoad(Stackable, Dimensioned):
    """Where a branch of equilibria ends; a symmetric branch can bifurcate there instead.

    Attributes:
        equilibrium: the last equilibrium of the branch, with its load.
        kind: a member of `KINDS`: a fold or a release; uncertain where the branch ends, but the
            condition of neither is met.
        critical: the smallest eigenvalue on the points that are free or released, and its mode. It
            is zero at a fold and negative at a release. `Stability.critical` leaves out the points
            that are released, and is still positive just before a release.
        after: the state that remains beyond a pull-off; otherwise None.
        result: a member of `RESULTS`: how the search ended.
    """

    equilibrium: Equilibrium
    kind: KINDS
    critical: Eigenpair
    after: Equilibrium | None
    result: RESULTS

    __repr__ = block

    @property
    def load(self) -> Load:
        """The critical load."""
        return self.equilibrium.load


def critical_load_at(contact: Contact, loads: Load, limit: Limit) -> CriticalLoad:
    """Return the limit of a branch as a differentiable function of the contact and its loads.

    The values of the loads have no effect on it.
    """
    limit = replace(limit, load=loads[0].at(limit.load.value))
    load, gap = differentiable(limit, contact)
    is_found, in_contact = limit.is_found, limit.gap == 0
    fields, _ = fields_of(*jax.lax.stop_gradient((contact, limit.load, limit.gap)))
    fields = {name: jnp.where(is_found, field, jnp.nan) for name, field in fields.items()}
    fields = differentiable_fields(fields, is_found, contact, load, gap)
    space = Subspace(~in_contact | limit.point, contact.control(load).fixes_mean)
    eigenvalue = jnp.where(is_found, limit.critical.eigenvalue, jnp.nan)
    pair = replace(limit.critical, eigenvalue=eigenvalue, result=limit.result)
    return CriticalLoad(
        equilibrium=Equilibrium(
            load=load,
            in_contact=in_contact,
            contact_area=jnp.where(is_found, contact_area(contact, limit.gap), jnp.nan),
            area=contact.area,
            units=contact.units,
            is_window=contact.solid.is_window,
            residual=limit.residual,
            num_steps=limit.num_steps,
            result=limit.result,
            history=limit.history,
            **fields,
        ),
        kind=limit.kind,
        critical=differentiable_pair(pair, space, contact, load, gap),
        after=None,
        result=limit.result,
    )

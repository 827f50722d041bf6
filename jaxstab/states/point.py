"""A state on a curve or a load path, with the quantities that follow from its load and gap."""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.contact.energy import rounding_of, supply_of
from jaxstab.core.grid import mean
from jaxstab.core.types import Field, Scalar
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load
from jaxstab.states.sequence import States


class PathPoint(eqx.Module):
    """A state on a path: its load and gap, and the quantities that follow from them.

    Attributes:
        value: of the load.
        gap: g [length].
        mean_gap: mean(g) [length].
        mean_pressure: p0 [pressure].
        contact_area: the number of contact points over the number of all points.
        energy: E, of the surface [energy].
        stored: E and the energy of the machine [energy].
        potential: E + W [energy].
        force: F, how the potential follows the load on a branch [energy over unit of the load].
        dissipation: lost in the jumps up to there [energy].
    """

    value: Scalar
    gap: Field
    mean_gap: Scalar
    mean_pressure: Scalar
    contact_area: Scalar
    energy: Scalar
    stored: Scalar
    potential: Scalar
    force: Scalar
    dissipation: Scalar

    def rounding(self, area: Scalar) -> Scalar:
        """Return the part of a loss near this state that may be rounding [energy]."""
        return rounding_of(self.potential, area * self.mean_pressure * self.mean_gap)


def point_of(contact: Contact, found: Equilibrium, value: Scalar) -> PathPoint:
    """Return an equilibrium as a point of a path without jumps, at the value of the load."""
    load = found.load.at(value)
    control = contact.control(load)
    held, force = supply_of(contact, load, control.mean_gap_of(found.gap), found.mean_pressure)
    stored = found.energy
    if control.stores_energy:
        stored = found.energy + held
    return PathPoint(
        value,
        found.gap,
        mean(found.gap),
        found.mean_pressure,
        found.contact_area,
        found.energy,
        stored,
        found.energy + held,
        force,
        jnp.zeros_like(held),
    )


def states_along(contact: Contact, one: Load, points: PathPoint) -> tuple[Load, States]:
    """Return the loads and the states of points along a path, given the load at any value."""
    loads = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, points.value.shape), one)
    gaps = None
    if points.gap.size:
        gaps = points.gap
    return loads.at(points.value), States.of(
        contact,
        points.energy,
        mean_gap=points.mean_gap,
        mean_pressure=points.mean_pressure,
        contact_area=points.contact_area,
        work=points.stored - points.stored[0] + points.dissipation,
        dissipation=points.dissipation,
        gap=gaps,
    )

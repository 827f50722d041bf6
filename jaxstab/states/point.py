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
        potential: E + W, and the plastic work [energy].
        force: F, how the potential follows the load on a branch [energy over unit of the load].
        dissipation: lost in the jumps up to there [energy].
        indentation: of the surface as the contact has it, up to there; None if nothing yields
            [length].
        plastic_work: that this took [energy]; None likewise.
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
    indentation: Field | None = None
    plastic_work: Scalar | None = None

    @property
    def signed_gap(self) -> Field:
        """The gap less the indentation: u - h over the surface as the contact has it [length]."""
        if self.indentation is None:
            return self.gap
        return self.gap - self.indentation

    def rounding(self, area: Scalar) -> Scalar:
        """Return the part of a loss near this state that may be rounding [energy]."""
        return rounding_of(self.potential, area * self.mean_pressure * self.mean_gap)


def point_of(
    contact: Contact, found: Equilibrium, value: Scalar, before: PathPoint | None = None
) -> PathPoint:
    """Return an equilibrium as a point of a path without jumps, at the value of the load.

    A surface that yields has been left by the state before as that has found it. Loads count from
    the surface as the contact has it, with which the path began.
    """
    load = found.load.at(value)
    control = contact.control(load)
    indentation = found.indentation
    plastic_work = found.plastic_work
    if before is not None and indentation is not None:
        assert before.indentation is not None and before.plastic_work is not None
        assert plastic_work is not None
        indentation = before.indentation + indentation
        plastic_work = before.plastic_work + plastic_work
    signed_gap = found.gap
    if indentation is not None:
        signed_gap = found.gap - indentation
    mean_gap = control.mean_gap_of(signed_gap)
    held, force = supply_of(contact, load, mean_gap, found.mean_pressure)
    potential = found.energy + held
    if plastic_work is not None:
        potential = potential + plastic_work
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
        potential,
        force,
        jnp.zeros_like(held),
        indentation,
        plastic_work,
    )


def states_along(contact: Contact, one: Load, points: PathPoint) -> tuple[Load, States]:
    """Return the loads and the states of points along a path, given the load at any value."""
    loads = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, points.value.shape), one)
    gaps = None
    indentation = None
    if points.gap.size:
        gaps = points.gap
        indentation = points.indentation
    work = points.stored - points.stored[0] + points.dissipation
    plastic_work = None
    if points.plastic_work is not None:
        plastic_work = points.plastic_work - points.plastic_work[0]
        work = work + plastic_work
    return loads.at(points.value), States.of(
        contact,
        points.energy,
        mean_gap=points.mean_gap,
        mean_pressure=points.mean_pressure,
        contact_area=points.contact_area,
        work=work,
        dissipation=points.dissipation,
        gap=gaps,
        indentation=indentation,
        plastic_work=plastic_work,
    )

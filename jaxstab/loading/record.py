"""The states and jumps that load stepping records, in stores of a bounded size."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.point import PathPoint
from jaxstab.contact import Contact
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose, cond
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import nothing_like
from jaxstab.core.table import Table
from jaxstab.core.types import Flag, Scalar
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrium import detached_where, state_at
from jaxstab.loads import Load


class Event(eqx.Module):
    """A jump: its two states, its loss, the number of its state, whether it is a touch."""

    before: PathPoint
    after: PathPoint
    dissipation: Scalar
    state: Int[Array, ""]
    is_touch: Flag

    @property
    def ahead(self) -> Scalar:
        """How far ahead of the state before the load of the one after lies, with its sign."""
        return self.after.value - self.before.value

    def state_before(self, contact: Contact, one: Load) -> Equilibrium:
        """Return the equilibrium before it, given the load there at any value."""
        return _state_unless(self.is_touch, contact, one, self.before)

    def state_after(self, contact: Contact, one: Load) -> Equilibrium:
        """Return the equilibrium after it, given the load there at any value."""
        is_pulled = ~self.is_touch & jnp.isnan(self.dissipation)
        return _state_unless(is_pulled, contact, one, self.after)


def _state_unless(is_apart: Flag, contact: Contact, one: Load, point: PathPoint) -> Equilibrium:
    """Return the equilibrium of a point; where surfaces are apart there is none."""
    return detached_where(is_apart, state_at(contact, one.at(point.value), point.gap))


class Record(eqx.Module):
    """The state and the jump of a step, as far as there are any, and where it has led to.

    Attributes:
        point: the state.
        is_state: whether it is a new one, of surfaces that are not apart.
        event: the jump.
        is_event: whether there is one.
        part: the number of the monotone part of the load path.
        result: how load stepping went so far.
    """

    point: PathPoint
    is_state: Flag
    event: Event
    is_event: Flag
    part: Int[Array, ""]
    result: RESULTS


class Room(eqx.Module):
    """Room for the states and the jumps of a path, with or without the gaps of the states."""

    num_states: int = eqx.field(static=True)
    num_jumps: int = eqx.field(static=True)
    fields: bool = eqx.field(static=True)

    def __call__(self, like: Record) -> "Tables":
        """Return empty tables for records like one."""
        states = Table.like(like.point, self.num_states, self.fields)
        return Tables(states, Table.like(like.event, self.num_jumps))


class Tables(eqx.Module):
    """The states and the jumps of a path within a program, in room for a number of them."""

    states: Table[PathPoint]
    jumps: Table[Event]

    @property
    def is_full(self) -> Flag:
        """Whether there is no room for another state or jump."""
        return self.states.is_full | self.jumps.is_full

    def append(self, record: Record) -> "Tables":
        """Return the tables with what a step has recorded."""
        states = self.states.with_entry(record.point, record.is_state)
        return Tables(states, self.jumps.with_entry(record.event, record.is_event))


class Strongest(eqx.Module):
    """Of all jumps the first from the largest tension [pressure], NaN where there is none."""

    event: Event
    tension: Scalar

    @property
    def is_found(self) -> Flag:
        """Whether there is one."""
        return self.tension > -jnp.inf

    @property
    def is_full(self) -> bool:
        """Whether there is no room: there always is."""
        return False

    def append(self, record: Record) -> "Strongest":
        """Return the stronger one of this and the jump of a step, if that is no touch."""
        return cond(record.is_event, lambda: _stronger(self, record.event), lambda: self)


@program
def no_jump(like: Record) -> Strongest:
    """Return that there is no jump as yet, of records like one."""
    event = jax.tree.map(nothing_like, like.event)
    return Strongest(event, jnp.full_like(like.event.dissipation, -jnp.inf))


@program
def _stronger(strongest: Strongest, event: Event) -> Strongest:
    tension = -event.before.mean_pressure
    is_stronger = ~event.is_touch & (tension > strongest.tension)
    return choose(is_stronger, Strongest(event, tension), strongest)

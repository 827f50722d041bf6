"""The records that load stepping makes, step by step, and stores for them.

1. A step makes a `Record`: of the state that it has led to, if that is a new one, and of the jump
   that it has located, if there is one.
2. A store takes the records in order, by `append`, until it is full. Outside of a trace, where a
   path has as many states as it needs, that is `PathRecording`; within a program it is
   `PathTables`, made by `PathRoom`, of a bounded size. Where the strongest jump alone matters, it
   is `Strongest`.
3. At the end the equilibria before and after a jump are computed from the gaps in its `Event`.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact
from jaxstab.core.compile import program
from jaxstab.core.control_flow import cond
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import nothing_like
from jaxstab.core.table import Table
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrium import detached_where, state_at
from jaxstab.loads import Load
from jaxstab.states.point import PathPoint


class Event(eqx.Module):
    """A jump along a load path, or a touch of surfaces that were apart.

    An empty row of a table is neither.

    Attributes:
        before: the state before.
        after: the state after it, at the next load.
        ahead: how far ahead that load lies, with its sign.
        dissipation: the energy lost [energy]; NaN where surfaces fall apart or touch.
        state: the number of the state before, among those recorded.
        is_jump: whether it is a jump, from the end of a branch.
        is_pulled: whether the surfaces fall apart in the jump.
        is_touch: whether it is a touch.
    """

    before: PathPoint
    after: PathPoint
    ahead: Scalar
    dissipation: Scalar
    state: Int[Array, ""]
    is_jump: Flag
    is_pulled: Flag
    is_touch: Flag

    def equilibrium_before(self, contact: Contact, load: Load) -> Equilibrium:
        """Return the equilibrium before it, given the load at any value."""
        return _equilibrium_unless(self.is_touch, contact, load, self.before)

    def equilibrium_after(self, contact: Contact, load: Load) -> Equilibrium:
        """Return the equilibrium after it, given the load at any value."""
        return _equilibrium_unless(self.is_pulled, contact, load, self.after)


def _equilibrium_unless(
    is_apart: Flag, contact: Contact, load: Load, point: PathPoint
) -> Equilibrium:
    """Return the equilibrium of a point; where surfaces are apart there is none."""
    load = load.at(point.value)
    return cond(
        is_apart,
        lambda: _none(contact, load, point.gap),
        lambda: state_at(contact, load, point.gap),
    )


@program
def _none(contact: Contact, load: Load, gap: Field) -> Equilibrium:
    return detached_where(jnp.array(True), state_at(contact, load, gap))


class Record(eqx.Module):
    """The state and the jump of a step, as far as there are any, and where it has led to.

    Attributes:
        point: the state.
        is_state: whether it is a new one, of surfaces that are not apart.
        event: the jump or the touch.
        is_event: whether there is one.
        leg: the number of the leg of the load path.
        result: how load stepping went so far.
    """

    point: PathPoint
    is_state: Flag
    event: Event
    is_event: Flag
    leg: Int[Array, ""]
    result: RESULTS


class PathRoom(eqx.Module):
    """Room for the states and the jumps of a path, with or without the gaps of the states."""

    num_states: int = eqx.field(static=True)
    num_jumps: int = eqx.field(static=True)
    fields: bool = eqx.field(static=True)

    def __call__(self, like: Record) -> "PathTables":
        """Return empty tables for records like one."""
        states = Table.like(like.point, self.num_states, self.fields)
        jumps = Table.like(like.event, self.num_jumps)
        return PathTables(states, jumps, like.point.gap)


class PathTables(eqx.Module):
    """The states and the jumps of a path within a program, in room for a number of them.

    Attributes:
        states: the states.
        jumps: the jumps and touches.
        gap: of the last state [length].
    """

    states: Table[PathPoint]
    jumps: Table[Event]
    gap: Field

    @property
    def is_full(self) -> Flag:
        """Whether there is no room for another state or jump."""
        return self.states.is_full | self.jumps.is_full

    def append(self, record: Record) -> "PathTables":
        """Return the tables with the record of a step."""
        states = self.states.with_entry(record.point, record.is_state)
        jumps = self.jumps.with_entry(record.event, record.is_event)
        return PathTables(states, jumps, jnp.where(record.is_state, record.point.gap, self.gap))


class Strongest(eqx.Module):
    """Of all jumps the first from the largest tension.

    Attributes:
        event: the jump, NaN where there is none.
        tension: the tension before it [pressure], -inf where there is none.
    """

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
        """Return the stronger one of this and the jump of a step, if there is one."""
        return cond(record.event.is_jump, lambda: self._or(record.event), lambda: self)

    def _or(self, event: Event) -> "Strongest":
        tension, is_stronger = _compared(self.tension, event.before.mean_pressure)
        return cond(is_stronger, lambda: Strongest(event, tension), lambda: self)


@program
def no_jump(like: Record) -> Strongest:
    """Return that there is no jump as yet, of records like one, and no state after it."""
    event = jax.tree.map(nothing_like, like.event)
    event = replace(event, is_pulled=jnp.array(True))
    return Strongest(event, jnp.full_like(like.event.dissipation, -jnp.inf))


@program
def _compared(largest: Scalar, mean_pressure: Scalar) -> tuple[Scalar, Flag]:
    """Return the tension of a mean pressure, and whether it is larger than another one."""
    return -mean_pressure, -mean_pressure > largest

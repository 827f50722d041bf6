"""The states and events of a search in order, in a store that it fills step by step.

1. A step makes a `Record`: of the state that it has led to, if that is a new one, and of the event
   on the way there, if there is one.
2. A store takes the records in order, by `append`, until it is full. Outside of a trace, where a
   search has as many states as it needs, that is a `RecordList`; within a program it is `Tables`,
   made by `Room`, of a bounded size.
"""

import math
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import numpy as np

from jaxstab.core.checks import concrete
from jaxstab.core.control_flow import choose
from jaxstab.core.interrupts import interrupts_after
from jaxstab.core.stack import stack_of
from jaxstab.core.table import Table
from jaxstab.core.types import Flag

# Tables of known states have multiples of this size, so that one program serves many lengths.
_ROOM = 1024

State = TypeVar("State")
Event = TypeVar("Event")
Search = TypeVar("Search")


class Record(eqx.Module, Generic[State, Event]):
    """The state and the event of a step, as far as there are any.

    Attributes:
        state: the state.
        is_state: whether it is a new one.
        event: the event.
        is_event: whether there is one.
    """

    state: State
    is_state: Flag
    event: Event
    is_event: Flag


class RecordList(Generic[Search, State, Event]):
    """The states and events of a search outside of a trace.

    Attributes:
        search: the search after the last step; None before the first.
        states: the states, without their fields unless `fields`.
        events: the events.
        last: the last state, with its fields.
    """

    def __init__(self, fields: bool, max_states: float = math.inf) -> None:
        self.fields = fields
        self.max_states = max_states
        self.search: Any = None
        self.states: list[State] = []
        self.events: list[Event] = []
        self.last: Any = None

    @property
    def is_full(self) -> bool:
        """Whether there is no room for another state."""
        return len(self.states) >= self.max_states

    def has_event(self, is_it: Callable[[Event], Flag]) -> bool:
        """Return whether a condition holds for one of the events."""
        return any(map(is_it, self.events))

    def append(
        self, search: Search, record: Record[State, Event]
    ) -> "RecordList[Search, State, Event]":
        """Append what a step has recorded, all of it or, where it is interrupted, nothing."""
        is_state = bool(record.is_state)
        is_event = bool(record.is_event)
        # Fields of all states have their place in the memory of the host, unless they are sharded.
        kept = jax.tree.map(self._compact, record.state)
        with interrupts_after():
            if is_state:
                self.states.append(kept)
                self.last = record.state
            if is_event:
                self.events.append(record.event)
            self.search = search
        return self

    def rows(self, like: Event) -> tuple[State, Event]:
        """Return the states and the events along a leading axis; `like` gives an event's shapes."""
        return stack_of(self.states, self.states[0]), stack_of(self.events, like)

    def table(self) -> State:
        """Return the numbers of the states, without fields, in room for more states.

        In the room that is left numbers are NaN, and integers zero.
        """
        number = len(self.states)
        room = _ROOM * max(-(-number // _ROOM), 1)

        def column(*leaves: Any) -> np.ndarray:
            known = np.zeros((number, 0))
            if leaves[0].ndim == 0:
                known = np.stack([concrete(leaf) for leaf in leaves])
            left = np.zeros((room - number, *known.shape[1:]), known.dtype)
            if left.dtype.kind == "f":
                left[:] = np.nan
            return np.concatenate([known, left])

        return jax.tree.map(column, *self.states)

    def _compact(self, leaf: Any) -> Any:
        if leaf.ndim == 0:
            return leaf
        if not self.fields:
            return np.zeros(0, leaf.dtype)
        return concrete(leaf)


class Room(eqx.Module):
    """Room for the states and events of a search, with or without the fields of the states."""

    num_states: int = eqx.field(static=True)
    num_events: int = eqx.field(static=True)
    fields: bool = eqx.field(static=True)

    def __call__(self, like: Record[State, Event]) -> "Tables[State, Event]":
        """Return empty tables for records like one."""
        states = Table.like(like.state, self.num_states, self.fields)
        return Tables(states, Table.like(like.event, self.num_events), like.state)


class Tables(eqx.Module, Generic[State, Event]):
    """The states and events of a search within a program, in room for a number of each.

    Attributes:
        states: the states.
        events: the events.
        last: the last state, with its fields.
    """

    states: Table[State]
    events: Table[Event]
    last: State

    @property
    def is_full(self) -> Flag:
        """Whether there is no room for another state or event."""
        return self.states.is_full | self.events.is_full

    def has_event(self, is_it: Callable[[Event], Flag]) -> Flag:
        """Return whether a condition of all events along a leading axis holds for one of them."""
        return is_it(self.events.rows)

    def append(self, _: object, record: Record[State, Event]) -> "Tables[State, Event]":
        """Return the tables with the record of a step."""
        states = self.states.with_entry(record.state, record.is_state)
        events = self.events.with_entry(record.event, record.is_event)
        return Tables(states, events, choose(record.is_state, record.state, self.last))

"""What a walk outside of JAX transformations has recorded: as much as there is, on the host."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from jaxstab.core.checks import known
from jaxstab.paths.record import Event, Store
from jaxstab.paths.step import Walk

# Of the states, so that one program serves paths of many lengths.
_ROOM = 1024


class Recording:
    """All states and jumps of a walk, taken out of its stores from time to time.

    Attributes:
        walk: where it is, with room for more states and jumps.
        num_states: of all that is recorded.
        events: the jumps.
    """

    def __init__(self, walk: Walk[Store]):
        self.walk = walk
        self._states: list[Any] = []
        self.num_states = 0
        self.events: list[Event] = []
        self.add(walk)

    def add(self, walk: Walk[Store]) -> None:
        """Record what the stores of a walk hold."""
        states, jumps = _entries(walk.states), _entries(walk.jumps)
        events = [self._event(jumps, i) for i in range(int(walk.jumps.count))]
        emptied = replace(walk, states=_empty(walk.states), jumps=_empty(walk.jumps))
        self._states.append(states)
        self.events += events
        self.num_states += int(walk.states.count)
        self.walk = emptied

    def _event(self, jumps: Any, i: int) -> Event:
        event = jax.tree.map(lambda leaf: leaf[i], jumps)
        return replace(event, state=event.state + self.num_states)

    @property
    def no_event(self) -> Event:
        """An event of the right kind, where there is none."""
        return jax.tree.map(lambda leaf: leaf[0], self.walk.jumps.rows)

    @property
    def ended(self) -> Walk[Any]:
        """The walk with all of its states, without their fields, in room that it may not fill."""
        size = _ROOM * max(-(-self.num_states // _ROOM), 1)

        def padded(*parts: np.ndarray) -> np.ndarray:
            # Fields, if there are any, are not needed.
            rows = np.concatenate(parts) if parts[0].ndim == 1 else np.zeros((size, 0))
            missing = np.full(size - len(rows), np.nan, rows.dtype)
            return rows if rows.ndim > 1 else np.concatenate([rows, missing])

        rows = jax.tree.map(padded, *self._states)
        states = Store(rows, self.walk.states.count + self.num_states)
        return replace(self.walk, states=states, jumps=None)

    @property
    def gaps(self) -> Array:
        """The gap of each state."""
        parts = [states.place.gap for states in self._states]
        return jax.device_put(np.concatenate(parts))


def _entries(store: Any) -> Any:
    return jax.tree.map(lambda leaf: known(leaf)[: int(store.count)], store.rows)


def _empty(store: Any) -> Any:
    return replace(store, count=store.count * 0)

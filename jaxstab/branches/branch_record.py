"""The states and turns that a continuation records, in stores that it fills one by one.

Outside of a trace that is `BranchRecording`; within a program it is `BranchTables`, of a bounded
size.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp

from jaxstab.branches.branch import Turn
from jaxstab.branches.branch_steps import BranchState, Entry, is_same
from jaxstab.branches.curve import ContinuationProblem
from jaxstab.core.interrupts import interrupts_after
from jaxstab.core.progress import advance_if_known
from jaxstab.core.stack import stacked
from jaxstab.core.table import Table
from jaxstab.core.types import Flag


class BranchRecording:
    """All states and turns of a branch outside of a trace.

    Arguments:
        number: of states after which it is full.
        fields: whether to keep the gaps of all states.
        branch: the branch at its first state, which is `entry`.
        turn: as if it had one, for the shapes of its arrays.
    """

    def __init__(
        self, number: int, fields: bool, branch: BranchState, entry: Entry, turn: Turn
    ) -> None:
        self.number = number
        self.fields = fields
        self.branch = branch
        self.like = turn
        self.entries = [self._kept(entry)]
        self.turns: list[Turn] = []

    @property
    def is_full(self) -> bool:
        """Whether there is no room for another state."""
        return len(self.entries) >= self.number

    def has(self, problem: ContinuationProblem, turn: Turn) -> bool:
        """Return whether a turn is one of those recorded."""
        return any(is_same(problem, turn, other) for other in self.turns)

    def append(self, branch: BranchState, entry: Entry, turn: Turn) -> "BranchRecording":
        """Record the state, the turn and the end of a branch after a step, or nothing at all."""
        with interrupts_after():
            self.branch = branch
            if branch.step.is_new:
                self.entries.append(self._kept(entry))
                advance_if_known(entry)
                if branch.step.turn.is_there:
                    self.turns.append(turn)
        return self

    def rows(self) -> tuple[Entry, Turn]:
        """Return the states and the turns along a leading axis."""
        return stacked(self.entries, self.entries[0]), stacked(self.turns, self.like)

    def _kept(self, entry: Entry) -> Entry:
        if self.fields:
            return entry
        return replace(entry, point=replace(entry.point, gap=jnp.zeros((0,))))


class BranchTables(eqx.Module):
    """The states and turns of a branch within a program, in room for a number of each."""

    states: Table[Entry]
    turns: Table[Turn]

    @property
    def is_full(self) -> Flag:
        """Whether there is no room for another state or turn."""
        return self.states.is_full | self.turns.is_full

    def has(self, problem: ContinuationProblem, turn: Turn) -> Flag:
        """Return whether a turn is one of those recorded."""
        return is_same(problem, turn, self.turns.rows)

    def append(self, branch: BranchState, entry: Entry, turn: Turn) -> "BranchTables":
        """Return the tables with the state and the turn of a branch after a step."""
        is_new = branch.step.is_new
        states = self.states.with_entry(entry, is_new)
        return BranchTables(states, self.turns.with_entry(turn, is_new & branch.step.turn.is_there))

"""A part of a case that many lanes can run: loops that can pause."""

from abc import ABC, abstractmethod
from typing import Any

from jaxtyping import Array, ArrayLike, Int

from jaxstab.core.types import Flag

# The inputs of a case, and after them the states of its stages so far.
Record = tuple[Any, ...]


class Stage(ABC):
    """A part of a case: loops that can pause. All methods are of one case, and traced.

    Attributes:
        has_rounds: whether lanes may begin anew once all are over.
        pace: the steps between two exchanges.
    """

    has_rounds: bool = False
    pace: int = 8

    @abstractmethod
    def begin(self, record: Record) -> Any:
        """Return the states of all lanes before their first step, along a leading axis."""

    @abstractmethod
    def advance(self, record: Record, state: Any, max_steps: ArrayLike) -> Any:
        """Return the state of a lane after at most so many steps more."""

    @abstractmethod
    def is_over(self, record: Record, state: Any) -> Flag:
        """Return whether a lane has no step to take."""

    @abstractmethod
    def num_steps(self, state: Any) -> Int[Array, ""]:
        """Return the number of steps that a lane has taken."""

    def turn(self, record: Record, states: Any) -> Any:
        """Return the states of all lanes, which are over, in the next round that has steps."""
        return states

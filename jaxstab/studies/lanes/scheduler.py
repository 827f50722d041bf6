"""Many cases in a fixed number of lanes: a finished case frees its lane for the next.

Under `jax.vmap` a loop runs until its slowest lane is done, and all lanes are paid for. Here a case
is a procedure, which stops where it waits for loops. Loops of one stop, of any cases, advance by a
few steps together. Between two such calls finished loops are replaced.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from jaxstab.studies.lanes.programs import Programs, Stop

# Returns up to so many new cases, and their inputs along a leading axis; whether it may wait.
Take = Callable[[int, bool], tuple[Sequence[Any], Any]]

# Programs are compiled for so many lanes, each number over the next.
_RATIO = 4
# Cases under way, in units of the lanes: as many as there are stops of a verdict.
_ROOMS = 6


@dataclass
class _Case:
    """A case that is under way.

    Attributes:
        name: its name.
        num_stops: how many stops it has come to.
        has_steps: which lanes of the last have steps to take.
        is_on: whether any takes part in the round.
        seconds: its share of the time.
    """

    name: Any
    num_stops: int = 0
    has_steps: np.ndarray = field(default_factory=lambda: np.zeros(1, bool))
    is_on: bool = False
    seconds: float = 0.0


class Lanes:
    """Runs cases in a number of lanes.

    Arguments:
        programs: those of the cases.
        width: how many lanes advance together.
        take: where cases come from.

    Attributes:
        paid: steps of all lanes that ran together, each for as long as the slowest.
        useful: those of them that lanes took.
    """

    def __init__(self, programs: Programs, width: int, take: Take):
        self._programs, self._take = programs, take
        self._widths = _widths(width)
        # So many that there are always lanes enough at one of the stops.
        self._free = list(range(_ROOMS * width))[::-1]
        self._num_rooms = len(self._free)
        # The inputs of all rooms, and their stops.
        self._inputs: Any = None
        self._stops: list[Any] = []
        # By room; the longest under way come first.
        self._cases: dict[int, _Case] = {}
        self.paid = self.useful = 0

    @property
    def in_hand(self) -> list[Any]:
        """The cases that are under way."""
        return [case.name for case in self._cases.values()]

    def run(self) -> Iterator[tuple[Any, Any, float]]:
        """Yield each case as it is done, its outputs, and its share of the seconds."""
        while True:
            yield from self._settle()
            if not self._fill():
                if not self._cases:
                    return
                self._advance()

    def _fill(self) -> bool:
        """Let new cases in, if there are any."""
        number = min(len(self._free), self._widths[0])
        if number == 0:
            return False
        names, inputs = self._take(number, not self._cases)
        if not names:
            return False
        where = [self._free.pop() for _ in names]
        self._cases |= {room: _Case(name) for room, name in zip(where, names, strict=True)}
        last = np.minimum(np.arange(self._padded(where).size), len(where) - 1)
        self._inputs = self._stored(
            self._inputs, jax.tree.map(lambda leaf: leaf[last], inputs), where
        )
        return True

    def _settle(self) -> Iterator[tuple[Any, Any, float]]:
        """Let cases without steps to take go on to the next round or stop, or leave."""
        for number in range(len(self._stops) + 1):
            while waiting := self._waiting(number, is_on=True):
                for where in waiting:
                    start, padded = perf_counter(), self._padded(where)
                    stop, lanes = self._programs.turn(self._stops[number - 1], padded)
                    self._open(number - 1, where, stop, lanes, start)
            for where in self._waiting(number, is_on=False):
                start, padded = perf_counter(), self._padded(where)
                before = self._inputs, tuple(self._stops[:number])
                stop, lanes = self._programs.go_on(*before, padded)
                if stop.rounds is None:
                    yield from self._leave(where, stop.outputs, start)
                else:
                    self._open(number, where, stop, lanes, start)

    def _waiting(self, number: int, is_on: bool) -> list[list[int]]:
        """Return the rooms at a stop without steps to take, as many together as there are lanes."""
        rooms = [
            room
            for room, case in self._cases.items()
            if case.num_stops == number and case.is_on == is_on and not case.has_steps.any()
        ]
        width = self._widths[0]
        return [rooms[i : i + width] for i in range(0, len(rooms), width)]

    def _open(
        self, number: int, where: list[int], stop: Stop, lanes: tuple[Array, Array], start: float
    ) -> None:
        """Let the lanes of a stop begin, or begin anew."""
        if number == len(self._stops):
            self._stops.append(None)
        self._stops[number] = self._stored(self._stops[number], stop, where)
        has_steps, is_on = map(np.array, lanes)
        seconds = (perf_counter() - start) / len(where)
        for i, room in enumerate(where):
            case = self._cases[room]
            case.num_stops, case.has_steps, case.is_on = number + 1, has_steps[i], bool(is_on[i])
            case.seconds += seconds

    def _leave(
        self, where: list[int], outputs: Any, start: float
    ) -> Iterator[tuple[Any, Any, float]]:
        outputs = jax.device_get(outputs)
        seconds = (perf_counter() - start) / len(where)
        for i, room in enumerate(where):
            case = self._cases.pop(room)
            self._free.append(room)
            own = jax.tree.map(lambda leaf, i=i: leaf[i], outputs)
            yield case.name, own, case.seconds + seconds

    def _advance(self) -> None:
        """Advance lanes of the stop where most have steps to take."""
        lanes: dict[int, list[tuple[int, int]]] = {}
        for room, case in self._cases.items():
            open_ = [(room, int(lane)) for lane in np.flatnonzero(case.has_steps)]
            lanes.setdefault(case.num_stops - 1, []).extend(open_)
        number = max(lanes, key=lambda number: len(lanes[number]))
        if not lanes[number]:
            return
        start = perf_counter()
        width = _best(self._widths, len(lanes[number]))
        chosen = lanes[number][:width]
        places = np.array([*chosen, *[chosen[-1]] * (width - len(chosen))]).T
        self._stops[number], *taken = self._programs.advance(self._stops[number], tuple(places))
        has_steps, steps = jax.device_get(taken)
        self.paid += width * int(steps.max())
        useful = int(steps[: len(chosen)].sum())
        self.useful += useful
        seconds = (perf_counter() - start) / max(useful, 1)
        for (room, lane), more, num_steps in zip(chosen, has_steps, steps, strict=False):
            case = self._cases[room]
            case.has_steps[lane] = more
            case.seconds += seconds * int(num_steps)

    def _stored(self, arrays: Any, values: Any, where: list[int]) -> Any:
        """Return the arrays of all rooms with values, padded with copies of the last, in some."""
        if arrays is None:
            arrays = self._programs.taken(values, np.zeros(self._num_rooms, int))
        return self._programs.put(arrays, values, self._padded(where))

    def _padded(self, where: list[int]) -> np.ndarray:
        """Return rooms with copies of the last among them, as many as there is a program for."""
        size = min(width for width in self._widths if width >= len(where))
        return np.array([*where, *[where[-1]] * (size - len(where))])


def _widths(width: int) -> list[int]:
    """Return the numbers of lanes that programs are compiled for, from the largest down."""
    widths = [width]
    while widths[-1] > _RATIO:
        widths.append(-(-widths[-1] // _RATIO))
    return widths


def _best(widths: Sequence[int], number: int) -> int:
    """Return the width at which least is lost, where half of it may be empty."""
    return next((width for width in widths if width < 2 * number), widths[-1])

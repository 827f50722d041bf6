"""Many cases in a fixed number of lanes: what is done leaves, and what is new takes its place.

Under `jax.vmap` a loop runs until its slowest lane is done, and all lanes are paid for. Here a case
is a procedure, which stops where it waits for loops. Loops of one stop, of whatever cases, advance
by a few steps together, and between two such calls those that are over are exchanged.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxstab.core.procedure import Procedure, Rounds, unfolded

# Returns up to so many new cases, and their inputs along a leading axis; whether it may wait.
Take = Callable[[int, bool], tuple[Sequence[Any], Any]]

# Programs are compiled for so many lanes, each number over the next.
_RATIO = 4
# Cases under way, in units of the lanes: as many as there are stops of a verdict.
_ROOMS = 6


@dataclass
class Tally:
    """What was paid for steps of lanes, and what of it was of use.

    Attributes:
        paid: steps of all lanes that ran together, each for as long as the slowest.
        useful: steps that lanes took.
    """

    paid: int = 0
    useful: int = 0


class Stop(eqx.Module):
    """Where a procedure waits for its loops, or its end.

    Attributes:
        kept: the values kept since the last stop.
        rounds: the loops; None at the end.
        outputs: what the procedure returns at its end.
    """

    kept: list[Any]
    rounds: Rounds | None = None
    outputs: Any = None

    @property
    def answers(self) -> list[Any]:
        """What the procedure was sent up to here, since the last stop."""
        assert self.rounds is not None
        return [*self.kept, self.rounds.found]

    @property
    def has_steps(self) -> tuple[Any, Any]:
        """Which lanes have steps to take, and whether any takes part in the round."""
        if self.rounds is None:
            return jnp.zeros(1, bool), jnp.array(False)
        has_steps = jax.vmap(self.rounds.has_steps)(self.rounds.loops, self.rounds.is_on)
        return has_steps, jnp.any(self.rounds.is_on)


def next_stop(procedure: Procedure[Any], stops: Sequence[Stop]) -> Stop:
    """Return where a procedure waits next, taken anew through the stops that it had."""
    answers = [answer for stop in stops for answer in stop.answers]
    kept, found = [], None
    while True:
        try:
            request = procedure.send(found)
        except StopIteration as end:
            return Stop(kept, outputs=end.value)
        if answers:
            found = answers.pop(0)
        elif isinstance(request, Rounds):
            return Stop(kept, request)
        else:
            found = request.value
            kept.append(found)


class Programs:
    """The compiled programs of cases.

    Arguments:
        procedure: returns the procedure of a case, given its inputs.
    """

    def __init__(self, procedure: Callable[[Any], Procedure[Any]]):
        self._procedure = procedure
        self.taken, self.put = jax.jit(_taken), jax.jit(_put, donate_argnums=0)
        self.go_on, self.turn = jax.jit(self._go_on), jax.jit(_turned)
        self.advance = jax.jit(_advanced, donate_argnums=0)

    def _go_on(self, inputs: Any, stops: Sequence[Stop], where: Array) -> tuple[Stop, Any]:
        """Return the next stops of cases, and which of their lanes have steps."""

        def one(inputs: Any, stops: Sequence[Stop]) -> tuple[Stop, Any]:
            stop = next_stop(unfolded(self._procedure(inputs)), stops)
            return stop, stop.has_steps

        return jax.vmap(one)(*_taken((inputs, stops), where))


def _turned(stop: Stop, where: Array) -> tuple[Stop, Any]:
    """Return stops in their next round, and which of their lanes have steps."""

    def one(stop: Stop) -> tuple[Stop, Any]:
        assert stop.rounds is not None
        stop = replace(stop, rounds=stop.rounds.turned())
        return stop, stop.has_steps

    return jax.vmap(one)(_taken(stop, where))


def _advanced(stop: Stop, where: tuple[Array, Array]) -> tuple[Stop, Array, Array]:
    """Return stops with some lanes advanced, whether these have steps left, and those taken."""
    assert stop.rounds is not None
    rounds, before = replace(stop.rounds, loops=None, is_on=None), stop.rounds.loops

    def one(rounds: Rounds, loop: Any, is_on: Array) -> tuple[Any, Array]:
        loop = rounds.advanced(loop, is_on)
        return loop, rounds.has_steps(loop, is_on)

    lanes = _taken((before, stop.rounds.is_on), where)
    loops, has_steps = jax.vmap(one)(_taken(rounds, where[0]), *lanes)
    stop = replace(stop, rounds=replace(stop.rounds, loops=_put(before, loops, where)))
    return stop, has_steps, loops.num_steps - lanes[0].num_steps


@dataclass
class _Case:
    """A case that is under way.

    Attributes:
        name: what it is known by.
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
        tally: what was paid so far.
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
        self.tally = Tally()

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
        self.tally.paid += width * int(steps.max())
        useful = int(steps[: len(chosen)].sum())
        self.tally.useful += useful
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


def _taken(arrays: Any, where: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[where], arrays)


def _put(arrays: Any, values: Any, where: Any) -> Any:
    return jax.tree.map(lambda leaf, new: leaf.at[where].set(new), arrays, values)


def _widths(width: int) -> list[int]:
    """Return the numbers of lanes that programs are compiled for, from the largest down."""
    widths = [width]
    while widths[-1] > _RATIO:
        widths.append(-(-widths[-1] // _RATIO))
    return widths


def _best(widths: Sequence[int], number: int) -> int:
    """Return the width at which least is lost, where half of it may be empty."""
    return next((width for width in widths if width < 2 * number), widths[-1])

"""Many cases in a fixed number of lanes: what is done leaves, and what is new takes its place.

Under `jax.vmap` a loop runs until its slowest lane is done, and all lanes are paid for. Here a case
is a sequence of stages, loops that can pause: lanes of one stage, of whatever cases, advance by a
bounded number of steps together, and between two such calls those that are done are exchanged.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, ArrayLike

from jaxstab.studies.lanes.stage import Record, Stage

# Returns up to so many new cases, and their inputs along a leading axis; whether it may wait.
Take = Callable[[int, bool], tuple[Sequence[Any], Any]]

# Programs are compiled for so many lanes, each number over the next.
_RATIO = 4


@dataclass
class Tally:
    """What was paid for steps of lanes, and what of it was of use.

    Attributes:
        paid: steps of all lanes that ran together, each for as long as the slowest.
        useful: steps that lanes took.
    """

    paid: int = 0
    useful: int = 0


class Programs:
    """The compiled programs of cases that are a sequence of stages.

    Arguments:
        stages: the stages, in order.
        finish: the outputs of a case, from its record at the end.
    """

    def __init__(self, stages: Sequence[Stage], finish: Callable[[Record], Any]):
        self.stages = stages
        self.taken, self.put = jax.jit(_taken), jax.jit(_put, donate_argnums=0)
        self.begin, self.turn = jax.jit(self._begin), jax.jit(self._turn)
        self.advance = jax.jit(self._advance, donate_argnums=1)
        self.finish = jax.jit(lambda rooms, where: jax.vmap(finish)(_taken(rooms, where)))

    def _begin(self, rooms: Record, where: Array) -> tuple[Any, Array]:
        """Return the states of the stage after those given, and whether lanes are over."""
        stage, record = self.stages[len(rooms) - 1], _taken(rooms, where)
        states = jax.vmap(stage.begin)(record)
        return states, jax.vmap(jax.vmap(stage.is_over, (None, 0)))(record, states)

    def _turn(self, rooms: Record, states: Any, where: Array) -> tuple[Any, Array]:
        """Return states of a stage in their next round, and whether lanes are over."""
        stage, record = self.stages[len(rooms) - 1], _taken(rooms, where)
        states = jax.vmap(stage.turn)(record, _taken(states, where))
        return states, jax.vmap(jax.vmap(stage.is_over, (None, 0)))(record, states)

    def _advance(
        self, rooms: Record, states: Any, where: tuple[Array, Array], max_steps: ArrayLike
    ) -> tuple[Any, Array, Array]:
        """Return all states with some advanced, whether these are over, and their steps."""
        stage, record = self.stages[len(rooms) - 1], _taken(rooms, where[0])
        before = _taken(states, where)
        after = jax.vmap(stage.advance, (0, 0, None))(record, before, max_steps)
        steps = jax.vmap(stage.num_steps)(after) - jax.vmap(stage.num_steps)(before)
        return _put(states, after, where), jax.vmap(stage.is_over)(record, after), steps


@dataclass
class _Case:
    """A case that is under way.

    Attributes:
        name: what it is known by.
        stage: the number of the stage that it is in.
        is_open: which of the lanes of that stage have steps to take.
        seconds: its share of the time.
    """

    name: Any
    stage: int = -1
    is_open: np.ndarray = field(default_factory=lambda: np.zeros(1, bool))
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
        # The inputs of all rooms, and their states in each stage.
        self._arrays: list[Any] = [None] * (1 + len(programs.stages))
        # So many that there are always lanes enough in one of the stages.
        self._free = list(range(width * len(programs.stages)))[::-1]
        self._num_rooms = len(self._free)
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
        self._store(0, jax.tree.map(lambda leaf: leaf[last], inputs), where)
        return True

    def _settle(self) -> Iterator[tuple[Any, Any, float]]:
        """Let cases whose lanes are over go on to the next stage, or leave."""
        stages = self._programs.stages
        for stage in range(-1, len(stages)):
            if stage >= 0 and stages[stage].has_rounds:
                for where in self._over(stage):
                    self._open(stage, where, self._programs.turn, self._arrays[stage + 1])
            for where in self._over(stage):
                if stage + 1 < len(stages):
                    self._open(stage + 1, where, self._programs.begin)
                else:
                    yield from self._leave(where)

    def _over(self, stage: int) -> list[list[int]]:
        """Return the rooms of a stage without open lanes, as many together as there are lanes."""
        cases, width = self._cases.items(), self._widths[0]
        over = [room for room, case in cases if case.stage == stage and not case.is_open.any()]
        return [over[i : i + width] for i in range(0, len(over), width)]

    def _open(self, stage: int, where: list[int], program: Any, *states: Any) -> None:
        """Let lanes of a stage begin, by one of the programs that say so."""
        start = perf_counter()
        states, is_over = program(self._record(stage), *states, self._padded(where))
        self._store(stage + 1, states, where)
        is_over = np.asarray(is_over)
        for room, over in zip(where, is_over[: len(where)], strict=True):
            case = self._cases[room]
            case.stage, case.is_open = stage, ~over
            case.seconds += (perf_counter() - start) / len(where)

    def _leave(self, where: list[int]) -> Iterator[tuple[Any, Any, float]]:
        start = perf_counter()
        outputs = self._programs.finish(tuple(self._arrays), self._padded(where))
        outputs = jax.device_get(outputs)
        seconds = (perf_counter() - start) / len(where)
        for i, room in enumerate(where):
            case = self._cases.pop(room)
            self._free.append(room)
            yield (
                case.name,
                jax.tree.map(lambda leaf, i=i: leaf[i], outputs),
                case.seconds + seconds,
            )

    def _advance(self) -> None:
        """Advance lanes of the stage that has most of them open."""
        lanes: dict[int, list[tuple[int, int]]] = {}
        for room, case in self._cases.items():
            open_ = [(room, int(lane)) for lane in np.flatnonzero(case.is_open)]
            lanes.setdefault(case.stage, []).extend(open_)
        if not any(lanes.values()):
            return
        stage = max(lanes, key=lambda stage: len(lanes[stage]))
        start = perf_counter()
        width = _best(self._widths, len(lanes[stage]))
        chosen, pace = lanes[stage][:width], self._programs.stages[stage].pace
        places = np.array([*chosen, *[chosen[-1]] * (width - len(chosen))]).T
        self._arrays[stage + 1], is_over, steps = self._programs.advance(
            self._record(stage), self._arrays[stage + 1], tuple(places), pace
        )
        is_over, steps = jax.device_get((is_over, steps))
        self.tally.paid += width * int(steps.max())
        useful = int(steps[: len(chosen)].sum())
        self.tally.useful += useful
        seconds = (perf_counter() - start) / max(useful, 1)
        for (room, lane), over, taken in zip(chosen, is_over, steps, strict=False):
            case = self._cases[room]
            case.is_open[lane] = not over
            case.seconds += seconds * int(taken)

    def _record(self, stage: int) -> Record:
        return tuple(self._arrays[: stage + 1])

    def _store(self, number: int, values: Any, where: list[int]) -> None:
        """Store values, padded with copies of the last, in rooms."""
        if self._arrays[number] is None:
            self._arrays[number] = self._programs.taken(values, np.zeros(self._num_rooms, int))
        self._arrays[number] = self._programs.put(self._arrays[number], values, self._padded(where))

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

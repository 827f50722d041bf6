"""Procedures: computations that hand over their loops, so that others can pause and mix these.

A procedure is a generator. It yields `Rounds`, loops of a solver, and is sent their results. It
yields a `Part` for a procedure of its own, which may not be needed, and `Kept` for values that are
not to be computed twice. `run` takes one from beginning to end. Lanes run many side by side.
"""

from abc import abstractmethod
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike

from jaxstab.core.batching import advance_lanes
from jaxstab.core.compile import program
from jaxstab.core.conditional import if_needed
from jaxstab.core.loop import NO_LIMIT, Iteration, IterativeSolver, Loop
from jaxstab.core.types import Flag

Out = TypeVar("Out")
Procedure = Generator[Any, Any, Out]


class Rounds(eqx.Module):
    """Loops of one solver side by side: once all are over, another round may begin.

    Attributes:
        loops: along a leading axis, once they have begun.
        is_on: which of them take part in the round; at the end none do.
    """

    loops: Any = eqx.field(default=None, kw_only=True)
    is_on: Any = eqx.field(default=None, kw_only=True)

    @property
    @abstractmethod
    def search(self) -> tuple[IterativeSolver, Any]:
        """The solver of this round, and its problem, prepared."""

    @property
    @abstractmethod
    def found(self) -> Any:
        """The results of the rounds, at the end."""

    def begun(self) -> "Rounds":
        """Return the first round, its loops before their first step."""
        return self

    def turned(self) -> "Rounds":
        """Return the next round, once all loops are over; if there is only one, the end."""
        return replace(self, is_on=jnp.zeros_like(self.is_on))

    @property
    def length(self) -> ArrayLike:
        """The most steps that a loop takes in this round."""
        return NO_LIMIT

    def advanced(self, loop: Loop, is_on: Flag) -> Loop:
        """Return a loop after a few steps more of this round, as many as the solver's pace says."""
        solver, problem = self.search
        left = jnp.minimum(solver.pace, self.length - loop.num_steps)
        return solver.advance(problem, loop, jnp.where(is_on, left, 0))

    def has_steps(self, loop: Loop, is_on: Flag) -> Flag:
        """Return whether a loop has steps to take in this round."""
        return is_on & (loop.num_steps < self.length) & ~self.search[0].is_over(loop)

    def run(self) -> Any:
        """Return the results of the rounds."""

        def round_after(rounds: Rounds) -> Rounds:
            solver, problem = rounds.search
            limits = jnp.where(rounds.is_on, rounds.length, 0)
            advance = partial(solver.advance, problem)
            return replace(rounds, loops=advance_lanes(advance, rounds.loops, limits)).turned()

        first = self.begun()
        return jax.lax.while_loop(lambda rounds: jnp.any(rounds.is_on), round_after, first).found


class Solve(Rounds):
    """One loop, from a start to its end.

    Attributes:
        solver: the solver.
        given: the data of the problem.
        start: where to start.
        make: makes the problem.
    """

    solver: IterativeSolver
    given: Any
    start: Any
    make: Callable[[Any], Any] = eqx.field(static=True, default=lambda given: given)

    @property
    def search(self) -> tuple[IterativeSolver, Any]:
        """The solver, and its problem, prepared."""
        return self.solver, self.solver.prepared(self.make(self.given), self.start)

    @property
    def found(self) -> Iteration[Any]:
        """The state of the loop."""
        return self.solver.outcome(jax.tree.map(lambda leaf: leaf[0], self.loops))

    def begun(self) -> "Solve":
        """Return the loop before its first step."""
        solver, problem = self.search
        loop = solver.begin(problem, self.start)
        loops = jax.tree.map(lambda leaf: leaf[None], loop)
        return replace(self, loops=loops, is_on=jnp.ones(1, bool))

    def run(self) -> Iteration[Any]:
        """Return the final state of the loop."""
        return self.solver.run(self.make(self.given), self.start)


@dataclass(frozen=True)
class Part:
    """A procedure within another, which may not be needed.

    Alone it is a program of its own, that is not compiled where it is not needed.

    Attributes:
        procedure: the function that returns it.
        arguments: its arguments.
        is_needed: whether it is.
        otherwise: what stands for its outcome where it is not.
    """

    procedure: Callable[..., Procedure[Any]]
    arguments: tuple[Any, ...]
    is_needed: Any = True
    otherwise: Any = None

    def run(self) -> Any:
        """Return the outcome."""
        return if_needed(
            self.is_needed, lambda: _run_part(self.procedure, *self.arguments), self.otherwise
        )


@dataclass(frozen=True)
class Kept:
    """A value that is not computed again for later parts."""

    value: Any

    def run(self) -> Any:
        """Return the value."""
        return self.value


def run(procedure: Procedure[Out]) -> Out:
    """Return the outcome of a procedure, taken from beginning to end."""
    found = None
    while True:
        try:
            request = procedure.send(found)
        except StopIteration as end:
            return end.value
        found = request.run()


def unfolded(procedure: Procedure[Out], is_needed: Any = True) -> Procedure[Out]:
    """Return a procedure without parts, since these are its own; its rounds have begun.

    Where it is not needed, they are over.
    """
    found = None
    while True:
        try:
            request = procedure.send(found)
        except StopIteration as end:
            return end.value
        if isinstance(request, Part):
            part = request.procedure(*request.arguments)
            found = yield from unfolded(part, is_needed & request.is_needed)
            if request.is_needed is not True:
                choose = partial(jnp.where, request.is_needed)
                found = jax.tree.map(choose, found, request.otherwise)
        elif isinstance(request, Rounds):
            begun = request.begun()
            found = yield replace(begun, is_on=begun.is_on & is_needed)
        else:
            found = yield request


@partial(program, static_argnums=0)
def _run_part(procedure: Callable[..., Procedure[Out]], *arguments: Any) -> Out:
    return run(procedure(*arguments))

"""The forward loop of every solver: it steps, measures, stops, and keeps a history."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.core.checks import array, known, parameter, require, require_positive
from jaxstab.core.history import History, Indicators
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Flag, Scalar

State = TypeVar("State")
Solver = TypeVar("Solver")

_STALL_FACTOR = 0.99
# What counts as progress: of the fall of the energy so far, and in units of the precision.
_LEAST_FALL = 1e-9
_ROUNDING = 10
NO_LIMIT = 2**31 - 1


def optional_parameter(value: ArrayLike | None) -> Scalar | None:
    """Return `value` as a floating-point array, None as None."""
    return None if value is None else parameter(value)


def integer_parameter(value: ArrayLike) -> Int[Array, ""]:
    """Return `value` as an array, without compiling anything."""
    return value if isinstance(value, jax.Array) else array(value)


def solver_or_default(solver: Any, kind: type, default: type[Solver]) -> Solver:
    """Return the solver that was given, or one of the default's class where there is none."""
    if solver is None:
        return default()
    if isinstance(solver, kind):
        return solver
    is_class = isinstance(solver, type)
    given = f"the class {solver.__name__}" if is_class else f"of type {type(solver).__name__}"
    raise TypeError(
        f"The solver is {given}: give an instance of {kind.__name__}, such as {default.__name__}()."
    )


class Iteration(eqx.Module, Generic[State]):
    """The state of a loop."""

    state: State
    residual: Scalar
    num_steps: Int[Array, ""]
    result: RESULTS
    history: History


class Loop(eqx.Module, Generic[State]):
    """A loop that is under way, from which it can go on.

    Attributes:
        state: where it is.
        residual: the residual there.
        num_steps: the steps taken since it began or was resumed.
        num_before: those taken before.
        first: the indicators where it began.
        best: the least that each indicator was at a step that made progress.
        best_step: that step.
        history: the indicators on record.
    """

    state: State
    residual: Scalar
    num_steps: Int[Array, ""]
    num_before: Int[Array, ""]
    first: Indicators
    best: Indicators
    best_step: Int[Array, ""]
    history: History


class IterativeSolver(eqx.Module):
    """An algorithm that repeats a step until its residual falls to a tolerance.

    A subclass defines the start (`init`), a step (`step`) and the distance from the answer
    (`measure`); the loop is here. The loop also ends at the step limit, at a residual that is not
    finite, and when it has stagnated.

    Attributes:
        tolerance: the residual to reach; None stands for `default_tolerance`.
        max_steps: the step limit.
        default_tolerance: the residual that each precision can reach; not needed where the
            tolerance is never None.
        patience: the loop has stagnated when it has made no progress for this many steps and as
            many as it took to the last. Progress is a lower residual, or a lower "energy" where the
            solver measures one.
        steps_per_check: steps between two looks at the residual; limits are rounded up to them.

    Raises:
        ValueError: if tolerance or step limit is not positive.
    """

    tolerance: eqx.AbstractVar[Scalar | None]
    max_steps: eqx.AbstractVar[Int[Array, ""]]

    default_tolerance: ClassVar[Mapping[str, float]]
    patience: ClassVar[int] = 300
    steps_per_check: ClassVar[int] = 1

    def __check_init__(self) -> None:
        if self.tolerance is not None:
            require_positive("The tolerance", self.tolerance)
        require("max_steps", self.max_steps, known(self.max_steps) > 0, "it must be positive.")

    def prepared(self, problem: Any, start: Any) -> Any:
        """Return a problem with all that is the same at every step from a start."""
        return problem

    def init(self, problem: Any, start: Any) -> Any:
        """Return the state before the first step; the start itself where nothing else is said."""
        return start

    @abstractmethod
    def step(self, problem: Any, state: Any) -> Any:
        """Return the state after a step."""

    @abstractmethod
    def measure(self, problem: Any, state: Any) -> Indicators:
        """Return the indicators of a state, of which "residual" decides."""

    def tolerance_in(self, dtype: jnp.dtype) -> Scalar | float:
        """Return the residual to reach in a precision."""
        if self.tolerance is not None:
            return self.tolerance
        return self.default_tolerance.get(dtype.name, max(self.default_tolerance.values()))

    def run(self, problem: Any, start: Any, max_steps: ArrayLike = NO_LIMIT) -> Iteration[Any]:
        """Go from a start until the tolerance is reached, or say why it is not.

        Arguments:
            problem: what `step` and `measure` are given, once it is `prepared`.
            start: what `init` is given.
            max_steps: the number of steps after which to stop: none where nothing is sought.
        """
        problem = self.prepared(problem, start)
        return self.outcome(self.advance(problem, self.begin(problem, start), max_steps))

    def begin(self, problem: Any, start: Any) -> Loop[Any]:
        """Return the loop from a start before its first step; the problem is prepared."""
        state, zero = self.init(problem, start), jnp.zeros((), int)
        first = self.measure(problem, state)
        history = History.empty(first, first["residual"].dtype).record(zero, zero, first)
        return Loop(state, first["residual"], zero, zero, first, first, zero, history)

    def resumed(self, before: Iteration[State]) -> Loop[State]:
        """Return a loop that goes on from an iteration, from which progress counts anew.

        Its steps and history count too. It is for solvers that measure the residual alone.
        """
        zero, residual = jnp.zeros_like(before.num_steps), before.residual
        first = {"residual": residual}
        return Loop(
            before.state, residual, zero, before.num_steps, first, first, zero, before.history
        )

    def advance(
        self, problem: Any, loop: Loop[State], max_steps: ArrayLike = NO_LIMIT
    ) -> Loop[State]:
        """Return a loop after at most `max_steps` steps more; pauses change nothing."""
        limit = jnp.minimum(max_steps, NO_LIMIT - loop.num_steps) + loop.num_steps
        step = partial(self.step, problem)

        def further(loop: Loop[State]) -> Loop[State]:
            state = loop.state
            if self.steps_per_check == 1:
                state = step(state)
            else:
                state = jax.lax.fori_loop(0, self.steps_per_check, lambda _, s: step(s), state)
            num_steps = loop.num_steps + self.steps_per_check
            indicators = self.measure(problem, state)
            improved = _is_progress(loop, indicators)
            steps = loop.num_before + num_steps
            return replace(
                loop,
                state=state,
                residual=indicators["residual"],
                num_steps=num_steps,
                best={
                    name: jnp.where(improved, jnp.minimum(best, indicators[name]), best)
                    for name, best in loop.best.items()
                },
                best_step=jnp.where(improved, num_steps, loop.best_step),
                history=loop.history.record(steps // self.steps_per_check, steps, indicators),
            )

        # By default accelerators multiply float32 matrices to three digits.
        with jax.default_matmul_precision("highest"):
            return jax.lax.while_loop(
                lambda loop: ~self.is_over(loop) & (loop.num_steps < limit), further, loop
            )

    def is_over(self, loop: Loop[Any]) -> Flag:
        """Return whether a loop has come to its end."""
        unfinished = (loop.residual > self._goal(loop)) & jnp.isfinite(loop.residual)
        has_steps = loop.num_steps < self.max_steps - loop.num_before
        return ~(unfinished & has_steps & ~self._is_stalled(loop))

    def outcome(self, loop: Loop[State]) -> Iteration[State]:
        """Return the state of a loop, at its end or at a pause."""
        stalled = self._is_stalled(loop)
        result = RESULTS.where(stalled, RESULTS.stagnated, RESULTS.max_steps_reached)
        result = RESULTS.where(loop.residual <= self._goal(loop), RESULTS.successful, result)
        result = RESULTS.where(jnp.isfinite(loop.residual), result, RESULTS.nonfinite)
        num_steps = loop.num_before + loop.num_steps
        return Iteration(loop.state, loop.residual, num_steps, result, loop.history)

    def _goal(self, loop: Loop[Any]) -> Scalar | float:
        return self.tolerance_in(loop.residual.dtype)

    def _is_stalled(self, loop: Loop[Any]) -> Flag:
        return loop.num_steps > self.patience + 2 * loop.best_step


def _is_progress(loop: Loop[Any], new: Indicators) -> Flag:
    first, best = loop.first, loop.best
    progress = new["residual"] < _STALL_FACTOR * best["residual"]
    if "energy" in new:
        fall = first["energy"] - best["energy"]
        rounding = _ROUNDING * float(jnp.finfo(fall.dtype).eps)
        least = jnp.maximum(max(_LEAST_FALL, rounding) * fall, rounding * jnp.abs(best["energy"]))
        progress |= best["energy"] - new["energy"] > least
    return progress

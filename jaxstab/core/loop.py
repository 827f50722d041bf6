"""The forward loop of every solver: it steps, measures, stops, and keeps a history."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import ClassVar, Generic, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, PyTree

from jaxstab.core.accuracy import rounding_of_numbers
from jaxstab.core.checks import array, cast, concrete, parameter, require, require_positive
from jaxstab.core.history import History, Indicators
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Flag, Scalar

State = TypeVar("State")
Solver = TypeVar("Solver")

_STALL_FACTOR = 0.99
# The least fall of the energy that is progress, over its fall so far.
_LEAST_FALL = 1e-9
NO_LIMIT = int(np.iinfo(np.int32).max)


def optional_parameter(value: ArrayLike | None) -> Scalar | None:
    """Return `value` as a floating-point array, None as None."""
    if value is None:
        return None
    return parameter(value)


def solver_or_default(
    solver: Solver | None, kind: type[Solver], default: Callable[[], Solver]
) -> Solver:
    """Return the given solver, or an instance of the default class for None.

    Raises:
        TypeError: for anything but a solver of this kind, and for a class.
    """
    if solver is None:
        return default()
    if not isinstance(solver, kind):
        given = getattr(solver, "__name__", type(solver).__name__)
        instance = f"an instance of {kind.__name__}, as {default.__name__}()"
        raise TypeError(f"The solver is {given}: give {instance}.")
    return solver


class Iteration(eqx.Module, Generic[State]):
    """The state of a loop."""

    state: State
    residual: Scalar
    num_steps: Int[Array, ""]
    result: RESULTS
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
        require("max_steps", self.max_steps, concrete(self.max_steps) > 0, "it must be positive.")

    def prepared(self, problem: PyTree, start: PyTree) -> PyTree:
        """Return the problem with precomputed quantities that are the same at every step."""
        return problem

    def init(self, problem: PyTree, start: PyTree) -> PyTree:
        """Return the state before the first step, by default the start itself."""
        return start

    @abstractmethod
    def step(self, problem: PyTree, state: PyTree) -> PyTree:
        """Return the state after a step."""

    @abstractmethod
    def measure(self, problem: PyTree, state: PyTree) -> Indicators:
        """Return the indicators of a state, "residual" among them, which the tolerance bounds."""

    def tolerance_in(self, dtype: jnp.dtype) -> Scalar | float:
        """Return the residual to reach in a precision."""
        if self.tolerance is not None:
            return self.tolerance
        return self.default_tolerance.get(dtype.name, max(self.default_tolerance.values()))

    def in_precision(self, dtype: jnp.dtype) -> Self:
        """Return the solver with all its numbers in a precision, so that calls share programs."""
        if self.tolerance is not None:
            return cast(self, dtype)
        tolerance = array(self.tolerance_in(dtype), dtype)
        solver = eqx.tree_at(lambda s: s.tolerance, self, tolerance, is_leaf=lambda x: x is None)
        return cast(solver, dtype)

    def run(self, problem: PyTree, start: PyTree) -> Iteration[PyTree]:
        """Iterate from a start until the tolerance is reached, or report why it is not.

        Arguments:
            problem: the argument of `step` and `measure`, before it is `prepared`.
            start: the argument of `init`.
        """
        problem = self.prepared(problem, start)
        state = self.init(problem, start)
        zero = jnp.zeros((), int)
        first = self.measure(problem, state)
        history = History.empty(first, first["residual"].dtype).record(zero, zero, first)
        begin = Iteration(state, first["residual"], zero, RESULTS.max_steps_reached, history)
        return self._iterate(problem, begin, first, NO_LIMIT)

    def resume(
        self, problem: PyTree, before: Iteration[State], max_steps: ArrayLike
    ) -> Iteration[State]:
        """Continue an iteration by at most `max_steps`; stagnation counts from here.

        For solvers that measure the residual alone, with a prepared problem.
        """
        return self._iterate(problem, before, {"residual": before.residual}, max_steps)

    def _iterate(
        self, problem: PyTree, before: Iteration[State], first: Indicators, max_steps: ArrayLike
    ) -> Iteration[State]:
        begin = before.num_steps
        tolerance = self.tolerance_in(before.residual.dtype)
        limit = jnp.minimum(begin + jnp.minimum(max_steps, NO_LIMIT - begin), self.max_steps)

        def conclude(iteration: Iteration[State], best_step: Int[Array, ""]) -> Iteration[State]:
            is_stalled = iteration.num_steps - begin > self.patience + 2 * (best_step - begin)
            result = RESULTS.where(is_stalled, RESULTS.stagnated, RESULTS.max_steps_reached)
            result = RESULTS.where(iteration.residual <= tolerance, RESULTS.successful, result)
            result = RESULTS.where(jnp.isfinite(iteration.residual), result, RESULTS.nonfinite)
            return replace(iteration, result=result)

        def goes_on(carry: tuple[Iteration[State], Indicators, Int[Array, ""]]) -> Flag:
            iteration, *_ = carry
            is_unfinished = iteration.result == RESULTS.max_steps_reached
            return is_unfinished & (iteration.num_steps < limit)

        def further(carry: tuple[Iteration[State], Indicators, Int[Array, ""]]) -> tuple:
            old, best, best_step = carry
            state = old.state
            if self.steps_per_check == 1:
                state = self.step(problem, state)
            else:
                state = jax.lax.fori_loop(
                    0, self.steps_per_check, lambda _, s: self.step(problem, s), state
                )
            steps = old.num_steps + self.steps_per_check
            new = self.measure(problem, state)
            history = old.history.record(steps // self.steps_per_check, steps, new)
            is_better = _is_progress(first, best, new)
            best = {
                name: jnp.where(is_better, jnp.minimum(least, new[name]), least)
                for name, least in best.items()
            }
            best_step = jnp.where(is_better, steps, best_step)
            iteration = Iteration(state, new["residual"], steps, old.result, history)
            return conclude(iteration, best_step), best, best_step

        start = conclude(before, begin), first, begin
        return jax.lax.while_loop(goes_on, further, start)[0]


def _is_progress(first: Indicators, best: Indicators, new: Indicators) -> Flag:
    progress = new["residual"] < _STALL_FACTOR * best["residual"]
    if "energy" in new:
        fall = first["energy"] - best["energy"]
        rounding = rounding_of_numbers(fall.dtype)
        least = jnp.maximum(max(_LEAST_FALL, rounding) * fall, rounding * jnp.abs(best["energy"]))
        progress |= best["energy"] - new["energy"] > least
    return progress

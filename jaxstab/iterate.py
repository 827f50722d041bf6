"""The forward loop of every solver: it steps, measures, stops, and keeps a bounded history."""

from collections.abc import Callable, Mapping
from typing import ClassVar, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxstab.checks import parameter, require, require_positive
from jaxstab.results import RESULTS

State = TypeVar("State")
Indicators = dict[str, Float[Array, ""]]

_STALL_FACTOR = 0.99
_LEAST_FALL = 1e-6
_HISTORY_LENGTH = 512


def optional_parameter(value: ArrayLike | None) -> Float[Array, ""] | None:
    """Return `value` as a floating-point array, None as None."""
    return None if value is None else parameter(value)


class History(eqx.Module):
    """Indicators of a solver at a bounded number of its steps, evenly thinned; NaN where unused."""

    steps: Float[Array, " records"]
    values: dict[str, Float[Array, " records"]]
    stride: Int[Array, ""]

    @classmethod
    def empty(cls, indicators: Indicators) -> "History":
        """Return a history without records for these indicators."""
        blank = {
            name: jnp.full(_HISTORY_LENGTH, jnp.nan, x.dtype) for name, x in indicators.items()
        }
        return cls(jnp.full(_HISTORY_LENGTH, jnp.nan), blank, jnp.array(1))

    def record(self, count: Int[Array, ""], step: Int[Array, ""], new: Indicators) -> "History":
        """Return the history with the `count`-th measurement, taken at `step`, added."""
        full = count // self.stride == _HISTORY_LENGTH
        stride = jnp.where(full, 2 * self.stride, self.stride)
        slot = count // stride

        def put(old: Float[Array, " records"], value: Array) -> Float[Array, " records"]:
            halved = jnp.full_like(old, jnp.nan).at[: _HISTORY_LENGTH // 2].set(old[::2])
            kept = jnp.where(full, halved, old)
            return kept.at[slot].set(jnp.where(count % stride == 0, value, kept[slot]))

        values = {name: put(self.values[name], value) for name, value in new.items()}
        return History(put(self.steps, step), values, stride)


class Iteration(eqx.Module, Generic[State]):
    """The outcome of `iterate`."""

    state: State
    residual: Float[Array, ""]
    num_steps: Int[Array, ""]
    result: RESULTS
    history: History


class _Loop(eqx.Module, Generic[State]):
    state: State
    residual: Float[Array, ""]
    num_steps: Int[Array, ""]
    best: Indicators
    best_step: Int[Array, ""]
    history: History


class IterativeSolver(eqx.Module):
    """An algorithm that repeats a step until its residual falls to a tolerance.

    Attributes:
        tolerance: the residual to reach; None stands for `default_tolerance`.
        max_steps: the step limit.
        default_tolerance: the residual that each precision can reach.
        patience: the loop has stagnated when its last progress is older than this many steps and
            than half of all steps. Progress is a lower residual, or a lower "energy" where the
            solver measures one.
        steps_per_check: steps between two looks at the residual.

    Raises:
        ValueError: if tolerance or step limit is not positive.
    """

    tolerance: eqx.AbstractVar[Float[Array, ""] | None]
    max_steps: eqx.AbstractVar[Int[Array, ""]]

    default_tolerance: ClassVar[Mapping[str, float]]
    patience: ClassVar[int]
    steps_per_check: ClassVar[int] = 1

    def __check_init__(self) -> None:
        if self.tolerance is not None:
            require_positive("The tolerance", self.tolerance)
        require("max_steps", self.max_steps, self.max_steps > 0, "it must be positive.")

    def tolerance_in(self, dtype: jnp.dtype) -> Float[Array, ""] | float:
        """Return the residual to reach in a precision."""
        default = self.default_tolerance.get(dtype.name, max(self.default_tolerance.values()))
        return default if self.tolerance is None else self.tolerance

    def iterate(
        self,
        step: Callable[[State], State],
        measure: Callable[[State], Indicators],
        state: State,
        before: Iteration[State] | None = None,
    ) -> Iteration[State]:
        """Repeat `step` from `state` until the tolerance is reached, or say why it is not.

        The loop also ends at the step limit, at a residual that is not finite, and when it has
        stagnated.

        Arguments:
            step: one step of the algorithm.
            measure: its indicators, of which "residual" decides, every `steps_per_check` steps.
            state: where to start.
            before: an iteration that this one goes on from: its steps and history count too.
        """
        first = measure(state)
        zero = jnp.array(0)
        num_before = zero if before is None else before.num_steps
        history = History.empty(first) if before is None else before.history

        def record(history: History, num_steps: Int[Array, ""], new: Indicators) -> History:
            steps = num_before + num_steps
            return history.record(steps // self.steps_per_check, steps, new)

        tolerance = self.tolerance_in(first["residual"].dtype)

        def is_progress(best: Indicators, new: Indicators) -> Bool[Array, ""]:
            progress = new["residual"] < _STALL_FACTOR * best["residual"]
            if "energy" in new:
                fall = first["energy"] - best["energy"]
                progress |= best["energy"] - new["energy"] > _LEAST_FALL * fall
            return progress

        def is_stalled(loop: _Loop[State]) -> Bool[Array, ""]:
            return loop.num_steps > self.patience + 2 * loop.best_step

        def goes_on(loop: _Loop[State]) -> Bool[Array, ""]:
            unfinished = (loop.residual > tolerance) & jnp.isfinite(loop.residual)
            return unfinished & (loop.num_steps < self.max_steps) & ~is_stalled(loop)

        def advance(loop: _Loop[State]) -> _Loop[State]:
            state = jax.lax.fori_loop(0, self.steps_per_check, lambda _, s: step(s), loop.state)
            num_steps = loop.num_steps + self.steps_per_check
            indicators = measure(state)
            improved = is_progress(loop.best, indicators)
            return _Loop(
                state,
                indicators["residual"],
                num_steps,
                {
                    name: jnp.where(improved, jnp.minimum(best, indicators[name]), best)
                    for name, best in loop.best.items()
                },
                jnp.where(improved, num_steps, loop.best_step),
                record(loop.history, num_steps, indicators),
            )

        history = record(history, zero, first)
        loop = _Loop(state, first["residual"], zero, first, zero, history)
        loop = jax.lax.while_loop(goes_on, advance, loop)

        result = RESULTS.where(is_stalled(loop), RESULTS.stagnated, RESULTS.max_steps_reached)
        result = RESULTS.where(loop.residual <= tolerance, RESULTS.successful, result)
        result = RESULTS.where(jnp.isfinite(loop.residual), result, RESULTS.nonfinite)
        num_steps = num_before + loop.num_steps
        return Iteration(loop.state, loop.residual, num_steps, result, loop.history)


@jax.custom_jvp
def refuse_derivatives(tree: State) -> State:
    """Return `tree`, for a loop whose derivatives would be of its steps, not of its answer."""
    return tree


@refuse_derivatives.defjvp
def _raise(primals: tuple[State], tangents: tuple[State]) -> tuple[State, State]:
    raise NotImplementedError(
        "lowest_modes and calibrate cannot be differentiated: apply jax.lax.stop_gradient to what "
        "goes in, or take the eigenvalues of assess_stability."
    )

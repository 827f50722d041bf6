"""The forward loop of every solver: it steps, measures, stops, and keeps a bounded history."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, ClassVar, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxstab import display
from jaxstab.checks import parameter, require, require_positive
from jaxstab.results import RESULTS
from jaxstab.stacks import Stackable

State = TypeVar("State")
Indicators = dict[str, Float[Array, ""]]

_STALL_FACTOR = 0.99
_LEAST_FALL = 1e-6
_HISTORY_LENGTH = 512
_NO_LIMIT = 2**31 - 1


def optional_parameter(value: ArrayLike | None) -> Float[Array, ""] | None:
    """Return `value` as a floating-point array, None as None."""
    return None if value is None else parameter(value)


class History(Stackable, eqx.Module):
    """Indicators of a solver at a bounded number of its steps: all at first, then ever fewer.

    Attributes:
        table: a row for each record, NaN where unused: the step, and the indicators by name.
        names: of the indicators, in order.
    """

    table: Float[Array, "records columns"]
    names: tuple[str, ...] = eqx.field(static=True)

    __repr__ = display.history

    @property
    def stack_shape(self) -> tuple[int, ...]:
        """The leading axes of a stack of histories."""
        return self.table.shape[:-2]

    @classmethod
    def empty(cls, names: Iterable[str], dtype: Any = float) -> "History":
        """Return a history without records for indicators of these names."""
        names = tuple(sorted(names))
        return cls(jnp.full((_HISTORY_LENGTH, 1 + len(names)), jnp.nan, dtype), names)

    @property
    def steps(self) -> Float[Array, " records"]:
        """The steps that are on record."""
        return self.table[..., 0]

    @property
    def values(self) -> dict[str, Float[Array, " records"]]:
        """The indicators at these steps."""
        return {name: self.table[..., 1 + i] for i, name in enumerate(self.names)}

    def scaled(self, **factors: Float[Array, ""]) -> "History":
        """Return the history with some of its indicators, if they are there, times a factor."""
        dtype = self.table.dtype
        columns = [jnp.asarray(factors.get(name, 1), dtype) for name in ("step", *self.names)]
        return replace(self, table=self.table * jnp.stack(columns))

    def record(self, count: Int[Array, ""], step: Int[Array, ""], new: Indicators) -> "History":
        """Return the history with the `count`-th measurement, taken at `step`, added.

        The first 256 have a row each. Then the rows of each doubling of the count are 32, and each
        keeps the last of those that share it.
        """
        octave = jnp.maximum(23 - jax.lax.clz(count.astype(jnp.int32)), 0)
        shared = 224 + 32 * octave + (count >> (octave + 3))
        row = jnp.minimum(jnp.where(count < 256, count, shared), _HISTORY_LENGTH - 1)
        values = jnp.stack([step, *(new[name] for name in self.names)]).astype(self.table.dtype)
        table = jax.lax.dynamic_update_index_in_dim(self.table, values, row, 0)
        return replace(self, table=table)


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
        default_tolerance: the residual that each precision can reach; not needed where the
            tolerance is never None.
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
    patience: ClassVar[int] = 300
    steps_per_check: ClassVar[int] = 1

    def __check_init__(self) -> None:
        if self.tolerance is not None:
            require_positive("The tolerance", self.tolerance)
        require("max_steps", self.max_steps, self.max_steps > 0, "it must be positive.")

    def tolerance_in(self, dtype: jnp.dtype) -> Float[Array, ""] | float:
        """Return the residual to reach in a precision."""
        if self.tolerance is not None:
            return self.tolerance
        return self.default_tolerance.get(dtype.name, max(self.default_tolerance.values()))

    def iterate(
        self,
        step: Callable[[State], State],
        measure: Callable[[State], Indicators],
        state: State,
    ) -> Iteration[State]:
        """Repeat `step` from `state` until the tolerance is reached, or say why it is not.

        The loop also ends at the step limit, at a residual that is not finite, and when it has
        stagnated.

        Arguments:
            step: one step of the algorithm.
            measure: its indicators, of which "residual" decides, every `steps_per_check` steps.
            state: where to start.
        """
        first = measure(state)
        zero = jnp.zeros((), int)
        history = History.empty(first, first["residual"].dtype).record(zero, zero, first)
        start = Iteration(state, first["residual"], zero, RESULTS.max_steps_reached, history)
        return self.resume(step, measure, start, first)

    def resume(
        self,
        step: Callable[[State], State],
        measure: Callable[[State], Indicators],
        before: Iteration[State],
        first: Indicators,
        max_steps: ArrayLike = _NO_LIMIT,
    ) -> Iteration[State]:
        """Go on from an iteration, by at most `max_steps` steps; its steps and history count too.

        Arguments:
            step, measure: as in `iterate`.
            before: where it stands.
            first: its indicators there.
            max_steps: the number of steps after which to pause.
        """
        tolerance = self.tolerance_in(first["residual"].dtype)
        limit = jnp.minimum(max_steps, self.max_steps - before.num_steps)

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
            return unfinished & (loop.num_steps < limit) & ~is_stalled(loop)

        def advance(loop: _Loop[State]) -> _Loop[State]:
            state = loop.state
            if self.steps_per_check == 1:
                state = step(state)
            else:
                state = jax.lax.fori_loop(0, self.steps_per_check, lambda _, s: step(s), state)
            num_steps = loop.num_steps + self.steps_per_check
            indicators = measure(state)
            improved = is_progress(loop.best, indicators)
            steps = before.num_steps + num_steps
            return _Loop(
                state,
                indicators["residual"],
                num_steps,
                {
                    name: jnp.where(improved, jnp.minimum(best, indicators[name]), best)
                    for name, best in loop.best.items()
                },
                jnp.where(improved, num_steps, loop.best_step),
                loop.history.record(steps // self.steps_per_check, steps, indicators),
            )

        zero = jnp.zeros_like(before.num_steps)
        loop = _Loop(before.state, before.residual, zero, first, zero, before.history)
        loop = jax.lax.while_loop(goes_on, advance, loop)

        result = RESULTS.where(is_stalled(loop), RESULTS.stagnated, RESULTS.max_steps_reached)
        result = RESULTS.where(loop.residual <= tolerance, RESULTS.successful, result)
        result = RESULTS.where(jnp.isfinite(loop.residual), result, RESULTS.nonfinite)
        num_steps = before.num_steps + loop.num_steps
        return Iteration(loop.state, loop.residual, num_steps, result, loop.history)


@jax.custom_jvp
def refuse_derivatives(tree: State) -> State:
    """Return `tree`, for a loop whose derivatives would be of its steps, not of its answer."""
    return tree


@refuse_derivatives.defjvp
def _raise(primals: tuple[State], tangents: tuple[State]) -> tuple[State, State]:
    raise NotImplementedError(
        "lowest_modes, follow and calibrate cannot be differentiated: apply jax.lax.stop_gradient "
        "to what goes in, or take the derivatives of equilibrate, assess_stability or "
        "critical_load."
    )

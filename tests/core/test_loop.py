from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.core.history import History
from jaxstab.core.loop import IterativeSolver


@pytest.mark.parametrize("count", [1, 256, 257, 513, 5000, 100_000])
def test_a_history_stays_bounded_and_keeps_the_beginning_and_the_end(count):
    def body(history, i):
        return history.record(i, 10 * i, {"value": 1.0 * i}), None

    history, _ = jax.lax.scan(body, History.empty(["value"]), jnp.arange(count))
    steps, values = np.asarray(history.steps), np.asarray(history.values["value"])
    used = np.isfinite(steps)
    assert used.sum() >= min(count, 256)
    assert not used[used.sum() :].any()
    np.testing.assert_array_equal(steps[used], 10 * values[used])
    np.testing.assert_array_equal(values[: min(count, 256)], np.arange(min(count, 256)))
    assert values[used][-1] == count - 1
    # Ever fewer, but always more than 15 for each doubling.
    gaps = np.diff(values[used][:-1])
    assert (gaps > 0).all()
    assert (gaps <= np.maximum(values[used][1:-1] / 15, 1)).all()


class Counter(IterativeSolver):
    """Counts up; the problem gives the measure."""

    tolerance: jax.Array | None = None
    max_steps: jax.Array = eqx.field(converter=jnp.asarray, default=1000)

    default_tolerance: ClassVar[dict[str, float]] = {"float64": 1e-3}
    patience: ClassVar[int] = 20

    def step(self, problem, state):
        return state + 1

    def measure(self, problem, state):
        return problem(state)


@pytest.mark.parametrize(("ends_at", "result"), [(500, "successful"), (10, "stagnated")])
def test_a_falling_energy_is_progress_though_the_residual_is_not(ends_at, result):
    def measure(step):
        residual = jnp.where(step < 300, 1.0 + step, 1e-4)
        return {"residual": residual, "energy": 100.0 - jnp.minimum(step, ends_at)}

    iteration = Counter().run(measure, jnp.array(0.0))
    assert iteration.result == getattr(js.RESULTS, result)
    assert iteration.num_steps == (300 if result == "successful" else 41)


@pytest.mark.parametrize(
    ("dtype", "fall", "level", "is_progress"),
    [
        (np.float64, 1e-8, 0.0, True),
        (np.float64, 1e-11, 0.0, False),
        (np.float64, 1e-8, 1e8, False),
        (np.float32, 1e-5, 0.0, True),
        # This is the rounding of terms of the size of the fall.
        (np.float32, 1e-8, 0.0, False),
    ],
)
def test_falls_count_where_they_are_more_than_rounding(dtype, fall, level, is_progress):
    """After a fall from one, the energy goes on falling by a small part of that at each step."""

    def measure(step):
        energy = level + jnp.where(step == 0, 1, -fall * step)
        return {"residual": 1 + step, "energy": energy.astype(dtype)}

    iteration = Counter(max_steps=200).run(measure, jnp.zeros((), dtype))
    assert iteration.result == ("max_steps_reached" if is_progress else "stagnated")


def test_an_iteration_that_is_resumed_ends_like_one_without_pauses():
    def measure(step):
        return {"residual": 0.97**step}

    solver = Counter()
    whole = solver.run(measure, jnp.array(0.0))
    part = Counter(max_steps=7).run(measure, jnp.array(0.0))
    resumed = jax.jit(lambda part: solver.resume(measure, part, 7))
    for count in range(2, 40):
        part = resumed(part)
        assert part.num_steps == min(7 * count, whole.num_steps)
    assert whole.num_steps == 227
    for one, other in zip(jax.tree.leaves(part), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_resumed_iteration_stops_at_the_limits_of_the_whole():
    def measure(step):
        return {"residual": 1.0 + 0.0 * step}

    stalled = Counter().run(measure, jnp.array(0.0))
    assert stalled.result == js.RESULTS.stagnated
    again = Counter().resume(measure, stalled, 1000)
    assert again.num_steps == 2 * stalled.num_steps
    limited = Counter(max_steps=25)
    begun = Counter(max_steps=15).run(measure, jnp.array(0.0))
    assert limited.resume(measure, begun, 1000).num_steps == 25

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.iterate import History
from jaxstab.progress import LaneReport, advance_to, progress_bar


@pytest.mark.parametrize("count", [1, 512, 513, 5000])
def test_a_history_stays_bounded_and_evenly_thinned(count):
    def body(history, i):
        return history.record(i, 10 * i, {"value": 1.0 * i}), None

    history, _ = jax.lax.scan(body, History.empty({"value": jnp.array(0.0)}), jnp.arange(count))
    steps, values = np.asarray(history.steps), np.asarray(history.values["value"])
    used = np.isfinite(steps)
    assert used.sum() > min(count, 256) - 1
    assert not used[used.sum() :].any()
    np.testing.assert_array_equal(steps[used], 10 * values[used])
    stride = 2 ** max(0, int(np.ceil(np.log2(count / 512))))
    np.testing.assert_array_equal(values[used], np.arange(0, count, stride))


def test_a_bar_moves_when_compiled_code_says_so_and_never_back():
    with progress_bar(10, "step") as bar:
        jax.jit(advance_to)(4)
        jax.effects_barrier()
        assert bar.n == 4
        jax.jit(advance_to)(2)
        jax.effects_barrier()
        assert bar.n == 4
    assert bar.n == 10


def test_lanes_under_vmap_are_counted_together():
    with progress_bar(10, "lane") as bar:
        ended = jnp.array([True, False, True, True])

        @jax.jit
        @jax.vmap
        def report(has_ended):
            LaneReport(done_before=5)(has_ended)
            return has_ended

        report(ended)
        jax.effects_barrier()
        assert bar.n == 8


def test_a_lane_reports_while_it_goes_on(hertz):
    seen = []

    def report(has_ended):
        jax.debug.callback(lambda ended: seen.append(bool(ended)), has_ended)

    control = js.MeanDisplacement(1.2).control(hertz.heights)
    gap = control.restore(control.starting_gap(hertz.heights))
    iteration = js.PolonskyKeerRey().solve(hertz, control, gap, report)
    jax.effects_barrier()
    assert seen == [False] * int(iteration.num_steps)

"""Viscoelastic contacts in time: derivatives, batches and single precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from viscoelastic_lines import ANY, cycle, viscoelastic

import jaxstab as js

INSTANTS, VALUES = cycle(9)
# The surface energy, a ratio, its time and the speed.
POINT = jnp.array([0.002, 2.0, 0.1, 1.0])


@jax.jit
def differentiated(parameters, other_ratio, values, rtol, weights):
    """Return a run, derivatives in forward mode, and those of a weighted sum in reverse mode.

    All of them are in one program, as it takes longer to make than to run.
    """

    def numbers(parameters):
        energy, ratio, time, speed = parameters
        ratios, times = jnp.stack([ratio, other_ratio]), jnp.stack([time, jnp.ones(())])
        contact, load = viscoelastic(ratios, times, energy), js.MeanDisplacement(values)
        options = {"rtol": rtol, "max_steps": 128, "fields": True, "throw": False}
        run = js.evolve(contact, load, INSTANTS / speed, **options)
        lost = jnp.sum(run.dissipation)
        return (run.force + run.dissipated, run.reached, lost, run.fields.gap[1, 3]), run

    found, push, run = jax.linearize(numbers, parameters, has_aux=True)
    forward = jax.vmap(push, out_axes=-1)(jnp.eye(4))
    nothing = jax.tree.map(jnp.zeros_like, found[1:])
    (reverse,) = jax.linear_transpose(push, parameters)((weights, *nothing))
    return run, forward, reverse


def test_derivatives_by_law_ratio_time_and_speed_are_those_of_differences():
    def pull(point):
        run, forward, reverse = differentiated(point, 1.0, VALUES, ANY, jnp.eye(9)[6])
        return (run.force + run.dissipated)[6], forward[0][6], reverse

    _, forward, reverse = pull(POINT)
    assert reverse == pytest.approx(np.array(forward), rel=1e-8)
    for i, derivative in enumerate(forward):
        step = 1e-5 * POINT[i] * jnp.eye(4)[i]
        difference = (pull(POINT + step)[0] - pull(POINT - step)[0]) / (2e-5 * POINT[i])
        assert derivative == pytest.approx(float(difference), rel=1e-5)


def test_after_a_failure_there_are_no_derivatives():
    # The surfaces would overlap.
    values = VALUES.at[4:].set(-0.05)
    run, (changes, *_), found = differentiated(POINT, 1.0, values, 0.1, jnp.eye(9)[1])
    assert run.result.name.tolist() == 4 * ["successful"] + 5 * ["infeasible_load"]
    assert np.all(np.isnan(changes) == (np.arange(9) >= 4)[:, None])
    # Where failed states do not count, they spoil nothing.
    assert found == pytest.approx(np.array(changes[1])) and np.all(found != 0)
    _, _, failed = differentiated(POINT, 1.0, values, 0.1, jnp.eye(9)[5])
    assert np.all(np.isnan(failed))


def test_losses_of_jumps_and_kept_fields_have_no_derivatives_and_times_have():
    point = jnp.array([0.004, 0.0, 0.1, 1.0])
    run, (_, reached, lost, kept), _ = differentiated(point, 0.0, VALUES, 1e-3, jnp.zeros(9))
    assert run.result[-1] == "successful" and run.lost[-1] > 0 and run[:2].reached == 0.5
    assert reached == pytest.approx(np.array([0.0, 0.0, 0.0, -4.0]))
    assert np.isnan(lost[0]) and np.all(np.isnan(kept))


def test_many_speeds_at_once_are_those_alone():
    times, values = cycle(9)

    def pulled(speed):
        contact = viscoelastic(length=2.0)
        return js.evolve(contact, js.MeanDisplacement(values), times / speed, rtol=1e-2)

    speeds = jnp.array([0.1, 1.0, 10.0])
    runs = [pulled(speed) for speed in speeds]
    alone = np.array([run.mean_pressure for run in runs])
    batch = jax.vmap(pulled)(speeds)
    assert np.array(batch.mean_pressure) == pytest.approx(alone, abs=1e-12)
    assert np.array(batch.force) == pytest.approx(np.array([run.force for run in runs]), abs=1e-12)
    # A batch is a sequence of evolutions.
    assert len(batch) == 3
    assert batch[2][3].work == pytest.approx(float(runs[2][3].work), abs=1e-12)
    assert batch[2].force == pytest.approx(np.array(runs[2].force), abs=1e-12)
    assert batch[2].contact.heights.shape == (32,)
    with pytest.raises(ValueError, match="3 evolutions: choose one"):
        js.growth_rate(batch)
    assert np.ptp(alone[:, -2]) > 1e-4
    # So are states of several evolutions.
    last = jax.vmap(lambda run: run[-1])(batch)
    assert last[0].times == times[-1] / speeds[0] and last[2].gap.shape == (32,)
    with pytest.raises(ValueError, match="3 evolutions: choose one"):
        js.growth_rate(last)


def test_single_precision_agrees_to_its_digits():
    times, values = cycle(9)
    contact = viscoelastic()
    single = js.Contact(contact.solid, contact.heights.astype("float32"), contact.potential)
    load = js.MeanDisplacement(values)
    both = [js.evolve(c, load, times, rtol=ANY).mean_pressure for c in (contact, single)]
    assert both[1].dtype == "float32"
    assert np.array(both[1]) == pytest.approx(np.array(both[0]), abs=1e-4)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.ResolutionWarning")
def test_by_default_single_precision_takes_few_steps_too():
    grid = js.Grid(64, (30.0, 30.0))
    heights = js.surfaces.paraboloid(grid, radius=20.0)
    solid = js.Viscoelastic(js.FreeHalfSpace(grid, 1.0), 3.0, 1.0)
    law, times = js.potentials.Exponential(0.05, 0.5), jnp.linspace(0.0, 1.0, 5)
    load = js.FarDisplacement(jnp.linspace(1.0, 3.0, 5))
    double, single = (
        js.evolve(js.Contact(solid, heights.astype(dtype), law), load, times)
        for dtype in ("float64", "float32")
    )
    assert single.num_steps.sum() < 100
    np.testing.assert_allclose(single.force, double.force, atol=1e-2 * abs(double.force).max())
    np.testing.assert_allclose(single.work, double.work, atol=2e-2 * abs(double.work).max())

"""Viscoelastic contacts in time: derivatives, batches and single precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from viscoelastic_lines import ANY, cycle, line, viscoelastic

import jaxstab as js

# One program of all derivatives takes longest to compile.
pytestmark = pytest.mark.nightly

INSTANTS, VALUES = cycle(9)
_, WAVE = line()
# The surface energy, a ratio, its time and the speed.
POINT = jnp.array([0.002, 2.0, 0.1, 1.0])


@jax.jit
def differentiated(parameters, heights, other_ratio, values, rtol, weights):
    """Return a run, derivatives in forward mode, and those of a weighted sum in reverse mode.

    All of them are in one program, as it takes longer to make than to run.
    """

    def numbers(parameters):
        energy, ratio, time, speed = parameters
        ratios, times = jnp.stack([ratio, other_ratio]), jnp.stack([time, jnp.ones(())])
        contact = viscoelastic(ratios, times, energy, heights=heights)
        options = {"rtol": rtol, "max_steps": 256, "fields": True, "throw": False}
        run = js.evolve(contact, js.MeanDisplacement(values), INSTANTS / speed, **options)
        return (
            run.force + run.viscous_dissipation,
            run.reached,
            run.fields.gap[1, 3],
            jumps(run),
        ), run

    found, push, run = jax.linearize(numbers, parameters, has_aux=True)
    forward = jax.vmap(push, out_axes=-1)(jnp.eye(4))
    nothing = jax.tree.map(jnp.zeros_like, found[1:])
    (reverse,) = jax.linear_transpose(push, parameters)((weights, *nothing))
    return run, forward, reverse


def jumps(run):
    """Return the largest tension, the loss, the last time of a jump, force and work behind it."""
    last = jnp.max(jnp.where(run.jump_losses > 0, run.jump_times, 0))
    lost = jnp.sum(run.jump_losses)
    return jnp.stack([run.largest_tension, lost, last, run.force[8], run.work[8]])


def test_derivatives_by_law_ratio_time_and_speed_are_those_of_differences():
    def pull(point):
        run, forward, reverse = differentiated(point, WAVE, 1.0, VALUES, ANY, jnp.eye(9)[6])
        return (run.force + run.viscous_dissipation)[6], forward[0][6], reverse

    _, forward, reverse = pull(POINT)
    assert reverse == pytest.approx(np.array(forward), rel=1e-8)
    for i, derivative in enumerate(forward):
        step = 1e-5 * POINT[i] * jnp.eye(4)[i]
        difference = (pull(POINT + step)[0] - pull(POINT - step)[0]) / (2e-5 * POINT[i])
        assert derivative == pytest.approx(float(difference), rel=1e-5)


def test_after_a_failure_there_are_no_derivatives():
    # The surfaces would overlap.
    values = VALUES.at[4:].set(-0.05)
    run, (changes, *_), found = differentiated(POINT, WAVE, 1.0, values, 0.1, jnp.eye(9)[1])
    assert run.result.name.tolist() == 4 * ["successful"] + 5 * ["infeasible_load"]
    assert np.all(np.isnan(changes) == (np.arange(9) >= 4)[:, None])
    # Where failed states do not count, they spoil nothing.
    assert found == pytest.approx(np.array(changes[1])) and np.all(found != 0)
    _, _, failed = differentiated(POINT, WAVE, 1.0, values, 0.1, jnp.eye(9)[5])
    assert np.all(np.isnan(failed))


def test_kept_fields_have_no_derivatives_and_times_have():
    run, (_, reached, kept, _), _ = differentiated(POINT, WAVE, 1.0, VALUES, 0.1, jnp.zeros(9))
    assert run.result[-1] == "successful" and run[:2].reached == 0.5
    assert reached == pytest.approx(np.array([0.0, 0.0, 0.0, -4.0]))
    assert np.all(np.isnan(kept))


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_derivatives_behind_jumps_are_those_of_differences():
    # Contact points release one by one.
    point, heights = jnp.array([0.04, 0.5, 0.3, 1.0]), 5 * WAVE

    def pull(point):
        values = jnp.linspace(0.07, 0.17, 9)
        return differentiated(point, heights, 0.0, values, 1e-3, jnp.eye(9)[8])

    run, forward, reverse = pull(point)
    assert jnp.sum(run.jump_losses > 0) > 3
    assert reverse == pytest.approx(np.array(forward[0][8]), rel=1e-8)
    # Steps, chosen by a tolerance, change between the runs.
    for i, tolerance in ((0, 5e-3), (1, 2e-2)):
        step = 1e-4 * point[i] * jnp.eye(4)[i]
        difference = jumps(pull(point + step)[0]) - jumps(pull(point - step)[0])
        slopes = difference / (2e-4 * point[i])
        np.testing.assert_allclose(forward[3][1:, i], slopes[1:], tolerance)
        # The largest tension is that before a jump, and hardly changes with the ratio.
        np.testing.assert_allclose(forward[3][0, i], slopes[0], 5e-3, 1e-3)


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
@pytest.mark.parametrize("noise", [0.0, 1e-11])
def test_derivatives_behind_two_releases_at_once_are_nan_in_both_modes(noise):
    point, places = jnp.array([0.04, 0.5, 0.3, 1.0]), jnp.arange(32)
    heights = 0.1 * jnp.cos(2 * jnp.pi * places / 32) + noise * jnp.sin(places)
    values = jnp.linspace(0.07, 0.17, 9)
    run, forward, reverse = differentiated(point, heights, 0.0, values, 1e-3, jnp.eye(9)[8])
    assert jnp.sum(run.jump_losses > 0) > 0
    assert np.all(np.isnan(forward[3][2:])) and np.all(np.isnan(reverse))


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
    # Entries take other numbers of steps, and leave room empty.
    extremes = np.array([(run.largest_tension, run.largest_tension_time) for run in runs])
    found = np.transpose([batch.largest_tension, batch.largest_tension_time])
    np.testing.assert_allclose(found, extremes, rtol=1e-6)
    assert np.all(extremes[:, 0] > 0) and np.all(extremes[:, 1] > 0)
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


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
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

"""Viscoelastic contacts in time: derivatives, batches and single precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from viscoelastic_lines import ANY, cycle, viscoelastic

import jaxstab as js


def test_after_a_failure_there_are_no_derivatives():
    times, load = jnp.linspace(0, 4, 5), js.MeanPressure(jnp.linspace(0, -0.16, 5))

    def gaps(energy):
        contact = viscoelastic(energy=energy)
        return js.evolve(contact, load, times, rtol=0.1, max_steps=64, throw=False).mean_gap

    @jax.jit
    def derivatives(energy):
        _, changes = jax.jvp(gaps, (energy,), (1.0,))
        _, pull_back = jax.vjp(gaps, energy)
        return changes, *(pull_back(jnp.eye(5)[i])[0] for i in (1, 3))

    changes, found, failed = derivatives(0.002)
    assert np.isnan(changes).tolist() == [False, False, True, True, True]
    # Where failed states do not count, they spoil nothing.
    assert found == pytest.approx(float(changes[1])) and found != 0
    assert np.isnan(failed)


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


def test_derivatives_by_law_ratio_time_and_speed_are_those_of_differences():
    times, values = cycle(9)

    def pull(parameters):
        energy, ratio, time, speed = parameters
        one = jnp.ones(())
        contact = viscoelastic(jnp.stack([ratio, one]), jnp.stack([time, one]), energy)
        load = js.MeanDisplacement(values)
        found = js.evolve(contact, load, times / speed, rtol=ANY, max_steps=16)
        return found.force[6] + found.dissipated[6]

    point = jnp.array([0.002, 2.0, 0.1, 1.0])
    gradient = jax.jit(jax.grad(pull))(point)
    for i, derivative in enumerate(gradient):
        step = 1e-5 * point[i] * jnp.eye(4)[i]
        difference = (pull(point + step) - pull(point - step)) / (2e-5 * point[i])
        assert derivative == pytest.approx(float(difference), rel=1e-5)


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

"""Searches along paths end, and say why; derivatives that are not computed are NaN."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import with_parameters
from viscoelastic_lines import line, relaxed_of, viscoelastic

import jaxstab as js

HEIGHTS = np.array([0.0265, 0.0055, -0.0643, 0.0301, 0.0105, -0.0316, 0.0162, 0.007])
LINE = js.Contact(
    js.HalfSpace(js.Grid((8,)), 1.0), jnp.asarray(HEIGHTS), js.potentials.Exponential(0.02, 0.2)
)


# Where the loads are known they are refused, as is tested daily below.
@pytest.mark.nightly
def test_a_branch_without_a_way_to_go_ends_under_jit():
    @jax.jit
    def end(value):
        loads = js.MeanGap(jnp.stack([jnp.array(0.1), value]))
        return js.continuation(LINE, loads, max_states=4, throw=False).result

    for last in (0.1, np.nan):
        assert end(last) != "successful"


def test_loads_that_are_one_in_the_precision_of_the_contact_are_refused():
    single = js.Contact(LINE.solid, LINE.heights.astype("float32"), LINE.potential)
    for find in (js.continuation, js.critical_load):
        with pytest.raises(ValueError, match="two loads that differ, in float32"):
            find(single, js.MeanGap([0.1, 0.1 + 1e-10]))
    with pytest.raises(ValueError, match="nan"):
        js.critical_load(LINE, js.MeanGap([0.1, np.nan]))


@pytest.mark.nightly
def test_a_start_that_is_not_found_says_why():
    contact, times = viscoelastic(), jnp.array([0.0, 1.0])
    with pytest.raises(js.exceptions.SolverError, match=r"no start at t = 0.*pulled_off"):
        js.evolve(contact, js.MeanPressure(jnp.full(2, -5.0)), times)
    with pytest.raises(js.exceptions.SolverError, match=r"no start at t = 0.*infeasible_load"):
        js.evolve(contact, js.MeanDisplacement(jnp.full(2, -1.0)), times)


@pytest.mark.nightly
def test_a_flat_surface_takes_few_steps_and_no_jump():
    contact = js.Contact(
        js.Viscoelastic(js.HalfSpace(js.Grid((32,)), 1.0), 2.0, 1.0),
        jnp.zeros(32),
        js.potentials.Exponential(0.0002, 0.05),
    )
    found = js.evolve(contact, js.MeanGap(jnp.array([0.05, 0.06])), jnp.array([0.0, 1.0]))
    assert found.num_steps[-1] < 20 and len(found.jump_times) == 0
    law = -0.0002 / 0.05 * np.exp(-np.array([0.05, 0.06]) / 0.05)
    assert found.mean_pressure == pytest.approx(law, rel=1e-9)


def rate(parameters):
    energy, ratio = parameters
    solid = js.Viscoelastic(js.HalfSpace(js.Grid((32,)), 1.0), ratio, 1.0)
    contact = js.Contact(solid, jnp.zeros(32), js.potentials.Exponential(energy, 0.05))
    load = js.MeanGap(jnp.full(2, 0.05))
    return js.growth_rate(js.evolve(contact, load, jnp.array([0.0, 1e-3]), rtol=1e9))


@pytest.mark.nightly
def test_a_growth_rate_has_the_derivatives_of_the_closed_form():
    # K(s) q / 2 = w / rho^2 exp(-g / rho) for the longest wave, and K(s) = 1 + r s / (1 + s).
    point = jnp.array([0.03, 4.0])
    needed = float(point[0]) / 0.05**2 * np.exp(-1) / np.pi
    value, slopes = jax.jit(jax.value_and_grad(rate))(point)
    assert value == pytest.approx((needed - 1) / (5 - needed), rel=1e-7)
    by_energy = needed / float(point[0]) * 4 / (5 - needed) ** 2
    by_ratio = -(needed - 1) / (5 - needed) ** 2
    assert slopes == pytest.approx(np.array([by_energy, by_ratio]), rel=1e-6)


@pytest.mark.nightly
def test_a_growth_rate_has_no_second_derivatives():
    assert np.all(np.isnan(jax.hessian(rate)(jnp.array([0.03, 4.0]))[0]))


@pytest.mark.nightly
def test_a_law_with_a_core_lasts_until_it_is_pulled_apart():
    grid, wave = line()
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), (2.0, 1.0), (0.1, 1.0))
    contact = js.Contact(solid, wave, js.potentials.LennardJones(0.001, 0.02))
    strength = float(js.pull_off(relaxed_of(contact)).load.value)
    assert js.lifetime(contact, js.MeanPressure(0.9 * strength)) == np.inf
    times = [js.lifetime(contact, js.MeanPressure(part * strength)) for part in (1.01, 1.1)]
    assert times[0] > times[1] > 0


@pytest.mark.nightly
def test_a_larger_tension_is_not_carried_for_longer():
    grid, wave = line(height=0.002)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), (2.0, 1.0), (0.1, 1.0))
    contact = js.Contact(solid, wave, js.potentials.Gaussian(0.002, 0.02))
    strength = float(js.pull_off(relaxed_of(contact)).load.value)
    start = js.equilibrate(relaxed_of(contact), js.MeanPressure(0.02))
    times = [
        js.lifetime(contact, js.MeanPressure(part * strength), initial=start)
        for part in (0.99, 1.0005, 1.01)
    ]
    assert np.all(np.diff(times) <= 0)


@pytest.mark.nightly
def test_there_is_no_easiest_way_out_of_a_saddle_or_of_another_contact(hertz, transition):
    with pytest.raises(ValueError, match="The state is unstable"):
        js.easiest_exit(hertz, transition.saddle, num_modes=1)
    other = with_parameters(hertz, 9.0, 1.0, 1.0)
    with pytest.raises(js.exceptions.SolverError, match="other_contact"):
        js.easiest_exit(other, transition.start, num_modes=1)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_without_a_state_beyond_the_easiest_way_out_under_a_dead_load_is_to_nothing():
    heights = 0.1 * np.cos(2 * np.pi * np.arange(16) / 16)
    law = js.potentials.Exponential(0.02, 0.05)
    contact = js.Contact(js.HalfSpace(js.Grid((16,)), 1.0), heights, law)
    state = js.equilibrate(contact, js.MeanPressure(-0.05))
    found = js.easiest_exit(contact, state, num_modes=1)
    assert found.end.result == "pulled_off" and found.back == np.inf
    both = js.transition(contact, state.load, state, None)
    np.testing.assert_allclose(found.there, both.there, rtol=1e-9)
    # On this symmetric branch the state at the load has two negative eigenvalues.
    flat = js.Contact(contact.solid, heights / 4, js.potentials.Exponential(0.06, 0.06))
    state = js.equilibrate(flat, js.MeanPressure(-0.3))
    with pytest.raises(
        js.exceptions.SolverError, match=r"0 other states.*detached surfaces.*: no_detachment"
    ):
        js.easiest_exit(flat, state, num_modes=1)

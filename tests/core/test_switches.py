"""JAX's own switches, which check the user's code: public calls pass under each."""

import contextlib
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js

README = Path(__file__).parents[2] / "README.md"
SWITCHES = [
    jax.debug_nans(True),
    jax.debug_infs(True),
    jax.numpy_dtype_promotion("strict"),
    jax.numpy_rank_promotion("raise"),
]


@pytest.fixture(scope="module", autouse=True)
def switches():
    with contextlib.ExitStack() as stack:
        for switch in SWITCHES:
            stack.enter_context(switch)
        yield


@pytest.mark.nightly
def test_the_readmes_example_runs_under_all_of_them(capsys):
    example = re.search(r"```python\n(.*?)```", README.read_text(), re.DOTALL)[1]
    # On fewer points.
    exec(example.replace("Grid(64)", "Grid(16)").replace("k_high=16", "k_high=4"), {})
    assert "stable: " in capsys.readouterr().out


@pytest.mark.nightly
def test_surfaces_solids_states_and_derivatives_pass(capsys):
    grid = js.Grid(16)
    heights = js.surfaces.self_affine(grid, jax.random.key(3), k_high=4, rms_height=0.05)
    js.surfaces.power_spectrum(grid, heights)
    js.surfaces.autocorrelation(grid, heights)
    js.surfaces.sinusoid(grid, 0.1)
    js.surfaces.paraboloid(grid, 2.0)
    solid = js.HalfSpace(grid, 1.0)
    js.surfaces.effective_work_of_adhesion(solid, heights, 0.1)
    for other in (js.Layer(grid, 1.0, 0.5, 0.2), js.FreeHalfSpace(grid, 1.0)):
        assert np.isfinite(other.energy(heights))
    law = js.potentials.LennardJones(0.02, 0.06)
    state = js.equilibrate(js.Contact(solid, heights, law), js.MeanGap(0.1))
    assert np.isfinite(state.mean_pressure)
    apart = js.Contact(solid, heights, js.potentials.Exponential(0.06, 0.06))
    assert (
        js.assess_stability(apart, js.equilibrate(apart, js.MeanGap(0.5))).complementarity == np.inf
    )

    def pressure(energy):
        contact = js.Contact(solid, heights, js.potentials.Exponential(energy, 0.06))
        return js.equilibrate(contact, js.MeanGap(0.1)).mean_pressure

    slope = jax.grad(pressure)(0.06)
    differences = (pressure(0.06 + 1e-5) - pressure(0.06 - 1e-5)) / 2e-5
    np.testing.assert_allclose(slope, differences, rtol=1e-4)
    # The user's own code is checked as before.
    with pytest.raises(ValueError, match="rank_promotion"):
        jnp.ones((2, 3)) + jnp.ones(3)


@pytest.mark.nightly
def test_pull_offs_loops_and_observables_pass():
    grid = js.Grid(16)
    heights = js.surfaces.self_affine(grid, jax.random.key(3), k_high=4, rms_height=0.05)
    law = js.potentials.Exponential(0.06, 0.06)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, law)
    state = js.equilibrate(contact, js.MeanGap(0.1))
    js.patches(contact, state)
    js.conductance(contact, state, (1.0, 1.0))
    js.leakage(contact, state, 1.0)
    js.to_dataset(contact, state)
    assert js.pull_off(contact).equilibrium.mean_pressure < 0
    js.follow(contact, js.MeanGap(jnp.array([0.3, 0.1])))


@pytest.mark.nightly
def test_evolutions_failures_and_fits_pass():
    line = js.Grid((16,))
    heights = js.surfaces.self_affine(line, jax.random.key(3), k_high=4, rms_height=0.05)
    law, solid = js.potentials.Exponential(0.02, 0.08), js.HalfSpace(line, 1.0)
    slow = js.Contact(js.Viscoelastic(solid, (1.0,), (1.0,)), heights, law)
    times, pressures = jnp.array([0.0, 1.0, 2.0]), js.MeanPressure(jnp.array([0.0, -0.1, -10.0]))
    torn = js.evolve(slow, pressures, times, throw=False)
    assert torn.result.name.tolist() == ["successful", "successful", "pulled_off"]
    held = js.evolve(slow, js.MeanGap(jnp.array([0.2, 0.1])), times[:2])
    assert js.growth_rate(held) == 0
    storage, loss = slow.solid.storage_and_loss(jnp.array([1.0, 2.0]))
    np.testing.assert_allclose([*storage, *loss], [1.5, 1.8, 0.5, 0.4])
    contact = js.Contact(solid, heights, law)
    failed = js.sweep(contact, js.MeanPressure(jnp.array([0.0, -5.0])), throw=False)
    assert js.observe(contact, failed, js.patches).patches.number[0] > 0
    gaps = js.MeanGap(jnp.linspace(0.1, 0.4, 6))
    curve = js.sweep(contact, gaps, stability=False).equilibrium.mean_pressure
    assert js.calibrate(contact, gaps, curve).result == "successful"

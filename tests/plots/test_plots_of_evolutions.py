"""Figures of viscoelastic contacts in time."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from viscoelastic_lines import viscoelastic

import jaxstab as js


@pytest.fixture(scope="module")
def run():
    contact = viscoelastic(energy=0.001, n=16)
    times = jnp.array([0.0, 0.1, 1.0, 10.0])
    return js.evolve(contact, js.MeanDisplacement(jnp.full(4, 0.02).at[0].set(0.05)), times)


def test_quantities_are_drawn_over_load_or_time_with_their_units(run):
    axes = js.plots.evolution(run, run, labels=["a", "b"])
    assert axes.get_ylabel().endswith("[MPa]") and axes.get_xlabel().endswith("[µm]")
    assert np.array(axes.lines[0].get_ydata()) == pytest.approx(np.array(run.mean_pressure))
    axes = js.plots.evolution(run, x="time", y="contact_area")
    assert axes.get_xscale() == "log" and axes.get_ylabel() == "contact area"
    # Zero has no place on a logarithmic axis.
    assert np.array(axes.lines[0].get_xdata()) == pytest.approx([0.1, 1.0, 10.0])


def test_under_a_dead_load_the_gap_is_drawn(run):
    pressed = eqx.tree_at(lambda x: x.load, run, js.MeanPressure(run.mean_pressure))
    for across in ("load", "time"):
        assert js.plots.evolution(pressed, x=across).get_ylabel().startswith("mean gap")


def test_mistakes_are_named(run):
    with pytest.raises(TypeError, match=r"result of jaxstab\.evolve"):
        js.plots.evolution(run.contact)
    with pytest.raises(TypeError, match="NoneType is no evolution"):
        js.plots.evolution()
    with pytest.raises(ValueError, match="single state"):
        js.plots.evolution(run[1])
    with pytest.raises(ValueError, match="y is 'energy': choose one of"):
        js.plots.evolution(run, y="energy")
    codes = run.result.code.at[1:].set(js.RESULTS.infeasible_load.code)
    unfound = run.mean_pressure.at[1:].set(jnp.nan)
    failed = eqx.tree_at(lambda x: (x.result.code, x.mean_pressure), run, (codes, unfound))
    assert len(js.plots.evolution(failed).lines) == 1
    with pytest.raises(ValueError, match=r"No state to draw was found \(infeasible_load\)"):
        js.plots.evolution(failed, x="time")
    with pytest.raises(ValueError, match=r"No state to draw was found \(none\)"):
        js.plots.evolution(run[[]])
    with pytest.raises(TypeError, match=r"state of an evolution .* in evolution\[i\]\.instant"):
        js.plots.gap(run.contact, run[-1])
    state = js.plots.gap(*run[-1].instant)
    np.testing.assert_array_equal(state.lines[0].get_ydata(), run.gap)
    with pytest.raises(ValueError, match="give a list of 2, one for each curve"):
        js.plots.evolution(run, run, labels=["a"])

import equinox as eqx
import numpy as np
import pytest
from matplotlib.text import Text

import jaxstab as js
from jaxstab import plots


def words(figure):
    return {text.get_text() for text in figure.findobj(Text)}


def test_a_summary_tells_the_numbers_of_a_state(hertz, sweep):
    state = sweep[0]
    figure = plots.summary(hertz, state)
    shown = words(figure)
    stability = state.stability
    for pair in stability.pairs.values():
        value, error = float(pair.eigenvalue), float(pair.error)
        assert f"{value:.3g} ± {error:.1g}" in shown
    assert {"held by contact", "1.2", "[pressure/length]"} <= shown
    assert f"{float(state.equilibrium.mean_pressure):.3g}" in shown
    assert f"{100 * float(state.equilibrium.contact_area):.1f} %" in shown
    assert f"{float(stability.barrier.height):.3g}" in shown
    images = [axes.images[0].get_array() for axes in figure.axes if axes.images]
    fields = [hertz.heights, state.equilibrium.gap, state.equilibrium.pressure, stability.cone.mode]
    np.testing.assert_array_equal(images, [np.asarray(field).T for field in fields])
    given = plots.summary(hertz, state.equilibrium, stability)
    assert words(given) == shown
    assert "barrier" not in words(plots.summary(hertz, sweep[1]))


def test_a_summary_of_a_line_shades_the_contact(line):
    contact, equilibrium, _ = line
    figure = plots.summary(contact, equilibrium, js.assess_stability(contact, equilibrium))
    assert [len(axes.collections) for axes in figure.axes] == [0, 1, 0, 0, 1]


def test_a_failed_state_says_so_in_its_summary(hertz, sweep):
    failed = js.RESULTS.infeasible_load
    state = eqx.tree_at(lambda x: x.equilibrium.result, sweep[0], failed)
    assert {"equilibrium", "infeasible load"} <= words(plots.summary(hertz, state))


def test_what_cannot_be_summed_up_is_told(hertz, sweep):
    with pytest.raises(ValueError, match=r"stack of shape \(3,\)"):
        plots.summary(hertz, sweep)
    with pytest.raises(ValueError, match=r"stack of shape \(3,\)"):
        plots.summary(hertz, sweep[0], sweep.stability)
    with pytest.raises(ValueError, match="stability of this state is missing"):
        plots.summary(hertz, sweep[0].equilibrium)
    with pytest.raises(TypeError, match="Eigenpair is not a stability"):
        plots.summary(hertz, sweep[0], sweep[0].stability.cone)

"""Defaults, scales and colours that all figures share."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import PathCollection
from matplotlib.colors import to_rgb
from matplotlib.text import Text

import jaxstab as js
from jaxstab import plots
from jaxstab.core.units import Units


def under(result, load):
    """Return a result as though it was found under loads of another class."""
    return eqx.tree_at(lambda x: x.load, result, load)


@pytest.fixture(scope="module")
def dead(branch):
    pressed = under(branch, js.MeanPressure(branch.equilibrium.mean_pressure))
    turns = under(branch.turns, js.MeanPressure(branch.turns.equilibrium.mean_pressure))
    return eqx.tree_at(lambda x: x.turns, pressed, turns)


def test_over_a_dead_load_the_gap_is_drawn_and_not_the_load_itself(dead, loop):
    axes = plots.branch(dead)
    assert axes.get_xlabel() == "mean pressure $p_0$ [pressure]"
    assert axes.get_ylabel() == "mean gap $g_0$ [length]"
    path = under(loop, js.MeanPressure(loop.equilibrium.mean_pressure))
    over_load = plots.path(path, x="load", axes=plt.subplots()[1])
    assert over_load.get_ylabel() == "mean gap $g_0$ [length]"
    over_gap = plots.path(path, axes=plt.subplots()[1])
    assert over_gap.get_xlabel() == "mean gap $g_0$ [length]"
    assert over_gap.get_ylabel() == "mean pressure $p_0$ [pressure]"


def test_a_sweep_over_dead_loads_shows_the_gap(sweep):
    pressed = under(sweep, js.MeanPressure(sweep.equilibrium.mean_pressure))
    assert plots.stability_curve(pressed).get_ylabel() == "mean gap $g_0$ [length]"


def test_loads_that_span_decades_are_on_a_logarithmic_axis(sweep):
    def drawn(gaps):
        return plots.stability_curve(under(sweep, js.MeanGap(jnp.asarray(gaps))))

    assert drawn([1e-6, 1e-4, 1e-2]).get_xscale() == "log"
    # Equal steps leave nothing to spread, and there is no logarithm of zero.
    for gaps in ([1e-6, 1.0, 2.0], [0.0, 1e-4, 1e-2], [-1e-6, 1e-4, 1e-2]):
        assert drawn(gaps).get_xscale() == "linear"


def test_an_observable_that_spans_decades_is_on_a_logarithmic_axis(hertz, sweep):
    observed = js.observe(hertz, sweep[[0, 1, 2, 0]], js.patches)
    first = "patches.true_area"
    assert plots.observed(observed, first).get_yscale() == "linear"
    for areas, scale in (
        ([1.0, 1e-3, 1e-5, 0.0], "log"),
        ([1.0, 1e-3, 1e-5, 1e-9], "log"),
        ([1.0, 1e-3, -1e-5, 0.0], "linear"),
    ):
        values = jnp.array(areas)
        leak = eqx.tree_at(lambda x: x.observables["patches"].true_area, observed, values)
        assert plots.observed(leak, first).get_yscale() == scale


def test_an_indentation_is_how_far_the_far_side_has_approached(loop):
    states = loop.equilibrium
    spring = js.Spring(loop.load.value - states.mean_pressure / 3.0, 3.0)
    axes = plots.path(under(loop, spring), "indentation", "force", axes=plt.subplots()[1])
    assert axes.get_xlabel() == r"indentation $\delta$ [length]"
    assert axes.get_ylabel() == "force [force]"
    expected = np.unique(np.stack([-loop.load.value, states.force], axis=1).round(9), axis=0)
    far = under(loop, js.FarDisplacement(loop.load.value))
    same = plots.path(far, "indentation", "force", axes=plt.subplots()[1])
    for drawn in (axes, same):
        points = np.concatenate([line.get_xydata() for line in drawn.lines])
        np.testing.assert_allclose(np.unique(points.round(9), axis=0), expected, atol=1e-9)
    with pytest.raises(ValueError, match="indentation under a MeanDisplacement is not known"):
        plots.path(loop, "indentation")


def test_a_legend_names_approach_and_retraction(loop):
    right = plots.path(loop).figure.axes[1]
    assert [text.get_text() for text in right.get_legend().get_texts()][:2] == [
        "approach to 1.2",
        "retraction to 1.6",
    ]
    assert right.get_legend().get_title().get_text() == "mean\ndisplacement\n$u_0$"
    nanometres = eqx.tree_at(lambda x: x.load.value, loop, 1e-9 * loop.load.value)
    states = replace(loop.equilibrium, units=Units("m", "Pa"))
    nanometres = replace(nanometres, equilibrium=states)
    right = plots.path(nanometres).figure.axes[1]
    assert [text.get_text() for text in right.get_legend().get_texts()][:2] == [
        "approach to 1.2 nm",
        "retraction to 1.6 nm",
    ]
    # The direction is that of the load, whatever the gap does.
    pressed = plots.path(under(loop, js.MeanPressure(loop.load.value))).figure.axes[1]
    assert [text.get_text() for text in pressed.get_legend().get_texts()][:2] == [
        "retraction to 1.2",
        "approach to 1.6",
    ]


def contrast(one, other):
    """Return the ratio of luminances of WCAG 2.2."""

    def luminance(colour):
        linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in colour]
        return np.dot([0.2126, 0.7152, 0.0722], linear) + 0.05

    ratio = luminance(to_rgb(one)) / luminance(to_rgb(other))
    return max(ratio, 1 / ratio)


FIGURES = {
    "path": lambda r: plots.path(r("loop")),
    "branch": lambda r: plots.branch(r("branch")),
    "stability_curve": lambda r: plots.stability_curve(r("sweep")),
    "transition": lambda r: plots.transition(r("hertz"), r("transition")).axes[0],
    "distribution": lambda r: plots.distribution(*r("line")[:2]),
    "laws": lambda r: plots.force([js.potentials.Exponential(1.0, 1.0)] * 7, jnp.ones(3)),
    "contact": lambda r: plots.contact_map(*r("line")[:2]),
}


@pytest.mark.parametrize("style", ["default", "dark_background"])
@pytest.mark.parametrize("kind", FIGURES)
def test_lines_marks_and_letters_stand_out_from_light_and_dark_paper(kind, style, request):
    with plt.style.context(style):
        axes = FIGURES[kind](request.getfixturevalue)
        paper = axes.get_facecolor()
        lines = [line for line in axes.lines if len(line.get_xdata())]
        drawn = [line.get_color() for line in lines]
        drawn += [text.get_color() for text in axes.findobj(Text) if text.get_text()]
        for marks in axes.collections:
            edges = marks.get_edgecolor() if isinstance(marks, PathCollection) else []
            drawn += [*(edges if len(edges) else marks.get_facecolor())]
        assert drawn and all(contrast(colour, paper) > 2 for colour in drawn)

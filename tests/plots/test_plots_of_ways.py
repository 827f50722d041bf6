"""Figures of branches and of passes."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab import plots
from jaxstab.core.unit_system import Units

LINE, SHORT = js.Grid((6,), (1.0,)), js.Grid((3,), (1.0,))
PROFILE = jnp.array([0.00, -0.05, -0.12, -0.03, -0.09, -0.16])
LOADS = js.MeanGap(jnp.array([0.6, 0.01]))


@pytest.fixture(scope="module")
def contact():
    solid = js.HalfSpace(SHORT, youngs_modulus=1.0, poisson_ratio=0.0)
    return js.Contact(solid, jnp.array([0.0, -0.07, -0.2]), js.potentials.Exponential(0.08, 0.05))


@pytest.fixture(scope="module")
def branch():
    solid = js.HalfSpace(LINE, youngs_modulus=1.0, poisson_ratio=0.0)
    return js.continuation(js.Contact(solid, PROFILE, js.potentials.Exponential(0.06, 0.05)), LOADS)


@pytest.fixture(scope="module")
def transition(contact):
    near, far = (0.001 + 0.3 * jnp.array(gap) for gap in ((1.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    return js.transition(contact, js.MeanGap(0.1), near, far)


def names(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


@pytest.mark.nightly
def test_a_branch_is_solid_where_both_neighbours_are_minima(branch):
    axes = plots.branch(branch)
    assert axes.get_xlabel() == "mean gap $g_0$ [length]"
    assert axes.get_ylabel() == "mean pressure $p_0$ [pressure]"
    kinds = set(branch.turns.kind.name.tolist())
    assert len(kinds) >= 2 and set(names(axes)) == {"stable", "unstable", *kinds}
    stable, loads = np.asarray(branch.index) == 0, np.asarray(branch.load.value)
    solid = [line for line in axes.lines if line.get_linestyle() == "-"]
    drawn = {x for line in solid for x in line.get_xdata()}
    # A state whose neighbours are stable lies on a solid line, an unstable one on none.
    inner = np.flatnonzero(stable[1:-1] & stable[:-2] & stable[2:]) + 1
    assert set(loads[inner]) <= drawn
    assert not set(loads[~stable]) & drawn
    joined = np.concatenate([line.get_xdata() for line in axes.lines])
    assert len(joined) - len(axes.lines) + 1 == len(loads) + len(branch.turns)


def test_the_turns_lie_where_they_are(branch):
    axes = plots.branch(branch, "mean_pressure", "contact_area")
    for marks in axes.collections:
        chosen = branch.turns.kind.name == marks.get_label()
        states = branch.turns.equilibrium
        expected = np.stack([states.mean_pressure, states.contact_area], axis=1)[chosen]
        np.testing.assert_allclose(marks.get_offsets(), expected)
    over_gap = plots.branch(branch, y="mean_gap")
    for marks in over_gap.collections:
        there, across = np.asarray(marks.get_offsets()).T
        np.testing.assert_allclose(there, across, rtol=1e-6)


def test_what_is_no_branch_is_refused(branch, transition):
    with pytest.raises(TypeError, match=r"Transition is not a branch"):
        plots.branch(transition)
    with pytest.raises(ValueError, match="y is 'work': choose one of"):
        plots.branch(branch, y="work")
    twice = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), branch)
    with pytest.raises(ValueError, match="several branches"):
        plots.branch(twice)


def test_a_pass_is_drawn_with_its_saddle(contact, transition):
    figure = plots.transition(contact, transition)
    string = figure.axes[0]
    assert string.get_ylabel() == "energy above the start [energy/length]"
    assert set(names(string)) == {"string", "start, end", "saddle"}
    ends, saddle = (np.asarray(marks.get_offsets()) for marks in string.collections)
    there, back = (float(height) for height in transition.barrier)
    np.testing.assert_allclose(ends, [[0, 0], [1, there - back]], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(saddle[0, 1], there)
    # The saddle lies beside the highest part of the string.
    number = len(transition.energies) - 1
    assert abs(saddle[0, 0] - np.argmax(transition.energies) / number) < 1.5 / number
    saddle = replace(transition.saddle, units=Units("m", "Pa", 1))
    figure = plots.transition(contact, replace(transition, saddle=saddle))
    assert figure.axes[0].get_ylabel().endswith("J/m]")


def test_what_is_no_single_pass_is_refused(contact, branch, transition):
    with pytest.raises(TypeError, match="Branch is not a transition"):
        plots.transition(contact, branch)
    both = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), transition)
    with pytest.raises(ValueError, match="is a stack"):
        plots.transition(contact, both)

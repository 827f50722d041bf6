"""Figures of branches and of passes."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstab import plots
from jaxstab.core.units import Units


def names(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_a_branch_is_solid_where_both_neighbours_are_minima(branch):
    axes = plots.branch(branch)
    assert axes.get_xlabel() == "mean displacement $u_0$ [length]"
    assert axes.get_ylabel() == "mean pressure $p_0$ [pressure]"
    kinds = set(branch.turns.kind.name.tolist())
    assert kinds and set(names(axes)) == {"stable", "unstable", *kinds}
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
    (fold,) = plots.branch(branch, y="mean_gap").collections
    turn = branch.turns[0]
    np.testing.assert_allclose(fold.get_offsets(), [[turn.load.value, turn.equilibrium.mean_gap]])


def test_what_is_no_branch_is_refused(branch, transition):
    with pytest.raises(TypeError, match=r"Transition is not a branch"):
        plots.branch(transition)
    with pytest.raises(ValueError, match="y is 'work': choose one of"):
        plots.branch(branch, y="work")
    twice = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), branch)
    with pytest.raises(ValueError, match="several branches"):
        plots.branch(twice)


def test_a_pass_is_drawn_with_its_saddle(hertz, transition):
    figure = plots.transition(hertz, transition)
    string = figure.axes[0]
    assert string.get_ylabel() == "energy above the start [energy]"
    assert set(names(string)) == {"string", "start, end", "saddle"}
    ends, saddle = (np.asarray(marks.get_offsets()) for marks in string.collections)
    there, back = (float(height) for height in transition.barrier)
    np.testing.assert_allclose(ends, [[0, 0], [1, there - back]], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(saddle[0, 1], there)
    # The saddle lies beside the highest part of the string.
    number = len(transition.energies) - 1
    assert abs(saddle[0, 0] - np.argmax(transition.energies) / number) < 1.5 / number
    saddle = replace(transition.saddle, units=Units("m", "Pa", 1))
    figure = plots.transition(hertz, replace(transition, saddle=saddle))
    assert figure.axes[0].get_ylabel().endswith("J/m]")


def test_a_pass_to_detached_surfaces_is_drawn_up_to_its_saddle(detaching):
    contact, found = detaching
    panel = plots.transition(contact, found).axes[0]
    assert panel.get_xlabel() == "part of the branch"
    assert set(names(panel)) == {"branch", "start", "saddle"}
    start, saddle = (np.asarray(marks.get_offsets()) for marks in panel.collections)
    np.testing.assert_allclose(start, [[0, 0]])
    np.testing.assert_allclose(saddle, [[1, found.there]])
    assert panel.get_title() == f"barrier {float(found.there):.3g} [energy/length], no way back"


def test_what_is_no_single_pass_is_refused(hertz, branch, transition):
    with pytest.raises(TypeError, match="Branch is not a transition"):
        plots.transition(hertz, branch)
    both = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), transition)
    with pytest.raises(ValueError, match="is a stack"):
        plots.transition(hertz, both)

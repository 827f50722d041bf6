"""Branches of equilibria, stable or not, and the passes between two of them."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstab.branches import Branch
from jaxstab.contact import Contact, require_contact
from jaxstab.core.checks import require_kind
from jaxstab.core.stack import require_single
from jaxstab.core.units import in_brackets, readable_unit
from jaxstab.plots.fields import draw_mode, gap, outline_contact
from jaxstab.plots.paths import Quantity, of_states, quantities_or_default, scale
from jaxstab.plots.style import (
    BLUE,
    GREEN,
    ORANGE,
    VERMILION,
    Panels,
    Style,
    add_legend,
    axes_or_new,
    grey,
    label_axes,
)
from jaxstab.transitions import Transition

_STABLE: Style = {"color": BLUE, "label": "stable"}
_UNSTABLE: Style = {"color": VERMILION, "linestyle": (0, (3, 1.5)), "label": "unstable"}
# The turns differ by shape; a fold has the colour of the background.
_TURNS: dict[str, Style] = {
    "fold": {"marker": "o"},
    "release": {"marker": "^", "facecolors": ORANGE},
    "touch": {"marker": "v", "facecolors": GREEN},
    "bifurcation": {"marker": "D", "facecolors": BLUE},
}
_PANELS: Panels = [["string", "gap", "mode"]]


def branch(
    branch: Branch,
    x: Quantity = "load",
    y: Quantity | None = None,
    *,
    axes: Axes | None = None,
) -> Axes:
    """Draw a quantity along a branch: solid where it is stable, dashed where not, with its turns.

    A compression above the largest tension is cut off, so that adhesion is seen.

    Arguments:
        branch: the branch.
        x: the quantity of the horizontal axis: the load, or a scalar field of `States`.
        y: the quantity of the vertical axis: by default the mean pressure, or on a window the
            force; over a dead load the mean gap.
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: for something that is not a branch.
        ValueError: for a quantity that cannot be drawn, and for several branches at once.

    Example:
        >>> axes = js.plots.branch(js.continuation(contact, js.MeanGap([0.05, 0.3]), initial=state))
    """
    require_kind(branch, Branch, "not a branch: give a result of jaxstab.continuation.")
    x, y = quantities_or_default(branch, x, y)
    if branch.load.value.ndim != 1:
        raise ValueError("These are several branches: draw one of them, as branches[0].")
    branch = branch.recorded
    axes = axes_or_new(axes)
    states, turns = ([of_states(part, q) for q in (x, y)] for part in (branch, branch.turns))
    # Each turn lies before the state of its number.
    after = np.asarray(branch.turns.state)
    there, across = (np.insert(s, after, t) for s, t in zip(states, turns, strict=True))
    # A segment is stable if both of its ends are; a turn counts as stable.
    index = np.insert(np.asarray(branch.index), after, 0)
    is_unstable = (index[1:] != 0) | (index[:-1] != 0)
    ends = np.flatnonzero(np.diff(is_unstable)) + 1
    drawn = set()
    for piece in np.split(np.arange(is_unstable.size), ends):
        style = _UNSTABLE if is_unstable[piece[0]] else _STABLE
        if style["label"] in drawn:
            style = {**style, "label": None}
        places = [*piece, piece[-1] + 1]
        axes.plot(there[places], across[places], **style)
        drawn.add(style["label"])
    kinds = np.asarray(branch.turns.kind.name)
    for kind, marker in _TURNS.items():
        chosen = kinds == kind
        if chosen.any():
            edges = grey(axes, 1)
            empty = grey(axes, 0)
            style = {"s": 30, "facecolors": empty, "edgecolors": edges, "zorder": 3, **marker}
            axes.scatter(*(values[chosen] for values in turns), label=kind, **style)
    scale(axes.xaxis, branch, x)
    scale(axes.yaxis, branch, y)
    add_legend(axes)
    return axes


def transition(contact: Contact, transition: Transition) -> Figure:
    """Draw a pass in one figure: the energy along the string, the saddle's gap, and its mode.

    The energy of a pass to detached surfaces is drawn along the branch, up to the saddle. The
    contact at the saddle is outlined on gap and mode, or on a line shaded.

    Arguments:
        contact: the contact problem.
        transition: a result of `jaxstab.transition` for it.

    Returns:
        The figure.

    Raises:
        TypeError: for something that is not a transition.
        ValueError: for several transitions at once, or one on another grid.

    Example:
        >>> load = js.MeanGap(0.0624)
        >>> closed, open = (js.equilibrate(contact, load, initial=x) for x in (state, None))
        >>> figure = js.plots.transition(contact, js.transition(contact, load, closed, open))
    """
    require_contact(contact)
    cure = "give a result of jaxstab.transition."
    require_kind(transition, Transition, f"not a transition: {cure}")
    require_single(transition)
    figure = plt.figure(figsize=(11, 3.2), layout="constrained")
    panels = figure.subplot_mosaic(_PANELS, width_ratios=[1.3, 1, 1])
    saddle = transition.saddle
    _draw_string(transition, panels["string"])
    gap(contact, saddle, axes=panels["gap"]).set_title("gap at the saddle")
    outline_contact(panels["gap"], contact, saddle.in_contact, "white")
    draw_mode(contact, transition.mode, saddle, panels["mode"]).set_title("mode of descent")
    return figure


def _draw_string(transition: Transition, axes: Axes) -> None:
    """Draw the energy along the string, or the branch, with the saddle and the ends."""
    energies = np.asarray(transition.energies)
    places = np.linspace(0, 1, energies.size)
    there, back = (float(energy) for energy in transition.barrier)
    units = transition.saddle.units
    if back == np.inf:
        # From detached surfaces there is no way back, and the branch ends at the saddle.
        line = "branch"
        summit = places.size - 1
        ends = {"start": (0, 0)}
        divisor, unit = readable_unit(units, "energy", there)
        title = f"barrier {there / divisor:.3g} {in_brackets(unit)}, no way back"
    else:
        line = "string"
        summit = np.argmax(energies)
        ends = {"start, end": ([0, 1], [0, there - back])}
        divisor, unit = readable_unit(units, "energy", max(there, back))
        heights = f"barrier {there / divisor:.3g}, back {back / divisor:.3g}"
        title = f"{heights} {in_brackets(unit)}"
    axes.plot(places, energies, ".-", color=BLUE, label=line)
    for label, points in ends.items():
        axes.scatter(*points, color=grey(axes, 1), zorder=3, label=label)
    style = {"marker": "*", "s": 90, "color": VERMILION, "edgecolors": grey(axes, 1), "zorder": 4}
    axes.scatter([places[summit]], [there], label="saddle", **style)
    label_axes(axes, f"part of the {line}", "energy above the start [energy]", units)
    axes.set_title(title)
    axes.legend()

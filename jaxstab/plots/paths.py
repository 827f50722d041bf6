"""The states along a path, and its jumps."""

from __future__ import annotations

from textwrap import fill
from typing import Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis

from jaxstab.branches import Branch, Turn
from jaxstab.core.checks import require_kind, require_one_of
from jaxstab.core.display import several
from jaxstab.core.units import LENGTH, readable_unit, shown_unit
from jaxstab.loading import Path
from jaxstab.loading.sweep import Sweep
from jaxstab.observation import Observed
from jaxstab.plots.style import (
    PALETTE,
    QUANTITIES,
    Style,
    add_legend,
    axes_or_new,
    default_ordinate,
    grey,
    label_axis,
    quantity_label,
    scale_decades,
)

Quantity = Literal[
    "mean_gap", "mean_pressure", "force", "contact_area", "energy", "indentation", "load"
]
_Curve = Path | Branch

# The least tension that is shown, over the largest compression.
_LEAST_TENSION = 1e-3
# Points.
_SHORTEST_ARROW = 8
# Letters.
_LEGEND_WIDTH = 14
# The approach lies on top of the retraction and is thinner, so that both are seen where they agree.
_APPROACH: Style = {"linewidth": 0.8, "markersize": 2, "zorder": 2.2}
_RETRACTION: Style = {"linewidth": 2, "markersize": 3, "zorder": 2}


def path(
    path: Path,
    x: Quantity | None = None,
    y: Quantity | None = None,
    *,
    axes: Axes | None = None,
) -> Axes:
    """Draw the states along a path, its jumps as arrows, and the energy lost around a loop.

    The approach is a thinner line on top of the retraction. A compression above the largest tension
    is cut off, so that adhesion is seen. A quantity that spans decades is on a logarithmic axis. If
    `axes` is None and the surfaces touch, the contact area is drawn beside it.

    Arguments:
        path: the path.
        x: the quantity of the horizontal axis: a scalar field of `States`, "force", "load", or the
            "indentation": how far the far side has approached, under a `Spring` or a
            `FarDisplacement`. By default the mean gap, or on a window the displacement of the load.
        y: the quantity of the vertical axis: by default the mean pressure, or on a window the
            force; over a dead load the mean gap.
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: for something that is not a path.
        ValueError: for a quantity that cannot be drawn, and for several paths at once.

    Example:
        >>> axes = js.plots.path(js.follow(contact, js.MeanGap([0.3, 0.03, 0.3])))
    """
    require_path(path)
    path = path.recorded
    x, y = quantities_or_default(path, x, y)
    touches = np.any(np.asarray(path.equilibrium.contact_area) > 0)
    if axes is not None or "contact_area" in (x, y) or not touches:
        return _with_legend(path, _draw(path, x, y, axes_or_new(axes)))
    _, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    _with_legend(path, _draw(path, x, "contact_area", right))
    return _draw(path, x, y, left)


def require_path(path: Path) -> None:
    """Raise `TypeError` for anything but a path, `ValueError` for several or a single state."""
    cure = "give a result of jaxstab.follow. A sweep is drawn by jaxstab.plots.stability_curve."
    require_kind(path, Path, f"not a path: {cure}")
    if path.load.value.ndim != 1:
        raise ValueError("These are several paths: draw one of them, as paths[0].")
    if path.load.value.size < 2:
        raise ValueError(
            f"The path has {path.load.value.size} states ({path.result.name}), a curve two or more."
        )


def quantities_or_default(
    path: _Curve, x: Quantity | None, y: Quantity | None
) -> tuple[Quantity, Quantity]:
    """Return the quantities to draw, those given or their defaults.

    Raises:
        ValueError: for one that cannot be drawn.
    """
    is_window = path.equilibrium.is_window
    if x is None:
        x = "mean_gap"
        if is_window and path.load.unit == LENGTH:
            # The mean gap of a window grows with the window.
            x = "load"
    if y is None:
        y = default_ordinate(path.load, is_window, x)
    for name, quantity in (("x", x), ("y", y)):
        require_one_of(name, quantity, [*QUANTITIES, "load"])
    return x, y


def _draw(path: Path, x: Quantity, y: Quantity, axes: Axes) -> Axes:
    loads = np.asarray(path.load.value)
    units = path.equilibrium.units
    there, across = (of_states(path, quantity) for quantity in (x, y))
    # A state belongs to the part of the load path that leads to it.
    forth = np.sign(np.diff(loads, prepend=2 * loads[0] - loads[1]))
    part = np.cumsum(np.diff(forth, prepend=forth[0]) != 0)
    is_last = np.isin(np.arange(loads.size), np.asarray(path.jumps.state))
    branch = np.cumsum(np.concatenate([[False], is_last[:-1]]))
    largest = float(np.abs(loads).max())
    divisor, unit = readable_unit(units, path.load.unit, largest)
    for i, j in sorted(set(zip(part, branch, strict=True))):
        chosen = np.flatnonzero((part == i) & (branch == j))
        # The line starts at the state before, unless a jump lies between.
        before = chosen[0] - 1
        if before >= 0 and branch[before] == j:
            chosen = np.concatenate([[before], chosen])
        is_rising = forth[chosen[-1]] > 0
        if is_rising == (path.load.unit == LENGTH):
            name = "retraction"
            style = _RETRACTION
        else:
            name = "approach"
            style = _APPROACH
        label = None
        if j == branch[part == i][0]:
            end = f"{loads[part == i][-1] / divisor:.3g} {shown_unit(unit)}".rstrip()
            label = f"{name} to {end}"
        colour = PALETTE[i % len(PALETTE)]
        axes.plot(there[chosen], across[chosen], ".-", color=colour, label=label, **style)
    scale(axes.xaxis, path, x)
    scale(axes.yaxis, path, y)
    _draw_jumps(path, there, across, axes)
    is_loop = loads[0] == loads[-1] and np.isfinite(path.dissipation)
    if is_loop and (x, y) == quantities_or_default(path, None, None):
        axes.fill(there, across, color=grey(axes, 0.1), zorder=0)
        lost = units.text(float(path.jumps.dissipation.sum()), "energy", digits=4)
        axes.set_title(f"lost in {several(len(path.jumps), 'jump')}: {lost}")
    return axes


def _with_legend(path: Path, axes: Axes) -> Axes:
    name = path.load.quantity or type(path.load).__name__
    add_legend(axes, title=fill(name, _LEGEND_WIDTH))
    return axes


def scale(axis: XAxis | YAxis, path: _Curve, quantity: Quantity) -> None:
    """Scale and label an axis, and cut off a compression that leaves no room to see the tension."""
    values = of_states(path, quantity)
    scale_decades(axis, values)
    if quantity in ("mean_pressure", "force"):
        tension = -np.nanmin(values)
        compression = np.nanmax(values)
        if _LEAST_TENSION * compression < tension < compression:
            axis.axes.set(**{f"{axis.axis_name}lim": (-1.2 * tension, tension)})
    label_axis(axis, quantity_label(quantity, path.load), path.equilibrium.units)


def _draw_jumps(path: Path, there: np.ndarray, across: np.ndarray, axes: Axes) -> None:
    # A jump to separation has no state after it. Its dissipation is NaN, as that of the next touch.
    dissipation = np.asarray(path.jumps.dissipation)
    last = np.asarray(path.jumps.state)
    gone = last[np.isnan(dissipation)]
    kept = last[np.isfinite(dissipation)]
    if gone.size:
        axes.plot(there[gone], across[gone], "x", color=grey(axes, 0.8), label="pulled off")
    colour: Style = {"color": grey(axes, 0.6), "linestyle": "--"}
    arrow = {**colour, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}
    if kept.size:
        # Annotations have no entry in a legend.
        axes.plot([], [], marker=">", markersize=4, label="jump", **colour)
    for i in kept:
        tail, tip = ((float(there[k]), float(across[k])) for k in (i, i + 1))
        # In points; a head on a shorter jump hides it.
        length = np.hypot(*np.diff(axes.transData.transform([tail, tip]), axis=0)[0])
        length *= 72 / axes.figure.dpi
        style = "->" if length > _SHORTEST_ARROW else "-"
        drawn = axes.annotate("", tip, tail, arrowprops={**arrow, "arrowstyle": style})
        assert drawn.arrow_patch is not None
        drawn.arrow_patch.set_clip_path(axes.patch)


def of_states(path: _Curve | Turn | Observed | Sweep, quantity: Quantity) -> np.ndarray:
    """Return a quantity of each state.

    Raises:
        ValueError: for an indentation under a load that does not move the far side.
    """
    if quantity == "indentation":
        far = path.load.far_displacement(path.equilibrium.mean_pressure)
        if far is None:
            raise ValueError(
                f"The indentation under a {type(path.load).__name__} is not known, since it holds "
                "no far side: draw the mean gap, or press by a Spring or a FarDisplacement."
            )
        return -np.asarray(far)
    if quantity == "load":
        return np.asarray(path.load.value)
    return np.asarray(getattr(path.equilibrium, quantity))

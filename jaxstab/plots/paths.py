"""The states along a path, and its jumps."""

from textwrap import fill
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from jaxstab.core.checks import require_kind
from jaxstab.files.labels import dimension_on, measured
from jaxstab.paths import Branch, Path
from jaxstab.plots.style import (
    PALETTE,
    QUANTITIES,
    add_legend,
    axes_or_new,
    label_axis,
    load_label,
    quantity_label,
    scaled_label,
)

Quantity = Literal["mean_gap", "mean_pressure", "contact_area", "energy", "load"]
_Curve = Path | Branch

# Over the largest compression: less is rounding, or nothing to look at.
_LEAST_TENSION = 1e-3
# Points.
_SHORTEST_ARROW = 8
# Letters.
_LEGEND_WIDTH = 14


def path(
    path: Path,
    x: Quantity = "mean_gap",
    y: Quantity = "mean_pressure",
    *,
    unit: str | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw the states along a path, its jumps as arrows, and the energy lost around a loop.

    A compression above the largest tension is cut off, so that adhesion is seen. Without `axes`,
    the contact area is drawn beside it where surfaces touch.

    Arguments:
        path: the path.
        x: what to draw over: a field of `States` that is one number for each, or "load".
        y: what to draw, of the same kind.
        unit: that of lengths, as in `contact.unit`.
        axes: where to draw.

    Raises:
        TypeError: for something that is not a path.
        ValueError: for a quantity that cannot be drawn, and for several paths at once.
    """
    require_path(path)
    require_quantities(x, y)
    touches = np.any(np.asarray(path.equilibrium.contact_area) > 0)
    if axes is not None or y == "contact_area" or not touches:
        return _with_legend(path, unit, _draw(path, x, y, unit, axes_or_new(axes)))
    _, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    _with_legend(path, unit, _draw(path, x, "contact_area", unit, right))
    return _draw(path, x, y, unit, left)


def require_path(path: Path) -> None:
    """Raise `TypeError` for what is not a path, `ValueError` for several or one without a curve."""
    cure = "give what jaxstab.follow returned. A sweep is drawn by jaxstab.plots.stability_curve."
    require_kind(path, Path, f"not a path: {cure}")
    if path.load.value.ndim != 1:
        raise ValueError("These are several paths: draw one of them, chosen by jax.tree.map.")
    if path.load.value.size < 2:
        raise ValueError(
            f"The path has {path.load.value.size} states ({path.result.name}), a curve two or more."
        )


def require_quantities(x: str, y: str) -> None:
    """Raise `ValueError` where one of them cannot be drawn."""
    for name, quantity in (("x", x), ("y", y)):
        if quantity not in (*QUANTITIES, "load"):
            choices = ", ".join([*QUANTITIES, "load"])
            raise ValueError(f"{name} is {quantity!r}: choose one of {choices}.")


def _draw(path: Path, x: Quantity, y: Quantity, unit: str | None, axes: Axes) -> Axes:
    loads = np.asarray(path.load.value)
    there, across = (of_states(path, quantity) for quantity in (x, y))
    # A state belongs to the part of the programme that leads to it.
    forth = np.sign(np.diff(loads, prepend=2 * loads[0] - loads[1]))
    part = np.cumsum(np.diff(forth, prepend=forth[0]) != 0)
    is_last = np.isin(np.arange(loads.size), np.asarray(path.jumps.state))
    branch = np.cumsum(np.concatenate([[False], is_last[:-1]]))
    divisor, _ = _load_label(path, unit)
    for i, j in sorted(set(zip(part, branch, strict=True))):
        chosen = np.flatnonzero((part == i) & (branch == j))
        # From the state before, unless a jump lies between.
        before = chosen[0] - 1
        if before >= 0 and branch[before] == j:
            chosen = np.concatenate([[before], chosen])
        label = f"to {loads[part == i][-1] / divisor:.3g}" if j == branch[part == i][0] else None
        colour = PALETTE[i % len(PALETTE)]
        axes.plot(there[chosen], across[chosen], ".-", markersize=3, color=colour, label=label)
    scale(axes.xaxis, path, x, unit)
    scale(axes.yaxis, path, y, unit)
    _draw_jumps(path, there, across, axes)
    is_loop = loads[0] == loads[-1] and np.isfinite(path.dissipation)
    if is_loop and (x, y) == ("mean_gap", "mean_pressure"):
        axes.fill(there, across, color="0.9", zorder=0)
        number = len(path.jumps)
        lost = measured(
            unit,
            float(path.jumps.dissipation.sum()),
            dimension_on(_sides(path), "energy"),
            digits=4,
        )
        axes.set_title(f"lost in {number} jump{'' if number == 1 else 's'}: {lost}")
    return axes


def _with_legend(path: Path, unit: str | None, axes: Axes) -> Axes:
    add_legend(axes, title=fill(_load_label(path, unit)[1], _LEGEND_WIDTH))
    return axes


def _load_label(path: Path, unit: str | None) -> tuple[float, str]:
    return scaled_label(unit, load_label(path.load), np.abs(path.load.value).max())


def scale(axis: Any, path: _Curve, quantity: Quantity, unit: str | None) -> None:
    """Label an axis, and cut off a compression that leaves no room to see the tension."""
    if quantity == "mean_pressure":
        pressures = of_states(path, quantity)
        tension, compression = -np.nanmin(pressures), np.nanmax(pressures)
        if _LEAST_TENSION * compression < tension < compression:
            axis.axes.set(**{f"{axis.axis_name}lim": (-1.2 * tension, tension)})
    is_load = quantity == "load"
    label = load_label(path.load) if is_load else quantity_label(quantity, _sides(path))
    label_axis(axis, label, unit)


def _draw_jumps(path: Path, there: np.ndarray, across: np.ndarray, axes: Axes) -> None:
    # Of surfaces that a tension pulls apart no state is left.
    dissipation, last = np.asarray(path.jumps.dissipation), np.asarray(path.jumps.state)
    gone = last[np.isnan(dissipation)]
    axes.plot(there[gone], across[gone], "x", color="0.2")
    arrow = {"color": "0.4", "linestyle": "--", "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}
    for i in last[np.isfinite(dissipation)]:
        tail, tip = ((float(there[k]), float(across[k])) for k in (i, i + 1))
        # In points; a head on a shorter jump hides it.
        length = np.hypot(*np.diff(axes.transData.transform([tail, tip]), axis=0)[0])
        length *= 72 / axes.figure.dpi
        style = "->" if length > _SHORTEST_ARROW else "-"
        drawn = axes.annotate("", tip, tail, arrowprops={**arrow, "arrowstyle": style})
        assert drawn.arrow_patch is not None
        drawn.arrow_patch.set_clip_path(axes.patch)


def of_states(path: _Curve, quantity: Quantity) -> np.ndarray:
    """Return a quantity of each state."""
    values = path.load.value if quantity == "load" else getattr(path.equilibrium, quantity)
    return np.asarray(values)


def _sides(path: _Curve) -> int:
    ends = path.jumps if isinstance(path, Path) else path.turns
    return ends.mode.ndim - 1

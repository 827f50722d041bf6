"""The states along a path, and its jumps."""

from typing import Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from jaxstab.labels import with_unit
from jaxstab.paths import Path
from jaxstab.plots.style import PALETTE, QUANTITIES, axes_or_new, load_label

Quantity = Literal["mean_gap", "mean_pressure", "contact_area", "energy", "load"]


def path(
    path: Path,
    x: Quantity = "mean_gap",
    y: Quantity = "mean_pressure",
    *,
    unit: str | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw the states along a path, its jumps as arrows, and the energy lost around a loop.

    Without `axes`, the contact area is drawn beside it.

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
    for name, quantity in (("x", x), ("y", y)):
        if quantity not in (*QUANTITIES, "load"):
            choices = ", ".join([*QUANTITIES, "load"])
            raise ValueError(f"{name} is {quantity!r}: choose one of {choices}.")
    if axes is not None:
        return _draw(path, x, y, unit, axes_or_new(axes))
    _, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    _draw(path, x, "contact_area", unit, right)
    return _draw(path, x, y, unit, left)


def require_path(path: Path) -> None:
    """Raise `TypeError` for what is not a path, `ValueError` for several or one without a curve."""
    if not isinstance(path, Path):
        raise TypeError(
            f"{type(path).__name__} is not a path: give what jaxstab.follow returned. A sweep is "
            "drawn by jaxstab.plots.stability_curve."
        )
    if path.load.value.ndim != 1:
        raise ValueError("These are several paths: draw one of them, chosen by jax.tree.map.")
    if path.load.value.size < 2:
        raise ValueError(
            f"The path has {path.load.value.size} states ({path.result.name}), a curve two or more."
        )


def _draw(path: Path, x: Quantity, y: Quantity, unit: str | None, axes: Axes) -> Axes:
    loads = np.asarray(path.load.value)
    there, across = (_of_states(path, quantity) for quantity in (x, y))
    # A state belongs to the part of the programme that leads to it.
    forth = np.sign(np.diff(loads, prepend=2 * loads[0] - loads[1]))
    part = np.cumsum(np.diff(forth, prepend=forth[0]) != 0)
    is_last = np.isin(np.arange(loads.size), np.asarray(path.jumps.state))
    branch = np.cumsum(np.concatenate([[False], is_last[:-1]]))
    for i, j in sorted(set(zip(part, branch, strict=True))):
        chosen = np.flatnonzero((part == i) & (branch == j))
        # From the state before, unless a jump lies between.
        before = chosen[0] - 1
        if before >= 0 and branch[before] == j:
            chosen = np.concatenate([[before], chosen])
        label = f"to {loads[part == i][-1]:.3g}" if j == branch[part == i][0] else None
        colour = PALETTE[i % len(PALETTE)]
        axes.plot(there[chosen], across[chosen], ".-", markersize=3, color=colour, label=label)
    _draw_jumps(path, there, across, axes)
    is_loop = loads[0] == loads[-1] and np.isfinite(path.dissipation)
    if is_loop and (x, y) == ("mean_gap", "mean_pressure"):
        axes.fill(there, across, color="0.9", zorder=0)
        axes.set_title(f"lost around the loop: {float(path.dissipation):.4g} [energy]")
    axes.set(xlabel=_label(path, x, unit), ylabel=_label(path, y, unit))
    axes.legend(title=_label(path, "load", unit))
    return axes


def _draw_jumps(path: Path, there: np.ndarray, across: np.ndarray, axes: Axes) -> None:
    # Of surfaces that a tension pulls apart no state is left.
    dissipation, last = np.asarray(path.jumps.dissipation), np.asarray(path.jumps.state)
    gone = last[np.isnan(dissipation)]
    axes.plot(there[gone], across[gone], "x", color="0.2")
    arrow = {"arrowstyle": "->", "color": "0.4", "linestyle": "--", "shrinkA": 0, "shrinkB": 0}
    for i in last[np.isfinite(dissipation)]:
        tip, tail = ((float(there[k]), float(across[k])) for k in (i + 1, i))
        axes.annotate("", tip, tail, arrowprops={**arrow, "mutation_scale": 7})


def _of_states(path: Path, quantity: Quantity) -> np.ndarray:
    values = path.load.value if quantity == "load" else getattr(path.equilibrium, quantity)
    return np.asarray(values)


def _label(path: Path, quantity: Quantity, unit: str | None) -> str:
    label = load_label(path.load) if quantity == "load" else QUANTITIES[quantity]
    return with_unit(unit, label)

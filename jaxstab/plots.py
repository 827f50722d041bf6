"""Figures: each function draws into a Matplotlib `Axes`, its own or a given one, and returns it."""

from collections.abc import Callable, Sequence
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Array, Float
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.image import AxesImage

from jaxstab.contact import Contact
from jaxstab.equilibrium.state import State, equilibrium_of
from jaxstab.grid import Grid
from jaxstab.loads import MeanDisplacement, MeanGap, MeanPressure, Spring
from jaxstab.paths import Path
from jaxstab.potentials import Potential, energy_density, slope
from jaxstab.stability import Eigenpair
from jaxstab.stacks import require_single
from jaxstab.sweeps import Sweep

Quantity = Literal["mean_gap", "mean_pressure", "contact_area", "energy", "load"]


def surface(contact: Contact, *, axes: Axes | None = None) -> Axes:
    """Draw the heights h: a map, or a profile on a line."""
    return _field(contact.grid, contact.heights, "height h [length]", "cividis", axes)


def gap(contact: Contact, equilibrium: State, *, axes: Axes | None = None) -> Axes:
    """Draw the gap g: a map, or a profile on a line."""
    return _field(
        contact.grid, equilibrium_of(contact, equilibrium).gap, "gap g [length]", "viridis", axes
    )


def pressure(contact: Contact, equilibrium: State, *, axes: Axes | None = None) -> Axes:
    """Draw the elastic pressure p, positive in compression: a map, or a profile on a line."""
    field, label = equilibrium_of(contact, equilibrium).pressure, "elastic pressure p [pressure]"
    return _field(contact.grid, field, label, "RdBu_r", axes, centred=True)


def contact_map(contact: Contact, equilibrium: State, *, axes: Axes | None = None) -> Axes:
    """Draw where the surfaces touch, in black (Rey & Bleyer, fig. 8)."""
    equilibrium = equilibrium_of(contact, equilibrium)
    axes = _axes(axes)
    touches = np.asarray(equilibrium.in_contact)
    x, *y = (np.asarray(side) for side in contact.grid.coordinates)
    if y:
        colours, norm = ListedColormap(["white", "black"]), BoundaryNorm([0, 0.5, 1], 2)
        _map(axes, contact.grid, touches, cmap=colours, norm=norm)
    else:
        axes.fill_between(x, touches, step="mid", color="black")
        axes.set(xlabel="x [length]", yticks=[0, 1], yticklabels=["apart", "in contact"])
    axes.set_title(f"contact area {100 * float(equilibrium.contact_area):.1f} %")
    return axes


def mode(contact: Contact, pair: Eigenpair, *, axes: Axes | None = None) -> Axes:
    """Draw a mode of unit norm: a map, or a profile on a line (Rey & Bleyer, fig. 9)."""
    require_single(pair)
    axes = _field(contact.grid, pair.mode, "mode x [1]", "RdBu_r", axes, centred=True)
    axes.set_title(rf"$\lambda$ = {float(pair.eigenvalue):.4g} [pressure/length]")
    return axes


def mode_cut(
    contact: Contact,
    pair: Eigenpair,
    equilibrium: State | None = None,
    *,
    row: int | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw a mode along x at one row of y, and where that row is in contact.

    Arguments:
        contact: the contact problem, on a two-dimensional grid.
        pair: the eigenpair whose mode to draw.
        equilibrium: shades the points in contact if given.
        row: index along y, by default the middle of the cell (Rey & Bleyer, fig. 4b).
        axes: where to draw.

    Raises:
        ValueError: on a line, which has no rows, and for a stack of modes or of states.
    """
    if len(contact.grid.shape) != 2:
        raise ValueError("A mode on a line has no rows: draw it with jaxstab.plots.mode.")
    require_single(pair)
    axes = _axes(axes)
    row = contact.grid.shape[1] // 2 if row is None else row
    x, y = (np.asarray(side) for side in contact.grid.coordinates)
    axes.plot(x[:, row], np.asarray(pair.mode)[:, row], ".-")
    axes.axhline(0, color="0.6", linewidth=0.8)
    if equilibrium is not None:
        touches = np.asarray(equilibrium_of(contact, equilibrium).in_contact)[:, row]
        across = axes.get_xaxis_transform()
        axes.fill_between(
            x[:, row], 0, 1, where=touches, transform=across, color="0.88", label="in contact"
        )
        axes.legend()
    axes.set(xlabel="x [length]", ylabel="mode x [1]", title=f"at y = {y[0, row]:.4g}")
    return axes


def potential(
    laws: Potential | Sequence[Potential],
    gaps: Float[Array, " gaps"],
    *,
    labels: Sequence[str] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw interaction laws f(g) (Rey & Bleyer, fig. 7a).

    Arguments:
        laws: one or more functions of the gap.
        gaps: where to draw them [length].
        labels: their names, by default those of their classes.
        axes: where to draw.
    """
    return _laws(energy_density, "energy per area f(g)", laws, gaps, labels, axes)


def force(
    laws: Potential | Sequence[Potential],
    gaps: Float[Array, " gaps"],
    *,
    labels: Sequence[str] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw the attraction f'(g) of interaction laws (Rey & Bleyer, fig. 7b)."""
    return _laws(slope, "attraction f'(g) [pressure]", laws, gaps, labels, axes)


def convergence(pair: Eigenpair, *, axes: Axes | None = None) -> Axes:
    """Draw the indicators of the eigensolver over its steps (Rey & Bleyer, fig. 5)."""
    require_single(pair)
    axes = _axes(axes)
    for name, values in pair.history.values.items():
        label = "projected residual" if name == "residual" else rf"$\{name}$"
        # At the start epsilon and eta are zero by construction.
        axes.semilogy(pair.history.steps[1:], values[1:], label=label)
    axes.set(xlabel="step", ylabel="indicator [1]")
    axes.legend()
    return axes


def stability_curve(
    sweep: Sweep,
    quantity: Literal["mean_pressure", "contact_area", "energy"] = "mean_pressure",
    *,
    axes: Axes | None = None,
) -> Axes:
    """Draw a quantity over the load, with filled markers where it is stable (Rey & Bleyer, 12).

    Arguments:
        sweep: the states.
        quantity: a field of `Equilibrium` that is one number for each load.
        axes: where to draw.

    Raises:
        ValueError: for a quantity that cannot be drawn, a single state, or a sweep without
            stability.
    """
    if quantity not in _CURVES:
        raise ValueError(f"quantity is {quantity!r}: choose one of {', '.join(_CURVES)}.")
    if not isinstance(sweep, Sweep) or len(sweep.stack_shape) != 1:
        raise ValueError(
            "stability_curve draws a whole sweep over one axis of loads: give it what "
            "jaxstab.sweep returned, not a state of it."
        )
    if sweep.stability is None:
        raise ValueError("This sweep left stability out: run it with stability=True.")
    axes = _axes(axes)
    load, values = np.asarray(sweep.load.value), np.asarray(getattr(sweep.equilibrium, quantity))
    axes.plot(load, values, color="0.8", linewidth=1, zorder=1)
    for name, face in _MARKERS.items():
        chosen = np.asarray(sweep.stability.verdict == name)
        if chosen.any():
            marks = axes.scatter(load[chosen], values[chosen], label=name.replace("_", " "))
            marks.set(facecolors=face, edgecolors="C0")
    axes.set(xlabel=_LOADS[type(sweep.load)], ylabel=_CURVES[quantity])
    axes.legend()
    return axes


def path(
    path: Path,
    x: Quantity = "mean_gap",
    y: Quantity = "mean_pressure",
    *,
    axes: Axes | None = None,
) -> Axes:
    """Draw the states along a path, its jumps as arrows, and the energy lost around a loop.

    Without `axes`, the contact area is drawn beside it.

    Arguments:
        path: the path.
        x: what to draw over: a field of `States` that is one number for each, or "load".
        y: what to draw, of the same kind.
        axes: where to draw.

    Raises:
        ValueError: for a quantity that cannot be drawn, and for several paths at once.
    """
    for name, quantity in (("x", x), ("y", y)):
        if quantity not in (*_PATH_CURVES, "load"):
            choices = ", ".join([*_PATH_CURVES, "load"])
            raise ValueError(f"{name} is {quantity!r}: choose one of {choices}.")
    if path.load.value.ndim != 1:
        raise ValueError("These are several paths: draw one of them, chosen by jax.tree.map.")
    if axes is not None:
        return _draw_path(path, x, y, axes)
    _, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    _draw_path(path, x, "contact_area", right)
    return _draw_path(path, x, y, left)


def _draw_path(path: Path, x: Quantity, y: Quantity, axes: Axes) -> Axes:
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
        axes.plot(
            there[chosen], across[chosen], ".-", markersize=3, color=f"C{i % 10}", label=label
        )
    # Of surfaces that a tension pulls apart no state is left.
    dissipation, last = np.asarray(path.jumps.dissipation), np.asarray(path.jumps.state)
    gone = last[np.isnan(dissipation)]
    axes.plot(there[gone], across[gone], "x", color="0.2")
    arrow = {"arrowstyle": "->", "color": "0.4", "linestyle": "--", "shrinkA": 0, "shrinkB": 0}
    for i in last[np.isfinite(dissipation)]:
        tip, tail = ((float(there[k]), float(across[k])) for k in (i + 1, i))
        axes.annotate("", tip, tail, arrowprops={**arrow, "mutation_scale": 7})
    is_loop = loads[0] == loads[-1] and np.isfinite(path.dissipation)
    if is_loop and (x, y) == ("mean_gap", "mean_pressure"):
        axes.fill(there, across, color="0.9", zorder=0)
        axes.set_title(f"lost around the loop: {float(path.dissipation):.4g} [energy]")
    axes.set(xlabel=_label(path, x), ylabel=_label(path, y))
    axes.legend(title=_label(path, "load"))
    return axes


def _of_states(path: Path, quantity: Quantity) -> np.ndarray:
    values = path.load.value if quantity == "load" else getattr(path.equilibrium, quantity)
    return np.asarray(values)


def _label(path: Path, quantity: Quantity) -> str:
    return _LOADS[type(path.load)] if quantity == "load" else _PATH_CURVES[quantity]


_MARKERS = {"stable": "C0", "held_by_contact": "lightblue", "unstable": "C3", "undecided": "white"}
_CURVES = {
    "mean_pressure": "mean pressure $p_0$ [pressure]",
    "contact_area": "contact area [1]",
    "energy": "energy [energy]",
}
_PATH_CURVES = {"mean_gap": "mean gap $g_0$ [length]", **_CURVES}
_LOADS = {
    MeanDisplacement: "mean displacement $u_0$ [length]",
    MeanGap: "mean gap $g_0$ [length]",
    MeanPressure: "mean pressure $p_0$ [pressure]",
    Spring: "position of the spring [length]",
}


def _axes(axes: Axes | None) -> Axes:
    return plt.subplots(layout="constrained")[1] if axes is None else axes


def _field(
    grid: Grid,
    field: Float[Array, " *grid"],
    label: str,
    colours: str,
    axes: Axes | None,
    centred: bool = False,
) -> Axes:
    """Draw a field as a map with a colour bar, or on a line as a profile."""
    axes = _axes(axes)
    values = np.asarray(field)
    if values.ndim == 1:
        axes.plot(np.asarray(grid.coordinates[0]), values)
        axes.set(xlabel="x [length]", ylabel=label)
        return axes
    limit = np.abs(values).max() if centred else None
    image = _map(axes, grid, values, cmap=colours, vmin=limit and -limit, vmax=limit)
    axes.figure.colorbar(image, ax=axes, label=label)
    return axes


def _map(axes: Axes, grid: Grid, values: np.ndarray, **style: Any) -> AxesImage:
    width, height = (float(length) for length in grid.lengths)
    # The first index runs along x, and each point stands in the middle of its pixel.
    dx, dy = (float(spacing) / 2 for spacing in grid.spacing)
    extent = (-dx, width - dx, -dy, height - dy)
    image = axes.imshow(values.T, origin="lower", extent=extent, interpolation="nearest", **style)
    axes.set(xlabel="x [length]", ylabel="y [length]")
    return image


def _laws(
    derivative: Callable[[Potential, Float[Array, " gaps"]], Float[Array, " gaps"]],
    ylabel: str,
    laws: Potential | Sequence[Potential],
    gaps: Float[Array, " gaps"],
    labels: Sequence[str] | None,
    axes: Axes | None,
) -> Axes:
    axes = _axes(axes)
    laws = [laws] if callable(laws) else list(laws)
    labels = [type(law).__name__ for law in laws] if labels is None else labels
    for law, label in zip(laws, labels, strict=True):
        axes.plot(np.asarray(gaps), np.asarray(derivative(law, gaps)), label=label)
    axes.axhline(0, color="0.6", linewidth=0.8)
    axes.set(xlabel="gap g [length]", ylabel=ylabel)
    axes.legend()
    return axes

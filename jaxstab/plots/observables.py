"""Observables of a contact: patches, flow through the gap, distributions of pressures and gaps."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm

from jaxstab.contact import Contact, require_contact
from jaxstab.core.checks import integer, require, require_kind, require_one_of
from jaxstab.core.stack import require_single
from jaxstab.core.units import NUMBER, dimensions
from jaxstab.equilibrium import observables
from jaxstab.equilibrium.equilibrium import State, found_equilibrium
from jaxstab.equilibrium.observables import Leakage
from jaxstab.equilibrium.observables.clusters import Neighbours
from jaxstab.observation.observe import Observed, by_side
from jaxstab.plots.fields import add_colour_bar, draw_areas, draw_map, outline_contact, require_own
from jaxstab.plots.paths import Quantity, of_states
from jaxstab.plots.style import (
    PALETTE,
    QUANTITIES,
    add_legend,
    axes_or_new,
    grey,
    label_axes,
    plain_decades,
    quantity_label,
    scale_decades,
    with_dimension,
)

# The lower end of the colours, over the largest flux.
_FAINTEST = 1e-4
_SIDES = "xy"


def patches(
    contact: Contact,
    equilibrium: State,
    *,
    neighbours: Neighbours = 4,
    axes: Axes | None = None,
) -> Axes:
    """Draw the patches of a contact, coloured in the order of their areas.

    Arguments:
        contact: the contact problem.
        equilibrium: one of its states.
        neighbours: as in `jaxstab.patches`.
        axes: the axes to draw on; new ones by default.

    Example:
        >>> axes = js.plots.patches(contact, state)
    """
    found = observables.patches(contact, equilibrium, neighbours=neighbours)
    labels = np.asarray(found.labels)
    colours = PALETTE
    # Colours repeat when there are more patches.
    numbers = np.where(labels > 0, (labels - 1) % len(colours) + 1, 0)
    axes = draw_areas(axes, contact, numbers, colours)
    number = int(found.number)
    percolates = np.asarray(found.percolates)
    along = [name for name, is_so in zip(_SIDES, percolates, strict=False) if is_so]
    title = f"{number} patch{'es' * (number != 1)}"
    if along:
        title += f", percolating along {' and '.join(along)}"
    axes.set_title(title)
    return axes


def flow(
    contact: Contact,
    leakage: Leakage,
    equilibrium: State | None = None,
    *,
    along: Literal["x", "y"] = "x",
    axes: Axes | None = None,
) -> Axes:
    """Draw the flow through the gap: a map of the flux with streamlines, or drops on a line.

    Arguments:
        contact: the contact problem.
        leakage: a result of `jaxstab.leakage` for it.
        equilibrium: fills the contact if given, or shades it on a line.
        along: the side along which the pressure falls.
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: for anything but a leakage.
        ValueError: for a stack, a leakage without fields or on another grid, and a side that does
            not exist.

    Example:
        >>> open = js.equilibrate(contact, js.MeanGap(0.1))
        >>> axes = js.plots.flow(contact, js.leakage(contact, open), open)
    """
    require_contact(contact)
    require_kind(leakage, Leakage, "no leakage: give a result of jaxstab.leakage.")
    require_single(leakage)
    shape = contact.grid.shape
    if leakage.drop is None or leakage.flux is None:
        raise ValueError(
            "A leakage along a path has no fields to draw: give one of a state, as jaxstab."
            "leakage(contact, state)."
        )
    require_own(contact, leakage.drop.shape[1:], "leakage")
    require_one_of("along", along, _SIDES[: len(shape)])
    axes = axes_or_new(axes)
    touches = None
    if equilibrium is not None:
        touches = found_equilibrium(contact, equilibrium).in_contact
    side = _SIDES.index(along)
    if len(shape) == 1:
        axes.plot(np.asarray(contact.grid.coordinates[0]), np.asarray(leakage.drop[0]))
        if touches is not None:
            outline_contact(axes, contact, touches, "black")
        label_axes(axes, "x [length]", "drop of pressure over its gradient [length]", contact.units)
    else:
        # At points, the mean over the two faces along each side.
        faces = enumerate(np.asarray(leakage.flux[side]))
        _draw_flux(axes, contact, np.stack([(x + np.roll(x, 1, i)) / 2 for i, x in faces]))
        if touches is not None:
            shown = np.ma.masked_equal(np.asarray(touches), False)
            draw_map(axes, contact, shown, cmap=ListedColormap(["0.35"]))
    title = f"nothing flows along {along}"
    if np.asarray(leakage.flux[side]).any():
        title = f"pressure falls along {along}"
    axes.set_title(title)
    return axes


def _draw_flux(axes: Axes, contact: Contact, flux: np.ndarray) -> None:
    size = np.hypot(*flux)
    most = size.max()
    if not most:
        draw_map(axes, contact, np.zeros(size.shape), cmap=ListedColormap(["white"]))
        return
    norm = LogNorm(_FAINTEST * most, most)
    shown = np.ma.masked_equal(size, 0)
    image = draw_map(axes, contact, shown, cmap="Blues", norm=norm)
    add_colour_bar(axes, image, "flux x viscosity / gradient of pressure [length^3]", contact.units)
    limits = axes.get_xlim(), axes.get_ylim()
    x, y = (np.asarray(side) for side in contact.grid.coordinates)
    # Streamlines are left out where the flux is negligible.
    u, v = (np.where(size > _FAINTEST * most, part, np.nan).T for part in flux)
    axes.streamplot(x[:, 0], y[0], u, v, color="black", linewidth=0.6, arrowsize=0.7, density=1.5)
    axes.set(xlim=limits[0], ylim=limits[1])


def observed(
    observed: Observed,
    column: str | None = None,
    x: Quantity = "load",
    *,
    axes: Axes | None = None,
) -> Axes:
    """Draw a column of the observables beside the states of a path or a sweep.

    What spans decades is on a logarithmic axis, which leaves out zeros of the column.

    Arguments:
        observed: the result of `jaxstab.observe`.
        column: "observable.field", as "patches.true_area"; by default the first. One for each side
            of the grid is a curve for each.
        x: the abscissa: the load, or a quantity of the states, as in `path`.
        axes: where to draw.

    Raises:
        TypeError: for something else than observables.
        ValueError: for a column or a quantity that is not there.

    Example:
        >>> sweep = js.sweep(contact, js.MeanGap([0.03, 0.05]))
        >>> axes = js.plots.observed(js.observe(contact, sweep, js.patches), "patches.number")
    """
    require_kind(observed, Observed, "no observables: give the result of jaxstab.observe.")
    results = observed.observables
    columns = {f"{key}.{name}": key for key in results for name in results[key].columns()}
    first, result = next(iter(results.items()))
    column = column or f"{first}.{(result.shown or result.columns())[0]}"
    require_one_of("column", column, columns)
    require_one_of("x", x, [*QUANTITIES, "load"])
    result = results[columns[column]]
    name = column.rpartition(".")[2]
    axes = axes_or_new(axes)
    units = observed.equilibrium.units
    across = of_states(observed, x)
    sides = {side.strip(): np.asarray(values) for side, values in by_side(getattr(result, name))}
    for side, values in sides.items():
        axes.plot(across, values, ".-", label=side)
    scale_decades(axes.xaxis, across)
    every = np.concatenate([*sides.values()])
    # A seal lets nothing through from some load on.
    scale_decades(axes.yaxis, every[every != 0])
    dimension = dimensions(type(result)).get(name, NUMBER)
    words = dict.fromkeys((columns[column], name))
    label = with_dimension(" ".join(words).replace("_", " "), dimension)
    label_axes(axes, quantity_label(x, observed.load), label, units)
    if len(axes.lines) > 1:
        add_legend(axes)
    return axes


def distribution(
    contact: Contact,
    equilibrium: State,
    quantity: Literal["pressure", "gap"] = "pressure",
    *,
    bins: int = 50,
    axes: Axes | None = None,
) -> Axes:
    """Draw the distribution of pressures or gaps over the points of a surface.

    Densities are over all points: the integral over pressures in contact is the contact area, the
    integral over gaps one less the contact area. Points apart without attraction have no pressure,
    and are left out. With attraction the densities of pressures are on a logarithmic axis.

    For a law without attraction in a periodic cell, Persson's distribution of the pressure on a
    randomly rough surface (2001) is drawn too: P(p) = (N(p - p0) - N(p + p0)), N the normal
    distribution with the variance of the pressure in full contact.

    Arguments:
        contact: the contact problem.
        equilibrium: one of its states.
        quantity: "pressure", the elastic one, or "gap".
        bins: the number of bins.
        axes: the axes to draw on; new ones by default.

    Raises:
        ValueError: for another quantity, and less than one bin.

    Example:
        >>> axes = js.plots.distribution(contact, state)
    """
    equilibrium = found_equilibrium(contact, equilibrium)
    require_one_of("quantity", quantity, ["pressure", "gap"])
    require("bins", integer("bins", bins), bins > 0, "give at least 1.")
    attracts = float(contact.profile.max_attraction) > 0
    is_known = quantity == "pressure" and not attracts and not contact.solid.is_window
    axes = axes_or_new(axes)
    touches = np.asarray(equilibrium.in_contact)
    values = np.asarray(getattr(equilibrium, quantity), float)
    parts = {}
    if quantity == "pressure":
        parts["in contact"] = values[touches]
    if attracts or quantity == "gap":
        parts["apart"] = values[~touches]
    parts = {name: part for name, part in parts.items() if part.size}
    shown = np.concatenate([*parts.values(), np.zeros(1)])
    edges = np.linspace(shown.min(), shown.max(), bins + 1)
    if not shown.any():
        parts = {}
    for name, part in parts.items():
        counts = np.histogram(part, edges)[0]
        axes.stairs(counts / (values.size * np.diff(edges)), edges, label=name, linewidth=1.2)
    if is_known:
        rms = float(contact.conforming_pressure)
        mean = float(equilibrium.mean_pressure)
        pressures = np.linspace(0, max(shown.max(), rms), 200)
        (theory,) = axes.plot(pressures, _persson(pressures, mean, rms), "--", color=grey(axes, 1))
        theory.set_label("Persson, random surface")
    names = {"pressure": "elastic pressure p", "gap": "gap g"}
    dimension = {"pressure": "pressure", "gap": "length"}[quantity]
    label_axes(axes, f"{names[quantity]} [{dimension}]", f"density [1/{dimension}]", contact.units)
    if quantity == "pressure" and "apart" in parts:
        # Most points are apart, at nearly equal pressures.
        axes.set_yscale("log")
        plain_decades(axes.yaxis)
    else:
        axes.set_ylim(bottom=0)
    axes.set_title(f"contact area {100 * float(equilibrium.contact_area):.1f} %")
    add_legend(axes)
    return axes


def _persson(pressures: np.ndarray, mean: float, rms: float) -> np.ndarray:
    """Return (N(p - p0) - N(p + p0)), N the normal distribution (Persson, 2001)."""
    if not rms:
        return np.zeros_like(pressures)

    def normal(pressure: np.ndarray) -> np.ndarray:
        return np.exp(-((pressure / rms) ** 2) / 2) / (np.sqrt(2 * np.pi) * rms)

    return normal(pressures - mean) - normal(pressures + mean)

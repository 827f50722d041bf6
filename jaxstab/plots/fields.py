"""Fields over the surface: maps, profiles on a line, and profiles beside a disc on rings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.image import AxesImage

from jaxstab.contact import Contact, require_contact
from jaxstab.core.checks import integer, require, require_kind, require_shape
from jaxstab.core.grid import Mesh
from jaxstab.core.rings import Rings
from jaxstab.core.stack import require_single
from jaxstab.core.types import Field, Mask
from jaxstab.core.units import Units
from jaxstab.equilibrium.equilibrium import State, found_equilibrium
from jaxstab.plots.style import (
    BLACK,
    VERMILION,
    add_legend,
    axes_or_new,
    draw_zero,
    grey,
    label_axes,
    label_axis,
)
from jaxstab.stability import Eigenpair

# The symbol x of a mode is left out, since x is a side of the surface too.
_MODE = "mode of unit norm"
# Points across the picture of a disc, and its place beside the axes.
_PIXELS = 301
_BESIDE = (1.02, 0.35, 0.3, 0.3)


def surface(contact: Contact, *, axes: Axes | None = None) -> Axes:
    """Draw the heights h, above the datum if it is not zero: a map, or a profile on a line.

    Example:
        >>> axes = js.plots.surface(contact)
    """
    require_contact(contact)
    datum = float(contact.datum)
    # A large datum would cost their digits, and all ticks would be alike.
    label = "height h"
    if datum:
        label += f" above {contact.units.text(datum, 'length', digits=6)}"
    return _field(contact, contact.heights, f"{label} [length]", "cividis", axes)


def gap(contact: Contact, equilibrium: State, *, axes: Axes | None = None) -> Axes:
    """Draw the gap g: a map, or a profile on a line.

    Example:
        >>> axes = js.plots.gap(contact, state)
    """
    equilibrium = found_equilibrium(contact, equilibrium)
    return _field(contact, equilibrium.gap, "gap g [length]", "viridis", axes)


def pressure(contact: Contact, equilibrium: State, *, axes: Axes | None = None) -> Axes:
    """Draw the elastic pressure p, positive in compression: a map, or a profile on a line.

    Example:
        >>> axes = js.plots.pressure(contact, state)
    """
    field = found_equilibrium(contact, equilibrium).pressure
    label = "elastic pressure p [pressure]"
    return _field(contact, field, label, "RdBu_r", axes, centred=True)


def contact_map(contact: Contact, equilibrium: State, *, axes: Axes | None = None) -> Axes:
    """Draw where surfaces touch (Rey & Bleyer, fig. 8): black, and orange where they yield.

    Example:
        >>> axes = js.plots.contact_map(contact, state)
    """
    equilibrium = found_equilibrium(contact, equilibrium)
    numbers, colours = np.asarray(equilibrium.in_contact, int), [BLACK]
    title = f"contact area {100 * float(equilibrium.contact_area):.1f} %"
    is_yielding = equilibrium.is_yielding
    if is_yielding is not None:
        yielding = np.asarray(is_yielding)
        numbers, colours = numbers + yielding, [BLACK, VERMILION]
        title += f", yielding {100 * yielding.mean():.1f} %"
    axes = draw_areas(axes, contact, numbers, colours)
    axes.set_title(title)
    return axes


def draw_areas(
    axes: Axes | None, contact: Contact, numbers: np.ndarray, colours: Sequence[str]
) -> Axes:
    """Draw the points of each number from 1 on in its colour: a map, or bars on a line."""
    axes = axes_or_new(axes)
    if numbers.ndim == 2:
        norm = BoundaryNorm(np.arange(len(colours) + 2) - 0.5, len(colours) + 1)
        draw_map(axes, contact, numbers, cmap=ListedColormap(["white", *colours]), norm=norm)
        return axes
    edges = _edges(contact.grid)
    for number, colour in enumerate(colours, 1):
        if colour == BLACK:
            colour = grey(axes, 1)
        _fill(axes, edges, numbers == number, color=colour)
    axes.margins(0)
    label_axis(axes.xaxis, f"{contact.grid.sides[0]} [length]", contact.units)
    axes.set(yticks=[0, 1], yticklabels=["apart", "in contact"])
    return axes


def mode(
    contact: Contact,
    pair: Eigenpair,
    equilibrium: State | None = None,
    *,
    axes: Axes | None = None,
) -> Axes:
    """Draw a mode of unit norm: a map, or a profile on a line (Rey & Bleyer, fig. 9).

    Arguments:
        contact: the contact problem.
        pair: the eigenpair whose mode to draw.
        equilibrium: outlines the contact if given, or shades it on a line.
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: for anything but an eigenpair, for instance `stability.cone`.
        ValueError: for a stack of modes, or one on another grid than the contact's.

    Example:
        >>> axes = js.plots.mode(contact, js.assess_stability(contact, state).cone, state)
    """
    _require_mode(contact, pair)
    axes = draw_mode(contact, pair.mode, equilibrium, axes)
    value = contact.units.text(float(pair.eigenvalue), "pressure/length", digits=4)
    axes.set_title(rf"$\lambda$ = {value}")
    return axes


def draw_mode(contact: Contact, mode: Field, equilibrium: State | None, axes: Axes | None) -> Axes:
    """Draw a mode of unit norm, and the outline of the contact where a state is given."""
    axes = _field(contact, mode, _MODE, "RdBu_r", axes, centred=True)
    if equilibrium is not None:
        touches = found_equilibrium(contact, equilibrium).in_contact
        outline_contact(axes, contact, touches, "black")
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
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: as `mode`.
        ValueError: as `mode`, on a line, which has no rows, and for a stack of states.

    Example:
        >>> axes = js.plots.mode_cut(contact, js.assess_stability(contact, state).cone, state)
    """
    if len(contact.grid.shape) != 2:
        raise ValueError("A mode on a line has no rows: draw it with jaxstab.plots.mode.")
    _require_mode(contact, pair)
    axes = axes_or_new(axes)
    rows = contact.grid.shape[1]
    row = rows // 2 if row is None else integer("row", row)
    require("row", row, -rows <= row < rows, f"the grid has {rows} rows along y.")
    x, y = (np.asarray(side) for side in contact.grid.coordinates)
    axes.plot(x[:, row], np.asarray(pair.mode)[:, row], ".-")
    draw_zero(axes)
    if equilibrium is not None:
        touches = np.asarray(found_equilibrium(contact, equilibrium).in_contact)[:, row]
        _shade(axes, _edges_between(x[:, row]), touches)
        add_legend(axes)
    label_axis(axes.xaxis, "x [length]", contact.units)
    place = contact.units.text(float(y[0, row]), "length", digits=4)
    axes.set(ylabel=_MODE, title=f"at y = {place}")
    return axes


def require_own(contact: Contact, shape: tuple[int, ...], name: str) -> None:
    """Raise `ValueError` if something has another shape than the grid of the contact."""
    cure = "use the contact that it came from."
    require_shape(f"A field of the {name}", shape, contact.grid.shape, cure)


def require_pair(pair: Eigenpair) -> None:
    """Raise `TypeError` for anything but an eigenpair, and `ValueError` for a stack."""
    cure = "give one of a stability, for instance `stability.cone`."
    require_kind(pair, Eigenpair, f"not an eigenpair: {cure}")
    require_single(pair)


def outline_contact(axes: Axes, contact: Contact, touches: Mask, colour: str) -> None:
    """Outline on a map, or shade on a profile, where the surfaces touch."""
    x, *y = (np.asarray(side) for side in contact.grid.coordinates)
    inside = np.asarray(touches)
    if not y:
        _shade(axes, _edges(contact.grid), inside)
    elif inside.any() and not inside.all():
        axes.contour(x, y[0], inside, levels=[0.5], colors=colour, linewidths=0.8)


def draw_map(axes: Axes, contact: Contact, values: np.ndarray, **style: Any) -> AxesImage:
    """Draw a field as an image over x and y."""
    width, height = (float(length) for length in contact.grid.lengths)
    # The first index runs along x, and each point stands in the middle of its pixel.
    dx, dy = (float(spacing) / 2 for spacing in contact.grid.spacing)
    extent = (-dx, width - dx, -dy, height - dy)
    image = axes.imshow(values.T, origin="lower", extent=extent, interpolation="nearest", **style)
    label_axes(axes, "x [length]", "y [length]", contact.units)
    return image


def add_colour_bar(axes: Axes, image: AxesImage, label: str, units: Units) -> None:
    """Add a colour bar as high as the map."""
    bar = axes.figure.colorbar(image, cax=axes.inset_axes((1.03, 0, 0.05, 1)))
    label_axis(bar.ax.yaxis, label, units)


def _field(
    contact: Contact,
    field: Field,
    label: str,
    colours: str,
    axes: Axes | None,
    centred: bool = False,
) -> Axes:
    axes = axes_or_new(axes)
    values = np.asarray(field)
    least = values.min()
    most = values.max()
    if centred:
        most = np.abs(values).max()
        least = -most
    elif not values.any():
        # A closed gap is zero everywhere.
        most = 1
    style = {"cmap": colours, "vmin": least, "vmax": most}
    if values.ndim == 1:
        axes.plot(np.asarray(contact.grid.coordinates[0]), values)
        label_axes(axes, f"{contact.grid.sides[0]} [length]", label, contact.units)
        if isinstance(contact.grid, Rings):
            _draw_disc(axes, values, **style)
        return axes
    image = draw_map(axes, contact, values, **style)
    add_colour_bar(axes, image, label, contact.units)
    return axes


def _draw_disc(axes: Axes, values: np.ndarray, **style: Any) -> None:
    """Draw a field on rings as a disc, seen from above, beside its profile."""
    across = np.linspace(-1, 1, _PIXELS)
    # Of N rings of equal area, N (r/R)^2 lie within r.
    ring = (values.size * (across[:, None] ** 2 + across**2)).astype(int)
    seen = np.ma.masked_where(ring >= values.size, values[np.minimum(ring, values.size - 1)])
    disc = axes.inset_axes(_BESIDE)
    disc.imshow(seen, interpolation="nearest", **style)
    disc.set_axis_off()


def _shade(axes: Axes, edges: np.ndarray, touches: np.ndarray) -> None:
    shade = grey(axes, 0.12)
    transform = axes.get_xaxis_transform()
    _fill(axes, edges, touches, transform=transform, color=shade, label="in contact")


def _edges(grid: Mesh) -> np.ndarray:
    """Return the edges of the intervals around the points of a line, or of rings."""
    if isinstance(grid, Rings):
        return np.asarray(grid.edges)
    return _edges_between(np.asarray(grid.coordinates[0]))


def _edges_between(x: np.ndarray) -> np.ndarray:
    """Return the edges of the intervals around equidistant points, each as wide as the spacing."""
    return np.append(x, 2 * x[-1] - x[-2]) - (x[1] - x[0]) / 2


def _fill(axes: Axes, edges: np.ndarray, chosen: np.ndarray, **style: Any) -> None:
    """Fill the chosen ones of the intervals between edges, and show the whole line."""
    axes.fill_between(np.repeat(edges, 2)[1:-1], 0, 1, where=np.repeat(chosen, 2), **style)
    axes.update_datalim(np.stack([edges, edges], axis=1), updatey=False)
    axes.autoscale_view()


def _require_mode(contact: Contact, pair: Eigenpair) -> None:
    require_pair(pair)
    require_own(contact, pair.mode.shape, "mode")

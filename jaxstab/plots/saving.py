"""Figures as files, at the sizes that journals print."""

from collections.abc import Collection
from copy import deepcopy
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import Collection as Marks
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text

from jaxstab.core.atomic_write import require_writable, write_whole
from jaxstab.core.checks import require_kind
from jaxstab.core.warn import warn

Width = Literal["single", "double"] | float

# Millimetres, as of most journals' columns.
_WIDTHS = {"single": 90.0, "double": 190.0}
_MM = 1 / 25.4
# Points.
_FONT = 8
_TICK_FONT = 7
# Thinner lines do not print.
_MOST_SHRUNK = 0.5
_DPI = 300
# A figure that is printed at less of its width is full of letters.
_MOST_CROWDED = 0.45
# Letters stay letters, which can be searched and edited.
_AS_TEXT: dict[Any, Any] = {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "none"}


def save(
    figure: Figure | Axes,
    file: str | Path,
    *,
    width: Width | None = None,
    overwrite: bool = False,
) -> Path:
    """Save a figure at the width at which it will be printed, and close it.

    The figure stays as it was and can be saved again, but pyplot neither shows nor keeps it.

    At that size its letters have 8 points, those at ticks 7; lines and markers shrink with it, but
    not below half. The height follows. Bitmaps have 300 dots per inch, PDF and SVG their text.

    Arguments:
        figure: the figure, or axes of it.
        file: the path of a file. Its ending is the format: .pdf, .svg, .png, ...
        width: "single" for a column of 90 mm, "double" for a page of 190 mm, or a number [mm]. By
            default a column, or a page for a figure that is wider than a column.
        overwrite: whether a file of that name is replaced.

    Returns:
        The path of the file.

    Raises:
        TypeError: for anything but a figure or axes.
        ValueError: for an invalid width, and an ending that Matplotlib does not know.
        FileExistsError: if the file exists and is not to be replaced.

    Example:
        >>> js.plots.save(js.plots.gap(contact, state), "gap.png").name
        'gap.png'
    """
    require_kind(figure, Figure | Axes, "no figure: give a figure, or axes of one.")
    whole: Any = figure.figure.figure
    target = new_file(file, whole.canvas.get_supported_filetypes(), overwrite)
    printed = _millimetres(width, whole)
    drawn = whole.get_size_inches()[0] / _MM
    if printed < _MOST_CROWDED * drawn:
        warn(
            f"A figure of {drawn:.0f} mm is hard to read at {printed:.0f} mm, since letters keep "
            'their size: choose `width="double"`.'
        )
    copy = _copy(whole)
    _resize(copy, printed * _MM)
    picture = BytesIO()
    with plt.rc_context(_AS_TEXT):
        copy.savefig(picture, format=target.suffix[1:].lower(), dpi=_DPI)
    write_whole(target, picture.getvalue())
    plt.close(whole)
    return target


def new_file(file: str | Path, endings: Collection[str], overwrite: bool) -> Path:
    """Check that a file may be written and has one of the endings, and return its path."""
    path = Path(file)
    if path.suffix[1:].lower() not in endings:
        known = ", ".join(f".{ending}" for ending in sorted(endings))
        raise ValueError(f"{path} has no ending that can be written: choose one of {known}.")
    if path.exists() and not overwrite:
        raise FileExistsError(
            f"{path} exists, and is not overwritten: choose another name, or give `overwrite=True`."
        )
    if not path.parent.is_dir():
        raise FileNotFoundError(f"The folder {path.parent} does not exist: make it first.")
    require_writable(path.parent)
    return path


def _millimetres(width: Width | None, figure: Figure) -> float:
    if width is None:
        is_narrow = figure.get_size_inches()[0] <= _WIDTHS["double"] * _MM
        width = "single" if is_narrow else "double"
    number = _WIDTHS.get(width) if isinstance(width, str) else width
    if not isinstance(number, int | float) or not 0 < number < np.inf:
        raise ValueError(f'width is {width!r}: choose "single", "double" or a number of mm.')
    return number


def _copy(figure: Figure) -> Figure:
    canvas: Any = figure.canvas
    # A copy of a figure with a manager would open a window.
    manager = canvas.manager
    canvas.manager = None
    try:
        return deepcopy(figure)
    finally:
        canvas.manager = manager


def _resize(figure: Figure, width: float) -> None:
    """Resize a figure to a printed width [inch]."""
    before, height = figure.get_size_inches()
    figure.set_size_inches(width, height * width / before)
    if figure.get_layout_engine() is None:
        figure.set_layout_engine("constrained")
    axes: list[Axis] = figure.findobj(Axis)
    for axis in axes:
        axis.set_tick_params(which="both", labelsize=_TICK_FONT)
    for text in figure.findobj(Text):
        text.set_fontsize(_FONT)
    # Smaller labels may bring more ticks into being.
    for axis in axes:
        for text in (*axis.get_ticklabels(which="both"), axis.get_offset_text()):
            text.set_fontsize(_TICK_FONT)
    figure.draw_without_rendering()
    shrunk = min(max(width / before, _MOST_SHRUNK), 1)
    for line in figure.findobj(Line2D):
        line.set(linewidth=shrunk * line.get_linewidth(), markersize=shrunk * line.get_markersize())
    for part in figure.findobj(Patch) + figure.findobj(Marks):
        plt.setp(part, linewidth=shrunk * np.asarray(plt.getp(part, "linewidth")))
    for marks in figure.findobj(PathCollection):
        marks.set_sizes(shrunk**2 * marks.get_sizes())

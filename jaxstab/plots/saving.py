"""Figures as files, at the sizes that journals print."""

from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis, Tick
from matplotlib.collections import Collection as Marks
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text

from jaxstab.core.checks import require_kind
from jaxstab.core.warn import warn

Width = Literal["single", "double"] | float

# Millimetres, as of most journals' columns.
_WIDTHS = {"single": 90.0, "double": 190.0}
_MM = 1 / 25.4
# Points.
_FONT, _TICK_FONT = 8, 7
# Thinner lines do not print.
_MOST_SHRUNK = 0.5
_DPI = 300
# A figure that is printed at less of its width is full of letters.
_MOST_CROWDED = 0.45
# Letters stay letters, which can be searched and edited.
_AS_TEXT: dict[Any, Any] = {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "none"}


def save(figure: Figure | Axes, file: str | Path, *, width: Width | None = None) -> Path:
    """Save a figure at the width at which it will be printed, and leave it as it was.

    At that size its letters have 8 points, those at ticks 7; lines and markers shrink with it, but
    not below half. The height follows. Bitmaps have 300 dots per inch, PDF and SVG their text.

    Arguments:
        figure: the figure, or axes of it.
        file: the path of a new file. Its ending is the format: .pdf, .svg, .png, ...
        width: "single" for a column of 90 mm, "double" for a page of 190 mm, or a number [mm]. By
            default a column, or a page for a figure that is wider than a column.

    Returns:
        The path of the file.

    Raises:
        TypeError: for anything but a figure or axes.
        ValueError: for an invalid width, and an ending that Matplotlib does not know.
        FileExistsError: if the file exists.
    """
    require_kind(figure, Figure | Axes, "no figure: give a figure, or axes of one.")
    whole: Any = figure.figure.figure
    target = new_file(file, whole.canvas.get_supported_filetypes())
    printed, drawn = _millimetres(width, whole), whole.get_size_inches()[0] / _MM
    if printed < _MOST_CROWDED * drawn:
        warn(
            f"A figure of {drawn:.0f} mm is hard to read at {printed:.0f} mm, since letters keep "
            'their size: choose width="double".'
        )
    with plt.rc_context(_AS_TEXT), _as_printed(whole, printed * _MM):
        picture = BytesIO()
        whole.savefig(picture, format=target.suffix[1:].lower(), dpi=_DPI)
    return written(target, picture.getvalue())


def new_file(file: str | Path, endings: Collection[str]) -> Path:
    """Return the path of a new file, whose ending must be one of some."""
    path = Path(file)
    if path.suffix[1:].lower() not in endings:
        known = ", ".join(f".{ending}" for ending in sorted(endings))
        raise ValueError(f"{path} has no ending that can be written: choose one of {known}.")
    if path.exists():
        raise FileExistsError(f"{path} exists, and is not overwritten: choose another name.")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"The folder {path.parent} does not exist: make it first.")
    return path


def written(path: Path, content: bytes) -> Path:
    """Write a new file, whole or not at all, and return its path."""
    with path.open("xb") as file:
        file.write(content)
    return path


def _millimetres(width: Width | None, figure: Figure) -> float:
    if width is None:
        width = "single" if figure.get_size_inches()[0] <= _WIDTHS["double"] * _MM else "double"
    number = _WIDTHS.get(width) if isinstance(width, str) else width
    if not isinstance(number, int | float) or not 0 < number < np.inf:
        raise ValueError(f'width is {width!r}: choose "single", "double" or a number of mm.')
    return number


@contextmanager
def _as_printed(figure: Figure, width: float) -> Iterator[None]:
    """Resize a figure to a printed width [inch] within a `with` block."""
    with ExitStack() as afterwards:

        def put(artist: Artist, **properties: Any) -> None:
            afterwards.callback(artist.set, **{name: plt.getp(artist, name) for name in properties})
            artist.set(**properties)

        before, height = figure.get_size_inches()
        afterwards.callback(figure.set_size_inches, before, height, forward=False)
        figure.set_size_inches(width, height * width / before, forward=False)
        _lay_out(figure, afterwards)
        for axis in figure.findobj(Axis):
            _set_ticks(axis, afterwards)
        # Smaller labels bring more ticks into being.
        at_ticks = _texts_at_ticks(figure)
        for text in figure.findobj(Text):
            put(text, fontsize=_TICK_FONT if text in at_ticks else _FONT)
        # Another size may have more ticks.
        figure.draw_without_rendering()
        shrunk = min(max(width / before, _MOST_SHRUNK), 1)
        for line in figure.findobj(Line2D):
            put(line, linewidth=shrunk * line.get_linewidth())
            put(line, markersize=shrunk * line.get_markersize())
        for part in figure.findobj(Patch) + figure.findobj(Marks):
            put(part, linewidth=shrunk * np.asarray(plt.getp(part, "linewidth")))
        for marks in figure.findobj(PathCollection):
            put(marks, sizes=shrunk**2 * marks.get_sizes())
        yield


def _lay_out(figure: Figure, afterwards: ExitStack) -> None:
    """Have labels inside the figure, where nobody sees to it."""
    if figure.get_layout_engine() is not None:
        return
    for axes in figure.axes:
        afterwards.callback(axes.set_in_layout, axes.get_in_layout())
        afterwards.callback(axes.set_position, axes.get_position(original=True))
    afterwards.callback(figure.set_layout_engine, None)
    figure.set_layout_engine("constrained")


def _texts_at_ticks(figure: Figure) -> set[Text]:
    """Return the labels of all ticks, and the offset texts of an axis."""
    ticks: list[Tick] = figure.findobj(Tick)
    axes: list[Axis] = figure.findobj(Axis)
    labels = {text for tick in ticks for text in (tick.label1, tick.label2)}
    return labels | {axis.get_offset_text() for axis in axes}


def _set_ticks(axis: Axis, afterwards: ExitStack) -> None:
    """Set the size of labels of ticks, also of those that another size of the figure adds."""
    for which in ("major", "minor"):
        if labels := axis.get_ticklabels(which=which):
            size = labels[0].get_fontsize()
            afterwards.callback(axis.set_tick_params, which=which, labelsize=size)
            axis.set_tick_params(which=which, labelsize=_TICK_FONT)

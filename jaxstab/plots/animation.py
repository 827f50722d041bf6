"""Animations of a path: the gap beside the curve of the pressure."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstab import loading
from jaxstab.contact import Contact
from jaxstab.core.atomic_write import write_whole
from jaxstab.core.checks import require
from jaxstab.plots.fields import add_colour_bar, draw_map, require_own
from jaxstab.plots.paths import of_states, quantities_or_default, require_path
from jaxstab.plots.paths import path as draw_path
from jaxstab.plots.saving import new_file
from jaxstab.plots.style import BLACK, axes_or_new, grey, label_axes

_WRITERS = {"gif": PillowWriter, "mp4": FFMpegWriter}
_MOST_PER_SECOND = 15
_SIZE = (10, 4.4)
_DPI = 100


def animation(
    contact: Contact,
    path: loading.Path,
    file: str | Path,
    *,
    seconds: float = 10,
    overwrite: bool = False,
) -> Path:
    """Write an animation of a path: left its gap, with the contact in black, right its pressure.

    The colours of the gap, or on a line its scale, are the same throughout. Frames are spread
    evenly over the states, at most 15 a second.

    Arguments:
        contact: the contact problem.
        path: its path, followed with `fields=True`.
        file: the path of a .gif or .mp4 file.
        seconds: the duration, rounded in a GIF, whose frames last whole hundredths of a second.
        overwrite: whether a file of that name is replaced.

    Returns:
        The path of the file.

    Raises:
        TypeError: for something that is not a path.
        ValueError: for a path without fields or of another contact, several paths, another
            ending, or a time that is not positive.
        FileExistsError: if the file exists and is not to be replaced.
        ImportError: for an .mp4 without ffmpeg.

    Example:
        >>> path = js.follow(contact, js.MeanGap([0.1, 0.08]), fields=True)
        >>> js.plots.animation(contact, path, "path.gif", seconds=1).name
        'path.gif'
    """
    require_path(path)
    path = path.recorded
    gaps = _gaps(contact, path)
    target = new_file(file, _WRITERS, overwrite)
    require("seconds", seconds, 0 < seconds < np.inf, "it must be positive and finite.")
    frames = np.linspace(0, len(gaps) - 1, min(len(gaps), max(int(_MOST_PER_SECOND * seconds), 2)))
    figure = Figure(_SIZE, _DPI, layout="constrained")
    left, right = map(axes_or_new, figure.subplots(1, 2))
    if gaps.ndim == 3:
        show_gap = _map(left, contact, gaps)
    else:
        show_gap = _profile(left, contact, gaps)
    show_place = _curve(right, path)

    def show(state: int) -> None:
        show_gap(gaps[state])
        left.set_title(f"contact area {100 * np.mean(gaps[state] == 0):.1f} %, in black")
        show_place(state)

    # The layout of the first frame is kept for all frames.
    show(0)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    ending = target.suffix[1:].lower()
    settings = {}
    if ending == "mp4":
        settings = _with_ffmpeg()
    with plt.rc_context(settings), TemporaryDirectory() as folder:
        film = Path(folder) / f"film.{ending}"
        writer = _WRITERS[ending](fps=len(frames) / seconds)
        with writer.saving(figure, str(film), _DPI):
            for state in frames.round().astype(int):
                show(state)
                writer.grab_frame()
        write_whole(target, film.read_bytes())
    return target


def _gaps(contact: Contact, path: loading.Path) -> np.ndarray:
    if path.equilibrium.gap is None:
        raise ValueError("This path left its fields out: follow it with fields=True.")
    gaps = np.asarray(path.equilibrium.gap)
    require_own(contact, gaps.shape[1:], "path")
    return gaps


def _map(axes: Axes, contact: Contact, gaps: np.ndarray) -> Callable[[np.ndarray], None]:
    """Draw a map of the first gap, and return the function that shows another."""
    # A GIF has 256 colours for the map and everything else.
    colours = plt.get_cmap("viridis", 128).with_extremes(bad=BLACK)
    most = gaps.max() or 1
    image = draw_map(axes, contact, gaps[0], cmap=colours, vmin=0, vmax=most)
    add_colour_bar(axes, image, "gap g [length]", contact.units)
    return lambda gap: image.set_data(np.ma.masked_equal(gap, 0).T)


def _profile(axes: Axes, contact: Contact, gaps: np.ndarray) -> Callable[[np.ndarray], None]:
    """Draw a profile of the first gap, and return the function that shows another."""
    x = np.asarray(contact.grid.coordinates[0])
    (line,) = axes.plot(x, gaps[0])
    (touching,) = axes.plot(x, np.zeros_like(x), color=grey(axes, 1), linewidth=4)
    most = gaps.max() or 1
    axes.set_ylim(-0.02 * most, 1.05 * most)
    label_axes(axes, f"{contact.grid.sides[0]} [length]", "gap g [length]", contact.units)

    def show(gap: np.ndarray) -> None:
        line.set_ydata(gap)
        touching.set_ydata(np.where(gap == 0, 0, np.nan))

    return show


def _curve(axes: Axes, path: loading.Path) -> Callable[[int], None]:
    """Draw pressure or force over gap, and return the function that moves a marker to a state."""
    draw_path(path, axes=axes)
    quantities = quantities_or_default(path, None, None)
    states = np.stack([of_states(path, quantity) for quantity in quantities], axis=1)
    (marker,) = axes.plot([], [], "o", color=grey(axes, 1), markersize=9)
    marker.set_markeredgecolor(grey(axes, 0))
    return lambda state: marker.set_data(*states[state, :, None])


def _with_ffmpeg() -> dict[Any, Any]:
    """Return the settings under which Matplotlib finds ffmpeg."""
    if which(plt.rcParams["animation.ffmpeg_path"]):
        return {}
    try:
        return {"animation.ffmpeg_path": import_module("imageio_ffmpeg").get_ffmpeg_exe()}
    except (ImportError, RuntimeError):
        raise ImportError(
            "An .mp4 needs ffmpeg: install it on your system, or pip install 'jaxstab[animation]'. "
            "A .gif needs neither."
        ) from None

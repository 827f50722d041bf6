"""The content of a surface file."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxstab.core.types import ArrayLike

# How far a coordinate may lie off an even lattice, in steps; nearer ones, over the extent, are one.
_OFF_LATTICE = 0.05
_NO_GAP = 1e-5


@dataclass(frozen=True)
class Scan:
    """The content of a surface file; None for data that it lacks.

    Attributes:
        heights: on a map or a line, the first index along x; NaN where missing.
        lengths: side lengths, in the unit of the heights.
        unit: the unit of lengths and heights.
        remarks: the choices of the reader.
        is_periodic: whether the file says so.
        is_counted: whether the lengths are numbers of points, since the coordinates are 0, 1, 2,
            ... without a unit: others are as good.
    """

    heights: np.ndarray
    lengths: Sequence[float] | ArrayLike | None = None
    unit: str | None = None
    remarks: tuple[str, ...] = ()
    is_periodic: bool = False
    is_counted: bool = False


class UnknownContent(ValueError):
    """Another reader may understand the file."""


def channel_to_read(
    names: Iterable[str], channel: str | None, default: str
) -> tuple[str, tuple[str, ...]]:
    """Return the name of the channel to read, and a remark where there are several."""
    names = list(names)
    listed = ", ".join(map(repr, names))
    if channel is None:
        channel = default
        remark = f"channel {channel!r} of {listed}, chosen by default: give another as `channel=`"
    else:
        remark = f"channel {channel!r} of {listed}"
    if channel not in names:
        raise ValueError(f"it has no channel {channel!r} of heights: choose from {listed}.")
    if len(names) == 1:
        return channel, ()
    return channel, (remark,)


def chosen_array(names: Iterable[str], channel: str | None) -> tuple[str, tuple[str, ...]]:
    """As `channel_to_read`, but by default `heights` or the only one: others may be coordinates."""
    names = list(names)
    if "heights" not in names and channel is None and len(names) > 1:
        raise ValueError(
            f"it has several arrays, {', '.join(names)}: name the surface `heights`, or choose one "
            "as `channel=`."
        )
    default = names[0]
    if "heights" in names:
        default = "heights"
    return channel_to_read(names, channel, default)


def on_a_side_or_two(values: np.ndarray) -> np.ndarray:
    """Return an array as heights of float64: a map, or of a single row or column a line."""
    if values.dtype.kind not in "fiub":
        raise ValueError(f"its array is of {values.dtype}: heights are real numbers.")
    heights = np.ma.filled(values.astype(float), np.nan)
    if heights.ndim == 2 and 1 in heights.shape:
        heights = heights.ravel()
    if heights.ndim not in (1, 2) or min(heights.shape) < 2:
        raise ValueError(
            f"its array has shape {heights.shape}: a surface has two axes and a profile one, of 2 "
            "points or more."
        )
    return heights


def are_pixels(values: np.ndarray) -> bool:
    """Whether coordinates are the numbers of points, 0, 1, 2, ..., which are no lengths."""
    places = np.unique(values)
    return len(places) > 1 and np.array_equal(places, np.arange(len(places)))


def on_lattice(values: np.ndarray) -> tuple[np.ndarray, int, float] | None:
    """Return indices of coordinates on an even lattice, the number of its places, and its step."""
    extent = np.ptp(values)
    if not 0 < extent < np.inf:
        return None
    gaps = np.diff(np.unique(values)) / extent
    gaps = gaps[gaps > _NO_GAP]
    # Rounded coordinates have gaps of a step, and of several over missing lines.
    steps = int(np.rint(gaps / gaps.min()).sum())
    places = (values - values.min()) / extent * steps
    nearest = np.rint(places).astype(int)
    if steps >= values.size or np.abs(places - nearest).max() > _OFF_LATTICE:
        return None
    return nearest, steps + 1, float(extent / steps)

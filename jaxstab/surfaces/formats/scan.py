"""The content of a surface file."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxstab.core.types import ArrayLike
from jaxstab.core.unit_system import converted

# The relative error up to which coordinates in a file are evenly spaced.
_UNEVEN = 1e-2


@dataclass(frozen=True)
class Scan:
    """The content of a surface file; None for data that it lacks.

    Attributes:
        heights: on a map or a line, the first index along x; NaN where missing.
        lengths: side lengths, in the unit of the heights.
        unit: the unit of lengths and heights.
        remarks: the choices of the reader.
        is_periodic: whether the file says so.
    """

    heights: np.ndarray
    lengths: Sequence[float] | ArrayLike | None = None
    unit: str | None = None
    remarks: tuple[str, ...] = ()
    is_periodic: bool = False

    def in_units(self, unit: str | None, unit_of_sides: str | None) -> "Scan":
        """Return it with heights in the unit of the sides, and a remark where the units differ.

        An unknown unit is taken to be the other one.
        """
        scan, remark = replace(self, unit=unit_of_sides or unit), None
        if unit is None and unit_of_sides is not None:
            remark = f"unit of heights taken from the sides, {unit_of_sides}"
        elif unit is not None and unit_of_sides is None:
            remark = f"unit of lengths taken from the heights, {unit}"
        elif unit is not None and unit_of_sides is not None and unit != unit_of_sides:
            scan = replace(scan, heights=converted(self.heights, unit, unit_of_sides))
            remark = f"heights converted from {unit} to {unit_of_sides}"
        return replace(scan, remarks=(*self.remarks, remark)) if remark else scan


class UnknownContent(ValueError):
    """Another reader may understand the file."""


def chosen(names: Iterable[str], channel: str | None, default: str) -> tuple[str, tuple[str, ...]]:
    """Return the name of the channel to read, and a remark where there are several."""
    names = list(names)
    listed = ", ".join(map(repr, names))
    if channel is not None and channel not in names:
        raise ValueError(f"it has no channel {channel!r} of heights: choose from {listed}.")
    name = default if channel is None else channel
    hint = ", chosen by default: give another as `channel=`" if channel is None else ""
    return name, (f"channel {name!r} of {listed}{hint}",) if len(names) > 1 else ()


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


def even_spacing(coordinates: np.ndarray) -> float | None:
    """Return the spacing, negative if they fall, of coordinates that follow each other evenly."""
    spacing = (coordinates[-1] - coordinates[0]) / (coordinates.size - 1)
    even = coordinates[0] + spacing * np.arange(coordinates.size)
    is_even = np.abs(coordinates - even).max() <= _UNEVEN * abs(spacing)
    return float(spacing) if spacing and is_even else None

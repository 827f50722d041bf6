"""Formats and surfaces of the package SurfaceTopography."""

import re
from collections.abc import Callable
from io import BytesIO
from typing import Any

import numpy as np

from jaxstab.core.optional_packages import require_packages
from jaxstab.core.units import unit_of
from jaxstab.surfaces.formats.scan import Scan, UnknownContent, channel_to_read, on_a_side_or_two

# The readers of these formats accept files of any kind; of text only if it states a unit.
_UNMARKED = {"hgt", "nms", "h5"}
_TEXT = {"asc", "xyz"}
_ROW = re.compile(rb"^[ \t]*([-+]?[\d.]|bad\b|nan\b)", re.MULTILINE | re.IGNORECASE)
_UNKNOWN = "SurfaceTopography: the file is damaged or of an unknown kind."


def read_instrument(source: str | BytesIO, channel: str | None) -> Scan:
    """Return the requested or the first channel of heights, as SurfaceTopography orients it."""
    require_packages("Files of instruments", "surfaces", "SurfaceTopography.IO")
    from SurfaceTopography.IO import open_topography

    with _ask(open_topography, source) as reader:
        channels = reader.channels
        kind = reader.format()
        if kind in _UNMARKED or (kind in _TEXT and any(one.unit is None for one in channels)):
            raise UnknownContent(_UNKNOWN)
        if kind == "asc" and isinstance(source, BytesIO):
            # A row with a word in it passes for a header.
            lines = len(_ROW.findall(source.getvalue()))
            rows = sum(one.nb_grid_pts[-1] for one in channels)
            if rows != lines:
                raise ValueError(f"of its {lines} rows {lines - rows} are not numbers alone.")
        return _scan_of(reader, channel)


def scan_of_topography(
    topography: Any, remarks: tuple[str, ...] = (), says_lengths: bool = True
) -> Scan:
    """Return the heights of a surface of SurfaceTopography."""
    if not topography.is_uniform:
        raise ValueError("its points are not evenly spaced: interpolate them first.")
    if len(topography.physical_sizes) != topography.dim:
        raise ValueError("its header says one side of two: write width and height.")
    heights = on_a_side_or_two(topography.heights())
    lengths = None
    if says_lengths:
        lengths = tuple(map(float, topography.physical_sizes))
    unit = None
    if topography.unit:
        unit = unit_of(topography.unit)
    return Scan(heights, lengths, unit, remarks, bool(topography.is_periodic))


def _scan_of(reader: Any, channel: str | None) -> Scan:
    # Some readers give a pair of units if values have no unit of length.
    channels = {
        one.channel_id: one
        for one in reader.height_channels
        if one.unit is None or isinstance(one.unit, str)
    }
    if not channels:
        raise ValueError("it has no channel of heights.")
    name, remarks = channel_to_read(channels, channel, next(iter(channels)))
    one = channels[name]
    says_lengths = one.physical_sizes is not None
    sizes = {}
    if not says_lengths:
        # A reader needs some.
        sizes = {"physical_sizes": one.nb_grid_pts}
    return scan_of_topography(_ask(one.topography, **sizes), remarks, says_lengths)


def _ask(function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Return the answer of SurfaceTopography, with its errors as `ValueError`."""
    try:
        with np.errstate(all="ignore"):
            return function(*arguments, **options)
    except Exception as error:
        message = f"SurfaceTopography: {error}"
        if type(error).__name__ == "CannotDetectFileFormat":
            # It lists the errors of all readers.
            message = _UNKNOWN
        raise ValueError(message) from None

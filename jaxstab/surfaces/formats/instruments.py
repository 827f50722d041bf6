"""Formats and surfaces of the package SurfaceTopography."""

import re
from collections.abc import Callable
from io import BytesIO
from typing import Any

import numpy as np

from jaxstab.core.optional_packages import require_packages
from jaxstab.core.unit_system import unit_of
from jaxstab.surfaces.formats.scan import Scan, UnknownContent, chosen, on_a_side_or_two

# The readers of these formats accept files of any kind.
_UNMARKED = {"hgt", "nms", "h5"}
# A header of text with one of these keys announces a matrix.
_OF_A_MATRIX = {
    *("nb_grid_pts_x", "nb_grid_pts_y", "physical_size_x", "physical_size_y"),
    *("xfac", "yfac", "wyko_pixel_size"),
}
_ROW = re.compile(rb"^[ \t]*([-+]?[\d.]|bad\b|nan\b)", re.MULTILINE | re.IGNORECASE)
_OF_TEXT = re.compile(r"tried AscReader: \n (?!'utf-8')(.*)")
_UNKNOWN = "the file is damaged or of an unknown kind."


def read_instrument(source: str | BytesIO, channel: str | None) -> Scan:
    """Return the requested or the first channel of heights, as SurfaceTopography orients it."""
    require_packages("Files of instruments", "surfaces", "SurfaceTopography.IO")
    from SurfaceTopography.IO import open_topography

    with _asked(open_topography, source) as reader:
        _require_mark(reader)
        if reader.format() == "asc" and isinstance(source, BytesIO):
            # A row with a word in it passes for a header.
            lines = len(_ROW.findall(source.getvalue()))
            rows = sum(one.nb_grid_pts[-1] for one in reader.channels)
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
    lengths = tuple(map(float, topography.physical_sizes)) if says_lengths else None
    unit = unit_of(topography.unit) if topography.unit else None
    return Scan(heights, lengths, unit, remarks, bool(topography.is_periodic))


def _require_mark(reader: Any) -> None:
    """Raise `UnknownContent` if the format is guessed and accepts files of any kind."""
    metadata = [one.info.get("raw_metadata", ()) for one in reader.channels]
    # A header of text states sides or points, titles of columns state a unit.
    is_known = {
        "asc": all(_OF_A_MATRIX & set(said) for said in metadata),
        "xyz": all(one.unit is not None for one in reader.channels),
    }
    if not is_known.get(reader.format(), reader.format() not in _UNMARKED):
        raise UnknownContent(f"SurfaceTopography: {_UNKNOWN}")


def _scan_of(reader: Any, channel: str | None) -> Scan:
    # Some readers give a pair of units if values have no unit of length.
    channels = {
        one.channel_id: one
        for one in reader.height_channels
        if one.unit is None or isinstance(one.unit, str)
    }
    if not channels:
        raise ValueError("it has no channel of heights.")
    name, remarks = chosen(channels, channel, next(iter(channels)))
    one = channels[name]
    says_lengths = one.physical_sizes is not None
    # A reader needs sizes if the file states none.
    sizes = {} if says_lengths else {"physical_sizes": one.nb_grid_pts}
    return scan_of_topography(_asked(one.topography, **sizes), remarks, says_lengths)


def _asked(function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Return the answer of SurfaceTopography, with its errors as `ValueError`."""
    try:
        with np.errstate(all="ignore"):
            return function(*arguments, **options)
    except Exception as error:
        reason = str(error)
        if type(error).__name__ == "CannotDetectFileFormat":
            # It lists the errors of all readers, of which the reader of text is useful.
            of_text = _OF_TEXT.search(reason)
            reason = of_text[1] if of_text else _UNKNOWN
        raise ValueError(f"SurfaceTopography: {reason}") from None

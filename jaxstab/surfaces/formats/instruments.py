"""Formats of instruments, through the package SurfaceTopography."""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, StringIO
from typing import Any

from jaxstab.core.optional_packages import require_packages
from jaxstab.surfaces.formats.scan import (
    Refused,
    Scan,
    UnknownContent,
    chosen,
    is_number,
    on_a_side_or_two,
)
from jaxstab.surfaces.units import unit_if_said, unit_of

# Readers of these accept files of many kinds, or those that ours have refused.
_UNMARKED = {"asc", "xyz", "hgt", "nms", "npy", "npz", "h5", "nc"}
# By these a header of text says that a matrix follows: its points, its sides, or its spacing.
_OF_A_MATRIX = {
    *("nb_grid_pts_x", "nb_grid_pts_y", "physical_size_x", "physical_size_y"),
    *("xfac", "yfac", "wyko_pixel_size"),
}
# How its text marks a missing point.
_MISSING = {"bad", "nan", "inf", "infinite"}


def read_instrument(source: str | BytesIO, content: bytes, channel: str | None) -> Scan:
    """Return the heights in an instrument's file, as SurfaceTopography orients them.

    Of several channels that is the first of heights, unless one is requested.
    """
    with _opened(source, content) as reader:
        if reader.format() in _UNMARKED:
            raise ValueError("no mark of a format in it")
        return _scan(reader, channel)


def read_instrument_text(text: str, channel: str | None) -> Scan:
    """Return the heights of a matrix of text below a header that SurfaceTopography understands.

    A line is a row along x. Its reader takes lines that it cannot read for parts of the header, and
    reads a matrix without one. Both raise an error here.
    """
    _require_whole_lines(text)
    with _opened(StringIO(text), b"", format="asc") as reader:
        if not all(_OF_A_MATRIX & set(_metadata(one)) for one in reader.channels):
            raise ValueError("its header says neither points nor sides")
        return _scan(reader, channel)


@contextmanager
def _opened(source: Any, content: bytes, **options: Any) -> Iterator[Any]:
    """Open a file by SurfaceTopography; whatever fails in a `with` block is unknown content."""
    require_packages("Files of instruments", "surfaces", "SurfaceTopography.IO")
    from SurfaceTopography.IO import open_topography

    try:
        with open_topography(source, **options) as reader:
            yield reader
    except Refused:
        raise
    except Exception as error:
        raise UnknownContent(_why(content, error)) from None


def _scan(reader: Any, channel: str | None) -> Scan:
    """Return the surface of a channel; heights and lengths come in its unit."""
    # Where sides have a unit and values have none of length, some readers give a pair of units.
    channels = {
        one.channel_id: one
        for one in reader.height_channels
        if one.unit is None or isinstance(one.unit, str)
    }
    if not channels:
        raise ValueError("it has no channel of heights")
    name, remarks = chosen(list(channels), channel, next(iter(channels)))
    one = channels[name]
    says_lengths = one.physical_sizes is not None
    # Where the file says no lengths it asks for some.
    sizes = {} if says_lengths else {"physical_sizes": one.nb_grid_pts}
    topography = one.topography(**sizes)
    if not topography.is_uniform:
        raise Refused("its points are not evenly spaced: interpolate them first.")
    lengths = tuple(map(float, topography.physical_sizes)) if says_lengths else None
    if lengths and len(lengths) != topography.dim:
        raise Refused("its header says one side of two: write width and height.")
    unit = unit_if_said(topography.unit)
    heights = on_a_side_or_two(topography.heights())
    scan = Scan(heights, lengths, None, remarks, bool(topography.is_periodic))
    return scan.in_units(unit, unit or _unit_of_sides(one))


def _unit_of_sides(channel: Any) -> str | None:
    """Return the unit that a header of text has for lengths alone."""
    metadata = _metadata(channel)
    said = {unit_of(metadata[name]) for name in ("xunit", "yunit") if metadata.get(name)}
    if len(said) > 1:
        raise ValueError("x and y are in different units")
    return next(iter(said), None)


def _metadata(channel: Any) -> dict[str, Any]:
    metadata = channel.info.get("raw_metadata", {})
    return metadata if isinstance(metadata, dict) else {}


def _require_whole_lines(text: str) -> None:
    """Raise `ValueError` for a line of the matrix that is not all numbers."""
    columns = 0
    for i, line in enumerate(text.splitlines(), 1):
        words = line.split()
        are_numbers = [is_number(word) or word.lower() in _MISSING for word in words]
        if words and all(are_numbers):
            columns = columns or len(words)
        elif (
            columns
            and not line.lstrip().startswith("#")
            and (len(words) == columns or any(are_numbers[:1]))
        ):
            raise ValueError(f"line {i}: {words[are_numbers.index(False)]!r} is no number.")


def _why(content: bytes, error: Exception) -> str:
    if content.startswith(b"PK") and not zipfile.is_zipfile(BytesIO(content)):
        return "this archive (an x3p file is one) has no end: it was truncated."
    first = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".: ")
    reason = "" if type(error).__name__ == "CannotDetectFileFormat" else f" ({first})"
    return f"SurfaceTopography finds no surface in it: it is damaged or of an unknown kind{reason}."

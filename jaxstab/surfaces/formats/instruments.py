"""Formats of instruments, through the package SurfaceTopography."""

import zipfile
from pathlib import Path

from jaxstab.packages import require_packages
from jaxstab.surfaces.formats.scan import Scan, UnknownContent, on_a_side_or_two
from jaxstab.surfaces.units import unit_of

# Readers of these accept files of many kinds, or those that ours have refused.
_UNMARKED = {"asc", "xyz", "hgt", "nms", "npy", "npz", "h5", "nc"}


def read_instrument(path: Path) -> Scan:
    """Return the heights in an instrument's file, as SurfaceTopography orients them.

    Of several channels that is the first of heights.

    Raises:
        ValueError: for a damaged file, or a format that SurfaceTopography does not know.
        ImportError: without the extra `surfaces`.
    """
    require_packages("Files of instruments", "surfaces", "SurfaceTopography.IO")
    from SurfaceTopography.IO import open_topography

    try:
        with open_topography(str(path)) as reader:
            if reader.format() in _UNMARKED:
                raise ValueError("no mark of a format in it")
            channels = reader.channels
            channel = [*reader.height_channels, reader.default_channel][0]
            says_lengths = channel.physical_sizes is not None
            # Where the file says no lengths it asks for some.
            sizes = {} if says_lengths else {"physical_sizes": channel.nb_grid_pts}
            topography = channel.topography(**sizes)
            heights = topography.heights()
    except Exception as error:
        raise UnknownContent(_why(path, error)) from None
    if not topography.is_uniform:
        raise ValueError("its points are not evenly spaced: interpolate them first.")
    return Scan(
        on_a_side_or_two(heights),
        tuple(map(float, topography.physical_sizes)) if says_lengths else None,
        unit_of(topography.unit) if topography.unit else None,
        (f"channel {channel.name!r} of {len(channels)}",) if len(channels) > 1 else (),
        bool(topography.is_periodic),
    )


def _why(path: Path, error: Exception) -> str:
    with path.open("rb") as file:
        is_archive = file.read(2) == b"PK"
    if is_archive and not zipfile.is_zipfile(path):
        return "this archive (an x3p file is one) has no end: it was truncated."
    first = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".: ")
    reason = "" if type(error).__name__ == "CannotDetectFileFormat" else f" ({first})"
    return f"SurfaceTopography finds no surface in it: it is damaged or of an unknown kind{reason}."

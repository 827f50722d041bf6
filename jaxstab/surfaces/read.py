"""Surfaces from files, whose content determines the format."""

import gzip
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import ArrayLike

from jaxstab.core.display import times
from jaxstab.core.grid import Grid
from jaxstab.surfaces import faults
from jaxstab.surfaces.formats.instruments import read_instrument, read_instrument_text
from jaxstab.surfaces.formats.netcdf import read_netcdf
from jaxstab.surfaces.formats.npy import read_npy
from jaxstab.surfaces.formats.scan import Scan, UnknownContent
from jaxstab.surfaces.formats.text import read_text
from jaxstab.surfaces.topography import Topography
from jaxstab.surfaces.units import unit_of

# The relative error up to which given side lengths agree with those of a file.
_AGREEMENT = 1e-6
_GZIP, _UTF_16 = b"\x1f\x8b", (b"\xff\xfe", b"\xfe\xff")
# What no text of single bytes holds.
_CONTROL = bytes(set(range(32)) - set(b"\t\n\v\f\r"))


def read(
    path: str | Path,
    lengths: Sequence[float] | ArrayLike | None = None,
    unit: str | None = None,
    channel: str | None = None,
) -> Topography:
    """Return the surface in a file, whose content, not its name, determines the format.

    The first index of heights runs along x. A text matrix has a line for each x, as
    `numpy.savetxt(path, heights)` writes it. So has an array in a `.npy` file. A single row or
    column is a profile. Three columns of text that lie on a lattice are points x, y, z in any
    order. More than 50 rows on no lattice raise an error. Two columns with an evenly rising or
    falling first one are a profile x, z. Titles above such columns may say units, as `x (µm), z
    (nm)`. Text that Gwyddion exports is an image, by its header: a line is a row along x, the first
    at y = 0, as in its own files. Decimal commas are read where fields are separated otherwise. Of
    NetCDF the dimensions x and y count, in either order. Any other file, as .x3p and .gwy, is read
    through SurfaceTopography; so is text below the header of an instrument. Rows stay in the order
    of the file, a line of text along x. A side is as long as its number of points times their
    spacing. Files packed by gzip are unpacked first.

    Missing points (nan, an empty field between separators, a masked point) stay NaN.

    Arguments:
        path: the file.
        lengths: side lengths, in the unit of the heights; needed where the file says none. One
            number does for a line, and for as many points along either side.
        unit: that of lengths and heights, where the file does not say.
        channel: which of several, by its name: of NetCDF a variable, `heights` by default, of
            instruments by default the first that holds heights. `print` of the surface names them.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file holds no surface, is damaged, or has no such channel. If `lengths`
            are needed, or if `lengths` or `unit` contradict the file.
        ImportError: if the format needs a package that is not installed.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    try:
        topography = _made(_scan(path, channel), lengths, unit)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    faults.warn(topography.wrong_scale)
    return topography


def _scan(path: Path, channel: str | None) -> Scan:
    """Return what the first reader that understands a file makes of it."""
    if not path.is_file():
        raise ValueError("this is no file.")
    source, content = str(path), path.read_bytes()
    if content.startswith(_GZIP):
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error) as error:
            raise ValueError(f"its gzip data are truncated or damaged ({error}).") from None
        source = BytesIO(content)
    if not content:
        raise ValueError("the file is empty.")
    errors = []
    for reader in _readers(source, content, channel):
        try:
            return reader()
        except UnknownContent as error:
            errors.append(error)
        except ImportError as error:
            if not errors:
                raise
            raise ValueError(f"{errors[0]} {error}") from None
    raise errors[0]


def _readers(
    source: str | BytesIO, content: bytes, channel: str | None
) -> Iterator[Callable[[], Scan]]:
    """Yield readers for a content, the likeliest first."""
    if content.startswith(b"\x93NUMPY"):
        yield partial(_alone, read_npy, content, channel)
        return
    text = _text(content)
    if content.startswith(b"CDF"):
        yield partial(read_netcdf, content, "scipy", channel)
    elif content.startswith(b"\x89HDF\r\n\x1a\n"):
        yield partial(read_netcdf, content, "h5netcdf", channel)
    elif text is not None:
        yield partial(_alone, read_text, text, channel)
    yield partial(read_instrument, source, content, channel)
    if text is not None:
        yield partial(read_instrument_text, text, channel)


def _text(content: bytes) -> str | None:
    try:
        if content.startswith(_UTF_16):
            return content.decode("utf-16")
        if content.translate(None, _CONTROL) != content:
            return None
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        # Of older programs: what is not of ASCII is a unit, or stands in comments.
        return None if content.startswith(_UTF_16) else content.decode("latin-1")


def _alone(reader: Callable[[Any], Scan], content: Any, channel: str | None) -> Scan:
    """Return what a reader of files without channels makes of one."""
    scan = reader(content)
    if channel is not None:
        raise ValueError(f"the channel is {channel!r}, but the file has one surface: leave it out.")
    return scan


def _made(scan: Scan, lengths: Sequence[float] | ArrayLike | None, unit: str | None) -> Topography:
    """Return a surface of what a file and its user say, which must not contradict each other."""
    points = times(scan.heights.shape)
    sides = lengths if scan.lengths is None else scan.lengths
    if sides is None:
        raise ValueError(
            f"its {points} heights come without side lengths: give them in the unit of the "
            "heights, as in `js.surfaces.read(path, lengths=(3.0, 1.4))`."
        )
    if scan.lengths is None and np.ndim(sides) == 0 and len(set(scan.heights.shape)) > 1:
        raise ValueError(
            f"lengths is {lengths}, one number for {points} points: give one for each side."
        )
    if lengths is not None and scan.lengths is not None and not _agree(lengths, scan.lengths):
        said = times(scan.lengths, ".10g") + (f" {scan.unit}" if scan.unit else "")
        raise ValueError(f"lengths are {lengths}, but the file says {said}: leave them out.")
    if unit is not None and scan.unit not in (None, unit_of(unit)):
        raise ValueError(
            f"the unit is {unit!r}, but the file says {scan.unit!r}: leave `unit` out, and convert "
            f'by `.in_unit("{unit}")`.'
        )
    grid = Grid(scan.heights.shape, sides)
    return Topography(grid, scan.heights, scan.unit or unit, scan.remarks, scan.is_periodic)


def _agree(lengths: Any, others: Sequence[float]) -> bool:
    given = np.asarray(lengths, float)
    return given.shape in ((), (len(others),)) and np.allclose(given, others, _AGREEMENT, 0)

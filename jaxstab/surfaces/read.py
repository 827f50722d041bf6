"""Surfaces from files, whose content determines the format."""

import gzip
import re
import zipfile
import zlib
from collections.abc import Sequence
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from jaxstab.core.checks import file_named_in_errors
from jaxstab.core.display import times
from jaxstab.core.grid import Grid
from jaxstab.core.text import text_of
from jaxstab.core.types import ArrayLike
from jaxstab.surfaces import faults
from jaxstab.surfaces.formats.arrays import read_arrays
from jaxstab.surfaces.formats.instruments import read_instrument
from jaxstab.surfaces.formats.labelled import read_netcdf
from jaxstab.surfaces.formats.scan import Scan, UnknownContent
from jaxstab.surfaces.formats.text import read_text
from jaxstab.surfaces.topography import Topography

_NUMPY = b"\x93NUMPY"
_GZIP = b"\x1f\x8b"
_NETCDF = b"CDF", b"\x89HDF\r\n\x1a\n"
_CONTROL = re.compile(r"[^\t\n\v\f\r -\U0010ffff]")


def read(
    path: str | Path,
    lengths: Sequence[float] | ArrayLike | None = None,
    unit: str | None = None,
    channel: str | None = None,
) -> Topography:
    """Read the surface in a file, whose content, and not its name, determines the format.

    The first index of heights runs along x.

    - `.npy`: `numpy.save(path, heights)`.
    - `.npz`: `numpy.savez(path, heights=heights, lengths=(3.0, 1.4), unit="µm")`, `lengths` and
      `unit` if they are known.
    - Text that `numpy.loadtxt` reads: three columns are x, y, z of points on a lattice, in any
      order, two are x, z of an evenly spaced profile; a first line may name them, as `x,y,z`.
      More are a matrix with a line for each x, as `numpy.savetxt(path, heights)` writes it; a
      single row or column is a profile.
    - NetCDF with dimensions x and y, in either order, as `jaxstab.save` and xarray write it.
    - Anything else, text with a header too, is read by SurfaceTopography.

    A side is as long as its number of points times their spacing. Missing points are NaN. Files
    packed by gzip are unpacked first. No file runs code.

    Arguments:
        path: the file.
        lengths: side lengths, in the unit of the heights; needed where the file states none. One
            number does for a line, and for as many points along either side.
        unit: the unit of lengths and heights, where the file states none.
        channel: the name of one of several channels, of NetCDF and `.npz` a variable; by default
            the first that holds heights, of NetCDF and `.npz` `heights`, or the only one. `print`
            of the surface names them.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file holds no surface, is damaged, or has no such channel. If `lengths`
            are needed, or if `lengths` or `unit` contradict the file.
        ImportError: if the format needs a package that is not installed.

    Example:
        >>> np.savetxt("scan.txt", heights)
        >>> scan = js.surfaces.read("scan.txt", lengths=(10.0, 10.0), unit="µm")
        >>> scan.grid.shape, f"{js.surfaces.rms_height(scan):.3f}"
        ((16, 16), '0.050')
    """
    path = Path(path)
    with file_named_in_errors(path):
        topography = _topography(_scan(path, channel), lengths, unit)
    faults.warn(topography.wrong_scale)
    return topography


def scan_of(path: Path, channel: str | None) -> Scan:
    """Return the content of a surface file, as it is; errors as of `read`."""
    with file_named_in_errors(path):
        return _scan(path, channel)


def _scan(path: Path, channel: str | None) -> Scan:
    """Return the content of a file by the first reader that understands it."""
    if not path.is_file():
        raise ValueError("this is no file.")
    source = str(path)
    content = path.read_bytes()
    if content.startswith(_GZIP):
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error) as error:
            raise ValueError(f"its gzip data are truncated or damaged ({error}).") from None
        source = BytesIO(content)
    if not content:
        raise ValueError("the file is empty.")
    if content.startswith(_NUMPY) or _is_npz(content):
        return read_arrays(content, channel)
    if content.startswith(_NETCDF):
        read_own = partial(read_netcdf, content, channel)
    else:
        text = text_of(content)
        if text is None or _CONTROL.search(text):
            return read_instrument(source, channel)
        read_own = partial(read_text, text, channel)
        source = BytesIO(text.encode())
    try:
        return read_own()
    except UnknownContent as unknown:
        try:
            return read_instrument(source, channel)
        except (ImportError, ValueError) as error:
            raise type(error)(f"{unknown} {error}") from None


def _is_npz(content: bytes) -> bool:
    if not zipfile.is_zipfile(BytesIO(content)):
        return False
    names = zipfile.ZipFile(BytesIO(content)).namelist()
    return bool(names) and all(name.endswith(".npy") for name in names)


def _topography(
    scan: Scan, lengths: Sequence[float] | ArrayLike | None, unit: str | None
) -> Topography:
    """Return the surface of a scan, with the user's lengths and unit, which must agree with it."""
    points = times(scan.heights.shape)
    if lengths is None:
        if scan.is_counted and (unit or scan.unit):
            raise ValueError(
                f"its coordinates 0, 1, 2, ... are numbers of points, and no lengths in "
                f"{unit or scan.unit}: give these, as in "
                "`js.surfaces.read(path, lengths=(3.0, 1.4))`."
            )
        if scan.lengths is None:
            raise ValueError(
                f"its {points} heights come without side lengths: give them in the unit of the "
                "heights, as in `js.surfaces.read(path, lengths=(3.0, 1.4))`."
            )
        lengths = scan.lengths
    if np.ndim(lengths) == 0 and len(set(scan.heights.shape)) > 1:
        raise ValueError(
            f"lengths is {lengths}, one number for {points} points: give one for each side."
        )
    heights: Any = scan
    return Topography(Grid(scan.heights.shape, lengths), heights, unit)

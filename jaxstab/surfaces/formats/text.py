"""Text that `numpy.loadtxt` reads: matrices, points x y z of a lattice, and profiles x z."""

import re
from io import StringIO

import numpy as np

from jaxstab.surfaces.formats.scan import (
    Scan,
    UnknownContent,
    chosen,
    even_spacing,
    on_a_side_or_two,
)

# The tolerance of coordinates on a lattice, in steps, and the part of the extent that is noise.
_OFF_LATTICE = 0.05
_NO_GAP = 1e-5
# Longer tables of three columns are points; points on no lattice are an error.
_LONGEST_OF_THREE = 50
# Heights of smaller tables may rise evenly by chance.
_FEWEST_WITH_COORDINATES = 5
_COMMENTS = "#", "%"
# A header has a comment with a number or a unit of length, as `Width: 3 µm` and `w = 12`.
_HEADER = re.compile(
    r"^\s*[#%].*\w\s*[:=\uff1a]\s*(\d\S*|(?:\d\S*\s*)?[kmnpµu\u03bc]?m)\s*$", re.MULTILINE
)


def read_text(text: str, channel: str | None) -> Scan:
    """Return the surface in a text without a header, which may state axes and units."""
    if header := _HEADER.search(text):
        raise UnknownContent(
            f"its comment {header[0].strip()!r} looks like an instrument's header: leave it out "
            "if each line stands for an x."
        )
    return read_table(text, channel)


def read_table(text: str, channel: str | None) -> Scan:
    """Return the surface in a text, a line for each row of numbers; comments are ignored.

    Blanks, commas or semicolons separate them; # and % begin comments; nan marks a missing point.
    Three columns in more than 50 rows are points x, y, z, never a matrix.
    """
    lines = [re.split("[#%]", line, maxsplit=1)[0].strip() for line in text.splitlines()]
    lines = list(filter(None, lines))
    chosen(["heights"], channel, "heights")
    if not lines:
        raise ValueError("it holds no numbers.")
    if all(re.fullmatch(r"-?\d+,\d+", line) for line in lines):
        raise ValueError(
            f"{lines[0]!r} looks like decimal commas, or like two columns: write 1.5, or put a "
            "blank after separating commas."
        )
    separator = next((mark for mark in ";," if mark in lines[0]), None)
    try:
        table = np.loadtxt(StringIO(text), delimiter=separator, comments=_COMMENTS, ndmin=2)
    except ValueError as error:
        raise UnknownContent(f"numpy.loadtxt finds no matrix in it: {error}") from None
    if table.shape[1] == 3:
        return _of_points(*table.T) or _of_three_columns(table)
    if table.shape[1] == 2 and (scan := _of_profile(*table.T)):
        return scan
    if _has_coordinates(table):
        raise ValueError(
            "its first row and its first column look like coordinates: save the heights alone, or "
            "points x y z."
        )
    return Scan(on_a_side_or_two(table))


def _has_coordinates(table: np.ndarray) -> bool:
    """Whether the first row and column rise evenly from a corner that is no height."""
    corner = table[0, 0]
    if min(table.shape) < _FEWEST_WITH_COORDINATES or not (corner == 0 or np.isnan(corner)):
        return False
    sides_rise = all((even_spacing(side) or 0) > 0 for side in (table[0, 1:], table[1:, 0]))
    # A plane rises evenly everywhere.
    return sides_rise and even_spacing(table[1, 1:]) is None


def _of_three_columns(table: np.ndarray) -> Scan:
    if len(table) > _LONGEST_OF_THREE:
        raise ValueError(
            f"it has three columns that lie on no lattice, in {len(table)} rows: interpolate them "
            "onto one, more than half full, if they are x, y, z. Save a matrix as .npy."
        )
    remark = "a matrix of three columns: no points of a lattice"
    return Scan(on_a_side_or_two(table), remarks=(remark,))


def _of_points(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> Scan | None:
    """Return the surface of points x, y, z in any order, if they lie on a lattice."""
    across, along = _on_lattice(x), _on_lattice(y)
    if across is None or along is None:
        return None
    (rows, nx, dx), (columns, ny, dy) = across, along
    if 2 * x.size <= nx * ny:
        return None
    heights = np.full((nx, ny), np.nan)
    heights[rows, columns] = z
    counts = np.zeros((nx, ny), int)
    np.add.at(counts, (rows, columns), 1)
    if (counts > 1).any():
        point = np.flatnonzero(counts[rows, columns] > 1)[0]
        raise ValueError(f"it has several heights at x = {x[point]:g}, y = {y[point]:g}.")
    missing = int(nx * ny - x.size)
    remarks = (f"{missing} points of the lattice not in the file",) if missing else ()
    return Scan(heights, (nx * dx, ny * dy), remarks=remarks)


def _on_lattice(values: np.ndarray) -> tuple[np.ndarray, int, float] | None:
    """Return indices on an even lattice, the number of its places, and their spacing."""
    extent = np.ptp(values)
    if not 0 < extent < np.inf:
        return None
    gaps = np.diff(np.unique(values)) / extent
    gaps = gaps[gaps > _NO_GAP]
    # Rounded coordinates have gaps of a step, and of several over missing lines.
    steps = int(np.rint(gaps / gaps.min()).sum())
    places = (values - values.min()) / extent * steps
    nearest = np.rint(places).astype(int)
    is_on = steps < values.size and np.abs(places - nearest).max() <= _OFF_LATTICE
    return (nearest, steps + 1, float(extent / steps)) if is_on else None


def _of_profile(x: np.ndarray, z: np.ndarray) -> Scan | None:
    """Return the profile of heights z at rising or falling x."""
    if x.size < 3 or np.isnan(x).any() or abs(np.sign(np.diff(x)).sum()) < x.size - 1:
        return None
    if x[0] > x[-1]:
        x, z = x[::-1], z[::-1]
    spacing = even_spacing(x)
    if spacing is None:
        raise ValueError(
            "its first column rises unevenly: interpolate the profile to an even spacing of x."
        )
    return Scan(z, (x.size * spacing,))

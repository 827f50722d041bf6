"""Text that `numpy.loadtxt` reads: matrices, points x y z of a lattice, and profiles x z."""

import re
from io import StringIO

import numpy as np

from jaxstab.surfaces.formats.scan import (
    Scan,
    UnknownContent,
    are_pixels,
    chosen,
    on_a_side_or_two,
    on_lattice,
)

# Heights of smaller tables may rise evenly by chance.
_FEWEST_WITH_COORDINATES = 5
# A header has a comment with a number or a unit of length, as `Width: 3 µm` and `w = 12`.
_HEADER = re.compile(
    r"^\s*[#%].*\w\s*[:=\uff1a]\s*(?=\S)(\d+([.,]\d+)?(e[-+]?\d+)?)?\s*([kmnpµu\u03bc]?m)?\s*$",
    re.MULTILINE | re.IGNORECASE,
)
# A line that names the columns of points, as programs write it above their numbers.
_NAMES = re.compile(r"\s*\W?x\W+(y\W+)?(z|h|heights?)\W?\s*", re.IGNORECASE)


def read_text(text: str, channel: str | None) -> Scan:
    """Return the surface in a text, a line for each row of numbers; # and % begin comments.

    Blanks, commas or semicolons separate numbers; nan marks a missing point. Two columns are a
    profile x z and three are points x y z, anything else is a matrix or a single line. A first line
    may name the columns of points.
    """
    first, _, rest = text.lstrip().partition("\n")
    widths = [len(re.split(r"[;,\s]+", line.strip())) for line in (first, rest.partition("\n")[0])]
    if _NAMES.fullmatch(first) and widths[0] == widths[1]:
        text = rest
    if header := _HEADER.search(text):
        raise UnknownContent(
            f"its comment {header[0].strip()!r} looks like an instrument's header: leave it out "
            "if each line stands for an x."
        )
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
        table = np.loadtxt(StringIO(text), delimiter=separator, comments=["#", "%"], ndmin=2)
    except ValueError as error:
        raise UnknownContent(
            f"numpy.loadtxt finds no matrix in it: {str(error).rstrip('.')}. Write numbers alone, "
            "with decimal points and nan for a missing point, or read them yourself for "
            "js.surfaces.Topography."
        ) from None
    numbered = _numbered(table)
    if numbered:
        raise ValueError(
            f"its first {numbered} counts 0, 1, 2, ...: these look like the labels of a table, and "
            "no heights. Save the heights alone, as pandas' `to_csv(index=False, header=False)`."
        )
    if len(table) > 1 and table.shape[1] in (2, 3):
        return _of_points(table)
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
    # A plane rises evenly everywhere.
    return _rises(table[0, 1:]) and _rises(table[1:, 0]) and not _rises(table[1, 1:])


def _numbered(table: np.ndarray) -> str:
    """Return "row" or "column" if the first one numbers the others, unless all rise so."""
    for name, lines in (("row", table), ("column", table.T)):
        if len(lines) < 2 or lines.shape[1] < _FEWEST_WITH_COORDINATES:
            continue
        is_profile = name == "column" and len(lines) in (2, 3)
        is_counted = np.array_equal(lines[0], np.arange(lines.shape[1]))
        if is_counted and not _rises(lines[1]) and not is_profile:
            return name
    return ""


def _rises(values: np.ndarray) -> bool:
    steps = np.diff(values)
    return bool(steps.min() > 0 and np.ptp(steps) <= 1e-2 * steps.mean())


def _of_points(table: np.ndarray) -> Scan:
    """Return the surface of points x, y, z or the profile of points x, z, in any order."""
    *coordinates, z = table.T
    sides = [side for values in coordinates if (side := on_lattice(values))]
    shape = tuple(count for _, count, _ in sides)
    if len(sides) < len(coordinates) or 2 * z.size <= np.prod(shape):
        names = " ".join([*"xy"[: len(coordinates)], "z"])
        raise ValueError(
            f"its {table.shape[1]} columns are no points {names} of an even lattice, in {z.size} "
            "rows: interpolate them onto one, more than half full. Save a matrix as .npy."
        )
    indices = tuple(index for index, _, _ in sides)
    steps = [step for _, _, step in sides]
    counts = np.zeros(shape, int)
    np.add.at(counts, indices, 1)
    if (counts > 1).any():
        place = table[np.argmax(counts[indices] > 1), :-1]
        where = ", ".join(f"{name} = {x:g}" for name, x in zip("xy", place, strict=False))
        raise ValueError(f"it has several heights at {where}.")
    heights = np.full(shape, np.nan)
    heights[indices] = z
    lengths = tuple(np.multiply(shape, steps))
    is_counted = all(are_pixels(values) for values in coordinates)
    missing = heights.size - z.size
    remarks = ()
    if missing:
        remarks = (f"{missing} points of the lattice not in the file",)
    return Scan(heights, lengths, remarks=remarks, is_counted=is_counted)

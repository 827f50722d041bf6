"""Text that `numpy.loadtxt` reads: matrices, points x y z of a lattice, and profiles x z."""

import re
from io import StringIO

import numpy as np

from jaxstab.surfaces.formats.scan import (
    Scan,
    UnknownContent,
    are_pixels,
    channel_to_read,
    on_a_side_or_two,
    on_lattice,
)

# Heights of smaller tables may rise evenly by chance, along both sides and along one.
_FEWEST_WITH_COORDINATES = 5
_FEWEST_IN_STEPS = 4
# Two columns are points x z, three are x y z.
_MOST_COORDINATES = 3
_INTEGER = re.compile(r"[-+]?\d+")
# A header has a comment with a number or a unit of length, as `Width: 3 µm` and `w = 12`.
_HEADER = re.compile(
    r"^\s*[#%].*\w\s*[:=\uff1a]\s*(?=\S)(\d+([.,]\d+)?(e[-+]?\d+)?)?\s*([kcmnpµu\u03bc]?m)?\s*$",
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
            "if each row of numbers holds the heights at one x."
        )
    lines = [re.split("[#%]", line, maxsplit=1)[0].strip() for line in text.splitlines()]
    lines = list(filter(None, lines))
    channel_to_read(["heights"], channel, "heights")
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
            "with decimal points and nan for a missing point, begin a line of titles with #, or "
            "read them yourself for js.surfaces.Topography."
        ) from None
    texts = [[text.strip() for text in line.split(separator)] for line in lines]
    if labels := _labels(table, texts):
        raise ValueError(
            f"{labels}: these look like the labels of a table, and no heights. Save the heights "
            "alone, as pandas' `to_csv(index=False, header=False)`; if they are heights, save them "
            "by `numpy.save`."
        )
    if len(table) > 1 and table.shape[1] in (2, _MOST_COORDINATES):
        return _of_points(table)
    return Scan(on_a_side_or_two(table))


def _labels(table: np.ndarray, texts: list[list[str]]) -> str:
    """Return which numbers are the labels of the others; nothing if all are heights or points."""
    sides = {"row": (table, texts[0], texts[1:])}
    is_matrix = len(table) == 1 or table.shape[1] > _MOST_COORDINATES
    if is_matrix:
        if _has_coordinates(table):
            return "its first row and its first column look like coordinates"
        sides["column"] = (table.T, [row[0] for row in texts], [row[1:] for row in texts])
    for name, (lines, first, others) in sides.items():
        if len(lines) > 1 and _counts(first, others):
            return f"its first {name} counts from 0"
        if len(lines) > 1 and is_matrix and _stands_apart(lines):
            return f"its first {name} rises evenly from {lines[0, 0]:g}, unlike the next one"
    return ""


def _counts(first: list[str], others: list[list[str]]) -> bool:
    """Whether a line is 0, 1, 2, ... beside numbers that are all written with decimals."""
    if first != [str(i) for i in range(len(first))]:
        return False
    return not any(_INTEGER.fullmatch(text) for line in others for text in line)


def _stands_apart(lines: np.ndarray) -> bool:
    """Whether the first line rises evenly, while the next one has other steps.

    A tilted surface rises evenly in all of its lines.
    """
    if lines.shape[1] < _FEWEST_IN_STEPS or not _rises(lines[0]):
        return False
    step = np.diff(lines[0]).mean()
    return not (np.abs(np.diff(lines[1]) - step) <= step / 2).all()


def _has_coordinates(table: np.ndarray) -> bool:
    """Whether the first row and column rise evenly from a corner that is no height."""
    corner = table[0, 0]
    if min(table.shape) < _FEWEST_WITH_COORDINATES or not (corner == 0 or np.isnan(corner)):
        return False
    # A plane rises evenly everywhere.
    return _rises(table[0, 1:]) and _rises(table[1:, 0]) and not _rises(table[1, 1:])


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

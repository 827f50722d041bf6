"""Text: matrices, points x y z of a lattice, and profiles x z."""

import re
from collections.abc import Iterator

import numpy as np

from jaxstab.surfaces.formats.scan import Scan, UnknownContent, even_spacing, on_a_side_or_two

# The relative error up to which coordinates lie on a lattice, and what gap is one of rounding.
_OFF_LATTICE = 0.05
_ROUNDING = 1e-4


def read_text(text: str) -> Scan:
    """Return the surface that a text holds.

    A line is a row of numbers; what follows # or % is a comment. Separators are blanks or, where
    they occur, semicolons, commas or tabs; a field left empty between these is a missing point.

    Raises:
        ValueError: if a word is no number, a number infinite, or a line of another length.
    """
    table = _table([(i, line) for i, line in enumerate(text.splitlines(), 1)])
    if table.shape[1] == 3:
        return _of_points(*table.T) or Scan(
            on_a_side_or_two(table), remarks=("a matrix of three columns: no points of a lattice",)
        )
    if table.shape[1] == 2 and (scan := _of_profile(*table.T)):
        return scan
    return Scan(on_a_side_or_two(table))


def _table(lines: list[tuple[int, str]]) -> np.ndarray:
    uncommented = ((i, re.split("[#%]", line, maxsplit=1)[0].strip(" \r")) for i, line in lines)
    rows = [(i, row) for i, row in uncommented if row.strip()]
    if not rows:
        raise ValueError("it holds no numbers.")
    values, first = [], rows[0][0]
    for i, words in _split(rows):
        numbers = np.array([_number(i, word, i == first and not values) for word in words])
        if values and numbers.size != values[0].size:
            raise ValueError(
                f"line {i} has {numbers.size} numbers, line {first} has {values[0].size}: all "
                "lines must have as many. Write nan for a missing point."
            )
        values.append(numbers)
    return np.array(values)


def _split(rows: list[tuple[int, str]]) -> Iterator[tuple[int, list[str]]]:
    """Yield the words of each row."""
    separator = next((mark for mark in ";,\t" if any(mark in row for _, row in rows)), None)
    # Blanks within a field tell that tabs only align.
    if separator == "\t" and any(re.search(r"\S +\S", row) for _, row in rows):
        separator = None
    ends = separator is not None and all(row.endswith(separator) for _, row in rows)
    for i, row in rows:
        yield i, row.split(separator)[: -1 if ends else None]


def _number(line: int, word: str, is_first: bool) -> float:
    word = word.strip()
    try:
        number = float(word) if word else np.nan
    except ValueError:
        kind = UnknownContent if is_first else ValueError
        raise kind(
            f"line {line}: {word!r} is no number. Write numbers as 1.5e-6, missing points as nan, "
            "and begin comments with #."
        ) from None
    if np.isinf(number):
        raise ValueError(f"line {line}: {word!r} is infinite. Write nan for a missing point.")
    return number


def _of_points(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> Scan | None:
    """Return the surface of points x, y, z in any order, if they lie on a lattice."""
    sides = [_on_lattice(x), _on_lattice(y)]
    if None in sides:
        return None
    (rows, nx, dx), (columns, ny, dy) = (side for side in sides if side)
    if 2 * x.size < nx * ny:
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
    """Return places on an even lattice, how many of them there are, and their spacing."""
    distinct = np.unique(values)
    gaps = np.diff(distinct)
    if not np.isfinite(distinct).all() or gaps.size == 0:
        return None
    extent = distinct[-1] - distinct[0]
    spacing = gaps[gaps > _ROUNDING * gaps.max()].min()
    count = round(extent / spacing) + 1
    if count > values.size:
        return None
    spacing = extent / (count - 1)
    places = (values - distinct[0]) / spacing
    nearest = np.rint(places).astype(int)
    is_on = np.abs(places - nearest).max() <= _OFF_LATTICE
    return (nearest, count, float(spacing)) if is_on else None


def _of_profile(x: np.ndarray, z: np.ndarray) -> Scan | None:
    """Return the profile of heights z at rising x.

    Raises:
        ValueError: if x rises unevenly.
    """
    if x.size < 3 or not (np.diff(x) > 0).all():
        return None
    spacing = even_spacing(x)
    if spacing is None:
        raise ValueError(
            "its first column rises unevenly: interpolate the profile to an even spacing of x."
        )
    return Scan(z, (x.size * spacing,))

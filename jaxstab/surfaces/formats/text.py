"""Text: matrices, points x y z of a lattice and profiles x z, and images of Gwyddion."""

import re
from collections.abc import Iterator

import numpy as np

from jaxstab.surfaces.formats.gwyddion import header_of, units_of_points
from jaxstab.surfaces.formats.scan import (
    Scan,
    UnknownContent,
    even_spacing,
    is_number,
    on_a_side_or_two,
)
from jaxstab.surfaces.formats.titles import Titles, titles_of

# The relative error up to which coordinates lie on a lattice, and what share of a gap is none.
_OFF_LATTICE = 0.05
_NO_GAP = 0.1
# Longer tables of three columns are points: what is no lattice then is no matrix either.
_LONGEST_OF_THREE = 50
# In smaller tables heights may rise evenly by chance.
_FEWEST_WITH_COORDINATES = 5
# With digits on both sides, as `1, 2` and `1,,2` have not.
_DECIMAL = re.compile(r"[+-]?\d+(,\d+)?(e[+-]?\d+)?|nan", re.IGNORECASE)

# What instruments write into comments: to leave it out could change axes and units.
_OF_AN_INSTRUMENT = re.compile(
    r"^\s*#\s*((?:[xy]-pixels|[xy]-length|[xyz]-unit|Bit2nm|pixel size|File Format)\s*[:=].*|"
    r"[hw]\s*=\s*\d.*|height conversion factor.*)$",
    re.MULTILINE | re.IGNORECASE,
)

Rows = list[tuple[int, str]]


def read_text(text: str) -> Scan:
    """Return the surface that a text holds.

    A line is a row of numbers; what follows # or % is a comment. Separators are blanks or, where
    they occur, semicolons, commas or tabs; a field left empty between these is a missing point.
    Commas are decimal ones where blanks, tabs or semicolons separate fields that all fit that.
    Three columns in more than 50 rows are points x, y, z, never a matrix. Titles with units may
    stand above columns x, z and x, y, z, and above x, z, valid, where 0 marks a missing point.
    """
    if said := _OF_AN_INSTRUMENT.search(text):
        raise UnknownContent(
            f"its header says {said[1]!r}, as that of an instrument does: leave that out where a "
            "line stands for each x."
        )
    rows = _uncommented(text)
    firsts = [re.split(r"[;,\s]+", row.strip(), maxsplit=1)[0] for _, row in rows]
    num_titles = next((i for i, word in enumerate(firsts) if is_number(word or "nan")), 0)
    head, rows = rows[:num_titles], rows[num_titles:]
    has_decimal_commas = _has_decimal_commas(rows)
    if has_decimal_commas:
        rows = [(i, row.replace(",", ".")) for i, row in rows]
    remarks = ("decimal commas taken for points",) if has_decimal_commas else ()
    if not head:
        return _scan(_table(rows), text).remarked(*remarks)
    unknown = UnknownContent(_no_number(head[0][0], firsts[0]))
    try:
        table = _table(rows)
    except ValueError:
        raise unknown from None
    # What profilers leave empty behind the last one.
    while table.shape[1] > 2 and np.isnan(table[:, -1]).all():
        table = table[:, :-1]
    titles = titles_of([row.strip() for _, row in head], table.shape[1])
    if titles is None:
        raise unknown
    return _of_columns(table, titles).remarked(*remarks)


def _scan(table: np.ndarray, text: str) -> Scan:
    if header := header_of(text):
        return header.scan(table)
    if table.shape[1] == 3:
        points = _of_points(*table.T)
        return points.in_units(*units_of_points(text)) if points else _of_three_columns(table)
    if table.shape[1] == 2 and (scan := _of_profile(*table.T)):
        return scan
    if _has_coordinates(table):
        raise ValueError(
            "its first row and its first column look like coordinates: save the heights alone, or "
            "points x y z."
        )
    return Scan(on_a_side_or_two(table))


def _of_columns(table: np.ndarray, titles: Titles) -> Scan:
    columns = list(table.T)[int(titles.has_index) :]
    if titles.has_marks:
        marks = columns.pop()
        columns[-1] = np.where(marks == 0, np.nan, columns[-1])
    scan = _of_points(*columns) if titles.are_points else _of_profile(*columns)
    if scan is None:
        what = "points lie on no lattice" if titles.are_points else "x neither rises nor falls"
        raise ValueError(f"its {what}: interpolate them to an even spacing.")
    return scan.in_units(titles.unit, titles.unit_of_sides)


def _has_coordinates(table: np.ndarray) -> bool:
    """Whether the first row and column rise evenly from a corner that is no height."""
    if min(table.shape) < _FEWEST_WITH_COORDINATES:
        return False
    has_corner = table[0, 0] == 0 or np.isnan(table[0, 0])
    sides_rise = all((even_spacing(side) or 0) > 0 for side in (table[0, 1:], table[1:, 0]))
    # A plane rises evenly everywhere.
    return bool(has_corner and sides_rise and even_spacing(table[1, 1:]) is None)


def _of_three_columns(table: np.ndarray) -> Scan:
    if len(table) > _LONGEST_OF_THREE:
        raise ValueError(
            f"it has three columns that lie on no lattice, in {len(table)} rows: interpolate them "
            "onto one, more than half full, if they are x, y, z. Save a matrix as .npy."
        )
    remark = "a matrix of three columns: no points of a lattice"
    return Scan(on_a_side_or_two(table), remarks=(remark,))


def _uncommented(text: str) -> Rows:
    lines = enumerate(text.splitlines(), 1)
    rows = ((i, re.split("[#%]", line, maxsplit=1)[0].strip(" \r")) for i, line in lines)
    return [(i, row) for i, row in rows if row.strip()]


def _has_decimal_commas(rows: Rows) -> bool:
    """Return whether commas are decimal ones, which takes another separator to tell."""
    if not any("," in row for _, row in rows):
        return False
    words = [[word for word in re.split(r"[;\s]+", row) if word] for _, row in rows]
    if not all(_DECIMAL.fullmatch(word) for row in words for word in row):
        return False
    if all(len(row) == 1 for row in words) and not any(";" in row for _, row in rows):
        line, row = next((i, row) for i, row in rows if "," in row)
        raise ValueError(
            f"line {line}: {row.strip()!r} looks like decimal commas, or like two columns: write "
            "1.5, or put a blank after separating commas."
        )
    return True


def _table(rows: Rows) -> np.ndarray:
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


def _split(rows: Rows) -> Iterator[tuple[int, list[str]]]:
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
        raise kind(_no_number(line, word)) from None
    if np.isinf(number):
        raise ValueError(f"line {line}: {word!r} is infinite. Write nan for a missing point.")
    return number


def _no_number(line: int, word: str) -> str:
    return (
        f"line {line}: {word!r} is no number. Write numbers as 1.5e-6, missing points as nan, and "
        "begin comments with #."
    )


def _of_points(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> Scan | None:
    """Return the surface of points x, y, z in any order, if they lie on a lattice."""
    sides = [_on_lattice(x), _on_lattice(y)]
    if None in sides:
        return None
    (rows, nx, dx), (columns, ny, dy) = (side for side in sides if side)
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
    """Return places on an even lattice, how many of them there are, and their spacing."""
    distinct = np.unique(values)
    gaps = np.diff(distinct)
    if not np.isfinite(distinct).all() or gaps.size == 0:
        return None
    # A gap is so many steps: none where coordinates differ by noise, several over missing lines.
    steps = np.rint(gaps / _smallest_step(gaps))
    if steps.sum() >= values.size:
        return None
    count = int(steps.sum()) + 1
    spacing = (distinct[-1] - distinct[0]) / (count - 1)
    places = (values - distinct[0]) / spacing
    nearest = np.rint(places).astype(int)
    is_on = np.abs(places - nearest).max() <= _OFF_LATTICE
    return (nearest, count, float(spacing)) if is_on else None


def _smallest_step(gaps: np.ndarray) -> float:
    """Return the smallest gap that is no noise beside the typical one, which half the extent has.

    Noise makes most of the gaps, but little of the extent.
    """
    ascending = np.sort(gaps)
    extents = np.cumsum(ascending)
    typical = ascending[np.searchsorted(extents, extents[-1] / 2)]
    return gaps[gaps > _NO_GAP * typical].min()


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

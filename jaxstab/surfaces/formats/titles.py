"""The titles of columns of numbers, and the units in them."""

import re
from dataclasses import dataclass

from jaxstab.surfaces.units import unit_of

_PLACE = re.compile(r"(x|lateral|distance|position)(?![a-z])", re.IGNORECASE)
# Of these alone the unit may be left to that of the places.
_HEIGHT = re.compile(r"(y|z|h|height|höhe)\d*", re.IGNORECASE)
_IN_BRACKETS = re.compile(r"[\[(]\s*(.*?)\s*[\])]")
# The first line of a profiler's file (Dektak), whose titles follow many others.
_PROFILER = "Scan Parameters"


@dataclass(frozen=True)
class Titles:
    """The titles of columns x, z, of x, z, valid, or of x, y, z, with or without an index.

    A last column of marks is zero where a point is missing; a unit is None where it is not said.
    """

    has_index: bool
    are_points: bool
    has_marks: bool
    unit: str | None
    unit_of_sides: str | None


def titles_of(head: list[str], num_columns: int) -> Titles | None:
    """Return the content of the lines above columns, if those are titles with units."""
    *rest, last = head
    units = _fields(last)
    if rest and all(_IN_BRACKETS.fullmatch(field) for field in units):
        # Units in a line of their own.
        *rest, last = rest
        titles = [" ".join(pair) for pair in zip(_fields(last), units, strict=False)]
    else:
        titles = units
    is_known = not rest or rest[0].startswith(_PROFILER)
    has_index = titles[0].lower() == "index"
    has_marks = titles[-1].lower().startswith("valid")
    values = titles[int(has_index) : -1 if has_marks else None]
    if not is_known or len(titles) != num_columns or not _PLACE.match(values[0] if values else ""):
        return None
    are_points = len(values) == 3 and values[1].lower().startswith("y")
    if len(values) != 2 and not are_points:
        return None
    *sides, unit = map(_unit, values)
    if len(set(sides)) > 1:
        raise ValueError(f"its columns x and y are in different units, {sides[0]} and {sides[1]}.")
    if unit is None and sides[0] is None:
        return None
    if unit is None and not _HEIGHT.fullmatch(values[-1]):
        raise ValueError(f"its column {values[-1]!r} has no unit of length: write `z (nm)`, say.")
    return Titles(has_index, are_points, has_marks, unit, sides[0])


def _fields(line: str) -> list[str]:
    separator = next((mark for mark in ";,\t" if mark in line), None)
    fields = [field.strip() for field in line.split(separator)]
    while fields and not fields[-1]:
        fields.pop()
    return fields


def _unit(title: str) -> str | None:
    if bracket := _IN_BRACKETS.search(title):
        return unit_of(bracket[1])
    for word in re.split(r"[\s_/]+", title)[1:]:
        try:
            return unit_of(word)
        except ValueError:
            continue
    return None

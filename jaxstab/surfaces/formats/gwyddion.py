"""The header that Gwyddion writes above an image that it exports as text."""

import re
from dataclasses import dataclass

import numpy as np

from jaxstab.surfaces.formats.scan import Scan, in_one_unit, on_a_side_or_two
from jaxstab.surfaces.units import converted, unit_of

_LINE = re.compile(r"^\s*#\s*(Width|Height|Value units):[ \t]*(.*?)\s*$", re.MULTILINE)
_LENGTH = re.compile(r"([-+.,\de]+)\s*(\S*)", re.IGNORECASE)


@dataclass(frozen=True)
class Header:
    """Side lengths with their units, and that of the heights; None where it is not said."""

    width: tuple[float, str | None]
    height: tuple[float, str | None]
    unit: str | None

    def scan(self, rows: np.ndarray) -> Scan:
        """Return the surface of an image, its rows along x, its first at y = 0 as in a .gwy file.

        Heights come in the unit of the width.
        """
        (width, unit_of_sides), (height, other) = self.width, self.height
        if other != unit_of_sides:
            if other is None or unit_of_sides is None:
                raise ValueError("its width or height comes without a unit: write both with one.")
            height = float(converted(np.asarray(height), other, unit_of_sides))
        heights, unit, remarks = in_one_unit(rows.T, self.unit, unit_of_sides)
        sides = zip((width, height), heights.shape, strict=True)
        # A single row or column is a profile.
        lengths = tuple(length for length, n in sides if n > 1)
        remark = "an image of Gwyddion, a row for each y"
        return Scan(on_a_side_or_two(heights), lengths, unit, (remark, *remarks))


def header_of(text: str) -> Header | None:
    """Return the header among the comments of a text, if there is one.

    Raises:
        ValueError: for one that is damaged, or of several images, and for units of no length.
    """
    lines = _LINE.findall(text)
    names = [name for name, _ in lines]
    if not {"Width", "Height"} <= set(names):
        return None
    if len(names) > len(set(names)):
        raise ValueError("it holds several images: export one channel.")
    said = dict(lines)
    unit = said.get("Value units")
    return Header(
        _length("width", said["Width"]),
        _length("height", said["Height"]),
        unit_of(unit) if unit else None,
    )


def _length(name: str, words: str) -> tuple[float, str | None]:
    try:
        number, unit = _LENGTH.fullmatch(words).groups()  # pyright: ignore[reportOptionalMemberAccess]
        return float(number.replace(",", ".")), unit_of(unit) if unit else None
    except (AttributeError, ValueError):
        raise ValueError(f"its {name} is {words!r}: write a number and a unit of length.") from None

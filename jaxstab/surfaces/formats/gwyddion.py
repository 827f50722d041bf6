"""The headers that Gwyddion writes above an image or points that it exports as text."""

import re
from dataclasses import dataclass

import numpy as np

from jaxstab.surfaces.formats.scan import Scan, UnknownContent, on_a_side_or_two
from jaxstab.surfaces.units import converted, unit_if_said

# What it says, in each language of its menus.
_LABELS = {
    "channel": "Channel|Kanál|Kanal|Canal|Canale|チャネル|채널|Канал",
    "width": "Width|Šířka|Breite|Anchura|Largeur|Larghezza|幅|폭|Largura|Ширина",
    "height": "Height|Výška|Höhe|Altura|Hauteur|Altezza|高さ|높이|Высота",
    "unit": "Value units|Jednotky hodnot|Einheiten|Unités|unità valore|値の単位|값 단위|"
    "Unidades de valor|Единицы измерения",
    "unit of sides": "Lateral units",
}
_NAMES = {label: name for name, labels in _LABELS.items() for label in labels.split("|")}
# The second colon is that of Japanese.
_LINE = re.compile(rf"^\s*#\s*({'|'.join(_NAMES)})\s*[:\uff1a][ \t]*(.*?)\s*$", re.MULTILINE)
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
        sides = zip((width, height), rows.T.shape, strict=True)
        # A single row or column is a profile.
        lengths = tuple(length for length, n in sides if n > 1)
        remarks = ("an image of Gwyddion, a row for each y",)
        scan = Scan(on_a_side_or_two(rows.T), lengths, remarks=remarks)
        return scan.in_units(self.unit, unit_of_sides)


def header_of(text: str) -> Header | None:
    """Return the header of an image among the comments of a text, if there is one."""
    said = _said(text)
    if not {"width", "height", "unit"} & set(said) or "unit of sides" in said:
        return None
    if max(map(len, said.values())) > 1:
        names = said.get("channel", [])
        is_told_apart = len(names) == len(set(names)) == len(said.get("width", []))
        kind = UnknownContent if is_told_apart else ValueError
        raise kind("it holds several images: export one channel, or name each.")
    if not {"width", "height"} <= set(said):
        raise UnknownContent(
            f"its header says {' and '.join(said)}, but not both sides: write width and height, or "
            "leave these comments out."
        )
    return Header(
        _length("width", said["width"][0]),
        _length("height", said["height"][0]),
        unit_if_said(said.get("unit", [""])[0]),
    )


def units_of_points(text: str) -> tuple[str | None, str | None]:
    """Return the units of heights and of places that a header of points says."""
    said = _said(text)
    if "unit of sides" not in said:
        return None, None
    return unit_if_said(said.get("unit", [""])[0]), unit_if_said(said["unit of sides"][0])


def _said(text: str) -> dict[str, list[str]]:
    said: dict[str, list[str]] = {}
    for label, words in _LINE.findall(text):
        said.setdefault(_NAMES[label], []).append(words)
    return said


def _length(name: str, words: str) -> tuple[float, str | None]:
    try:
        number, unit = _LENGTH.fullmatch(words).groups()  # pyright: ignore[reportOptionalMemberAccess]
        return float(number.replace(",", ".")), unit_if_said(unit)
    except (AttributeError, ValueError):
        raise ValueError(f"its {name} is {words!r}: write a number and a unit of length.") from None

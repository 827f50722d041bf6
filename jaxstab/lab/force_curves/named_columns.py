"""Text with named columns and units: `height [nm]`, `force (nN)`."""

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from jaxstab.lab.force_curves.recording import Recording
from jaxstab.lab.force_curves.segment import FORCES, LENGTHS
from jaxstab.units import unit_of

_TIMES = {"s": 0, "ms": -3, "µs": -6, "ns": -9}
_VOLTAGES = {"V": 0, "mV": -3, "kV": 3}
# Names of columns, as programs write them, and the kinds of their quantities.
_NAMES = {
    "force": "force",
    "load": "force",
    "deflection": "deflection",
    "height": "height",
    "height measured": "height",
    "piezo": "height",
    "z": "height",
    "extension": "extension",
    "tip position": "tip",
    "tip": "tip",
    "separation": "tip",
    "time": "time",
    "t": "time",
    "segment": "segment",
    "curve": "curve",
    "x": "x",
    "y": "y",
}
_TITLE = re.compile(r"\s*(?P<name>.*?)\s*[\[(]\s*(?P<unit>[^\[\]()]*?)\s*[\])]\s*")
# A title with its unit, or without one, where blanks separate titles.
_BEFORE_BLANK = re.compile(
    r"(?:segment|curve)(?=\s|$)|[^\s\[(][^\[(]*?\s*[\[(][^\])]*[\])]|\S+", re.IGNORECASE
)
_QUANTITY = re.compile(r"\s*(?P<value>[-+]?[\d.]+(?:e[-+]?\d+)?)\s*(?P<unit>\S+)\s*", re.IGNORECASE)
_LENGTH, _FORCE, _TIME, _DEFLECTION = "a length", "a force", "a time", "a length or a voltage"
_KINDS = {
    "force": _FORCE,
    "deflection": _DEFLECTION,
    "height": _LENGTH,
    "extension": _LENGTH,
    "tip": _LENGTH,
    "time": _TIME,
    "x": _LENGTH,
    "y": _LENGTH,
}
_COMMAS = "If commas are decimal marks, save it with points, or with semicolons between columns."
_WITHOUT_UNIT = {"segment", "curve"}


def is_named_table(text: str) -> bool:
    """Whether the first line that is no comment names columns with units."""
    lines = list(_lines(text))
    if not lines:
        return False
    cells = _titles(lines[0][1], _separator(lines[0][1]))
    return any(match["name"] for match in map(_TITLE.fullmatch, cells) if match)


@dataclass(frozen=True)
class _Column:
    """A column: the quantity in it, its title and unit, and the power of ten to SI units.

    The kind is empty for a column that is not read.
    """

    kind: str
    title: str
    unit: str
    exponent: int


def read_named_columns(
    text: str, name: str, spring_constant: float | None, sensitivity: float | None
) -> list[Recording]:
    """Return the curves of a text: a line of names with units, then a line for each point.

    Comments as `# spring constant: 0.2 N/m` and `# sensitivity: 50 nm/V` describe the cantilever.

    Arguments:
        text: the text.
        name: the file's, for the sources of the curves.
        spring_constant, sensitivity: what the user knows [N/m, m/V].

    Raises:
        ValueError: for columns without unit, repeated or lacking, lines of another length, and
            values that are no numbers.
    """
    lines = list(_lines(text))
    if not lines:
        raise ValueError("it holds no line but comments.")
    stated = dict(_stated_properties(text))
    constant = common_value(
        "spring constant", spring_constant, stated.get("spring constant"), "N/m"
    )
    sensitivity = common_value("sensitivity", sensitivity, stated.get("sensitivity"), "m/V")
    separator = _separator(lines[0][1])
    columns = _columns(_titles(lines[0][1], separator))
    table = _table(lines, separator, columns)
    unread = (column.title for column in columns if not column.kind)
    remarks = tuple(f"column {title!r} not read" for title in unread if title)
    number_of = table.get("curve", np.full(len(lines) - 1, ""))
    groups = list(dict.fromkeys(number_of.tolist()))
    recordings = []
    for group in groups:
        rows = {kind: values[number_of == group] for kind, values in table.items()}
        source = name
        if len(groups) > 1:
            source = f"{name}, curve {group}"
        try:
            recording = _recording(rows, columns, constant, sensitivity)
        except ValueError as error:
            if len(groups) == 1:
                raise
            raise ValueError(f"curve {group}: {error}") from None
        recordings.append(
            Recording(**recording, source=source, remarks=remarks, labels=rows.get("segment"))
        )
    return recordings


def common_value(name: str, given: float | None, stated: float | None, unit: str) -> float | None:
    """Return a property of the cantilever, which the user and the file must not contradict.

    Raises:
        ValueError: if they differ, or the number is not positive.
    """
    if isinstance(given, str):
        raise ValueError(f"the {name} is {given!r}: give a number in {unit}.")
    if given is not None and stated is not None and not np.isclose(given, stated, rtol=1e-3):
        raise ValueError(
            f"its {name} is {stated:.6g} {unit}, the given one {given:.6g} {unit}: leave that out. "
            "The forces in the file rest on its own."
        )
    value = given
    if value is None:
        value = stated
    if value is None:
        return None
    if not 0 < value < np.inf:
        raise ValueError(f"the {name} is {value:.6g} {unit}: it must be positive.")
    return float(value)


def _recording(
    rows: dict[str, np.ndarray],
    columns: list[_Column],
    constant: float | None,
    sensitivity: float | None,
) -> dict:
    """Return the arguments of a recording, in SI units."""
    values = {
        column.kind: rows[column.kind] * 10.0**column.exponent
        for column in columns
        if column.kind in _KINDS
    }
    force = values.get("force")
    height = values.get("height")
    tip = values.get("tip")
    if "extension" in values:
        height = -values["extension"]
    if force is None:
        deflection = values["deflection"]
        if next(column for column in columns if column.kind == "deflection").unit in _VOLTAGES:
            if sensitivity is None:
                raise ValueError(
                    "its deflection is in volts, but its sensitivity is unknown: give it in m/V, "
                    "as in read(path, sensitivity=50e-9, spring_constant=0.2)."
                )
            deflection = deflection * sensitivity
        if constant is None:
            raise ValueError(
                "it has a deflection and no force, but its spring constant is unknown: give it in "
                "N/m, as in read(path, spring_constant=0.2)."
            )
        force = deflection * constant
    if height is None:
        if constant is None or tip is None:
            raise ValueError(
                "it has a tip position and no height, but its spring constant is unknown: give it "
                "in N/m, as in read(path, spring_constant=0.2)."
            )
        height = tip - force / constant
    place = [values[axis] for axis in "xy" if axis in values]
    if any(np.ptp(axis) > 0 for axis in place):
        raise ValueError(
            "its x and y change within a curve: number its curves in a column `curve`."
        )
    position = None
    if len(place) == 2:
        position = (float(place[0][0]), float(place[1][0]))
    return {
        "force": force,
        "height": height,
        "tip": tip,
        "time": values.get("time"),
        "spring_constant": constant,
        "sensitivity": sensitivity,
        "position": position,
    }


def _columns(titles: list[str]) -> list[_Column]:
    """Return the columns by their titles; those of other names have no kind."""
    columns = []
    for title in map(str.strip, titles):
        name = title
        unit = ""
        if match := _TITLE.fullmatch(title):
            name = match["name"]
            unit = match["unit"]
        kind = _NAMES.get(re.sub(r"[\W_]+", " ", name.lower()).strip(), "")
        exponent = 0
        if kind in _KINDS:
            exponent = _exponent(kind, title, unit)
        columns.append(_Column(kind, title, unit, exponent))
    kinds = [column.kind for column in columns if column.kind]
    for kind in kinds:
        same = [column.title for column in columns if column.kind == kind]
        if len(same) > 1:
            raise ValueError(
                f"its columns {' and '.join(map(repr, same))} are both the {kind}: keep one."
            )
    for wanted in (("force", "deflection"), ("height", "extension", "tip")):
        if not {*wanted} & {*kinds}:
            raise ValueError(
                f"it has no column {' or '.join(wanted)} among {', '.join(map(repr, titles))}: "
                "name it with its unit, as in `height [nm],force [nN]`."
            )
    return columns


def _exponent(kind: str, title: str, unit: str) -> int:
    """Return the power of ten of a unit."""
    known = {_FORCE: FORCES, _TIME: _TIMES, _LENGTH: LENGTHS, _DEFLECTION: LENGTHS | _VOLTAGES}
    table = known[_KINDS[kind]]
    # Micro is written as u, or as a Greek letter.
    symbol = re.sub("^(u|\u03bc)(?=.)", "µ", unit)
    if symbol not in table and table is LENGTHS:
        try:
            symbol = unit_of(unit)
        except ValueError:
            symbol = ""
    if symbol not in table:
        stated = "no unit"
        if unit:
            stated = f"the unit {unit!r}"
        example = next(name for name in ("nN", "nm", *table) if name in table)
        raise ValueError(
            f"its column {title!r} has {stated}: name {_KINDS[kind]}, one of {', '.join(table)}, "
            f"as in `{kind} [{example}]`."
        )
    return table[symbol]


def _table(
    lines: list[tuple[int, str]], separator: str, columns: list[_Column]
) -> dict[str, np.ndarray]:
    """Return the columns as arrays: of floats, or of text for segments and curves."""
    rows = []
    for number, line in lines[1:]:
        cells = _cells(line, separator)
        if len(cells) != len(columns):
            cure = ""
            if separator == "," and len(cells) > len(columns):
                cure = f" {_COMMAS}"
            raise ValueError(
                f"its line {number} has {len(cells)} values for {len(columns)} columns.{cure}"
            )
        rows.append((number, cells))
    if not rows:
        raise ValueError("it has names of columns, and no values.")
    if separator == "," and _may_be_halves([cells for _, cells in rows], columns):
        raise ValueError(
            "all of its values are whole, and as many columns are not read as are: these may be "
            f"the decimals of numbers with commas. {_COMMAS} Otherwise leave out the columns that "
            "are not read."
        )
    table = {}
    for place, column in enumerate(columns):
        cells = [(number, row[place].strip()) for number, row in rows]
        if column.kind in _WITHOUT_UNIT:
            table[column.kind] = np.array([cell for _, cell in cells])
        elif column.kind:
            has_commas = separator != ","
            table[column.kind] = np.array([_number(*c, column.title, has_commas) for c in cells])
    return table


def _may_be_halves(rows: list[list[str]], columns: list[_Column]) -> bool:
    """Whether numbers with decimal commas, of the columns with a unit, would make the same rows."""
    with_unit = sum(column.kind in _KINDS for column in columns)
    is_split = any(not column.kind for column in columns) and len(columns) == 2 * with_unit
    return is_split and all(
        re.fullmatch(r"\s*[-+]?\d+\s*", whole) and re.fullmatch(r"\d+\s*", decimals)
        for cells in rows
        for whole, decimals in zip(cells[::2], cells[1::2], strict=True)
    )


def _number(line: int, cell: str, title: str, has_commas: bool) -> float:
    if not cell:
        return np.nan
    text = cell
    if has_commas:
        text = cell.replace(",", ".")
    try:
        return float(text)
    except ValueError:
        cure = f" {_COMMAS}" if "," in cell else ""
        raise ValueError(
            f"its column {title!r} has {cell!r} on line {line}, no number.{cure}"
        ) from None


def _stated_properties(text: str) -> Iterator[tuple[str, float]]:
    """Yield the properties of the cantilever in comments, in SI units."""
    per: dict[str, tuple[Callable[[str], float], str]] = {
        "spring constant": (lambda unit: _ratio(unit, FORCES, LENGTHS), "0.2 N/m"),
        "sensitivity": (lambda unit: _ratio(unit, LENGTHS, _VOLTAGES), "50 nm/V"),
    }
    for line in text.splitlines():
        name, mark, value = line.strip().lstrip("#% ").partition(":")
        if line.strip()[:1] in ("#", "%") and mark and name.strip().lower() in per:
            match = _QUANTITY.fullmatch(value)
            name = name.strip().lower()
            ratio_of, example = per[name]
            try:
                if match is None:
                    raise ValueError
                yield name, float(match["value"]) * ratio_of(match["unit"])
            except ValueError:
                raise ValueError(
                    f"its comment {line.strip()!r} states no {name}: write it as "
                    f"`# {name}: {example}`."
                ) from None


def _ratio(unit: str, above: dict[str, int], below: dict[str, int]) -> float:
    upper, _, lower = re.sub("(^|/)(u|\u03bc)", r"\1µ", unit).partition("/")
    if upper not in above or lower not in below:
        raise ValueError(f"{unit} is no unit of the two")
    return 10.0 ** (above[upper] - below[lower])


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines that are neither empty nor comments, with their numbers."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and line.lstrip()[0] not in "#%":
            yield number, line


def _separator(header: str) -> str:
    return next((mark for mark in ";\t," if mark in header), " ")


def _titles(header: str, separator: str) -> list[str]:
    """Return the titles of columns, which end with their units if blanks separate them."""
    if separator != " ":
        return _cells(header, separator)
    return [match[0] for match in _BEFORE_BLANK.finditer(header)]


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return next(csv.reader([line.strip()], delimiter=separator))

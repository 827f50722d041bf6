"""Force curves that the programs of Bruker's NanoScope have exported as text.

A line names columns as `Calc_Ramp_Ex_nm`, `Height_Sensor_nm_Rt`, `Defl_pN_Ex` or `Time_s_Rt`: a
quantity, Ex for the extension towards the sample or Rt for the retraction, and a unit. Below there
is a row for each pair of points of both. A header of lines that begin with a backslash may precede.
"""

import re
from typing import NamedTuple

import numpy as np

from jaxstab.lab.force_curves.named_columns import common_value
from jaxstab.lab.force_curves.recording import Recording
from jaxstab.lab.force_curves.segment import FORCES, LENGTHS

# The first bytes of a binary file of NanoScope.
BINARY = b"\\*Force file list", b"\\*File list"
_TITLE = re.compile(
    r"(?P<name>Calc_Ramp|Height_Sensor|Defl|Time)_(?:(?P<before>\w+?)_)?(?P<part>Ex|Rt)"
    r"(?:_(?P<after>\w+))?"
)
_CONSTANT = re.compile(r"^\W*Spring Constant:\s*(.*?)\W*$", re.MULTILINE | re.IGNORECASE)
_VOLTS = {"V": 1.0, "mV": 1e-3}
_COMMAS = "If commas are decimal marks, export it with points."
_PARTS = {"Ex": "approach", "Rt": "retraction"}


class _RampColumn(NamedTuple):
    name: str
    part: str
    unit: str


def is_nanoscope_text(text: str) -> bool:
    """Whether a text has a line that names columns as NanoScope does."""
    return _start(text) is not None


def read_nanoscope_text(
    text: str, name: str, spring_constant: float | None, sensitivity: float | None
) -> Recording:
    """Return the curve of a text that NanoScope has exported.

    Both heights grow towards the sample; the measured one is taken before the ramp.

    Arguments:
        text: the text.
        name: the file's, for the source of the curve.
        spring_constant, sensitivity: what the user knows [N/m, m/V].

    Raises:
        ValueError: for columns that lack, lines of another length, values that are no numbers, and
            deflections without what makes forces of them.
    """
    lines = text.splitlines()
    start = _start(text)
    assert start is not None
    stated = _CONSTANT.search("\n".join(lines[:start]))
    constant = spring_constant
    if stated is not None:
        try:
            constant = common_value("spring constant", spring_constant, float(stated[1]), "N/m")
        except ValueError as error:
            cure = f" {_COMMAS}" if "," in stated[1] else ""
            raise ValueError(f"its spring constant is {stated[1]!r}: {error}{cure}") from None
    titles = _cells(lines[start])
    rows = [_numbers(number, line, titles) for number, line in _lines_below(lines, start)]
    if not rows:
        raise ValueError("it has names of columns, and no values.")
    table = np.array(rows)
    columns = {}
    for place, title in enumerate(titles):
        if column := _column(title):
            # The export may repeat columns, of which the first are as good.
            columns.setdefault(column, table[:, place])
    parts = [
        _part(columns, part, constant, sensitivity)
        for part in _PARTS
        if any(column.part == part for column in columns)
    ]
    force, height, time = (np.concatenate([part[i] for part in parts]) for i in range(3))
    labels = np.concatenate([part[3] for part in parts])
    return Recording(
        force=force,
        height=height,
        time=time if np.isfinite(time).all() else None,
        labels=labels,
        spring_constant=constant,
        sensitivity=sensitivity,
        source=name,
        instrument="Bruker NanoScope",
    )


def _start(text: str) -> int | None:
    """Return the number of the line that names the columns."""
    for number, line in enumerate(text.splitlines()):
        names = {column.name for column in map(_column, _cells(line)) if column}
        if "Defl" in names and names & {"Calc_Ramp", "Height_Sensor"}:
            return number
    return None


def _lines_below(lines: list[str], start: int) -> list[tuple[int, str]]:
    return [(i + 1, lines[i]) for i in range(start + 1, len(lines)) if lines[i].strip()]


def _cells(line: str) -> list[str]:
    if "\t" in line:
        return [cell.strip(' "') for cell in line.rstrip("\t\r\n").split("\t")]
    return line.replace('"', " ").split()


def _column(title: str) -> _RampColumn | None:
    match = _TITLE.fullmatch(title)
    if match is None or (match["before"] and match["after"]):
        return None
    # Micro is written as u.
    unit = re.sub("^u(?=.)", "µ", match["before"] or match["after"] or "")
    return _RampColumn(match["name"], match["part"], unit)


def _numbers(number: int, line: str, titles: list[str]) -> list[float]:
    cells = _cells(line)
    # The shorter segment ends with empty cells, which may be left out.
    if len(cells) > len(titles) or ("\t" not in line and len(cells) != len(titles)):
        raise ValueError(f"its line {number} has {len(cells)} values for {len(titles)} columns.")
    cells += [""] * (len(titles) - len(cells))
    try:
        return [float(cell) if cell else np.nan for cell in cells]
    except ValueError:
        raise ValueError(
            f"its line {number} has a value that is no number: {line.strip()[:60]!r}. {_COMMAS}"
        ) from None


def _part(
    columns: dict[_RampColumn, np.ndarray],
    part: str,
    constant: float | None,
    sensitivity: float | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return force, height, time and labels of a segment in SI units, as they were measured."""
    own = {(c.name, c.unit): values for c, values in columns.items() if c.part == part}
    force = _force(own, part, constant, sensitivity)
    heights = [
        values * 10.0 ** LENGTHS[unit]
        for name in ("Height_Sensor", "Calc_Ramp")
        for (title, unit), values in own.items()
        if title == name and unit in LENGTHS
    ]
    if not heights:
        raise ValueError(f"it has no ramp and no height of {part} in a unit of length.")
    height = -heights[0]
    time = own.get(("Time", "s"), np.full(len(force), np.nan))
    # Points that were not recorded are empty, or zero in all columns at the end.
    numbers = np.arange(len(force))
    last = np.max(numbers[(force != 0) | (height != 0)], initial=0)
    is_there = np.isfinite(force) & np.isfinite(height) & (numbers <= last)
    force, height, time = force[is_there], height[is_there], time[is_there]
    if len(force) == 0:
        raise ValueError(f"its columns of {part} hold no point.")
    order = slice(None)
    if np.isfinite(time).all():
        order = np.argsort(time, kind="stable")
    elif (height[0] < height[-1]) == (part == "Ex"):
        order = slice(None, None, -1)
    return force[order], height[order], time[order], np.full(len(force), _PARTS[part])


def _force(
    own: dict[tuple[str, str], np.ndarray],
    part: str,
    constant: float | None,
    sensitivity: float | None,
) -> np.ndarray:
    """Return the force by the column that needs the least beside it [N]."""
    deflections = {unit: values for (name, unit), values in own.items() if name == "Defl"}
    for unit, values in deflections.items():
        if unit in FORCES:
            return values * 10.0 ** FORCES[unit]
    lacking = ""
    for unit, values in deflections.items():
        if unit in LENGTHS:
            if constant is not None:
                return values * 10.0 ** LENGTHS[unit] * constant
            lacking = "spring_constant=0.2"
    for unit, values in deflections.items():
        if unit in _VOLTS:
            if constant is not None and sensitivity is not None:
                return values * _VOLTS[unit] * sensitivity * constant
            lacking = lacking or "spring_constant=0.2, sensitivity=50e-9"
    if lacking:
        raise ValueError(
            f"its deflection of {part} is no force without the cantilever: give "
            f"read(path, {lacking}), in N/m and m/V."
        )
    raise ValueError(f"it has no deflection of {part} in volts, or a unit of length or force.")

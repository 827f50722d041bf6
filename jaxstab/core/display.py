"""Contacts and results in `print` and a notebook: a line for each field, with units where known.

Fields, and values that cannot be read, are shown by dtype and shape.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from jaxstab.core.checks import without_derivatives
from jaxstab.core.stack import Stackable
from jaxstab.core.types import ArrayLike
from jaxstab.core.units import (
    NO_UNITS,
    NUMBER,
    Dimensioned,
    Units,
    chosen_unit,
    dimensions,
    on_grid,
    shown_unit,
)

# Reading a field raises these where JAX traces, or where a transformation replaced the leaves.
UNREADABLE = (AttributeError, IndexError, TypeError, ValueError, RuntimeError)
# A table of more rows is shortened in its middle to this many.
_MOST_ROWS = 60
# Arrays of more numbers are shown by dtype and shape.
_MOST_NUMBERS = 3


def inline(self: eqx.Module) -> str:
    """Return a module on one line, without fields on the grid: a `__repr__`."""
    return _line(self, NO_UNITS)


def block(self: eqx.Module) -> str:
    """Return a module as one aligned line for each field: a `__repr__`."""
    # A contact or a result has units itself, or its state has them.
    holders = [self, *(getattr(self, field.name, None) for field in fields(self))]
    units = next((x.units for x in holders if hasattr(x, "units")), NO_UNITS)
    rows = {name: value for name, value in _texts(self, units) if value != "None"}
    for name in getattr(self, "derived", ()):
        with suppress(*UNREADABLE):
            rows[name] = units.text(float(getattr(self, name)), name, digits=6)
    width = max(map(len, rows), default=0)
    return "\n".join([type(self).__name__, *(f"  {k:<{width}}  {v}" for k, v in rows.items())])


class Outcome(Stackable, Dimensioned):
    """The result of a solve, or of many: with units, a sequence, and a line for each field."""

    __repr__ = block

    @property
    def derived(self) -> tuple[str, ...]:
        """Properties that are shown beside the fields, each named by its dimension."""
        return ()


def readable(text: Callable[[Any], str]) -> Callable[[Any], str]:
    """Return a `__repr__` that falls back to `block` where a result has no numbers to read."""

    def show(self: eqx.Module) -> str:
        try:
            return text(self)
        except UNREADABLE:
            return block(self)

    return show


def times(sides: Iterable[object], form: str = "") -> str:
    """Join the numbers of all sides, as in 256 x 256."""
    return " x ".join(f"{side:{form}}" for side in sides)


def several(count: int, noun: str, plural: str | None = None) -> str:
    """Return a number of things in words, as in 1 jump and 2 jumps."""
    if count == 1:
        return f"1 {noun}"
    if plural is None:
        plural = f"{noun}s"
    return f"{count} {plural}"


def column(values: ArrayLike | list, form: Callable[..., str]) -> list[str]:
    """Return the cells of a column of a table."""
    return [form(value) for value in np.atleast_1d(values).tolist()]


def table(columns: Mapping[str, Iterable[str]]) -> str:
    """Return a table of named columns, without its middle if it is long."""
    rows = list(zip(*columns.values(), strict=True))
    if len(rows) > _MOST_ROWS:
        half = _MOST_ROWS // 2
        rows = [*rows[:half], ("...",) * len(columns), *rows[-half:]]
    lines = [tuple(columns), *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    texts = ["  ".join(map(str.rjust, line, widths)) for line in lines]
    return "\n".join([texts[0], "-" * len(texts[0]), *texts[1:]])


def text(value: object, units: Units = NO_UNITS) -> str:
    """Return the text for a field."""
    if isinstance(value, jax.Array | np.ndarray | np.number | np.bool):
        return _array_text(value)
    if isinstance(value, int | float | complex):
        return number(value)
    without_own_text = eqx.Module.__repr__, block, inline
    if isinstance(value, eqx.Module) and type(value).__repr__ in without_own_text:
        return _line(value, units)
    if isinstance(value, tuple | list):
        return f"({', '.join(text(part, units) for part in value)})"
    return " ".join(repr(value).split())


def number(value: complex) -> str:
    """Return a number with six digits at most."""
    if isinstance(value, int):
        return str(value)
    return f"{value:.6g}"


def _line(module: eqx.Module, units: Units) -> str:
    hidden = {"history", *on_grid(type(module))}
    texts = [f"{name}={x}" for name, x in _texts(module, units) if name not in hidden]
    return f"{type(module).__name__}({', '.join(texts)})"


def _texts(module: eqx.Module, units: Units) -> Iterator[tuple[str, str]]:
    """Yield the name and the text of each field, with its unit."""
    kinds = dimensions(type(module))
    for name in [f.name for f in fields(module) if f.repr and hasattr(module, f.name)]:
        value = getattr(module, name)
        if value is None:
            yield name, text(value)
            continue
        divisor, symbol = chosen_unit(units, kinds.get(name, NUMBER))
        if divisor != 1:
            value = value / divisor
        yield name, f"{text(value, units)} {shown_unit(symbol)}".rstrip()


def _array_text(value: Array | np.ndarray | np.number | np.bool) -> str:
    texts = []
    value = without_derivatives(value)
    if np.ndim(value) <= 1 and np.size(value) <= _MOST_NUMBERS:
        with suppress(*UNREADABLE):
            texts = [number(x) for x in np.atleast_1d(np.asarray(value)).tolist()]
    if not texts:
        return eqx.tree_pformat(value)
    if value.ndim == 0:
        return texts[0]
    return f"[{', '.join(texts)}]"

"""Contacts and results in `print` and a notebook: numbers in a few aligned lines.

Fields are shown by shape and range, and traced values by shape alone; units stand beside them where
they are known.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from textwrap import shorten
from typing import Any, SupportsFloat

import equinox as eqx
import jax
import jax.core
import numpy as np
from jaxtyping import Array

from jaxstab.core.checks import are_finite, concrete
from jaxstab.core.types import ArrayLike
from jaxstab.core.unit_system import (
    NO_UNITS,
    Units,
    has_words,
    readable_unit,
    typeset,
    unit_symbol,
)
from jaxstab.core.units import NUMBER, declared, on_grid

# Reading a field raises these where JAX traces, or where a transformation replaced the leaves.
UNREADABLE = (AttributeError, IndexError, TypeError, ValueError, RuntimeError)
# A table of more rows is shortened in its middle to this many.
_MOST_ROWS = 60
# A field's text is cut at this length.
_LONGEST_TEXT = 120


def inline(self: eqx.Module) -> str:
    """Return a module on one line, without fields on the grid: a `__repr__`."""
    return _line(self, NO_UNITS)


def block(self: eqx.Module) -> str:
    """Return a module as one aligned line for each field: a `__repr__`."""
    # A contact or a result has units itself, or its state has them.
    holders = [self, *(getattr(self, field.name, None) for field in fields(self))]
    units = next((x.units for x in holders if hasattr(x, "units")), NO_UNITS)
    rows = {
        name: shorten(value, _LONGEST_TEXT, placeholder=" ...")
        for name, value in _texts(self, units)
        if value != "None"
    }
    if getattr(self, "is_window", False) and np.ndim(force := getattr(self, "force", 0)) == 0:
        rows["force"] = amount(force, units, "force")
    width = max(map(len, rows), default=0)
    return "\n".join([type(self).__name__, *(f"  {k:<{width}}  {v}" for k, v in rows.items())])


def readable(text: Callable[[Any], str]) -> Callable[[Any], str]:
    """Return a `__repr__` that falls back to `block` where a result has no numbers to read."""

    def shown(self: eqx.Module) -> str:
        try:
            return text(self)
        except UNREADABLE:
            return block(self)

    return shown


def times(sides: Iterable[object], form: str = "") -> str:
    """Join the numbers of all sides, as in 256 x 256."""
    return " x ".join(f"{side:{form}}" for side in sides)


def column(values: ArrayLike | list, form: Callable[..., str]) -> list[str]:
    """Return the cells of a column of a table."""
    return [form(value) for value in np.atleast_1d(values).tolist()]


def amount(value: SupportsFloat, units: Units, dimension: str) -> str:
    """Return a number in a readable unit, and the unit where it is known."""
    divisor, unit = readable_unit(units, dimension, abs(float(value)))
    return f"{number(float(value) / divisor)} {'' if has_words(unit) else typeset(unit)}".rstrip()


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
    """Return the text for a field: the range of an array, or a number itself."""
    if isinstance(value, jax.Array | np.ndarray | np.number | np.bool):
        return described(value)
    if isinstance(value, int | float | complex):
        return number(value)
    without_own_text = eqx.Module.__repr__, block, inline
    if isinstance(value, eqx.Module) and type(value).__repr__ in without_own_text:
        return _line(value, units)
    if isinstance(value, tuple | list):
        return f"({', '.join(text(part, units) for part in value)})"
    return " ".join(repr(value).split())


def _line(module: eqx.Module, units: Units) -> str:
    hidden = {"history", *on_grid(type(module))}
    texts = [f"{name}={x}" for name, x in _texts(module, units) if name not in hidden]
    return f"{type(module).__name__}({', '.join(texts)})"


def _texts(module: eqx.Module, units: Units) -> Iterator[tuple[str, str]]:
    """Yield the name and the text of each field, with its unit."""
    dimensions = declared(type(module))
    for name in [f.name for f in fields(module) if f.repr and hasattr(module, f.name)]:
        value = getattr(module, name)
        unit = unit_symbol(units, dimensions.get(name, (NUMBER,))[0])
        is_known = value is not None and unit != NUMBER and not has_words(unit)
        yield name, text(value, units) + (f" {typeset(unit)}" if is_known else "")


def described(value: Array | np.ndarray | np.number | np.bool) -> str:
    """Return dtype and shape of an array, and its range if known; of a scalar the number."""
    kind = f"{value.dtype}[{', '.join(map(str, value.shape))}]"
    if isinstance(value, jax.core.Tracer):
        return f"traced {kind}"
    # Reading other processes' shards needs their participation.
    if isinstance(value, jax.Array) and not (
        value.is_fully_addressable or value.is_fully_replicated
    ):
        return kind
    try:
        numbers = concrete(value)
        if numbers.size <= 3 and numbers.ndim <= 1:
            texts = [number(x) for x in numbers.ravel().tolist()]
            return texts[0] if numbers.ndim == 0 else f"[{', '.join(texts)}]"
        return f"{kind} {_range(numbers)}"
    except UNREADABLE:
        return kind


def number(value: complex) -> str:
    """Return a number with six digits at most."""
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def _range(numbers: Array | np.ndarray) -> str:
    if numbers.dtype == bool:
        return f"with {numbers.sum()} true"
    finite = are_finite(numbers)
    missing = f"with {numbers.size - finite.sum()} not finite"
    if not finite.any():
        return missing
    # Adding zero turns integers into floats, and a negative zero into zero.
    values = numbers + 0.0
    least, most = (
        values.min(where=finite, initial=np.inf),
        values.max(where=finite, initial=-np.inf),
    )
    ends = f"from {float(least):.4g} to {float(most):.4g}"
    return ends if finite.all() else f"{ends}, {missing}"

"""Contacts and results in `print` and a notebook: numbers in a few aligned lines.

Fields are shown by shape and range, and traced values by shape alone; units stand beside them where
they are known.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from textwrap import shorten
from typing import Any, SupportsFloat, TypeGuard

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from jaxstab.core.checks import are_finite, is_spread, known
from jaxstab.core.types import ArrayLike
from jaxstab.core.unit_system import (
    NO_UNITS,
    Units,
    has_words,
    in_brackets,
    readable_unit,
    typeset,
    unit_symbol,
)
from jaxstab.core.units import NUMBER, declared

# Reading a field raises these where JAX traces, or where a transformation replaced the leaves.
UNREADABLE = (AttributeError, IndexError, TypeError, ValueError, RuntimeError)
# A table of more rows is shortened in its middle to this many.
_MOST_ROWS = 60
# A field's text is cut at this length.
_LONGEST_TEXT = 120


def inline(self: eqx.Module) -> str:
    """Return a module on one line, without fields on a grid and history: a `__repr__`."""
    return _line(self, with_grids=False)


def in_full(self: eqx.Module) -> str:
    """Return a module on one line with all of its fields: a `__repr__`."""
    return _line(self, with_grids=True)


def _line(module: eqx.Module, with_grids: bool, units: Units = NO_UNITS) -> str:
    arguments = [f"{name}={value}" for name, value in _texts(module, with_grids, units)]
    return f"{type(module).__name__}({', '.join(arguments)})"


def block(self: eqx.Module) -> str:
    """Return a module as one aligned line for each field: a `__repr__`."""
    rows = {
        name: shorten(value, _LONGEST_TEXT, placeholder=" ...")
        for name, value in _texts(self, True, units_of(self))
        if value != "None"
    }
    force = getattr(self, "force", None) if getattr(self, "is_window", False) else None
    if _is_readable(force) and force.ndim == 0:
        rows["force"] = amount(force, units_of(self), "force")
    width = max(map(len, rows), default=0)
    return "\n".join([type(self).__name__, *(f"  {k:<{width}}  {v}" for k, v in rows.items())])


def history(self: PyTree) -> str:
    """Return the first and last of a solver's indicators, on one line: a `__repr__`."""
    try:
        used = np.flatnonzero(np.isfinite(self.steps))
        recorded = {name: np.asarray(values)[used] for name, values in self.values.items()}
        ends = [f"{name}={x[0]:.3g} to {x[-1]:.3g}" for name, x in recorded.items()]
        return f"History({', '.join([f'{used.size} records', *ends])})"
    except UNREADABLE:
        return f"History({', '.join(self.names)})"


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


def measured_column(
    name: str, values: ArrayLike, units: Units, dimension: str, form: str = "+.4e"
) -> dict[str, list[str]]:
    """Return a column of a table in one readable unit, which stands beside its name if known."""
    numbers = np.asarray(values)
    largest = np.abs(numbers[np.isfinite(numbers)]).max(initial=0)
    divisor, unit = readable_unit(units, dimension, largest)
    heading = name if has_words(unit) else f"{name} {in_brackets(unit)}".rstrip()
    return {heading: column(numbers / divisor, f"{{:{form}}}".format)}


def load_column(load: Any, units: Units, form: str) -> dict[str, list[str]]:
    """Return the column of the values of a load."""
    return measured_column(type(load).__name__, load.value, units, load.unit or NUMBER, form)


def pressure_columns(states: Any) -> dict[str, list[str]]:
    """Return the column of the mean pressures of states, on a window beside the forces."""
    units = states.units
    forces = measured_column("force", states.force, units, "force", "+.4g")
    pressures = measured_column("mean pressure", states.mean_pressure, units, "pressure")
    return {**(forces if states.is_window else {}), **pressures}


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


def described(value: object) -> str:
    """Return dtype and shape of an array, and its range if known; of a scalar the number."""
    if not _is_readable(value):
        return f"traced {_kind(value)}" if isinstance(value, jax.core.Tracer) else _kind(value)
    numbers = known(value)
    if numbers.size <= 3 and numbers.ndim <= 1:
        texts = [number(x) for x in numbers.ravel().tolist()]
        return texts[0] if numbers.ndim == 0 else f"[{', '.join(texts)}]"
    return f"{_kind(value)} {_range(numbers)}"


def _named(module: eqx.Module, with_grids: bool) -> Iterator[tuple[str, object]]:
    """Yield the fields of a module; fields on a grid have more axes than scalars."""
    shown = [f.name for f in fields(module) if f.repr and hasattr(module, f.name)]
    values = {name: getattr(module, name) for name in shown}
    axes = {name: value.ndim for name, value in values.items() if _is_array(value)}
    fewest = min(axes.values(), default=0)
    for name, value in values.items():
        is_long = axes.get(name, 0) > fewest or type(value).__repr__ is history
        if with_grids or not is_long:
            yield name, value


def units_of(module: eqx.Module) -> Units:
    """Return the units of a contact or a result: its own, or its state's."""
    holders = [module, *(getattr(module, field.name, None) for field in fields(module))]
    return next((x.units for x in holders if hasattr(x, "units")), NO_UNITS)


def _texts(module: eqx.Module, with_grids: bool, units: Units) -> Iterator[tuple[str, str]]:
    """Yield the name and the text of each field, with its unit."""
    dimensions = declared(type(module))
    for name, value in _named(module, with_grids):
        unit = unit_symbol(units, dimensions.get(name, (NUMBER,))[0])
        is_known = value is not None and unit != NUMBER and not has_words(unit)
        yield name, text(value, units) + (f" {typeset(unit)}" if is_known else "")


def text(value: object, units: Units = NO_UNITS) -> str:
    """Return the text for a field: the range of an array, or a number itself."""
    if _is_array(value):
        return described(value)
    if isinstance(value, int | float | complex):
        return number(value)
    form = type(value).__repr__
    if isinstance(value, eqx.Module) and form in (eqx.Module.__repr__, block, inline, in_full):
        return _line(value, form is in_full, units)
    if isinstance(value, tuple | list | dict):
        return repr(jax.tree.map(lambda part: _Word(text(part, units)), value, is_leaf=_is_content))
    return " ".join(repr(value).split())


class _Word(str):
    """A text that containers show without quotes."""

    __repr__ = str.__str__


def _is_content(value: object) -> bool:
    return not isinstance(value, tuple | list | dict)


def _is_array(value: object) -> TypeGuard[Array | np.ndarray]:
    return all(hasattr(value, name) for name in ("dtype", "shape", "ndim"))


def number(value: complex) -> str:
    """Return a number with six digits at most."""
    return str(value) if isinstance(value, int) else f"{value:.6g}"


def _kind(value: object) -> str:
    if not _is_array(value):
        return type(value).__name__
    return f"{value.dtype}[{', '.join(map(str, value.shape))}]"


def _range(numbers: Array | np.ndarray) -> str:
    if numbers.dtype == bool:
        return f"with {numbers.sum()} true"
    xp, finite = jnp if is_spread(numbers) else np, are_finite(numbers)
    missing = f"with {numbers.size - finite.sum()} not finite"
    if not finite.any():
        return missing
    # Adding zero turns a negative zero into zero.
    least, most = (
        float(reduce(numbers + 0.0, where=finite, initial=far)) + 0.0
        for reduce, far in ((xp.min, np.inf), (xp.max, -np.inf))
    )
    ends = f"from {least:.4g} to {most:.4g}"
    return ends if finite.all() else f"{ends}, {missing}"


def _is_readable(leaf: object) -> TypeGuard[Array | np.ndarray]:
    if isinstance(leaf, jax.core.Tracer) or not isinstance(leaf, np.ndarray | jax.Array):
        return False
    if isinstance(leaf, jax.Array):
        # Reading other processes' shards needs their participation.
        is_here = leaf.is_fully_addressable or leaf.is_fully_replicated
        if leaf.is_deleted() or not is_here:
            return False
    return any(jnp.issubdtype(leaf.dtype, kind) for kind in (np.number, np.bool_))

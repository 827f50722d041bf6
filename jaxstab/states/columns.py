"""Columns of the tables that results of many loads print, each in one readable unit."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxstab.core.display import column
from jaxstab.core.types import ArrayLike
from jaxstab.core.units import NUMBER, Units, named_with_unit, readable_unit, shown_unit
from jaxstab.loads import Load


def measured_columns(
    named: Mapping[str, ArrayLike], units: Units, dimension: str, form: str = "+.4e"
) -> dict[str, list[str]]:
    """Return columns that share a unit, which stands beside their names if it is known."""
    arrays = [np.asarray(values) for values in named.values()]
    largest = max(np.abs(values[np.isfinite(values)]).max(initial=0) for values in arrays)
    divisor, unit = readable_unit(units, dimension, largest)

    def cell(number: float) -> str:
        # A number that was not found has no sign.
        return f"{number:{form}}".replace("+nan", "nan")

    cells = [column(values / divisor, cell) for values in arrays]
    titles = [named_with_unit(name, shown_unit(unit)) for name in named]
    return dict(zip(titles, cells, strict=True))


def load_column(load: Load, units: Units, form: str) -> dict[str, list[str]]:
    """Return the column of the values of a load."""
    return measured_columns({type(load).__name__: load.value}, units, load.unit or NUMBER, form)


def state_columns(states: Any) -> dict[str, list[str]]:
    """Return the columns of mean pressure and contact area, beside any that states derive."""
    columns = {}
    units = states.units
    for name in states.derived:
        columns |= measured_columns({name: getattr(states, name)}, units, name, "+.4g")
    columns |= measured_columns({"mean pressure": states.mean_pressure}, units, "pressure")
    return columns | {"contact area": percent_column(states.contact_area)}


def percent_column(fractions: ArrayLike) -> list[str]:
    """Return the cells of a column of fractions."""
    return column(fractions, lambda fraction: f"{100 * fraction:.2f} %")

"""The axes of a study: what its cases are called with, and where each lies in a store."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

# Where a case lies: a place on each axis.
Index = tuple[int, ...]
# The dimension of listed combinations.
LISTED = "case"
_KINDS = "biufU"


@dataclass(frozen=True)
class Axis:
    """A dimension, and the arguments that vary along it.

    Attributes:
        name: the name of the dimension.
        values: what cases are called with, by the names of their arguments.
        columns: the same as a store holds it, where random keys are words.
    """

    name: str
    values: Mapping[str, Any]
    columns: Mapping[str, np.ndarray]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def rows(self) -> list[tuple[Any, ...]]:
        """Return the values that identify the places along the axis."""
        return rows_of(self.columns)


def rows_of(columns: Mapping[str, np.ndarray]) -> list[tuple[Any, ...]]:
    """Return the rows of a table of columns, as numbers and words of Python."""
    return list(zip(*(column.tolist() for column in columns.values()), strict=True))


def read_axes(axes: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> list[Axis]:
    """Return the axes of a product of arrays, or the one of listed combinations.

    Raises:
        ValueError: for values that are empty, repeated, not finite or not one-dimensional.
        TypeError: for values that are neither numbers, words nor random keys.
    """
    if isinstance(axes, Mapping):
        read = [_axis(name, {name: values}) for name, values in axes.items()]
    elif isinstance(axes, Sequence) and all(isinstance(row, Mapping) for row in axes):
        read = [_axis(LISTED, _columns(axes))] if axes else []
    else:
        raise TypeError(
            f"The axes are {type(axes).__name__}: give a dict of one-dimensional arrays, or a list "
            "of dicts."
        )
    if not read:
        raise ValueError("There is no axis: give at least one, as in {'seed': range(10)}.")
    return read


def arguments_of(axes: Sequence[Axis]) -> list[str]:
    """Return the names of the arguments that a case is called with."""
    return [name for axis in axes for name in axis.values]


def places(axes: Sequence[Axis]) -> Iterator[Index]:
    """Yield the place of each case on the axes, in the order of the product."""
    return product(*(range(len(axis)) for axis in axes))


def values_at(axes: Sequence[Axis], place: Index) -> dict[str, Any]:
    """Return the arguments of a case: numbers and words of Python, and random keys."""
    return {
        name: values[i] if isinstance(values, jax.Array) else values[i].item()
        for axis, i in zip(axes, place, strict=True)
        for name, values in axis.values.items()
    }


def stacked_at(axes: Sequence[Axis], places: Sequence[Index]) -> dict[str, Any]:
    """Return the arguments of several cases, as arrays with a leading axis of cases."""
    return {
        name: values[np.array([place[k] for place in places])]
        for k, axis in enumerate(axes)
        for name, values in axis.values.items()
    }


def _columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    names = list(rows[0])
    for number, row in enumerate(rows):
        if set(row) != set(names):
            raise ValueError(
                f"Combination {number} has {', '.join(row)}, the first {', '.join(names)}: give "
                "each the same names."
            )
    return {name: _joined(name, [row[name] for row in rows]) for name in names}


def _joined(name: str, values: list[Any]) -> Any:
    if any(np.ndim(value) for value in values):
        raise ValueError(f"{name} holds arrays: give a scalar in each combination.")
    return jnp.stack(values) if all(map(_are_keys, values)) else values


def _axis(dimension: str, values: Mapping[str, Any]) -> Axis:
    if not values:
        raise ValueError("The combinations are empty: give each at least one value.")
    for name in values:
        if not (isinstance(name, str) and name.isidentifier()):
            raise ValueError(f"The axis {name!r} is no name of an argument.")
    arrays = {name: _array(name, x) for name, x in values.items()}
    columns = {name: _words(x) if _are_keys(x) else x for name, x in arrays.items()}
    axis = Axis(dimension, arrays, columns)
    rows = axis.rows()
    if len(set(rows)) < len(rows):
        twice = next(row for row in rows if rows.count(row) > 1)
        raise ValueError(f"{dimension} has {', '.join(map(str, twice))} twice: give each once.")
    return axis


def _array(name: str, values: Any) -> Any:
    array = values if _are_keys(values) else np.asarray(values)
    if array.ndim != 1 or array.size == 0:
        raise ValueError(
            f"{name} has shape {array.shape}: give a one-dimensional array of at least one value "
            "(random keys as jax.random.key makes them)."
        )
    if _are_keys(array):
        return array
    if array.dtype.kind not in _KINDS:
        raise TypeError(f"{name} is {array.dtype}: give numbers, words or random keys.")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"{name} has NaN or infinite values: leave them out.")
    return array.astype(array.dtype.newbyteorder("="))


def _are_keys(values: Any) -> bool:
    return isinstance(values, jax.Array) and jnp.issubdtype(values.dtype, jax.dtypes.prng_key)


def _words(keys: Any) -> np.ndarray:
    """Return random keys as words: their generator and their data in hexadecimal digits."""
    data = np.asarray(jax.random.key_data(keys), ">u4")
    return np.array([f"{jax.random.key_impl(keys)}:{row.tobytes().hex()}" for row in data])

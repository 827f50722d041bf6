"""The axes of a study, and the coordinates of its cases."""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

# The dimension of listed combinations.
LISTED = "case"
WORDS, _KEYS = "words", "random keys"
_KINDS = {"b": "booleans", "i": "integers", "u": "integers", "f": "floats", "U": WORDS}
# The coordinates of a case by name: numbers and words of Python; random keys as words.
Coordinates = dict[str, Any]


class Axes(NamedTuple):
    """The values of a product, or of listed combinations, and their kinds, by name."""

    values: dict[str, list[Any]]
    kinds: dict[str, str]
    is_listed: bool

    @property
    def dims(self) -> tuple[str, ...]:
        """The names of the dimensions."""
        return (LISTED,) if self.is_listed else tuple(self.values)

    def cases(self) -> list[Coordinates]:
        """Return the coordinates of all cases, in the order of the product."""
        columns = self.values.values()
        rows = zip(*columns, strict=True) if self.is_listed else itertools.product(*columns)
        return [dict(zip(self.values, row, strict=True)) for row in rows]


def read_axes(axes: Any) -> Axes:
    """Return the axes of a product of arrays, or of listed combinations.

    Raises:
        ValueError: for values that are empty, repeated, not finite or not one-dimensional.
        TypeError: for values that are neither numbers, words nor random keys.
    """
    is_listed = isinstance(axes, list | tuple)
    rows = list(axes) if is_listed else []
    are_rows = all(isinstance(x, Mapping) and x.keys() == rows[0].keys() for x in rows)
    if not (is_listed or isinstance(axes, Mapping)) or not are_rows:
        raise TypeError(
            "The axes are neither a dict of one-dimensional arrays nor a list of dicts with the "
            "same names."
        )
    if is_listed:
        axes = {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}
    columns: dict[str, Any] = {name: _column(name, column) for name, column in axes.items()}
    if not columns:
        raise ValueError("There is no axis: give at least one, as in {'seed': range(10)}.")
    values, kinds = ({name: x[i] for name, x in columns.items()} for i in (0, 1))
    read = Axes(values, kinds, is_listed)
    [(case, number)] = Counter(tuple(x.values()) for x in read.cases()).most_common(1)
    if number > 1:
        raise ValueError(f"The axes give the case {case} twice: give each value once.")
    return read


def arguments(cases: Sequence[Coordinates], kinds: Mapping[str, str]) -> dict[str, Any]:
    """Return the arguments of cases: lists of numbers and words, arrays of random keys."""
    columns = {name: [case[name] for case in cases] for name in kinds}
    return {name: _keys(x) if kinds[name] == _KEYS else x for name, x in columns.items()}


def _column(name: Any, values: Any) -> tuple[list[Any], str]:
    """Return the coordinates along an axis, and their kind."""
    if not (isinstance(name, str) and name.isidentifier()):
        raise ValueError(f"The axis {name!r} is no name of an argument.")
    if isinstance(values, list) and values and all(map(_are_keys, values)):
        values = jnp.stack(values)
    array: Any = values if _are_keys(values) else np.asarray(values)
    if array.ndim != 1 or array.size == 0:
        raise ValueError(f"{name} has shape {array.shape}: give one dimension, which is not empty.")
    if _are_keys(array):
        data = np.asarray(jax.random.key_data(array), ">u4")
        return [f"{jax.random.key_impl(array)}:{row.tobytes().hex()}" for row in data], _KEYS
    if array.dtype.kind not in _KINDS:
        raise TypeError(f"{name} is {array.dtype}: give numbers, words or random keys.")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"{name} has NaN or infinite values: leave them out.")
    # Both zeros, which are equal, have one name.
    return (array + 0.0 if array.dtype.kind == "f" else array).tolist(), _KINDS[array.dtype.kind]


def _are_keys(values: Any) -> bool:
    return isinstance(values, jax.Array) and jnp.issubdtype(values.dtype, jax.dtypes.prng_key)


def _keys(words: Sequence[str]) -> Any:
    data = [np.frombuffer(bytes.fromhex(word.split(":")[1]), ">u4") for word in words]
    return jax.random.wrap_key_data(jnp.array(data, jnp.uint32), impl=words[0].split(":")[0])

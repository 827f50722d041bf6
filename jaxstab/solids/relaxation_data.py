"""Measured relaxation and creep: checked, averaged and without noise."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxstab.core.checks import parameter, require, require_finite
from jaxstab.core.types import ArrayLike
from jaxstab.core.warn import warn

# Negative values up to this part of the largest modulus are noise about zero, and others mistakes.
_NOISE = 0.1
_TINY = np.finfo(np.float64).tiny


class RelaxationWarning(UserWarning):
    """Measured relaxation is left out or averaged, or does not determine all of a fitted solid.

    Example:
        The stress of a liquid relaxes to zero:

        >>> times = np.logspace(-2, 2, 40)
        >>> import warnings
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     found = js.Viscoelastic.from_relaxation(solid, times, 3.0 * np.exp(-times / 5.0))
        >>> caught[0].category.__name__
        'RelaxationWarning'
    """


class Kind(NamedTuple):
    """A kind of measurement.

    Attributes:
        argument: the name of the argument over which it is measured, "frequency" or "time".
        values: the names of the measured values.
        response: of a term, over its time times the rate: the angular frequency, or one over the
            time of the measurement.
    """

    argument: str
    values: tuple[str, ...]
    response: Callable[[np.ndarray], np.ndarray]


OSCILLATION = Kind(
    "frequency", ("storage modulus", "loss modulus"), lambda x: 1j * x / (1 + 1j * x)
)
# Far from the data a search may shift the times until no rate is left.
RELAXATION = Kind("time", ("relaxation modulus",), lambda x: np.exp(-1 / np.maximum(x, _TINY)))
CREEP = Kind("time", ("creep compliance",), lambda x: -np.expm1(-1 / np.maximum(x, _TINY)))


class Data(NamedTuple):
    """Checked data, in any order.

    Attributes:
        kind: of the measurement.
        rates: angular frequencies, or one over the times.
        values: complex moduli, relaxation moduli or compliances.
        temperatures: of each, None if they are all at the same.
    """

    kind: Kind
    rates: np.ndarray
    values: np.ndarray
    temperatures: np.ndarray | None


def read_data(
    kind: Kind, arguments: ArrayLike, values: tuple[ArrayLike, ...], temperatures: ArrayLike | None
) -> Data:
    """Return data as arrays of NumPy, averaged and without noise, which is warned of.

    Raises:
        ValueError: where they cannot be measured ones.
    """
    names = [kind.argument, *kind.values]
    given = [arguments, *values]
    if temperatures is not None:
        names.append("temperature")
        given.append(temperatures)
    columns = [
        np.asarray(parameter(column, f"The {name}"), np.float64)
        for name, column in zip(names, given, strict=True)
    ]
    first = columns[0]
    if first.ndim != 1 or not first.size or any(x.shape != first.shape for x in columns):
        shapes = ", ".join(
            f"{x.shape} of the {name}" for name, x in zip(names, columns, strict=True)
        )
        raise ValueError(
            f"The data have the shapes {shapes}: give one of each for each of one or more "
            f"{plural(kind.argument)}."
        )
    for name, column in zip(names, columns, strict=True):
        require_finite(f"The {name}", column)
    is_measured = first > 0
    if kind is not OSCILLATION:
        # The response at once is the one before any step of the strain or the stress is complete.
        is_measured |= first == 0
    require(f"The {kind.argument}", first, is_measured, "it must be positive and finite.")
    _require_noise(kind, columns)
    table = np.array(columns)
    is_kept = first > 0
    if not is_kept.all():
        count = int(np.count_nonzero(~is_kept))
        _tell_of(count, "values at the time 0 are left out: a step takes some time.")
    if not is_kept.any():
        raise ValueError("The data have no value after the time 0: give later times.")
    table = _average(kind, table[:, is_kept], temperatures is not None)
    table = _above_noise(kind, table)
    rates = table[0]
    measured = table[1]
    if kind is OSCILLATION:
        measured = measured + 1j * table[2]
    else:
        rates = 1 / rates
    known = None
    if temperatures is not None:
        known = table[-1]
    return Data(kind, rates, measured, known)


def _require_noise(kind: Kind, columns: list[np.ndarray]) -> None:
    """Raise `ValueError` for a value that is too far below zero for noise."""
    first = columns[1]
    name = f"The {kind.values[0]}"
    cure = "it must be positive, but for noise about zero."
    require(name, first, first >= -_NOISE * first.max(), cure)
    require(name, first, np.full(first.shape, first.max() > 0), cure)
    if kind is OSCILLATION:
        loss = columns[2]
        cure = "it must not be negative: leave this frequency out, or give the loss as positive."
        is_possible = loss >= -_NOISE * np.abs(first)
        require("The loss modulus", loss, is_possible, cure)


def _average(kind: Kind, table: np.ndarray, has_temperatures: bool) -> np.ndarray:
    """Return columns in which each argument is there once at a temperature."""
    keys = table[:1]
    if has_temperatures:
        keys = table[[0, -1]]
    _, places, counts = np.unique(keys, axis=1, return_inverse=True, return_counts=True)
    if (counts == 1).all():
        return table
    places = places.ravel()
    means = np.array([np.bincount(places, column) for column in table]) / counts
    spread = np.max(np.abs(table[1] / means[1][places] - 1))
    _tell_of(
        table.shape[1] - counts.size,
        f"repeated {plural(kind.argument)} are averaged: one {kind.values[0]} is up to "
        f"{spread:.2g} of its mean away from it.",
    )
    return means


def _above_noise(kind: Kind, table: np.ndarray) -> np.ndarray:
    """Return columns without values that are zero within their noise.

    The lowest value below zero tells the noise. Positive values of its size are left out too, since
    their mean alone would be a plateau.
    """
    values = table[1]
    is_kept = values > max(0.0, -values.min())
    if kind is OSCILLATION:
        is_kept &= table[2] >= 0
    if not is_kept.any():
        raise ValueError(
            f"No {kind.values[0]} is above the noise that its negative values show: measure with a "
            "larger signal."
        )
    if not is_kept.all():
        names = " or ".join(kind.values)
        _tell_of(
            int(np.count_nonzero(~is_kept)),
            f"{plural(kind.argument)} are left out, at which the {names} is negative or no larger "
            "than its negative values: noise about zero.",
        )
    return table[:, is_kept]


def _tell_of(count: int, sentence: str) -> None:
    """Warn of a number of measured values."""
    warn(f"{count} {sentence}", RelaxationWarning)


def plural(argument: str) -> str:
    """Return the plural of the argument of a measurement."""
    return {"frequency": "frequencies", "time": "times"}[argument]

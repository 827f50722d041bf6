"""Series of relaxation or retardation times with non-negative terms, fitted to measured data.

Least squares of the deviation over the measured value, in which the terms are non-negative (SciPy's
`nnls`; M. Baumgaertel and H. H. Winter, Rheol. Acta 28, 511 (1989), for relative deviations). The
candidates for the times are fixed, so that the problem is linear.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxstab.core.checks import parameter, require, require_finite
from jaxstab.core.roots import bisect
from jaxstab.core.types import ArrayLike
from jaxstab.solids.williams_landel_ferry import WilliamsLandelFerry

# Neighbouring times of a fit differ by a factor of 1.26: a time between two is represented by both
# to better than 1 %.
_TIMES_PER_DECADE = 10
# Two constants follow from two shifts.
_FEWEST_TEMPERATURES = 3
# A sweep is at one temperature, of which an instrument tells each deviation [K].
_ONE_TEMPERATURE = 1.0
# First guesses of the constant C2 at the lowest temperature, over the span of temperatures.
_FIRST_C2 = 0.3, 1.0, 3.0, 10.0
# The step of differences by the logarithms of the constants: the residual of a fit whose terms
# come and go is rough at smaller ones.
_STEP = 1e-3


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
RELAXATION = Kind("time", ("relaxation modulus",), lambda x: np.exp(-1 / x))
CREEP = Kind("time", ("creep compliance",), lambda x: -np.expm1(-1 / x))


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


class Series(NamedTuple):
    """A constant and terms with their times, in rising order.

    Attributes:
        constant: the constant.
        terms: of each time, positive.
        times: of the terms.
        error: the largest relative deviation from the data.
        shift: of the times over the temperature, None for data at one temperature.
    """

    constant: float
    terms: np.ndarray
    times: np.ndarray
    error: float
    shift: WilliamsLandelFerry | None


def checked(
    kind: Kind, arguments: ArrayLike, values: tuple[ArrayLike, ...], temperatures: ArrayLike | None
) -> Data:
    """Return data as arrays of NumPy; `ValueError` where they cannot be measured ones."""
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
            f"{_plural(kind.argument)}."
        )
    for name, column in zip(names[:2], columns[:2], strict=True):
        cure = "it must be positive and finite."
        require(f"The {name}", column, (column > 0) & (column < np.inf), cure)
    for name, column in zip(names[2:], columns[2:], strict=True):
        require_finite(f"The {name}", column)
    if kind is OSCILLATION:
        loss = columns[2]
        cure = "it must not be negative: leave this frequency out, or give the loss as positive."
        require("The loss modulus", loss, loss >= 0, cure)
        measured = columns[1] + 1j * loss
        rates = first
    else:
        measured = columns[1]
        rates = 1 / first
    known = None
    if temperatures is not None:
        known = columns[-1]
    _require_once(kind, first, known)
    return Data(kind, rates, measured, known)


def _require_once(kind: Kind, arguments: np.ndarray, temperatures: np.ndarray | None) -> None:
    """Raise `ValueError` if an argument is there twice at one temperature."""
    pairs = arguments[:, None]
    if temperatures is not None:
        pairs = np.column_stack([arguments, temperatures])
    distinct, counts = np.unique(pairs, axis=0, return_counts=True)
    for pair, count in zip(distinct[counts > 1], counts[counts > 1], strict=True):
        there = ""
        if temperatures is not None:
            there = f" at the temperature {pair[1]:.6g}"
        raise ValueError(
            f"The {kind.argument} {pair[0]} is given {count} times{there}: average its values, or "
            "leave all but one out."
        )


def fitted(data: Data, reference: ArrayLike | None) -> Series:
    """Return the series of best fit, at the reference temperature if there are temperatures.

    Raises:
        ValueError: for data at one or two temperatures, those whose curves have no value in common
            from one temperature to the next, those that do not soften on heating, and a reference
            without temperatures.
    """
    if data.temperatures is None:
        if reference is not None:
            raise ValueError(
                f"The reference temperature is {reference}, and the data have no temperatures: "
                "give the temperature of each."
            )
        return _series(data, data.rates, _candidates(data.rates))
    sweeps = _sweeps(data.temperatures)
    shift = _shift(data, data.temperatures, sweeps)
    if reference is None:
        shift = shift.referred_to(data.temperatures[sweeps[(len(sweeps) - 1) // 2]].mean())
    else:
        shift = shift.referred_to(reference)
    rates = data.rates * np.asarray(shift.factor(data.temperatures))
    return _series(data, rates, _candidates(rates))._replace(shift=shift)


def _sweeps(temperatures: np.ndarray) -> list[np.ndarray]:
    """Return the indices of the data at each temperature, rising."""
    order = np.argsort(temperatures)
    starts = np.flatnonzero(np.diff(temperatures[order]) > _ONE_TEMPERATURE) + 1
    sweeps = np.split(order, starts)
    if len(sweeps) < _FEWEST_TEMPERATURES:
        known = ", ".join(f"{temperatures[sweep].mean():.6g}" for sweep in sweeps)
        raise ValueError(
            f"The data are at the temperatures {known}, from which no shift follows: give data at "
            f"{_FEWEST_TEMPERATURES} or more, a kelvin apart, or no temperatures."
        )
    return sweeps


def _candidates(rates: np.ndarray) -> np.ndarray:
    """Return the candidates for times in a band of rates, rising."""
    slowest = rates.min()
    fastest = rates.max()
    number = 1 + round(_TIMES_PER_DECADE * np.log10(fastest / slowest))
    return np.geomspace(1 / fastest, 1 / slowest, number)


def _solved(data: Data, rates: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the constant and the terms of best fit, and the relative deviations."""
    from scipy.optimize import nnls

    responses = data.kind.response(rates[:, None] * times)
    size = abs(data.values)
    rows = np.column_stack([np.ones(rates.size), responses]) / size[:, None]
    target = data.values / size
    terms, _ = nnls(
        np.concatenate([np.real(rows), np.imag(rows)]),
        np.concatenate([np.real(target), np.imag(target)]),
    )
    return terms, rows @ terms - target


def _series(data: Data, rates: np.ndarray, times: np.ndarray) -> Series:
    terms, deviations = _solved(data, rates, times)
    # Rounding leaves traces of other terms.
    terms[terms < 1e-12 * terms.sum()] = 0
    kept = terms[1:] > 0
    error = float(abs(deviations).max())
    return Series(float(terms[0]), terms[1:][kept], times[kept], error, None)


def _shift(data: Data, temperatures: np.ndarray, sweeps: list[np.ndarray]) -> WilliamsLandelFerry:
    """Return the shift with which one series fits the data at all temperatures best."""
    from scipy.optimize import least_squares

    lowest = temperatures.min()
    above = temperatures - lowest
    first = _first_guess(data, above, sweeps)

    def shifted(constants: np.ndarray) -> np.ndarray:
        c1, c2 = np.exp(constants)
        return data.rates * 10 ** (-c1 * above / (c2 + above))

    times = _candidates(shifted(first))

    def deviations(constants: np.ndarray) -> np.ndarray:
        _, found = _solved(data, shifted(constants), times)
        return np.concatenate([np.real(found), np.imag(found)])

    c1, c2 = np.exp(least_squares(deviations, first, diff_step=_STEP).x)
    return WilliamsLandelFerry(c1, c2, lowest)


def _first_guess(data: Data, above: np.ndarray, sweeps: list[np.ndarray]) -> np.ndarray:
    """Return logarithms of the constants at the lowest temperature, by overlaps of curves.

    The shift from one temperature to the next is the mean distance of the two curves along the
    logarithm of the rate, over the values that both have. It counts by their logarithmic range, so
    that the noise of a plateau has little weight.
    """
    curves = [_curve(data, sweep) for sweep in sweeps]
    shifts = np.zeros(len(sweeps) - 1)
    ranges = np.zeros(len(sweeps) - 1)
    for i in range(len(sweeps) - 1):
        (rates, values), (next_rates, next_values) = curves[i : i + 2]
        low = max(values[0], next_values[0])
        high = min(values[-1], next_values[-1])
        if low < high:
            # Between the values of either both curves are straight.
            common = np.clip(np.union1d(values, next_values), low, high)
            middles = (common[1:] + common[:-1]) / 2
            distance = np.interp(middles, values, rates)
            distance -= np.interp(middles, next_values, next_rates)
            shifts[i] = distance @ np.diff(common) / (high - low)
            ranges[i] = high - low
    means = np.array([above[sweep].mean() for sweep in sweeps])
    if np.count_nonzero(ranges) < _FEWEST_TEMPERATURES - 1:
        raise ValueError(
            f"The data at neighbouring ones of the {len(sweeps)} temperatures have no "
            f"{data.kind.values[0]} in common: measure over more {_plural(data.kind.argument)}, or "
            "at temperatures between."
        )
    best = np.inf, np.zeros(2)
    for c2 in means[-1] * np.array(_FIRST_C2):
        shape = -np.diff(means / (c2 + means))
        c1 = ((ranges * shape) @ shifts) / ((ranges * shape) @ shape)
        error = ranges @ (c1 * shape - shifts) ** 2
        if c1 > 0:
            best = min(best, (error, np.log([c1, c2])), key=lambda guess: guess[0])
    if best[0] == np.inf:
        raise ValueError(
            f"From one of the temperatures to the next the rates shift by 10 to the powers "
            f"{-shifts}: they must rise, as a solid relaxes faster when it is hot. Are the "
            "temperatures those of the data?"
        )
    return best[1]


def _curve(data: Data, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return log10 of the rates, rising, and a logarithm of the values that rises with them."""
    order = chosen[np.argsort(data.rates[chosen])]
    values = np.log(np.real(data.values[order]))
    if data.kind is CREEP:
        values = -values
    # Noise must not let a curve fall.
    return np.log10(data.rates[order]), np.maximum.accumulate(values)


def relaxation_of(kind: Kind, series: Series) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the relaxed modulus, the moduli and the relaxation times of a fitted series.

    Raises:
        ValueError: for a series of a liquid, of an elastic solid, or of one without a compliance at
            once.
    """
    constant = series.constant
    if constant <= 0 and kind is CREEP:
        raise ValueError(
            "The compliance of the fit at once is 0, and its modulus infinite: give earlier times, "
            "at which the compliance levels off."
        )
    if constant <= 0:
        earlier = "lower frequencies" if kind is OSCILLATION else "later times"
        raise ValueError(
            f"The relaxed modulus of the fit is 0: the data are of a liquid. Give {earlier}, at "
            f"which the {kind.values[0]} levels off."
        )
    if not series.terms.size:
        modulus = 1 / constant if kind is CREEP else constant
        raise ValueError(
            "The data are fitted best without any relaxation, by an elastic solid of modulus "
            f"{modulus:.6g}: use that solid, or give {_plural(kind.argument)} at which it relaxes."
        )
    if kind is CREEP:
        return _inverse(constant, series.terms, series.times)
    return constant, series.terms, series.times


def _inverse(
    constant: float, compliances: np.ndarray, retardation: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the relaxed modulus, the moduli and the relaxation times beside a creep.

    The Laplace transforms of creep and relaxation are inverse, s E(s) s J(s) = 1 (J. D. Ferry,
    Viscoelastic Properties of Polymers, 1980, chapter 3). The rates of relaxation are minus the
    zeros of s J = J_0 + sum J_k / (1 + s tau_k): one between each two 1 / tau_k, and one beyond.
    """

    def transform(rate: np.ndarray) -> np.ndarray:
        return constant + np.sum(compliances / (1 - rate[:, None] * retardation), axis=1)

    # From a pole to the next one the transform rises from minus infinity.
    poles = 1 / retardation[::-1]
    # Beyond the last one all terms together do not reach the constant from here on.
    last = poles[-1] * (1 + compliances.sum() / constant)
    rates = bisect(transform, poles, np.append(poles[1:], last))
    slopes = np.sum(compliances * retardation / (1 - rates[:, None] * retardation) ** 2, axis=1)
    moduli = 1 / (rates * slopes)
    return 1 / (constant + compliances.sum()), moduli[::-1], 1 / rates[::-1]


def _plural(argument: str) -> str:
    return {"frequency": "frequencies", "time": "times"}[argument]

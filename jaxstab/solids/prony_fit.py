"""Series of relaxation or retardation times with non-negative terms, fitted to measured data.

Least squares of the deviation over the measured value, in which the terms are non-negative (SciPy's
`nnls`; M. Baumgaertel and H. H. Winter, Rheol. Acta 28, 511 (1989), for relative deviations). The
candidates for the times are fixed, so that the problem is linear.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxstab.core.checks import parameter, require, require_finite, require_kind
from jaxstab.core.roots import bisect
from jaxstab.core.types import ArrayLike
from jaxstab.core.warn import warn
from jaxstab.solids.temperature_shift import TemperatureShift, WilliamsLandelFerry

# Neighbouring times of a fit differ by a factor of 1.26: a time between two is represented by both
# to better than 1 %.
_TIMES_PER_DECADE = 10
# Two constants follow from two shifts.
_FEWEST_TEMPERATURES = 3
# A sweep is at one temperature, of which an instrument tells each deviation [K].
_ONE_TEMPERATURE = 1.0
# First guesses of the constant C2 at the lowest temperature, over the span of temperatures.
_FIRST_C2 = 0.3, 1.0, 3.0, 10.0
# Negative values up to this part of the largest modulus are noise about zero, and others mistakes.
_NOISE = 0.1
# No measured value is more exact, relative to itself.
_LEAST_NOISE = 1e-3
# Times beyond the band that the data may hide, in the error of the relaxed modulus [decades].
_HIDDEN_DECADES = 1
# A change of the modulus, or an error of the relaxed one, that is no plateau any more.
_PLATEAU = 0.1
# A liquid is made a solid whose modulus at rest is smaller than the smallest measured one by this.
_FLOW = 100
# A fit is better for another term if the squares fall by this many of the noise: four errors.
_SIGNIFICANT = 4**2
# Squares within this of the least, in squares of the noise, are as good a fit: two errors.
_EQUAL = 2**2
# The same of two constants together, of which one may be off further: 95 % of a chi-square of two.
_EQUAL_TOGETHER = 6.0
# A row of this weight over that of a measured value is an equation.
_EQUATION = 1e4
# A shift that misses the distance between two curves by more does not describe them [decades].
_MISSED_SHIFT = 0.3
# They count where both curves change by this, in the logarithm: a plateau has no distance.
_CHANGE = 0.3
# The largest distance of the logarithm of a constant that an error counts.
_FARTHEST = 4.0
# An error of the logarithm of a constant with which it is not determined.
_UNDETERMINED = 0.25
# Steps of non-negative least squares for each term, which comes and goes a few times.
_STEPS = 100
# The step of differences by the logarithms of the constants: the residual of a fit whose terms
# come and go is rough at smaller ones.
_STEP = 1e-3


class RelaxationWarning(UserWarning):
    """Measured relaxation is left out or averaged, or does not determine all of a fitted solid."""


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
        relaxed_error: the relative error of the relaxed modulus.
        shift: of the times over the temperature, None for data at one temperature.
    """

    constant: float
    terms: np.ndarray
    times: np.ndarray
    error: float
    relaxed_error: float
    shift: TemperatureShift | None


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
            f"{_plural(kind.argument)}."
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
        f"repeated {_plural(kind.argument)} are averaged: one {kind.values[0]} is up to "
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
            f"{_plural(kind.argument)} are left out, at which the {names} is negative or no larger "
            "than its negative values: noise about zero.",
        )
    return table[:, is_kept]


def _tell_of(count: int, sentence: str) -> None:
    """Warn of a number of measured values."""
    warn(f"{count} {sentence}", RelaxationWarning)


def fit(data: Data, reference: ArrayLike | None, shift: TemperatureShift | None) -> Series:
    """Return the series of best fit, at the reference temperature if there are temperatures.

    Raises:
        TypeError: for a shift that is none.
        ValueError: for data at one or two temperatures without a shift, those whose curves have no
            value in common from one temperature to the next, those that do not soften on heating,
            and a reference or a shift without temperatures.
    """
    temperatures = data.temperatures
    if temperatures is None:
        for name, given in (("reference temperature", reference), ("shift", shift)):
            if given is not None:
                raise ValueError(
                    f"The {name} is {given}, and the data have no temperatures: give the "
                    "temperature of each."
                )
        return _series(data, data.rates)
    if shift is None:
        sweeps = _sweeps(temperatures)
        shift = _shift(data, temperatures, sweeps)
        if reference is None:
            reference = temperatures[sweeps[(len(sweeps) - 1) // 2]].mean()
    require_kind(shift, TemperatureShift, "no shift: give one of jaxstab.solids, as Arrhenius.")
    if reference is not None:
        shift = shift.referred_to(reference)
    rates = data.rates * np.asarray(shift.factor(temperatures))
    return _series(data, rates)._replace(shift=shift)


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


def _solve(
    data: Data, rates: np.ndarray, times: np.ndarray, held: tuple[np.ndarray, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the constant and the terms of best fit, and the relative deviations.

    Arguments:
        data: the measured values.
        rates: of the measurement.
        times: of the terms.
        held: weights of the constant and the terms, and the value of their sum, of order one.
    """
    from scipy.optimize import nnls

    responses = data.kind.response(rates[:, None] * times)
    size = abs(data.values)
    rows = np.column_stack([np.ones(rates.size), responses]) / size[:, None]
    target = data.values / size
    matrix = np.concatenate([np.real(rows), np.imag(rows)])
    values = np.concatenate([np.real(target), np.imag(target)])
    if held is not None:
        weights, value = held
        matrix = np.vstack([matrix, _EQUATION * weights])
        values = np.append(values, _EQUATION * value)
    terms, _ = nnls(matrix, values, maxiter=_STEPS * matrix.shape[1])
    return terms, rows @ terms - target


def _series(data: Data, rates: np.ndarray) -> Series:
    """Return the series of best fit, of a liquid with a small constant or a late time."""
    times = _candidates(rates)
    terms, deviations = _solve(data, rates, times)
    flows = False
    if data.kind is CREEP:
        later = np.append(times, _FLOW * times[-1])
        steady, missed = _solve(data, rates, later)
        gain = (_squares(deviations) - _squares(missed)) / _noise(steady, missed)
        flows = steady[-1] > _PLATEAU * _FLOW * data.values.max() and gain > _SIGNIFICANT
        if flows:
            times, terms, deviations = later, steady, missed
    elif terms[0] <= 1e-12 * terms.sum():
        flows = True
        constant = abs(data.values).min() / _FLOW
        terms, deviations = _solve(data, rates, times, (np.eye(terms.size)[0] / constant, 1.0))
    # Rounding leaves traces of other terms.
    terms[terms < 1e-12 * terms.sum()] = 0
    relaxed_error = _relaxed_error(data, rates, times, terms, deviations)
    if flows:
        # It may be zero.
        relaxed_error = max(relaxed_error, 1.0)
    error = float(abs(deviations).max())
    kept = terms[1:] > 0
    series = Series(float(terms[0]), terms[1:][kept], times[kept], error, relaxed_error, None)
    _tell_of_no_plateau(data.kind, rates, series, flows)
    return series


def _squares(deviations: np.ndarray) -> float:
    return float(np.sum(abs(deviations) ** 2))


def _noise(terms: np.ndarray, deviations: np.ndarray) -> float:
    """Return the variance of a measured value that the deviations of a fit show."""
    number = deviations.size * (1 + np.iscomplexobj(deviations)) - np.count_nonzero(terms)
    return max(_squares(deviations) / max(number, 1), _LEAST_NOISE**2)


def _relaxed_error(
    data: Data, rates: np.ndarray, times: np.ndarray, terms: np.ndarray, deviations: np.ndarray
) -> float:
    """Return how far, relative to itself, the relaxed modulus may be off.

    The data fix it only if no term is slower than they are. So it may be that of any series with
    terms of up to ten times the longest time that misses the data by no more than the fit does, but
    for two errors of the noise.
    """
    hidden = 10 ** (np.arange(1, 1 + _HIDDEN_DECADES * _TIMES_PER_DECADE) / _TIMES_PER_DECADE)
    candidates = np.append(times, times[-1] * hidden)
    weights = np.eye(candidates.size + 1)[0]
    # Twice the largest value is no fit; of a term of creep only the part of its time has passed.
    largest = 2 * abs(data.values).max()
    if data.kind is CREEP:
        weights = np.ones(candidates.size + 1)
        largest *= 1 + candidates[-1] * rates.min()
    found = float(weights[: terms.size] @ terms)
    most = _squares(deviations) + _EQUAL * _noise(terms, deviations)

    def excess(ratio: float) -> float:
        _, missed = _solve(data, rates, candidates, (weights / found, ratio))
        return _squares(missed) - most

    def farthest(end: float) -> float:
        if excess(end) <= 0:
            return end
        return _zero(excess, 1.0, end)

    ratios = np.array([farthest(0.0), farthest(largest / found)])
    if data.kind is CREEP:
        ratios = 1 / ratios[::-1]
    return float(max(1 - ratios[0], ratios[1] - 1))


def _zero(excess: Callable[[float], float], negative: float, positive: float) -> float:
    """Return the zero of a function between two values, to a thousandth of itself."""
    from scipy.optimize import root_scalar

    bracket = sorted((negative, positive))
    return float(root_scalar(excess, bracket=bracket, method="brentq", xtol=1e-5, rtol=1e-3).root)


def _tell_of_no_plateau(kind: Kind, rates: np.ndarray, series: Series, flows: bool) -> None:
    """Warn of a series whose relaxed modulus is not that of a plateau."""
    ends = rates.min() * np.array([1.0, 10.0])
    responses = kind.response(ends[:, None] * series.times)
    slow, faster = series.constant + responses @ series.terms
    change = abs(faster) / abs(slow)
    where = "lower frequencies" if kind is OSCILLATION else "later times"
    relaxed = series.constant
    if kind is CREEP:
        change = abs(slow) / abs(faster)
        relaxed = 1 / (relaxed + series.terms.sum())
    longest = 1 / rates.min()
    if flows:
        warn(
            f"The {kind.values[0]} has no plateau: the data are of a liquid, or end before it. The "
            f"relaxed modulus, {relaxed:.3g}, stands for none. The series holds up to the time "
            f"{longest:.3g}: a rest or a lifetime beyond is that of another solid. For a solid, "
            f"give {where}.",
            RelaxationWarning,
        )
    elif change > 1 + _PLATEAU and series.relaxed_error > _PLATEAU:
        changes = "rises" if kind is CREEP else "falls"
        loss = ""
        if kind is OSCILLATION:
            loss = f" (tan delta {slow.imag / slow.real:.2g} at its end)"
        warn(
            f"The {kind.values[0]} still {changes} by a factor of {change:.2f} in the slowest "
            f"decade of the data{loss}: no plateau. The relaxed modulus of the fit, "
            f"{relaxed:.3g}, has an error of {series.relaxed_error:.0%} (`relaxed_error`), on "
            f"which rests, lifetimes and slow loops depend. Give {where}.",
            RelaxationWarning,
        )


def _shift(data: Data, temperatures: np.ndarray, sweeps: list[np.ndarray]) -> WilliamsLandelFerry:
    """Return the shift with which one series fits the data at all temperatures best."""
    from scipy.optimize import least_squares

    lowest = temperatures.min()
    above = temperatures - lowest
    overlaps = _overlaps(data, sweeps)
    means = np.array([above[sweep].mean() for sweep in sweeps])
    first = _first_guess(means, *overlaps)

    def shift(constants: np.ndarray) -> np.ndarray:
        c1, c2 = np.exp(constants)
        return data.rates * 10 ** (-c1 * above / (c2 + above))

    times = _candidates(shift(first))
    if data.kind is CREEP:
        # So that a liquid, which flows, is fitted too.
        times = np.append(times, _FLOW * times[-1])

    def deviations(constants: np.ndarray) -> np.ndarray:
        _, found = _solve(data, shift(constants), times)
        return np.concatenate([np.real(found), np.imag(found)])

    best = least_squares(deviations, first, diff_step=_STEP)
    c1, c2 = np.exp(best.x)
    terms, missed = _solve(data, shift(best.x), times)
    most = 2 * best.cost + _EQUAL_TOGETHER * _noise(terms, missed)
    covariance = np.zeros((2, 2))
    # Differences over a small step count the terms that come and go; those over an error do not.
    for direction in np.linalg.svd(best.jac)[2]:
        error = _distance(lambda x, d=direction: _squares(deviations(best.x + x * d)) - most) / 2
        covariance += error**2 * np.outer(direction, direction)
    law = WilliamsLandelFerry(c1, c2, lowest).with_covariance(covariance)
    _tell_of_shift(law, lowest + means, *overlaps)
    return law


def _distance(excess: Callable[[float], float]) -> float:
    """Return how far from zero, on the farther side, a function that is negative there rises to it.

    No farther than a few units, which is as good as any distance for a logarithm.
    """
    farthest = [0.0]
    for end in (-_FARTHEST, _FARTHEST):
        if excess(end) <= 0:
            return _FARTHEST
        farthest.append(abs(_zero(excess, 0.0, end)))
    return max(farthest)


def _tell_of_shift(
    law: WilliamsLandelFerry, temperatures: np.ndarray, shifts: np.ndarray, ranges: np.ndarray
) -> None:
    """Warn of constants that are not determined, and of curves that the law does not join."""
    low, high = temperatures[[0, -1]]
    relative = np.sqrt(np.diagonal(np.asarray(law.covariance)))
    if relative.max() > _UNDETERMINED:
        constants = (float(law.c1), float(law.c2))
        c1, c2 = (
            f"{constant:.3g} with an error of {error:.0%}"
            for constant, error in zip(constants, relative, strict=True)
        )
        warn(
            f"The temperatures from {low:.6g} to {high:.6g} do not determine the constants of the "
            f"shift: at {low:.6g} C1 is {c1}, C2 {c2}. The shift factor is known between them "
            "alone: measure over a wider range, or give a `shift`.",
            RelaxationWarning,
        )
    missed = np.diff(np.log10(np.asarray(law.factor(temperatures)))) - shifts
    for i in np.flatnonzero((abs(missed) > _MISSED_SHIFT) & (ranges > _CHANGE)):
        warn(
            f"From the temperature {temperatures[i]:.6g} to {temperatures[i + 1]:.6g} the curves "
            f"are {shifts[i]:.2f} decades apart, and by the law of Williams, Landel and Ferry "
            f"{shifts[i] + missed[i]:.2f}: the material does not follow it there. Leave these "
            "temperatures out, or give a `shift`, as a ShiftTable.",
            RelaxationWarning,
        )


def _overlaps(data: Data, sweeps: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the shifts from one temperature to the next by overlaps, and what they rest on.

    A shift, log10 of a ratio of times, is the mean distance of two curves along the logarithm of
    the rate, over the values that both have. It rests on their logarithmic range: the noise of a
    plateau has little weight.

    Raises:
        ValueError: if fewer than two neighbours have values in common.
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
    if np.count_nonzero(ranges) < _FEWEST_TEMPERATURES - 1:
        raise ValueError(
            f"The data at neighbouring ones of the {len(sweeps)} temperatures have no "
            f"{data.kind.values[0]} in common: measure over more {_plural(data.kind.argument)}, or "
            "at temperatures between."
        )
    return shifts, ranges


def _first_guess(means: np.ndarray, shifts: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    """Return logarithms of the constants at the lowest temperature, by shifts over temperatures."""
    best = np.inf, np.zeros(2)
    for c2 in means[-1] * np.array(_FIRST_C2):
        shape = np.diff(means / (c2 + means))
        c1 = -((ranges * shape) @ shifts) / ((ranges * shape) @ shape)
        error = ranges @ (c1 * shape + shifts) ** 2
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
        ValueError: for a series of an elastic solid, or of one without a compliance at once.
    """
    constant = series.constant
    if constant <= 0 and kind is CREEP:
        raise ValueError(
            "The compliance of the fit at once is 0, and its modulus infinite: give earlier times, "
            "at which the compliance levels off."
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

"""Series of relaxation or retardation times with non-negative terms, fitted to measured data.

Least squares of the deviation over the measured value, in which the terms are non-negative (SciPy's
`nnls`; M. Baumgaertel and H. H. Winter, Rheol. Acta 28, 511 (1989), for relative deviations). The
candidates for the times are fixed, so that the problem is linear.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxstab.core.roots import bisect
from jaxstab.core.warn import warn
from jaxstab.solids.relaxation_data import (
    CREEP,
    OSCILLATION,
    Data,
    Kind,
    RelaxationWarning,
    plural,
)
from jaxstab.solids.temperature_shift import TemperatureShift

# Neighbouring times of a fit differ by a factor of 1.26: a time between two is represented by both
# to better than 1 %.
_TIMES_PER_DECADE = 10
# No measured value is more exact, relative to itself.
_LEAST_NOISE = 1e-3
# Times beyond the band that the data may hide, in the error of the relaxed modulus [decades].
_HIDDEN_DECADES = 1
# A change of the modulus, or an error of the relaxed one, that is no plateau any more.
_PLATEAU = 0.1
# A liquid is made a solid whose modulus at rest is smaller than the smallest measured one by this.
FLOW = 100
# A fit is better for another term if the squares fall by this many of the noise: four errors.
_SIGNIFICANT = 4**2
# Squares within this of the least, in squares of the noise, are as good a fit: two errors.
_EQUAL = 2**2
# A row of this weight over that of a measured value is an equation.
_EQUATION = 1e4
# Steps of non-negative least squares for each term, which comes and goes a few times.
_STEPS = 100


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


def candidate_times(rates: np.ndarray) -> np.ndarray:
    """Return the candidates for times in a band of rates, rising."""
    slowest = rates.min()
    fastest = rates.max()
    number = 1 + round(_TIMES_PER_DECADE * np.log10(fastest / slowest))
    return np.geomspace(1 / fastest, 1 / slowest, number)


def solve(
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


def series_of(data: Data, rates: np.ndarray) -> Series:
    """Return the series of best fit, of a liquid with a small constant or a late time."""
    times = candidate_times(rates)
    terms, deviations = solve(data, rates, times)
    flows = False
    if data.kind is CREEP:
        later = np.append(times, FLOW * times[-1])
        steady, missed = solve(data, rates, later)
        gain = sum_of_squares(deviations) - sum_of_squares(missed)
        is_better = gain > _SIGNIFICANT * noise_variance(steady, missed)
        flows = is_better and steady[-1] > _PLATEAU * FLOW * data.values.max()
        if flows:
            times, terms, deviations = later, steady, missed
    elif terms[0] <= 1e-12 * terms.sum():
        flows = True
        constant = abs(data.values).min() / FLOW
        terms, deviations = solve(data, rates, times, (np.eye(terms.size)[0] / constant, 1.0))
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


def sum_of_squares(deviations: np.ndarray) -> float:
    """Return the sum of the squared sizes of deviations, which may be complex."""
    return float(np.sum(abs(deviations) ** 2))


def noise_variance(terms: np.ndarray, deviations: np.ndarray) -> float:
    """Return the variance of a measured value that the deviations of a fit show."""
    number = deviations.size * (1 + np.iscomplexobj(deviations)) - np.count_nonzero(terms)
    return max(sum_of_squares(deviations) / max(number, 1), _LEAST_NOISE**2)


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
    most = sum_of_squares(deviations) + _EQUAL * noise_variance(terms, deviations)

    def excess(ratio: float) -> float:
        _, missed = solve(data, rates, candidates, (weights / found, ratio))
        return sum_of_squares(missed) - most

    def farthest(end: float) -> float:
        if excess(end) <= 0:
            return end
        return zero_between(excess, 1.0, end)

    ratios = np.array([farthest(0.0), farthest(largest / found)])
    if data.kind is CREEP:
        ratios = 1 / ratios[::-1]
    return float(max(1 - ratios[0], ratios[1] - 1))


def zero_between(excess: Callable[[float], float], negative: float, positive: float) -> float:
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
            f"{modulus:.6g}: use that solid, or give {plural(kind.argument)} at which it relaxes."
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

"""One series for measurements at several temperatures, by time-temperature superposition.

The shift of the times over the temperature is the one with which a single series fits the data at
all temperatures best. The search starts from the shifts with which neighbouring curves overlap.
"""

from collections.abc import Callable

import numpy as np

from jaxstab.core.checks import require_kind
from jaxstab.core.types import ArrayLike
from jaxstab.core.warn import warn
from jaxstab.solids.prony_fit import (
    FLOW,
    Series,
    candidate_times,
    noise_variance,
    series_of,
    solve,
    sum_of_squares,
    zero_between,
)
from jaxstab.solids.relaxation_data import CREEP, Data, RelaxationWarning, plural
from jaxstab.solids.temperature_shift import TemperatureShift, WilliamsLandelFerry

# Two constants follow from two shifts.
_FEWEST_TEMPERATURES = 3
# A sweep is at one temperature, of which an instrument tells each deviation [K].
_ONE_TEMPERATURE = 1.0
# First guesses of the constant C2 at the lowest temperature, over the span of temperatures.
_FIRST_C2 = 0.3, 1.0, 3.0, 10.0
# The same of two constants together, of which one may be off further: 95 % of a chi-square of two.
_EQUAL_TOGETHER = 6.0
# A shift that misses the distance between two curves by more does not describe them [decades].
_MISSED_SHIFT = 0.3
# They count where both curves change by this, in the logarithm: a plateau has no distance.
_CHANGE = 0.3
# The largest distance of the logarithm of a constant that an error counts.
_FARTHEST = 4.0
# An error of the logarithm of a constant with which it is not determined.
_UNDETERMINED = 0.25
# The step of differences by the logarithms of the constants: the residual of a fit whose terms
# come and go is rough at smaller ones.
_STEP = 1e-3


def fit_series(data: Data, reference: ArrayLike | None, shift: TemperatureShift | None) -> Series:
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
        return series_of(data, data.rates)
    if shift is None:
        sweeps = _sweeps(temperatures)
        shift = _shift(data, temperatures, sweeps)
        if reference is None:
            reference = temperatures[sweeps[(len(sweeps) - 1) // 2]].mean()
    require_kind(shift, TemperatureShift, "no shift: give one of jaxstab.solids, as Arrhenius.")
    if reference is not None:
        shift = shift.referred_to(reference)
    rates = data.rates * np.asarray(shift.factor(temperatures))
    return series_of(data, rates)._replace(shift=shift)


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

    times = candidate_times(shift(first))
    if data.kind is CREEP:
        # So that a liquid, which flows, is fitted too.
        times = np.append(times, FLOW * times[-1])

    def deviations(constants: np.ndarray) -> np.ndarray:
        _, found = solve(data, shift(constants), times)
        return np.concatenate([np.real(found), np.imag(found)])

    best = least_squares(deviations, first, diff_step=_STEP)
    c1, c2 = np.exp(best.x)
    terms, missed = solve(data, shift(best.x), times)
    most = 2 * best.cost + _EQUAL_TOGETHER * noise_variance(terms, missed)
    covariance = np.zeros((2, 2))
    # Differences over a small step count the terms that come and go; those over an error do not.
    for direction in np.linalg.svd(best.jac)[2]:

        def excess(x: float, direction: np.ndarray = direction) -> float:
            return sum_of_squares(deviations(best.x + x * direction)) - most

        error = _distance(excess) / 2
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
        farthest.append(abs(zero_between(excess, 0.0, end)))
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
            f"{data.kind.values[0]} in common: measure over more {plural(data.kind.argument)}, or "
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

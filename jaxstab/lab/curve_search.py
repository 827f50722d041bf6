"""The least squares of all numbers of a curve, with their errors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult

from jaxstab.lab import dugdale
from jaxstab.lab.curve_bins import Bins
from jaxstab.lab.curve_model import ALL, BUT_RANGE, FIRST, LAST, MECHANICS, CurveModel
from jaxstab.lab.tips import FlatPunch, Tip, paraboloid_radius

# An attraction is kept if the sum of squares falls by this much, in units of its scatter.
_GAIN = 14.0
# Bounds of the range over Tabor's length (w / E*)^(2/3) R^(1/3), and the numbers of ranges in
# between at which the others are fitted, and from which a search begins. Ranges are left out beyond
# one whose half sum of squares is so much larger.
_RANGES = 1e-3, 300.0
_TRIED, _STARTS = 19, 9
# Works over the best one at which the others are fitted, as logarithms.
_WORKS = np.array([-2.4, -1.6, -0.8, -0.4, -0.2, 0.2, 0.4, 0.8, 1.6, 2.4])
_MUCH_WORSE = 50.0
# An attraction acts over no less than the distance of atoms [m].
_ATOM = 1e-10
# The pull-off is between 1.5 and 2 times pi w R.
_PULL_OFF = 1.7
# Contact points among which a fit starts.
_CONTACTS = 120
# Autocorrelations are summed up to a lag of so many correlation lengths (A. Sokal).
_WINDOW = 5
# A better fit has half a sum of squares that is lower by this much.
_BETTER = 0.1
# So many standard errors reach to where the sum of squares has grown by the square of the other
# number: the joint regions of work and range in which both lie in 95.4 and 99.7 of 100 cases.
_ERRORS = (2.0, 2.48), (3.0, 3.44)
# The place of the work of adhesion among the numbers.
_WORK = 5
# Errors of the bins follow from so many fits.
_WEIGHINGS = 2


class BestFit(NamedTuple):
    """A fit of the numbers of a model.

    Attributes:
        model: with the errors of bins that the fit shows.
        found: the numbers.
        errors: of the numbers in SI units, not of logarithms.
    """

    model: CurveModel
    found: OptimizeResult
    errors: np.ndarray

    @classmethod
    def straight(cls, model: CurveModel, found: OptimizeResult) -> BestFit:
        """Return the fit with the errors of a model that is straight near it."""
        errors = np.sqrt(model.variances(found.x)) * model.units
        return cls(model, found, errors * model.slopes(found.x))


def without_adhesion(data: Bins, tip: Tip | FlatPunch) -> BestFit:
    """Return the fit without adhesion, with the errors of bins that it shows."""
    model = CurveModel(data, tip, False)
    modulus, contact = _start(data, tip, 0.0)
    start = np.array([np.log(modulus), contact, 0.0, 0.0, 0.0]) / model.units
    return BestFit.straight(*_reweighted_fit(model, model.fit(start, MECHANICS, LAST)))


def with_adhesion(data: Bins, tip: Tip | FlatPunch) -> BestFit:
    """Return the best of the fits at all ranges, with the errors that these show."""
    model = CurveModel(data, tip, True)
    # It may lie between two points.
    attraction = max(-float(data.forces[data.is_near].min()), data.noise)
    modulus, contact = _start(data, tip, attraction)
    zeros = [contact, 0.0, 0.0, 0.0]
    if isinstance(tip, FlatPunch):
        work = attraction**2 / (8 * np.pi * modulus * tip.radius**3)
        start = np.array([np.log(modulus), *zeros, np.log(work)])
        return BestFit.straight(*_reweighted_fit(model, model.fit(start / model.units, ALL, LAST)))
    # The curvature of the tip where it takes as much force as the attraction.
    branch = dugdale.without_adhesion(tip, modulus, float(np.ptp(data.tips)), 0.0)
    depth = np.interp(attraction, branch.force, branch.indentation)
    radius = paraboloid_radius(tip, depth)
    work = attraction / (_PULL_OFF * np.pi * radius)
    length = (work / modulus) ** (2 / 3) * radius ** (1 / 3)
    lowest = max(_RANGES[0] * length, _ATOM)
    ranges = lowest, max(_RANGES[1] * length, 2 * lowest)
    lengths = np.linspace(np.log(ranges[0]), np.log(ranges[1]), _TRIED)
    numbers = [np.log(modulus), *zeros, np.log(work)]
    found = [
        model.fit(np.append(numbers, start) / model.units, ALL, FIRST, ranges)
        for start in lengths[:: _TRIED // _STARTS]
    ]
    best = min(found, key=lambda one: one.cost)
    # Errors of bins would hide a fit that has not ended.
    model, best = _reweighted_fit(model, model.fit(best.x, ALL, LAST, ranges), ranges)
    profile = _profiles(model, best, lengths, ranges)
    # There may be other minima, of other works and moduli at the same range.
    profile += [
        model.fit(one.x, ALL, FIRST, ranges)
        for one in found
        if one.cost < min(other.cost for other in found) + _MUCH_WORSE
    ]
    least = min(profile, key=lambda one: one.cost)
    if least.cost < best.cost - _BETTER:
        model, best = _reweighted_fit(model, model.fit(least.x, ALL, LAST, ranges), ranges)
        minima = [model.fit(one.x, ALL, FIRST, ranges) for one in profile]
        profile = _profiles(model, best, lengths, ranges) + minima
    return _with_errors(model, best, profile, ranges)


def better(bare: BestFit, sticky: BestFit) -> BestFit:
    """Return the fit with adhesion if the curve needs it, otherwise the fit without.

    Adhesion that does not show may act all the same, as where few points lie near the contact. So
    the errors of modulus and contact point are those of the fit with adhesion where these are
    larger, and as much as the fits differ.
    """
    other = bare.model.with_scatter(sticky.model.scatter).fit(bare.found.x, ALL, LAST)
    if 2 * (other.cost - sticky.found.cost) > _GAIN:
        return sticky
    moved = sticky.model.values(sticky.found.x)[: bare.model.count]
    moved = moved - bare.model.values(bare.found.x)
    errors = np.maximum(bare.errors, sticky.errors[: bare.model.count])
    return BestFit(bare.model, bare.found, np.hypot(errors, moved))


def _start(data: Bins, tip: Tip | FlatPunch, attraction: float) -> tuple[float, float]:
    """Return E* and contact point of the best fit to tip positions, with a constant attraction."""
    lowest = 0
    if attraction > 0:
        lowest = int(np.argmin(data.forces))
    is_used = np.arange(len(data.forces)) >= lowest
    tips, forces = data.tips[is_used], data.forces[is_used] + attraction
    deep, high = tips.min(), data.tips[data.is_near].max()
    unit = dugdale.without_adhesion(tip, 1.0, 1.1 * (high - deep), 0.0)
    best = (np.inf, 1.0, 0.0)
    for contact in np.linspace(high, deep, _CONTACTS, endpoint=False):
        shape = np.interp(contact - tips, unit.indentation, unit.force / unit.force[-1])
        columns = shape[:, None]
        if attraction == 0:
            columns = np.stack([shape, np.ones_like(shape)], 1)
        found, *_ = np.linalg.lstsq(columns, forces, rcond=None)
        squares = float(np.sum((columns @ found - forces) ** 2))
        if found[0] > 0 and squares < best[0]:
            best = (squares, float(found[0] / unit.force[-1]), float(contact))
    return best[1], best[2]


def _reweighted_fit(
    model: CurveModel, found: OptimizeResult, ranges: tuple[float, float] | None = None
) -> tuple[CurveModel, OptimizeResult]:
    """Return fits of all numbers with the errors of bins that the fits before show."""
    for _ in range(_WEIGHINGS):
        model = model.with_scatter(_scatter(model, found))
        found = model.fit(found.x, ALL, LAST, ranges)
    return model, found


def _profiles(
    model: CurveModel, best: OptimizeResult, lengths: np.ndarray, ranges: tuple[float, float]
) -> list[OptimizeResult]:
    """Return the fits of all other numbers at ranges, and at works."""
    works = best.x[_WORK] + _WORKS
    at_ranges = _profile(model, best, model.count - 1, lengths, ranges, [])
    # An attraction between points may be of any work, at ranges that no smaller work leads to.
    return at_ranges + _profile(model, best, _WORK, works, ranges, at_ranges)


def _profile(
    model: CurveModel,
    best: OptimizeResult,
    number: int,
    values: np.ndarray,
    ranges: tuple[float, float],
    known: list[OptimizeResult],
) -> list[OptimizeResult]:
    """Return the fits of all others at values of a number, from the best one outwards.

    Each begins at the one before, and at the known one next to it. On either side it ends where a
    fit is much worse.
    """
    found = []
    others = np.delete(np.arange(model.count), number)
    for side in (values[values > best.x[number]], values[values <= best.x[number]][::-1]):
        last = best
        for value in side:
            near = sorted(known, key=lambda one: abs(one.x[number] - value))[:1]
            fits = []
            for one in (last, *near):
                start = one.x.copy()
                start[number] = value
                fits.append(model.fit(start, others, FIRST, ranges))
            found += fits
            last = min(fits, key=lambda one: one.cost)
            if last.cost > best.cost + _MUCH_WORSE:
                break
    return found


def _with_errors(
    model: CurveModel,
    best: OptimizeResult,
    profile: list[OptimizeResult],
    ranges: tuple[float, float],
) -> BestFit:
    """Return a fit with its errors, by fits at other ranges and works, and from other starts.

    The misfit is no parabola over the range: one that is short beside the deformation hardly
    changes the curve. Errors reach to the farther side of the joint regions of work and range, or
    as far as derivatives tell. Were the regions ellipses, the errors at one range and the change
    along the ranges would add as squares; where the misfit hardly changes along the ranges, the
    errors at the farthest range are as large as at the best one, and add themselves.
    """
    step = min(float(np.sqrt(model.variances(best.x)[-1])), 1.0)
    middle = best.x[-1]
    first = best.cost
    growths = [growth for _, growth in _ERRORS]
    for away in (*growths, *(-growth for growth in growths)):
        length = np.clip(middle + away * step, *np.log(ranges))
        found = model.fit(np.append(best.x[:-1], length), BUT_RANGE, FIRST)
        profile = [*profile, found]
        if found.cost < best.cost:
            best = OptimizeResult(best, x=found.x, cost=found.cost)
    if best.cost > first - _BETTER:
        # A narrow valley may take more steps than there are, and has been followed.
        best = OptimizeResult(best, status=1)
    profile = sorted([*profile, best], key=lambda one: one.x[-1])
    slopes = model.units * model.slopes(best.x)
    # Far from the fit derivatives tell nothing of logarithms.
    most = np.where(model.is_logarithm, 1.0, np.inf)
    straight, across = (
        np.minimum(np.sqrt(model.variances(best.x, free)), most) * slopes
        for free in (ALL, BUT_RANGE)
    )
    # The distance in standard errors.
    away = np.array([np.sqrt(2 * max(one.cost - best.cost, 0.0)) for one in profile])
    value = model.values(best.x)
    along, widened = [], [straight]
    for errors, growth in _ERRORS:
        inside = np.flatnonzero(away <= growth)
        moved = [np.abs(model.values(profile[one].x) - value) / errors for one in inside]
        along += moved
        # At each range the others have an error of their own, by what is left of the growth.
        left = np.sqrt(1 - (away[inside] / growth) ** 2)
        widened.append(np.max(moved + np.outer(left, across), axis=0))
        for last, beyond in ((inside[0], inside[0] - 1), (inside[-1], inside[-1] + 1)):
            side = profile[last].x
            if 0 <= beyond < len(profile):
                part = (growth - away[last]) / (away[beyond] - away[last])
                side = side + part * (profile[beyond].x - side)
            along.append(np.abs(model.values(side) - value) / errors)
    ellipse = np.hypot(across, np.max(along, axis=0))
    return BestFit(model, best, np.max([*widened, ellipse], axis=0))


def _scatter(model: CurveModel, found: OptimizeResult) -> np.ndarray:
    """Return the variance of each bin over the variance by white noise.

    Deviations of points from the model are taken together where no force acts, and in contact. With
    the autocorrelation r_k the mean of many points has the variance (1 + 2 sum r_k) sigma^2 / n.
    """
    data = model.data
    misfit = model.misfit(found.x)
    scatter = np.ones(len(data.forces))
    for is_part in (data.is_near, ~data.is_near):
        inside = misfit[is_part[data.group]]
        if inside.size > 3:
            scatter[is_part] = max(correlated_variance(inside, model.count) / data.noise**2, 1.0)
    return scatter


def correlated_variance(values: np.ndarray, freedom: int) -> float:
    """Return the variance of the mean of many values, times their number."""
    count = len(values)
    size = 2 ** int(np.ceil(np.log2(2 * count)))
    power = np.abs(np.fft.rfft(values, size)) ** 2
    products = np.fft.irfft(power, size)[:count] / count
    if products[0] == 0:
        return 0.0
    lengths = 1 + 2 * np.cumsum(products[1:] / products[0])
    is_enough = np.arange(1, count) >= _WINDOW * lengths
    length = 1.0
    if is_enough.any():
        length = max(float(lengths[np.argmax(is_enough)]), 1.0)
    length = min(length, count / (2 * freedom))
    return float(products[0]) * length * count / (count - freedom * length)

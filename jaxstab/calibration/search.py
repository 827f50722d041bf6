"""The search for the least misfit: several starts, and a profile along the weakest parameter."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from tqdm import tqdm

from jaxstab.calibration.least_squares import (
    Chosen,
    Curve,
    Fit,
    FitProblem,
    Values,
    directions,
    minimise,
)
from jaxstab.core.accuracy import SIGNIFICANT
from jaxstab.core.results import RESULTS

# The largest number of starts by default.
_MOST = 5
# The largest logarithm of the other starts over the first: a factor of two.
_FAR = 0.7
# Fits agree on the least misfit within this fraction of it.
_AGREEMENT = 0.25
# The places of the profile on a side: one and 2.5 standard errors away, then in steps of the
# logarithm to a factor of four, since points that detach one by one make minima beside each other.
_ON_A_SIDE = 9
_DISTANCE = 0.2
# A few steps are enough for the other parameters, which start from the profile's value before.
_PROFILE_STEPS = 4
# All parameters are fitted from a minimum of the profile below so many times the least loss.
_WORTH = 4.0
# Minima are distinct if a standard error apart, within these limits.
_SAME = 1e-3
_APART = 0.05


@dataclass
class Search:
    """The fits so far, which fitting adds.

    Attributes:
        problem: the misfit.
        is_profiled: which variables may be profiled.
        starts: the fits from starts.
        profile: the fits along the profile, with ascending values of the weakest parameter.
        refits: the fits of all variables from minima of the profile.
        num_steps: the steps of all fits.
    """

    problem: FitProblem
    is_profiled: Chosen
    starts: list[Fit] = field(default_factory=list)
    profile: list[Fit] = field(default_factory=list)
    refits: list[Fit] = field(default_factory=list)
    num_steps: int = 0

    @property
    def guess(self) -> Curve:
        """The curve at the first start."""
        return self.starts[0].first

    @property
    def best(self) -> Fit:
        """The fit of all variables with the least misfit."""
        return _least([*self.starts, *self.refits])

    @property
    def centre(self) -> Fit:
        """The best of the starts, the centre of the profile."""
        return _least(self.starts)

    @property
    def _errors(self) -> Values:
        """The standard errors at the centre of the profile, by slopes."""
        return directions(self.problem, self.centre.point).errors

    @property
    def weakest(self) -> int:
        """The index of the profiled parameter with the largest relative error."""
        return int(np.argmax(np.where(self.is_profiled, self._errors, -1)))

    @property
    def resolution(self) -> float:
        """The difference in the weakest parameter from which minima are distinct."""
        return float(np.clip(self._errors[self.weakest], _SAME, _APART))

    @property
    def result(self) -> RESULTS:
        """How the best fit ended.

        The least misfit of a curve with jumps may lie at a jump, where no method converges. It is
        accepted if two fits agree on it.
        """
        best = self.best
        most = (1 + _AGREEMENT) * best.point.loss
        agreeing = [fit for fit in (*self.starts, *self.refits) if fit.point.loss <= most]
        if best.result == RESULTS.stagnated and len(agreeing) > 1:
            return RESULTS.successful
        return best.result

    @property
    def num_minima(self) -> int:
        """The number of minima of the misfit, distinct in the weakest parameter."""
        ends = [fit for fit in (*self.starts, *self.refits) if fit.has_ended]
        places = np.sort([fit.point.free[self.weakest] for fit in ends])
        return len(places[:1]) + int(np.sum(np.diff(places) > self.resolution))

    def errors(self, of_slopes: Values) -> Values:
        """Return standard errors of the parameters, raised to the errors of the profile.

        A parabola's error is the distance over the root of twice the rise, in variances.
        """
        problem, best = self.problem, self.best.point
        variance = problem.variance(best)
        raised = of_slopes
        for fit in self.profile:
            rise = np.inf
            if variance > 0:
                rise = max(2 * (fit.point.loss - best.loss) / variance, 1)
            if rise < SIGNIFICANT**2:
                away = np.abs(problem.values(fit.point.free) - problem.values(best.free))
                raised = np.maximum(raised, away / np.sqrt(rise))
        return raised


def fits(search: Search, starts: int | None, max_steps: int, bar: tqdm) -> Iterator[None]:
    """Add fits to a search, and yield after each of them.

    1. Fit from several starts around zero; by default starts are added until one converges, up to
       `_MOST`.
    2. Along a profile, hold the weakest parameter at values around its fit, and fit the others.
    3. From each minimum of the profile, fit all parameters again.
    """
    problem = search.problem

    def fit_from(problem: FitProblem, start: Values, max_steps: int) -> Fit:
        fit = minimise(problem, start, max_steps)
        search.num_steps += fit.num_steps
        bar.update()
        return fit

    for start in _starts(problem, starts or _MOST):
        search.starts.append(fit_from(problem, start, max_steps))
        yield
        if starts is None and search.best.result.name in ("successful", "max_steps_reached"):
            break

    if not (search.best.has_ended and np.any(search.is_profiled)):
        return
    centre, weakest, near = search.centre.point.free, search.weakest, search.resolution
    others = problem.holding(problem.held | (np.arange(len(centre)) == weakest))
    far = _DISTANCE * np.arange(1, _ON_A_SIDE - 1)
    for side in (-1, 1):
        free = centre
        for distance in (near, 2.5 * near, *far):
            free = free.copy()
            free[weakest] = centre[weakest] + side * distance
            fit = fit_from(others, free, min(max_steps, _PROFILE_STEPS))
            search.profile.insert(0 if side < 0 else len(search.profile), fit)
            free = fit.point.free
            yield

    for fit in _minima(search):
        if fit.point.loss < _WORTH * search.best.point.loss:
            bar.total += 1
            search.refits.append(fit_from(problem, fit.point.free, max_steps))
            yield


def num_fits(starts: int | None) -> int:
    """Return the number of fits of a search, if the first of several starts is enough."""
    return (starts or 1) + 2 * _ON_A_SIDE


def _least(found: list[Fit]) -> Fit:
    return min(found, key=lambda fit: fit.point.loss)


def _starts(problem: FitProblem, number: int) -> Values:
    moves = _FAR * np.random.default_rng(0).uniform(-1, 1, (number, len(problem.start)))
    moves[0] = 0
    return moves * (problem.is_log & ~problem.held)


def _minima(search: Search) -> list[Fit]:
    """Return the minima of the profile, beside its centre."""
    line = [*search.profile]
    line.insert(_ON_A_SIDE, search.centre)
    losses = np.array([np.inf, *(fit.point.loss for fit in line), np.inf])
    is_low = (losses[1:-1] <= losses[:-2]) & (losses[1:-1] <= losses[2:])
    return [fit for fit, low in zip(line, is_low, strict=True) if low and fit is not search.centre]

"""Nonlinear least squares by the method of Levenberg and Marquardt (J. SIAM 11, 431, 1963)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxstab.core.accuracy import NEGLIGIBLE
from jaxstab.core.checks import parameter, require, require_finite
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike
from jaxstab.loads import Load

Values = Float[np.ndarray, " parameters"]
Chosen = Bool[np.ndarray, " parameters"]
Curve = Float[np.ndarray, " loads"]
Rows = Float[np.ndarray, "loads parameters"]

# Marquardt's damping: its start, and its factors after a successful and a failed step.
_DAMPING = 1e-2
_FALL = 0.1
_GROWTH = 5.0
# The default tolerance of a logarithm, over its standard error, which counts up to one; and
# the least one.
_PART_OF_ERROR = 1e-2
_FINEST = 1e-6
# The longest step in a logarithm, since slopes hold nearby only.
_LONGEST = 1.0
# Correlations of the misfit over so many loads count, if they exceed those of white noise so many
# times.
_LAGS = 3
_CHANCES = 3.0
# A positive parameter stays within this factor of its start.
FARTHEST = 1e3
_PRECISION = np.finfo(float)


@dataclass(frozen=True)
class Measured:
    """A measured curve: loads, mean pressures and their weights, zero for a missing value."""

    load: Load
    mean_pressure: Curve
    weights: Curve
    has_baseline: bool

    @classmethod
    def of(
        cls,
        load: Load,
        given: ArrayLike | None,
        weights: ArrayLike | None,
        area: float,
        has_baseline: bool,
    ) -> "Measured":
        """Return checked measurements, forces over an area or pressures, without masked ones."""
        mask = None
        if isinstance(given, np.ma.MaskedArray):
            mask = np.ma.getmaskarray(given)
            given = given.filled(0)
        measured = np.asarray(parameter(given, "The measurements"))
        if load.value.ndim != 1 or measured.shape != load.value.shape:
            raise ValueError(
                f"There are loads of shape {load.value.shape} and measurements of shape "
                f"{measured.shape}: give as many of one as of the other, in one dimension."
            )
        require_finite("The measured curve", measured)
        w = np.ones_like(measured)
        if weights is not None:
            w = np.asarray(parameter(weights, "The weights"))
        if w.shape != measured.shape:
            raise ValueError(
                f"The weights have shape {w.shape}, the measurements {measured.shape}."
            )
        require("A weight", w, (w >= 0) & np.isfinite(w), "all must be finite and not negative.")
        if mask is not None:
            w = np.where(mask, 0, w)
        return cls(load, measured / area, w, has_baseline)

    @property
    def count(self) -> int:
        """The number of measurements that have a weight."""
        return int(np.sum(self.weights > 0))

    @property
    def deviation(self) -> Curve:
        """The measurements times the roots of their weights, less their mean for a baseline."""
        mean = np.sum(self.weights * self.mean_pressure) / np.sum(self.weights)
        return np.sqrt(self.weights) * (self.mean_pressure - self.has_baseline * mean)

    @property
    def roots(self) -> Curve:
        """Roots of the weights, scaled such that the zero curve has a loss of 1/2."""
        return np.sqrt(self.weights) / np.linalg.norm(self.deviation)


class Evaluation(NamedTuple):
    """The misfit and its Jacobian at a value of the variables."""

    free: Values
    mean_pressure: Curve
    misfit: Curve
    jacobian: Rows

    @property
    def loss(self) -> float:
        """Half the sum of squared misfits, infinite where a load has no equilibrium."""
        loss = float(np.sum(self.misfit**2) / 2)
        return loss if np.isfinite(loss) else np.inf


@dataclass(frozen=True)
class FitProblem:
    """The misfit between a curve and measurements.

    Variables are logarithms of the parameters that start positive, and the others themselves.

    Attributes:
        curve: the curve and its Jacobian as a function of the parameters.
        start: the parameters at the start.
        measured: the measurements.
        held: which variables are fixed.
        tolerance: the relative change of each parameter to reach; None for a part of its error.
    """

    curve: Callable[[Values], tuple[Curve, Rows]]
    start: Values
    measured: Measured
    held: Chosen
    tolerance: float | None

    def holding(self, held: Chosen) -> "FitProblem":
        """Return the problem with other variables fixed."""
        return replace(self, held=held)

    @property
    def is_log(self) -> Chosen:
        """Which variables are logarithms."""
        return self.start > 0

    def values(self, free: Values) -> Values:
        """Return the parameters."""
        grown = self.start * np.exp(np.where(self.is_log, free, 0))
        return np.where(self.is_log, grown, self.start + free)

    def slopes(self, free: Values) -> Values:
        """Return the derivatives of the parameters by the variables."""
        return np.where(self.is_log, self.values(free), 1)

    def at(self, free: Values) -> Evaluation:
        """Evaluate the curve.

        A load without a derivative, as beside an event of the contact, counts in the misfit but not
        in the direction of a step.
        """
        pressure, jacobian = self.curve(self.values(free))
        roots = self.measured.roots
        misfit = np.where(roots > 0, roots * (pressure - self.measured.mean_pressure), 0)
        rows = roots[:, None] * jacobian * self.slopes(free)
        has_slope = (roots > 0) & np.all(np.isfinite(rows), axis=1)
        return Evaluation(free, pressure, misfit, np.where(has_slope[:, None], rows, 0))

    def variance(self, point: Evaluation) -> float:
        """Return the variance of a measurement, |r|^2 / (n - p), n being the loads of weight.

        A misfit that is alike at loads beside each other, as the misfit of another law is, counts
        as fewer measurements: by 1 + 2 sum_k (1 - k / (K + 1)) rho_k, with its correlations rho_k
        (Newey & West, Econometrica 55, 703, 1987), where chance does not explain these.
        """
        count = self.measured.count
        lags = np.arange(1, _LAGS + 1)
        shares = 1 - lags / (_LAGS + 1)
        products = np.array([np.sum(point.misfit[k:] * point.misfit[:-k]) for k in lags])
        square = np.sum(point.misfit**2)
        raised = 2 * np.sum(shares * products) / max(square, _PRECISION.tiny)
        by_chance = 2 * np.sqrt(np.sum(shares**2) / count)
        factor = 1.0
        if raised > _CHANCES * by_chance:
            factor += raised
        return float(factor * square / max(count - np.sum(~self.held), 1))


class Directions(NamedTuple):
    """The steps from a point, and the errors that its slopes give.

    Attributes:
        newton: the step of Gauss and Newton.
        damped: the step of Levenberg and Marquardt.
        covariance: of the variables, infinite where the curve does not determine them.
        unit: makes changes relative: 1 for logarithms, otherwise the size of a column.
    """

    newton: Values
    damped: Values
    covariance: Float[np.ndarray, "parameters parameters"]
    unit: Values

    @property
    def errors(self) -> Values:
        """The standard errors of the variables."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def relative_errors(self) -> Values:
        """The standard errors, relative; zero where the curve does not depend on a variable."""
        return np.where(self.unit > 0, self.errors, 0) * self.unit


def directions(problem: FitProblem, point: Evaluation, damping: float = 0.0) -> Directions:
    """Return the steps from a point."""
    jacobian = np.where(problem.held, 0, point.jacobian)
    norms = np.linalg.norm(jacobian, axis=0)
    scale = np.where(norms > 0, norms, 1)
    left, sizes, axes = np.linalg.svd(jacobian / scale, full_matrices=False)
    is_there = sizes > _PRECISION.eps * len(point.misfit) * np.max(sizes)
    inverse = np.where(is_there, 1 / np.where(is_there, sizes, 1), 0)
    along = left.T @ point.misfit
    damped = sizes / (sizes**2 + np.where(sizes > 0, damping, 1))
    spread = axes.T * inverse / scale[:, None]
    # A variable that the curve does not determine has an infinite error.
    unseen = 1 - np.sum(np.where(is_there[:, None], axes, 0) ** 2, axis=0)
    is_seen = unseen < NEGLIGIBLE["float64"]
    missing = np.where(is_seen | problem.held, 0, np.inf)
    covariance = problem.variance(point) * (spread @ spread.T)
    covariance[np.diag_indices_from(covariance)] += missing
    step = axes.T @ (damped * along) / scale
    longest = np.max(np.abs(np.where(problem.is_log, step, 0)))
    return Directions(
        newton=axes.T @ (inverse * along) / scale,
        damped=step * min(1, _LONGEST / max(longest, _LONGEST)),
        covariance=covariance,
        unit=np.where(problem.is_log, 1, norms),
    )


class Fit(NamedTuple):
    """The end of a fit.

    Attributes:
        first: the curve at its start.
        point: the best point.
        residual: the remaining Gauss-Newton step, relative to each parameter.
        num_steps: the steps taken.
        result: how it ended.
    """

    first: Curve
    point: Evaluation
    residual: float
    num_steps: int
    result: RESULTS

    @property
    def has_ended(self) -> bool:
        """Whether more steps cannot improve it."""
        return self.result.name in ("successful", "stagnated")


def minimise(problem: FitProblem, start: Values, max_steps: int) -> Fit:
    """Minimize the misfit until a Gauss-Newton step is small, or no step lowers the misfit.

    The least misfit of a curve that jumps as parameters change may lie at a jump; it is reached
    when no step longer than the tolerance lowers it.
    """
    point = problem.at(start)
    first = point.mean_pressure
    if not np.isfinite(point.loss):
        return Fit(first, point, np.inf, 0, RESULTS.nonfinite)
    damping = _DAMPING
    num_steps = 0
    while True:
        next_ = directions(problem, point, damping)
        goal = problem.tolerance
        if goal is None:
            goal = np.maximum(_PART_OF_ERROR * np.minimum(next_.relative_errors, 1), _FINEST)
        left = np.abs(next_.newton) * next_.unit
        if np.all(left <= goal):
            result = RESULTS.successful
            break
        if num_steps == max_steps:
            result = RESULTS.max_steps_reached
            break
        new = problem.at(point.free - next_.damped)
        num_steps += 1
        if new.loss <= point.loss:
            point = new
            damping *= _FALL
        elif np.all(np.abs(next_.damped) * next_.unit <= goal):
            result = RESULTS.stagnated
            break
        else:
            damping *= _GROWTH
    return Fit(first, point, float(np.max(left)), num_steps, result)

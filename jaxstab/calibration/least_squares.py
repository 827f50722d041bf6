"""Nonlinear least squares by the method of Levenberg and Marquardt (J. SIAM 11, 431, 1963)."""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxstab.core.accuracy import NEGLIGIBLE
from jaxstab.core.checks import parameter, require, require_finite
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Flag, Scalar
from jaxstab.loads import Load

Values = Float[Array, " parameters"]
Chosen = Bool[Array | np.ndarray, " parameters"]
Curve = Float[Array, " loads"]
Rows = Float[Array, "loads parameters"]

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


class Measured(eqx.Module):
    """A measured curve: loads, mean pressures and their weights, zero for a missing value."""

    load: Load
    mean_pressure: Curve
    weights: Curve
    has_baseline: bool = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        load: Load,
        given: ArrayLike | None,
        weights: ArrayLike | None,
        area: Scalar,
        has_baseline: bool,
    ) -> "Measured":
        """Return checked measurements, forces over an area or pressures, without masked ones."""
        mask = None
        if isinstance(given, np.ma.MaskedArray):
            mask = np.ma.getmaskarray(given)
            given = given.filled(0)
        measured = parameter(given, "The measurements")
        if load.value.ndim != 1 or measured.shape != load.value.shape:
            raise ValueError(
                f"There are loads of shape {load.value.shape} and measurements of shape "
                f"{measured.shape}: give as many of one as of the other, in one dimension."
            )
        require_finite("The measured curve", measured)
        w = jnp.ones_like(measured)
        if weights is not None:
            w = parameter(weights)
        if w.shape != measured.shape:
            raise ValueError(
                f"The weights have shape {w.shape}, the measurements {measured.shape}."
            )
        require("A weight", w, (w >= 0) & jnp.isfinite(w), "all must be finite and not negative.")
        if mask is not None:
            w = jnp.where(mask, 0, w)
        return cls(load, measured / area, w, has_baseline)

    @property
    def deviation(self) -> Curve:
        """The measurements times the roots of their weights, less their mean for a baseline."""
        mean = jnp.sum(self.weights * self.mean_pressure) / jnp.sum(self.weights)
        return jnp.sqrt(self.weights) * (self.mean_pressure - self.has_baseline * mean)

    @property
    def roots(self) -> Curve:
        """Roots of the weights, scaled such that the zero curve has a loss of 1/2."""
        return jnp.sqrt(self.weights) / jnp.linalg.norm(self.deviation)


class Evaluation(eqx.Module):
    """The misfit and its Jacobian at a value of the variables."""

    free: Values
    mean_pressure: Curve
    misfit: Curve
    jacobian: Rows

    @property
    def loss(self) -> Scalar:
        """Half the sum of squared misfits."""
        return jnp.sum(self.misfit**2) / 2


@dataclass(frozen=True)
class FitProblem:
    """The misfit between a curve and measurements.

    Variables are logarithms of the parameters that start positive, and the others themselves.

    Attributes:
        curve: the curve and its Jacobian as a function of the parameters.
        start: the parameters at the start.
        measured: the measurements.
        tolerance: the relative change of each parameter to reach; None for a part of its error.
    """

    curve: Callable[[Values], tuple[Curve, Rows]]
    start: Values
    measured: Measured
    tolerance: Scalar | None

    @property
    def is_log(self) -> Chosen:
        """Which variables are logarithms."""
        return self.start > 0

    def values(self, free: Values) -> Values:
        """Return the parameters."""
        grown = self.start * jnp.exp(jnp.where(self.is_log, free, 0))
        return jnp.where(self.is_log, grown, self.start + free)

    def slopes(self, free: Values) -> Values:
        """Return the derivatives of the parameters by the variables."""
        return jnp.where(self.is_log, self.values(free), 1)

    def at(self, free: Values) -> Evaluation:
        """Evaluate the curve.

        A load without an equilibrium makes the loss NaN. A load without a derivative, as beside an
        event of the contact, counts in the misfit but not in the direction of a step.
        """
        pressure, jacobian = self.curve(self.values(free))
        roots = self.measured.roots
        misfit = jnp.where(roots > 0, roots * (pressure - self.measured.mean_pressure), 0)
        rows = roots[:, None] * jacobian * self.slopes(free)
        has_slope = (roots > 0) & jnp.all(jnp.isfinite(rows), axis=1)
        return Evaluation(free, pressure, misfit, jnp.where(has_slope[:, None], rows, 0))

    def variance(self, point: Evaluation, held: Chosen) -> Scalar:
        """Return the variance of a measurement, |r|^2 / (n - p), n being the loads of weight.

        A misfit that is alike at loads beside each other, as the misfit of another law is, counts
        as fewer measurements: by 1 + 2 sum_k (1 - k / (K + 1)) rho_k, with its correlations rho_k
        (Newey & West, Econometrica 55, 703, 1987), where chance does not explain these.
        """
        count = jnp.sum(self.measured.weights > 0)
        lags = np.arange(1, _LAGS + 1)
        shares = 1 - lags / (_LAGS + 1)
        products = [jnp.sum(point.misfit[k:] * point.misfit[:-k]) for k in lags]
        square = jnp.maximum(2 * point.loss, jnp.finfo(float).tiny)
        raised = 2 * jnp.sum(shares * jnp.stack(products)) / square
        by_chance = 2 * jnp.sqrt(np.sum(shares**2) / jnp.maximum(count, 1))
        factor = 1 + jnp.where(raised > _CHANCES * by_chance, raised, 0)
        return factor * 2 * point.loss / jnp.maximum(count - jnp.sum(~held), 1)


class Directions(eqx.Module):
    """The steps from a point, and the errors that its slopes give.

    Attributes:
        newton: the step of Gauss and Newton.
        damped: the step of Levenberg and Marquardt.
        covariance: of the variables, infinite or NaN where the curve does not determine them.
        unit: makes changes relative: 1 for logarithms, otherwise the size of a column.
    """

    newton: Values
    damped: Values
    covariance: Float[Array, "parameters parameters"]
    unit: Values


def directions(
    problem: FitProblem, point: Evaluation, held: Chosen, damping: ArrayLike = 0.0
) -> Directions:
    """Return the steps from a point with some variables held."""
    jacobian = jnp.where(held, 0, point.jacobian)
    norms = jnp.linalg.norm(jacobian, axis=0)
    scale = jnp.where(norms > 0, norms, 1)
    left, sizes, axes = jnp.linalg.svd(jacobian / scale, full_matrices=False)
    is_there = sizes > jnp.finfo(sizes.dtype).eps * len(point.misfit) * jnp.max(sizes)
    inverse = jnp.where(is_there, 1 / jnp.where(is_there, sizes, 1), 0)
    along = left.T @ point.misfit
    damped = sizes / (sizes**2 + jnp.where(sizes > 0, damping, 1))
    spread = axes.T * inverse / scale[:, None]
    # A variable that the curve does not determine has an infinite error.
    unseen = 1 - jnp.sum(jnp.where(is_there[:, None], axes, 0) ** 2, axis=0)
    is_seen = unseen < NEGLIGIBLE[axes.dtype.name]
    missing = jnp.where(is_seen | held, 0, jnp.inf)
    covariance = problem.variance(point, held) * (spread @ spread.T) + jnp.diag(missing)
    step = axes.T @ (damped * along) / scale
    longest = jnp.max(jnp.abs(jnp.where(problem.is_log, step, 0)))
    return Directions(
        newton=axes.T @ (inverse * along) / scale,
        damped=step * jnp.minimum(1, _LONGEST / jnp.maximum(longest, _LONGEST)),
        covariance=covariance,
        unit=jnp.where(problem.is_log, 1, norms),
    )


class Fit(eqx.Module):
    """A fit as it goes: the curve at its start, the best point, and the next one to try.

    The residual is the remaining Gauss-Newton step, relative. Before the first point is evaluated
    the number of steps is -1.
    """

    first: Curve
    point: Evaluation
    tried: Values
    damping: Scalar
    residual: Scalar
    num_steps: Int[Array, ""]
    has_converged: Flag
    has_stalled: Flag

    @property
    def result(self) -> RESULTS:
        """How it ended."""
        result = RESULTS.where(self.has_stalled, RESULTS.stagnated, RESULTS.max_steps_reached)
        result = RESULTS.where(self.has_converged, RESULTS.successful, result)
        return RESULTS.where(jnp.isfinite(self.point.loss), result, RESULTS.nonfinite)


def minimise(problem: FitProblem, start: Values, held: Chosen, max_steps: ArrayLike) -> Fit:
    """Minimize the misfit until a Gauss-Newton step is small, or no step lowers the misfit.

    The least misfit of a curve that jumps as parameters change may lie at a jump; it is reached
    when no step longer than the tolerance lowers it. A `max_steps` of -1 evaluates nothing.
    """

    def goes_on(state: Fit) -> Flag:
        return (state.num_steps < max_steps) & ~(state.has_converged | state.has_stalled)

    def step(state: Fit) -> Fit:
        new = problem.at(state.tried)
        # A NaN is not lower.
        is_lower = (new.loss <= state.point.loss) | (state.num_steps < 0)
        point = jax.tree.map(lambda a, b: jnp.where(is_lower, a, b), new, state.point)
        damping = state.damping * jnp.where(is_lower, _FALL, _GROWTH)
        next_ = directions(problem, point, held, damping)
        goal = problem.tolerance
        if goal is None:
            errors = jnp.sqrt(jnp.diag(next_.covariance)) * next_.unit
            goal = jnp.maximum(_PART_OF_ERROR * jnp.minimum(errors, 1), _FINEST)
        left = jnp.abs(next_.newton) * next_.unit
        change = jnp.abs(state.tried - point.free) * next_.unit
        is_finite = jnp.isfinite(point.loss)
        return Fit(
            first=jnp.where(state.num_steps < 0, new.mean_pressure, state.first),
            point=point,
            tried=point.free - next_.damped,
            damping=damping,
            residual=jnp.where(is_finite, jnp.max(left), jnp.inf),
            num_steps=state.num_steps + 1,
            has_converged=is_finite & jnp.all(left <= goal),
            has_stalled=~is_lower & (jnp.all(change <= goal) | ~is_finite),
        )

    like = jax.eval_shape(problem.at, start)
    nothing = Evaluation(
        start,
        jnp.full(like.mean_pressure.shape, jnp.nan),
        jnp.full(like.misfit.shape, jnp.inf),
        jnp.zeros(like.jacobian.shape),
    )
    infinite = jnp.array(jnp.inf)
    no = jnp.array(False)
    damping = jnp.array(_DAMPING / _FALL)
    begin = Fit(nothing.mean_pressure, nothing, start, damping, infinite, jnp.array(-1), no, no)
    return jax.lax.while_loop(goes_on, step, begin)

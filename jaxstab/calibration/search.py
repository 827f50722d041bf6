"""The search for the least misfit: several starts, and a profile along the weakest parameter."""

from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.calibration.least_squares import (
    Chosen,
    Curve,
    Fit,
    FitProblem,
    Values,
    directions,
    minimise,
)
from jaxstab.core.control_flow import choose, zeros_of
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Scalar

MOST = 8
# Logarithms: a factor of two around the first start, and nearer to the best fit so far.
_FAR = 0.7
_NEAR = 0.2
_NEAREST = 0.02
# Fits agree on the least misfit within this fraction of it.
_AGREEMENT = 0.25
# Logarithms of the profile on each side, up to a factor of four. The nearest are at most so many
# standard errors away, since points that detach one by one make minima beside each other.
_DISTANCES = np.array([0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4])
_IN_ERRORS = np.array([1, 2.5, *[np.inf] * 7])
_SIGNS = np.repeat([-1, 1], len(_DISTANCES))
# A few steps are enough for the other parameters, which start from the profile's value before.
_PROFILE_STEPS = 4
# All parameters are fitted from a minimum of the profile below so many times the least loss.
_WORTH = 4.0
# Minima are distinct if a standard error apart, within these limits.
_SAME = 1e-3
_APART = 0.05
# Values of the profile up to so many standard errors away may raise the errors.
_MOST_ERRORS = 5.0


class Search(eqx.Module):
    """The fits so far: from starts, along the profile, and from minima of the profile.

    Attributes:
        guess: the curve at the first start.
        best: the fit of the least misfit.
        centre: the best of the starts, the centre of the profile.
        weakest: the index of the parameter with the largest relative error there.
        error: this error.
        free: the end of each fit.
        losses: the loss of each fit, infinite if there is none.
        results: how each fit ended.
        num_steps: the steps of all fits.
    """

    guess: Curve
    best: Fit
    centre: Values
    weakest: Int[Array, ""]
    error: Scalar
    free: Float[Array, "fits parameters"]
    losses: Float[Array, " fits"]
    results: RESULTS
    num_steps: Int[Array, ""]

    @property
    def num_starts(self) -> int:
        """The number of starts, whether they were needed or not."""
        return len(self.losses) - 2 * len(_SIGNS)

    @property
    def along(self) -> slice:
        """The slice of the fits along the profile."""
        return slice(self.num_starts, self.num_starts + len(_SIGNS))

    @property
    def is_apart(self) -> np.ndarray:
        """The mask of fits of all variables that do not start near the best fit so far."""
        numbers = np.arange(len(self.losses))
        return (numbers < _num_far(self.num_starts)) | (numbers >= self.along.stop)

    @property
    def result(self) -> RESULTS:
        """How the best fit ended.

        The least misfit of a curve with jumps may lie at a jump, where no method converges. It is
        accepted if two fits agree on it, and neither started at the other's end.
        """
        agreeing = self.is_apart & (self.losses <= (1 + _AGREEMENT) * self.best.point.loss)
        is_confirmed = (self.best.result == RESULTS.stagnated) & (jnp.sum(agreeing) > 1)
        return RESULTS.where(is_confirmed, RESULTS.successful, self.best.result)

    @property
    def num_minima(self) -> Int[Array, ""]:
        """The number of minima of the misfit, distinct in the weakest parameter."""
        has_ended = (self.results == RESULTS.successful) | (self.results == RESULTS.stagnated)
        has_ended = has_ended.at[self.along].set(False)
        at = jnp.sort(jnp.where(has_ended, self.free[:, self.weakest], jnp.inf))
        is_apart = at[1:] - at[:-1] > jnp.clip(self.error, _SAME, _APART)
        return jnp.sum(is_apart & jnp.isfinite(at[1:])) + jnp.isfinite(at[0])

    def errors(self, problem: FitProblem, held: Chosen, errors: Values) -> Values:
        """Return standard errors of the parameters, raised to the errors of the profile.

        A parabola's error is the distance over the root of twice the rise, in variances.
        """
        variance = problem.variance(self.best.point, held)
        rise = jnp.maximum(2 * (self.losses[self.along] - self.best.point.loss) / variance, 1)
        values = jax.vmap(problem.values)(self.free[self.along])
        away = jnp.abs(values - problem.values(self.best.point.free)) / jnp.sqrt(rise)[:, None]
        away = jnp.where((rise < _MOST_ERRORS**2)[:, None], away, 0)
        return jnp.maximum(errors, jnp.max(away, axis=0))


@dataclass(frozen=True)
class Plan:
    """The fits to make: from several starts, then along the weakest parameter for lower minima.

    Half of the starts lie around zero, the others around the best fit so far; by default starts are
    added until one converges, up to `MOST`. The profile holds the weakest parameter at values
    around its fit, and fits the others. From each of its minima, all are fitted again.

    Attributes:
        problem: the misfit.
        held: which variables are fixed.
        is_profiled: which may be profiled.
        starts: the number of starts, or None.
        max_steps: of each fit.
    """

    problem: FitProblem
    held: Chosen
    is_profiled: Chosen
    starts: int | None
    max_steps: ArrayLike

    def begin(self) -> Search:
        """Return a search without a fit."""
        zero = jnp.zeros_like(self.problem.start)
        number = num_fits(self.starts)
        nothing = zeros_of(partial(minimise, self.problem, zero, self.held, 0))
        return Search(
            guess=nothing.first,
            best=nothing,
            centre=zero,
            weakest=jnp.zeros((), int),
            error=jnp.zeros(()),
            free=jnp.zeros((number, zero.size)),
            losses=jnp.full(number, jnp.inf),
            results=RESULTS(jnp.full(number, RESULTS.not_computed.code)),
            num_steps=jnp.array(0),
        )

    def attempt(self, number: Array | int, so_far: Search) -> Search:
        """Return the search after the fit of a number, which may not be needed."""
        problem = self.problem
        limit = so_far.num_starts
        number = jnp.asarray(number)
        is_start = number < limit
        is_refit = number >= so_far.along.stop
        is_along = ~is_start & ~is_refit
        place = jnp.clip(number - limit, 0) % len(_SIGNS)
        is_first = place % len(_DISTANCES) == 0
        near = jnp.where(number < _num_far(limit), 0, so_far.best.point.free)
        moves = _moves(limit, self.held.size) * (problem.is_log & ~self.held)
        begin = moves[jnp.minimum(number, limit - 1)] + near
        before = jnp.where(is_first, so_far.centre, so_far.free[number - 1])
        error = jnp.maximum(so_far.error, _SAME)
        reach = jnp.minimum(_DISTANCES, error * _IN_ERRORS)
        moved = so_far.centre[so_far.weakest] + (_SIGNS * jnp.tile(reach, 2))[place]
        before = before.at[so_far.weakest].set(moved)
        start = jnp.where(is_start, begin, before)
        start = jnp.where(is_refit, so_far.free[limit + place], start)
        ended = so_far.best.result
        has_ended = (ended == RESULTS.successful) | (ended == RESULTS.stagnated)
        needs_start = (number == 0) | (ended == RESULTS.stagnated) | (ended == RESULTS.nonfinite)
        needs_start |= self.starts is not None
        is_needed = jnp.where(is_start, needs_start, jnp.any(self.is_profiled) & has_ended)
        is_needed &= ~is_refit | _minima(so_far)[place]
        is_held = self.held | (is_along & (jnp.arange(self.held.size) == so_far.weakest))
        steps = jnp.where(is_along, jnp.minimum(self.max_steps, _PROFILE_STEPS), self.max_steps)
        end = minimise(problem, start, is_held, jnp.where(is_needed, steps, -1))
        loss = jnp.where(jnp.isfinite(end.point.loss), end.point.loss, jnp.inf)
        # A finite loss is lower than NaN.
        is_lower = (loss < jnp.inf) & ~(loss >= so_far.best.point.loss)
        is_better = (number == 0) | (~is_along & is_lower)
        best = choose(is_better, end, so_far.best)
        errors = jnp.sqrt(jnp.diag(directions(problem, best.point, self.held).covariance))
        weakest = jnp.argmax(jnp.where(self.is_profiled, errors, -1))
        result = RESULTS.where(is_needed, end.result, RESULTS.not_computed)
        return Search(
            guess=jnp.where(number == 0, end.first, so_far.guess),
            best=best,
            centre=jnp.where(is_start, best.point.free, so_far.centre),
            weakest=jnp.where(is_start, weakest, so_far.weakest),
            error=jnp.where(is_start, errors[weakest], so_far.error),
            free=so_far.free.at[number].set(end.point.free),
            losses=so_far.losses.at[number].set(loss),
            results=RESULTS(jnp.asarray(so_far.results.code).at[number].set(result.code)),
            num_steps=so_far.num_steps + jnp.maximum(end.num_steps, 0),
        )


def num_fits(starts: int | None) -> int:
    """Return the number of fits of a search, needed or not."""
    return (MOST if starts is None else starts) + 2 * len(_SIGNS)


def _moves(limit: int, count: int) -> Float[Array, "starts parameters"]:
    reaches = np.geomspace(_NEAR, _NEAREST, limit)
    reaches[: _num_far(limit)] = _FAR
    reaches[0] = 0
    return jnp.asarray(reaches[:, None] * np.random.default_rng(0).uniform(-1, 1, (limit, count)))


def _minima(so_far: Search) -> Array:
    """Return the mask of minima of the profile with a low enough loss."""
    order = np.argsort(np.append(_SIGNS * np.tile(_DISTANCES, 2), 0))
    losses = so_far.losses[so_far.along]
    at_centre = jnp.min(so_far.losses[: so_far.num_starts])
    sorted_ = jnp.append(losses, at_centre)[order]
    outer = jnp.concatenate([jnp.array([jnp.inf]), sorted_, jnp.array([jnp.inf])])
    is_low = (sorted_ <= outer[:-2]) & (sorted_ <= outer[2:])
    is_low &= sorted_ < _WORTH * so_far.best.point.loss
    return is_low[np.argsort(order)][:-1]


def _num_far(number: int) -> int:
    return number // 2 + 1

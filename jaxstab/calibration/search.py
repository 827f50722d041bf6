"""The search for the least misfit: several starts, and a profile along the weakest parameter."""

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

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
from jaxstab.core.accuracy import SIGNIFICANT
from jaxstab.core.control_flow import choose, zeros_of
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Flag, Scalar

MOST = 5
# The largest logarithm of the other starts over the first: a factor of two.
_FAR = 0.7
# Fits agree on the least misfit within this fraction of it.
_AGREEMENT = 0.25
# The places of the profile on a side: one and 2.5 standard errors away, then in steps of the
# logarithm to a factor of four, since points that detach one by one make minima beside each other.
_ON_A_SIDE = 9
_DISTANCE = 0.2
_IN_PROFILE = 2 * _ON_A_SIDE
# A few steps are enough for the other parameters, which start from the profile's value before.
_PROFILE_STEPS = 4
# All parameters are fitted from a minimum of the profile below so many times the least loss.
_WORTH = 4.0
# Minima are distinct if a standard error apart, within these limits.
_SAME = 1e-3
_APART = 0.05


class Fits(eqx.Module):
    """The ends of several fits.

    Attributes:
        free: the variables at the end of each.
        losses: the loss of each, infinite if there is none.
        results: how each ended.
    """

    free: Float[Array, "fits parameters"]
    losses: Float[Array, " fits"]
    results: RESULTS

    def __getitem__(self, index: slice) -> "Fits":
        return Fits(self.free[index], self.losses[index], self.results[index])

    def with_end(self, number: Array, end: Values, loss: Scalar, result: RESULTS) -> "Fits":
        """Return the fits with the end of one."""
        return Fits(
            self.free.at[number].set(end),
            self.losses.at[number].set(loss),
            RESULTS(jnp.asarray(self.results.code).at[number].set(result.code)),
        )


class Search(eqx.Module):
    """The fits so far: from starts, along the profile, and from minima of the profile.

    Attributes:
        guess: the curve at the first start.
        best: the fit of the least misfit.
        centre: the best of the starts, the centre of the profile.
        weakest: the index of the parameter with the largest relative error there.
        error: this error.
        fits: all fits, whether they were needed or not.
        num_steps: the steps of all fits.
    """

    guess: Curve
    best: Fit
    centre: Values
    weakest: Int[Array, ""]
    error: Scalar
    fits: Fits
    num_steps: Int[Array, ""]

    @property
    def num_starts(self) -> int:
        """The number of starts, whether they were needed or not."""
        return len(self.fits.losses) - 2 * _IN_PROFILE

    @property
    def starts(self) -> Fits:
        """The fits from starts."""
        return self.fits[: self.num_starts]

    @property
    def profile(self) -> Fits:
        """The fits along the profile, on each side from the centre outwards."""
        return self.fits[self.num_starts : -_IN_PROFILE]

    @property
    def refits(self) -> Fits:
        """The fits of all variables from minima of the profile, one for each of its fits."""
        return self.fits[-_IN_PROFILE:]

    @property
    def has_ended(self) -> Flag:
        """Whether the best fit cannot be improved by more steps."""
        return _has_ended(self.best.result)

    @property
    def result(self) -> RESULTS:
        """How the best fit ended.

        The least misfit of a curve with jumps may lie at a jump, where no method converges. It is
        accepted if two fits agree on it.
        """
        losses = jnp.concatenate([self.starts.losses, self.refits.losses])
        num_agreeing = jnp.sum(losses <= (1 + _AGREEMENT) * self.best.point.loss)
        is_confirmed = (self.best.result == RESULTS.stagnated) & (num_agreeing > 1)
        return RESULTS.where(is_confirmed, RESULTS.successful, self.best.result)

    @property
    def resolution(self) -> Scalar:
        """The difference in the weakest parameter from which minima are distinct."""
        return jnp.clip(self.error, _SAME, _APART)

    @property
    def num_minima(self) -> Int[Array, ""]:
        """The number of minima of the misfit, distinct in the weakest parameter."""

        def ends(fits: Fits) -> Array:
            return jnp.where(_has_ended(fits.results), fits.free[:, self.weakest], jnp.inf)

        at = jnp.sort(jnp.concatenate([ends(self.starts), ends(self.refits)]))
        is_apart = at[1:] - at[:-1] > self.resolution
        return jnp.sum(is_apart & jnp.isfinite(at[1:])) + jnp.isfinite(at[0])

    def errors(self, problem: FitProblem, held: Chosen, errors: Values) -> Values:
        """Return standard errors of the parameters, raised to the errors of the profile.

        A parabola's error is the distance over the root of twice the rise, in variances.
        """
        variance = problem.variance(self.best.point, held)
        rise = jnp.maximum(2 * (self.profile.losses - self.best.point.loss) / variance, 1)
        values = jax.vmap(problem.values)(self.profile.free)
        away = jnp.abs(values - problem.values(self.best.point.free)) / jnp.sqrt(rise)[:, None]
        away = jnp.where((rise < SIGNIFICANT**2)[:, None], away, 0)
        return jnp.maximum(errors, jnp.max(away, axis=0))


class Trial(NamedTuple):
    """A fit to make: where it starts, which variables it holds, its steps, and if it is needed."""

    start: Values
    held: Chosen
    max_steps: ArrayLike
    is_needed: Flag


@dataclass(frozen=True)
class Plan:
    """The fits to make, for the least misfit.

    1. Fit from several starts around zero; by default starts are added until one converges, up to
       `MOST`.
    2. Along a profile, hold the weakest parameter at values around its fit, and fit the others.
    3. From each minimum of the profile, fit all parameters again.

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
            fits=Fits(
                free=jnp.zeros((number, zero.size)),
                losses=jnp.full(number, jnp.inf),
                results=RESULTS(jnp.full(number, RESULTS.not_computed.code)),
            ),
            num_steps=jnp.array(0),
        )

    def attempt(self, number: Array | int, so_far: Search) -> Search:
        """Return the search after the fit of a number, which may not be needed."""
        phases = [self._from_start, self._along_profile, self._from_minimum]
        firsts = np.array([0, so_far.num_starts, so_far.num_starts + _IN_PROFILE])
        number = jnp.asarray(number)
        phase = jnp.sum(number >= firsts) - 1
        place = number - jnp.asarray(firsts)[phase]
        trial = jax.lax.switch(phase, phases, place, so_far)
        steps = jnp.where(trial.is_needed, trial.max_steps, -1)
        end = minimise(self.problem, trial.start, trial.held, steps)

        loss = jnp.where(jnp.isfinite(end.point.loss), end.point.loss, jnp.inf)
        result = RESULTS.where(trial.is_needed, end.result, RESULTS.not_computed)
        so_far = replace(
            so_far,
            guess=jnp.where(number == 0, end.first, so_far.guess),
            fits=so_far.fits.with_end(number, end.point.free, loss, result),
            num_steps=so_far.num_steps + jnp.maximum(end.num_steps, 0),
        )
        # A finite loss is lower than NaN.
        is_lower = (loss < jnp.inf) & ~(loss >= so_far.best.point.loss)
        fits_all = phase != phases.index(self._along_profile)
        best = choose((number == 0) | (fits_all & is_lower), end, so_far.best)
        so_far = replace(so_far, best=best)
        is_start = phase == phases.index(self._from_start)
        return choose(is_start, self._centred(so_far), so_far)

    def _from_start(self, place: Array, so_far: Search) -> Trial:
        """Return a fit from a start around zero."""
        count = so_far.num_starts
        moves = _moves(count, self.held.size) * (self.problem.is_log & ~self.held)
        ended = so_far.best.result
        is_needed = (place == 0) | (ended == RESULTS.stagnated) | (ended == RESULTS.nonfinite)
        is_needed |= self.starts is not None
        return Trial(moves[place], self.held, self.max_steps, is_needed)

    def _along_profile(self, place: Array, so_far: Search) -> Trial:
        """Return a fit of the other variables, from the fit beside it, nearer to the centre."""
        near = so_far.resolution
        reach = jnp.concatenate(
            [jnp.stack([near, 2.5 * near]), _DISTANCE * jnp.arange(1, _ON_A_SIDE - 1)]
        )
        offset = jnp.concatenate([-reach, reach])[place]
        is_nearest = (place == 0) | (place == _ON_A_SIDE)
        start = jnp.where(is_nearest, so_far.centre, so_far.profile.free[place - 1])
        start = start.at[so_far.weakest].set(so_far.centre[so_far.weakest] + offset)
        held = self.held | (jnp.arange(self.held.size) == so_far.weakest)
        steps = jnp.minimum(self.max_steps, _PROFILE_STEPS)
        return Trial(start, held, steps, jnp.any(self.is_profiled) & so_far.has_ended)

    def _from_minimum(self, place: Array, so_far: Search) -> Trial:
        """Return a fit from a place of the profile, needed if that is a minimum."""
        is_needed = jnp.any(self.is_profiled) & so_far.has_ended & _minima(so_far)[place]
        return Trial(so_far.profile.free[place], self.held, self.max_steps, is_needed)

    def _centred(self, so_far: Search) -> Search:
        """Return the search with the profile around the best fit."""
        point = so_far.best.point
        errors = jnp.sqrt(jnp.diag(directions(self.problem, point, self.held).covariance))
        weakest = jnp.argmax(jnp.where(self.is_profiled, errors, -1))
        return replace(so_far, centre=point.free, weakest=weakest, error=errors[weakest])


def num_fits(starts: int | None) -> int:
    """Return the number of fits of a search, needed or not."""
    return (starts or MOST) + 2 * _IN_PROFILE


def _has_ended(result: RESULTS) -> Flag:
    return (result == RESULTS.successful) | (result == RESULTS.stagnated)


def _moves(limit: int, count: int) -> Float[Array, "starts parameters"]:
    moves = _FAR * np.random.default_rng(0).uniform(-1, 1, (limit, count))
    moves[0] = 0
    return jnp.asarray(moves)


def _minima(so_far: Search) -> Array:
    """Return the mask of minima of the profile with a low enough loss."""
    left, right = so_far.profile.losses.reshape(2, _ON_A_SIDE)
    centre = jnp.min(so_far.starts.losses)
    infinite = jnp.array([jnp.inf])
    losses = jnp.concatenate([infinite, left[::-1], centre[None], right, infinite])
    inner = losses[1:-1]
    is_low = (inner <= losses[:-2]) & (inner <= losses[2:])
    is_low &= inner < _WORTH * so_far.best.point.loss
    return jnp.concatenate([is_low[:_ON_A_SIDE][::-1], is_low[_ON_A_SIDE + 1 :]])

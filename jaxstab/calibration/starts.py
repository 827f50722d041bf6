"""Several starts of a fit, of which the best one counts."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.calibration.least_squares import FitState, Values
from jaxstab.core.loop import Iteration
from jaxstab.core.results import RESULTS

MOST = 8
# Logarithms: a factor of two around the first start, and nearer to the best fit so far.
_FAR, _NEAR, _NEAREST = 0.7, 0.2, 0.02
# Fits agree on the least misfit up to this part of it.
_AGREEMENT = 0.25


class Attempts(eqx.Module):
    """The fits so far.

    Attributes:
        number: how many there are.
        best: the one of the least misfit.
        losses: the misfit of each, infinite where there is none.
        results: how each ended.
        num_steps: the steps of all.
    """

    number: Int[Array, ""]
    best: Iteration[FitState]
    losses: Float[Array, " starts"]
    results: RESULTS
    num_steps: Int[Array, ""]

    @property
    def result(self) -> RESULTS:
        """How the best fit ended.

        Where a curve jumps, the least misfit may be at a jump, where no method converges smoothly.
        It is found if two starts agree on it, and neither began at the other's end.
        """
        far = self.losses[: _num_far(len(self.losses))]
        agreeing = jnp.sum(far <= (1 + _AGREEMENT) * jnp.min(self.losses))
        is_confirmed = (self.best.result == RESULTS.stagnated) & (agreeing > 1)
        return RESULTS.where(is_confirmed, RESULTS.successful, self.best.result)


def best_of(
    fit: Callable[[Values], Iteration[FitState]], starts: int | None, at_first: Values
) -> Attempts:
    """Fit from several starts: half of them around a given one, then around the best so far.

    By default that is as many as it takes until one converges, up to `MOST`.
    """
    limit = MOST if starts is None else starts
    num_far = _num_far(limit)
    reaches = np.geomspace(_NEAR, _NEAREST, limit)
    reaches[:num_far] = _FAR
    reaches[0] = 0
    moves = reaches[:, None] * np.random.default_rng(0).uniform(-1, 1, (limit, at_first.size))
    moves = at_first + jnp.asarray(moves)

    def is_needed(tried: Attempts) -> Array:
        ended = tried.best.result
        has_failed = (ended == RESULTS.stagnated) | (ended == RESULTS.nonfinite)
        goes_on = True if starts is not None else (tried.number == 0) | has_failed
        return (tried.number < limit) & goes_on

    def attempt(tried: Attempts) -> Attempts:
        number = tried.number
        new = fit(moves[number] + jnp.where(number < num_far, 0, tried.best.state.free))
        loss = jnp.where(jnp.isfinite(new.state.loss), new.state.loss, jnp.inf)
        is_better = (number == 0) | (loss < jnp.min(tried.losses))
        return Attempts(
            number + 1,
            jax.tree.map(lambda new, old: jnp.where(is_better, new, old), new, tried.best),
            tried.losses.at[number].set(loss),
            jax.tree.map(lambda all, one: all.at[number].set(one), tried.results, new.result),
            tried.num_steps + new.num_steps,
        )

    like = jax.eval_shape(fit, at_first)
    nothing: Any = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like)
    code = RESULTS.not_computed.code
    zero = jnp.zeros_like(nothing.num_steps)
    none = Attempts(zero, nothing, jnp.full(limit, jnp.inf), RESULTS(jnp.full(limit, code)), zero)
    return jax.lax.while_loop(is_needed, attempt, none)


def _num_far(number: int) -> int:
    return number // 2 + 1

"""Checks of a step along a curve, by the values and rates at its ends.

On one smooth piece cubics interpolate between both ends. No gap and no reaction may become negative
there, and the load may turn once at most. Over several active-set changes each point must change
sides where the lines from both ends predict.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.branches.curve import Curve, Place
from jaxstab.branches.events import ActiveSetChanges
from jaxstab.core.accuracy import EQUILIBRIUM, rounding_of_numbers
from jaxstab.core.types import Field, Flag, Scalar

# One in so many points may change sides in a step.
_ONE_IN = 64
# The sum of the lines from both ends of a step to the place where a point changes sides, over the
# length of the step: one where the lines meet, and more where the point moves unevenly.
_LONGEST_LINES = 3
# Places between two ends where the cubics are looked at.
_BETWEEN = 16


def most_changes(size: int) -> int:
    """Return how many of so many points may change sides in a step."""
    return max(size // _ONE_IN, 1)


class Cubics(NamedTuple):
    """Two places of a curve, and the cubics between them over the distance along the first tangent.

    Attributes:
        old: the first place.
        new: the second.
        length: their distance along the tangent of the first.
        cosine: between both tangents.
    """

    old: Place
    new: Place
    length: Scalar
    cosine: Scalar

    def between(self, value: Array, rate: Array, end: Array, end_rate: Array) -> Array:
        """Return the values of a cubic at several places between, given values and rates."""
        part = jnp.arange(1, _BETWEEN) / _BETWEEN
        part = part.astype(self.length.dtype).reshape(-1, *[1] * value.ndim)
        rest = 1 - part
        rate = self.length * rate
        end_rate = self.length * end_rate / self.cosine
        first = rest**2 * ((1 + 2 * part) * value + part * rate)
        return first + part**2 * ((1 + 2 * rest) * end - rest * end_rate)


def stays_positive(
    curve: Curve,
    cubics: Cubics,
    changes: ActiveSetChanges,
    is_change: Flag,
    after: tuple[Field, Field],
    scale: Scalar,
) -> tuple[Flag, Scalar]:
    """Return whether gaps and reactions stay positive between two places, and up to where."""
    old = cubics.old
    new = cubics.new
    # Below zero by so little a gap or reaction counts as zero.
    slack = 10 * EQUILIBRIUM[scale.dtype.name] * scale
    # A core lets no gap close.
    least = jnp.where(curve.contact.has_core, 0, -jnp.inf)

    def both(gap: Field, net: Field) -> Field:
        """Return gaps of free points, as pressures, and reactions of others, or the rates of these.

        The free points are the same at both ends.
        """
        return jnp.where(old.is_free, curve.stiffness * gap, net)

    net, net_rate = after
    value = both(jnp.maximum(old.at.gap, least), changes.net)
    end = both(jnp.maximum(new.at.gap, least), net)
    rate = both(old.tangent.gap, changes.net_rate)
    end_rate = both(new.tangent.gap, net_rate)
    # The active-set change itself ends the step.
    ends = is_change & changes.tied
    between = jnp.where(ends | ~jnp.isfinite(value), 0, cubics.between(value, rate, end, end_rate))
    is_over = ~ends & (end < -slack)
    dips = ~is_over & (value > slack) & (jnp.min(between, 0) < -slack)
    share = jnp.where(is_over, value / jnp.where(is_over, value - end, 1), 1)
    # A value at zero that is below at the end was above between, or only just below.
    share = jnp.where(is_over & (value <= slack), 0.5, share)
    share = jnp.where(dips, 0.5, share)
    return ~jnp.any(is_over | dips), jnp.min(share)


def turns_as_predicted(curve: Curve, cubics: Cubics) -> Flag:
    """Return whether the load turns between two places no more often than its rates say."""
    old = cubics.old
    new = cubics.new
    value = curve.value(old.at)
    end = curve.value(new.at)
    rate = curve.rate(old.tangent)
    end_rate = curve.rate(new.tangent)
    between = cubics.between(jnp.zeros_like(value), rate, end - value, end_rate)
    steps = jnp.diff(jnp.concatenate([jnp.zeros((1,)), between, (end - value)[None]]))
    # Rounding of the load hides smaller steps.
    noise = rounding_of_numbers(value.dtype) * (jnp.abs(value) + jnp.abs(end))
    signs = jnp.concatenate(
        [rate[None], jnp.where(jnp.abs(steps) > noise, steps, 0), end_rate[None]]
    )
    forth = signs * rate > 0
    back = signs * rate < 0
    # Once it goes back it does not go forth again.
    went_back = jnp.cumsum(back) > 0
    return ~jnp.any(went_back & forth) & (jnp.any(back) == (rate * end_rate < 0))


def changes_as_predicted(
    cubics: Cubics, changes: ActiveSetChanges, after: tuple[Field, Field]
) -> Flag:
    """Return whether each point that changed sides did so as the lines from both ends predict."""
    new = cubics.new
    flipped = cubics.old.is_free != cubics.new.is_free
    net, net_rate = after
    value = jnp.where(new.is_free, new.at.gap, net)
    rate = jnp.where(new.is_free, new.tangent.gap, net_rate)
    behind = jnp.where(rate > 0, value / jnp.where(rate > 0, rate, 1), jnp.inf)
    is_predicted = changes.distances + behind <= _LONGEST_LINES * cubics.length
    most = most_changes(net.size)
    return jnp.all(jnp.where(flipped, is_predicted, True)) & (jnp.sum(flipped) <= 2 * most)

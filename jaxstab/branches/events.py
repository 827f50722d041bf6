"""Events along a curve of equilibria, and the active-set change ahead of one of its points.

The curve is smooth as long as the free points stay the same. At a fold its load turns back on such
a piece. At an active-set change a contact point loses its reaction (release) or a free point its
gap (touch).
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.corrector import (
    Condition,
    CorrectorProblem,
    Undirected,
    at_change,
    correct,
    on_plane,
    place_of,
)
from jaxstab.branches.curve import BorderedVector, Curve, Place
from jaxstab.core.accuracy import EQUILIBRIUM, EXACT, NEGLIGIBLE
from jaxstab.core.checks import array
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose, cond, first_good, while_loop
from jaxstab.core.types import Field, Flag, Mask, Scalar

_MAX_SECANTS = 40


class ActiveSetChanges(eqx.Module):
    """The active-set changes ahead of a place, to first order.

    Attributes:
        net: K u + p0 + f'(g) [pressure].
        net_rate: how it changes along the tangent.
        distances: how far ahead each point changes sides [length].
        first: the least of them.
        point: the point that is the first.
        tied: the points that change sides with it.
    """

    net: Field
    net_rate: Field
    distances: Field
    first: Scalar
    point: Mask
    tied: Mask


def changes_ahead(curve: Curve, place: Place, shortest: Scalar) -> ActiveSetChanges:
    """Return the active-set changes ahead of a place; changes within the shortest distance tie."""
    at = place.at
    tangent = place.tangent
    is_free = place.is_free
    forces = curve.forces(at, is_free)
    rate = curve.net_rate(forces.curvature, tangent)
    # No gap over a core ever closes.
    closes = is_free & (tangent.gap < 0) & ~jnp.asarray(curve.contact.has_core)
    opens = ~is_free & (rate < 0)
    gap = jnp.maximum(at.gap, 0)
    net = jnp.maximum(forces.net, 0)
    distances = jnp.where(closes, gap / jnp.where(closes, -tangent.gap, 1), jnp.inf)
    distances = jnp.where(opens, net / jnp.where(opens, -rate, 1), distances)
    first = jnp.min(distances)
    places = jnp.arange(distances.size).reshape(distances.shape)
    point = places == jnp.argmin(distances)
    tied = distances <= first + shortest
    return ActiveSetChanges(forces.net, rate, distances, first, point, tied)


class Beyond(eqx.Module):
    """A place beyond an active-set change, or one without a change.

    Attributes:
        place: the place.
        goes_on: whether the points that change sides do so along its tangent.
        is_tied: whether several do.
        opened: positive on the points that are free there, of several before or behind.
    """

    place: Place
    goes_on: Flag
    is_tied: Flag
    opened: Field


def beyond_change(curve: Curve, place: Place, changes: ActiveSetChanges, opens: Flag) -> Beyond:
    """Return the place beyond an active-set change.

    All points whose gap or reaction vanishes there change sides, or the first alone.
    """

    def beyond(with_tied: Flag) -> Beyond:
        point, flips = _point_beyond(curve, place, changes, opens, with_tied)
        return _beyond(curve, place_of(curve, point), flips)

    return first_good(beyond, lambda found: found.goes_on, [array(True), array(False)])


def beyond_none(place: Place) -> Beyond:
    """Return a place on one smooth piece."""
    return Beyond(place, array(True), array(False), place.at.gap)


@program
def _point_beyond(
    curve: Curve, place: Place, changes: ActiveSetChanges, opens: Flag, with_tied: Flag
) -> tuple[Undirected, Mask]:
    """Return the point beyond an active-set change, and the points that change sides there."""
    # The first has a gap that grows, or a reaction.
    unit = at_change(curve, changes.point, ~opens, jnp.ones_like(place.at.pressure))
    forces = curve.forces(place.at, place.is_free)
    ahead = unit.gradient(curve, forces)
    # Others are near to it. Opened with a reaction left, a point would leave the curve.
    left = jnp.where(place.is_free, curve.contact.solid.max_stiffness * place.at.gap, forces.net)
    # States at events are found more closely.
    vanishes = left <= 10 * EXACT[left.dtype.name] * forces.scale
    flips = changes.point | (changes.tied & vanishes & with_tied)
    point = BorderedVector(jnp.where(flips, 0, place.at.gap), place.at.pressure)
    condition = at_change(curve, changes.point, opens, jnp.ones_like(place.at.pressure))
    return Undirected(point, place.is_free ^ flips, condition, ahead, place.tangent), flips


@program
def _beyond(curve: Curve, new: Place, flips: Mask) -> Beyond:
    rate = curve.net_rate(curve.contact.curvature(new.at.gap), new.tangent)
    # Released points open further along the tangent, others are pressed more.
    goes_on = jnp.where(new.is_free, new.tangent.gap, rate) > 0
    is_tied = jnp.sum(flips) > 1
    opened = jnp.where(is_tied & (new.is_free | flips), 1, new.at.gap)
    return Beyond(new, jnp.all(goes_on | ~flips), is_tied, opened)


class _Bracket(eqx.Module):
    """Two places between which the load turns.

    Attributes:
        low: the first.
        high: the second.
        distances: of both along the step [length].
        rates: of the load there; of a place that stays a second time half of it counts.
        is_low: whether the last place that was found is the first of the two.
        count: how many were found.
        goes_on: whether to look for another one.
        is_flat: whether the rate at the last vanishes.
    """

    low: Place
    high: Place
    distances: Array
    rates: Array
    is_low: Flag
    count: Int[Array, ""]
    goes_on: Flag
    is_flat: Flag

    @property
    def secant(self) -> Scalar:
        """The distance at which the line between both rates vanishes."""
        low, high = self.distances
        slow, fast = self.rates
        return low - slow * (high - low) / (fast - slow)


def fold_between(curve: Curve, old: Place, new: Place) -> tuple[Place, Flag]:
    """Return where the load turns between two places of one smooth piece (Illinois method).

    The direction there is the critical mode. And whether the rate of the load vanishes there.

    1. Look where the line between the rates of the load at both places vanishes.
    2. Correct the point of the cubic through both places there.
    3. Put it in the place of the one where the rate has the same sign.
    4. Repeat from 1 until the rate vanishes, or both places are close to each other.
    """
    dtype = old.at.gap.dtype.name

    def narrow(bracket: _Bracket) -> _Bracket:
        plane, start, direction = _on_cubic(curve, old, new, bracket)
        correction = CorrectorProblem(curve, plane, old.is_free)
        found = correct(
            correction, start, plane.row, direction, EXACT[dtype], EQUILIBRIUM[dtype]
        ).place
        return _shrink_bracket(curve, old, new, bracket, found)

    first = _first_bracket(curve, old, new)
    bracket = while_loop(lambda bracket: bracket.goes_on, narrow, first)
    return cond(bracket.is_low, lambda: bracket.low, lambda: bracket.high), bracket.is_flat


@program
def _first_bracket(curve: Curve, old: Place, new: Place) -> _Bracket:
    length = curve.gradient_of(old.tangent).times(new.at.minus(old.at))
    distances = jnp.stack([jnp.zeros_like(length), length])
    rates = jnp.stack([curve.rate(old.tangent), curve.rate(new.tangent)])
    yes = jnp.array(True)
    return _Bracket(old, new, distances, rates, yes, jnp.zeros((), int), yes, yes)


@program
def _on_cubic(
    curve: Curve, old: Place, new: Place, bracket: _Bracket
) -> tuple[Condition, BorderedVector, BorderedVector]:
    """Return the plane on which to look next, and the point and the direction to start from.

    The point is that of the cubic: with s between 0 and 1, g = g0 + s c + s (1 - s) ((1 - s) a -
    s b), where c is the change from one end to the other, and a and b those along both tangents
    less c.
    """
    distance = bracket.secant
    low, high = bracket.distances
    part = (distance - low) / (high - low)
    rest = 1 - part
    row = curve.gradient_of(old.tangent)
    slopes = [
        place.tangent.scale(1 / row.times(place.tangent)) for place in (bracket.low, bracket.high)
    ]
    change = bracket.high.at.minus(bracket.low.at)
    first, second = (slope.scale(high - low).minus(change) for slope in slopes)
    start = bracket.low.at.plus(change, part)
    start = start.plus(first, part * rest**2).plus(second, -(part**2) * rest)
    # That of the cubic would be a small difference of both ends.
    direction = slopes[0].scale(rest).plus(slopes[1], part)
    # The place along the step is needed no more closely than the fold, and in a short step it is
    # not known to more digits.
    dtype = distance.dtype.name
    length = row.times(new.at.minus(old.at))
    scale = EQUILIBRIUM[dtype] / EXACT[dtype] * jnp.abs(length)
    return on_plane(row, row.times(old.at) + distance, scale), start, direction


@program
def _shrink_bracket(
    curve: Curve, old: Place, new: Place, bracket: _Bracket, found: Place
) -> _Bracket:
    """Return the bracket of which the place found is one end."""
    length = curve.gradient_of(old.tangent).times(new.at.minus(old.at))
    first_rate = curve.rate(old.tangent)
    steepest = jnp.maximum(jnp.abs(first_rate), jnp.abs(curve.rate(new.tangent)))
    low, high = bracket.distances
    slow, fast = bracket.rates
    distance = bracket.secant
    rate = curve.rate(found.tangent)
    is_low = rate * first_rate > 0
    stays = jnp.where((bracket.count > 0) & (is_low == bracket.is_low), 0.5, 1)
    distances = jnp.where(is_low, jnp.stack([distance, high]), jnp.stack([low, distance]))
    rates = jnp.where(is_low, jnp.stack([rate, stays * fast]), jnp.stack([stays * slow, rate]))
    count = bracket.count + 1
    narrow_enough = EQUILIBRIUM[rate.dtype.name]
    is_wide = distances[1] - distances[0] > narrow_enough * jnp.abs(length)
    is_steep = jnp.abs(rate) > narrow_enough * steepest
    return _Bracket(
        low=choose(is_low, found, bracket.low),
        high=choose(is_low, bracket.high, found),
        distances=distances,
        rates=rates,
        is_low=is_low,
        count=count,
        goes_on=is_wide & is_steep & (count < _MAX_SECANTS),
        is_flat=jnp.abs(rate) < NEGLIGIBLE[rate.dtype.name] * steepest,
    )

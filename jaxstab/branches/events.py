"""Events along a curve of equilibria, and the active-set change ahead of one of its points.

The curve is smooth as long as the free points stay the same. At a fold its load turns back on such
a piece. At an active-set change a contact point loses its reaction (release) or a free point its
gap (touch).
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.corrector import (
    CLOSE,
    Condition,
    Correction,
    at_change,
    correct,
    direction_at,
    on_plane,
)
from jaxstab.branches.curve import Curve, Place, Point
from jaxstab.core.checks import array
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose, first_good, while_loop
from jaxstab.core.types import Field, Flag, Mask, Scalar

# Points tie that change sides within this part of the distance to the first of them.
_TIE = 1e-6
# A reaction below this counts as none at the event, over the size of the pressures: states there
# are found more closely.
_VANISHING = {"float64": 1e-11, "float32": 1e-5}
_MAX_SECANTS = 40
# How closely a fold is found, over the step that it lies in, and by what tangents.
_NARROW = {"float64": 1e-9, "float32": 1e-4}
_FINE = {"float64": 1e-10, "float32": 1e-4}
# How far the rate of the load may be from zero at a fold, over the larger one at the step's ends.
_FLAT = 1e-3


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
    tied = distances <= (1 + _TIE) * first + shortest
    return ActiveSetChanges(forces.net, rate, distances, first, point, tied)


class _Beyond(eqx.Module):
    """A place beyond an active-set change, but for its direction.

    Attributes:
        at: the point.
        is_free: its free points.
        flips: those that have changed sides.
        ahead: the gradient of a function that grows along the direction.
        condition: one that is met there.
    """

    at: Point
    is_free: Mask
    flips: Mask
    ahead: Point
    condition: Condition


def beyond_change(
    curve: Curve, place: Place, changes: ActiveSetChanges, opens: Flag
) -> tuple[Place, Flag]:
    """Return the place beyond an active-set change, and whether its points change sides there.

    All points whose gap or reaction vanishes there change sides, or the first alone.
    """

    def beyond(with_tied: Flag) -> tuple[Place, Flag]:
        new = _flipped(curve, place, changes, opens, with_tied)
        tangent = direction_at(curve, new.condition, new.at, new.is_free, new.ahead, place.tangent)
        return Place(new.at, new.is_free, tangent), _goes_on(curve, new, tangent)

    return first_good(beyond, lambda found: found[1], [array(True), array(False)])


@program
def _flipped(
    curve: Curve, place: Place, changes: ActiveSetChanges, opens: Flag, with_tied: Flag
) -> _Beyond:
    # The first has a gap that grows, or a reaction.
    unit = at_change(curve, changes.point, ~opens, jnp.ones_like(place.at.pressure))
    forces = curve.forces(place.at, place.is_free)
    ahead = unit.gradient(curve, forces)
    # Others are near to it. Opened with a reaction left, a point would leave the curve.
    left = jnp.where(place.is_free, curve.contact.solid.max_stiffness * place.at.gap, forces.net)
    vanishes = left <= _VANISHING[left.dtype.name] * forces.scale
    flips = changes.point | (changes.tied & vanishes & with_tied)
    point = Point(jnp.where(flips, 0, place.at.gap), place.at.pressure)
    condition = at_change(curve, changes.point, opens, jnp.ones_like(place.at.pressure))
    return _Beyond(point, place.is_free ^ flips, flips, ahead, condition)


@program
def _goes_on(curve: Curve, new: _Beyond, tangent: Point) -> Flag:
    rate = curve.net_rate(curve.contact.curvature(new.at.gap), tangent)
    # Released points open further along the tangent, others are pressed more.
    goes_on = jnp.where(new.is_free, tangent.gap, rate) > 0
    return jnp.all(goes_on | ~new.flips)


class _Bracket(eqx.Module):
    """Two distances ahead of a place between which the load turns, and its rates there.

    Attributes:
        ends: the distances [length].
        rates: of the load there; an end that stays a second time counts for half.
        row: the gradient of the distance.
        whole: the length of the step [length].
        steepest: the larger of the rates at its ends.
        place: the last that was looked at.
        rate: of the load there.
        is_low: whether it took the place of the nearer end.
        count: how many points were looked at.
        is_open: whether to look at another one.
        is_flat: whether the rate at the last vanishes.
    """

    ends: Array
    rates: Array
    row: Point
    whole: Scalar
    steepest: Scalar
    place: Place
    rate: Scalar
    is_low: Flag
    count: Int[Array, ""]
    is_open: Flag
    is_flat: Flag

    def looked_at(self) -> "_Bracket":
        """Return the bracket with flags that tell whether it is narrow enough."""
        narrow_enough = _NARROW[self.rate.dtype.name]
        is_wide = self.ends[1] - self.ends[0] > narrow_enough * jnp.abs(self.whole)
        is_steep = jnp.abs(self.rate) > narrow_enough * self.steepest
        is_open = is_wide & is_steep & (self.count < _MAX_SECANTS)
        return replace(self, is_open=is_open, is_flat=jnp.abs(self.rate) < _FLAT * self.steepest)


def fold_between(curve: Curve, old: Place, new: Place) -> tuple[Point, Flag]:
    """Return where the load turns between two places of one smooth piece (Illinois method).

    And whether its rate vanishes there.
    """
    dtype = old.at.gap.dtype.name

    def narrow(bracket: _Bracket) -> _Bracket:
        condition, start = _secant(old, bracket)
        correction = Correction(curve, condition, old.is_free)
        tangent = bracket.place.tangent
        found = correct(correction, start, bracket.row, tangent, CLOSE[dtype], _FINE[dtype])
        return _narrowed(curve, old, bracket, found.place)

    found = while_loop(lambda bracket: bracket.is_open, narrow, _bracket(curve, old, new))
    return found.place.at, found.is_flat


@program
def _bracket(curve: Curve, old: Place, new: Place) -> _Bracket:
    row = curve.gradient_of(old.tangent)
    whole = row.times(new.at.minus(old.at))
    rates = jnp.stack([curve.rate(old.tangent), curve.rate(new.tangent)])
    steepest = jnp.max(jnp.abs(rates))
    ends = jnp.stack([jnp.zeros_like(whole), whole])
    near = choose(jnp.abs(rates[0]) < jnp.abs(rates[1]), old, new)
    yes = jnp.array(True)
    none = jnp.array(0)
    first = _Bracket(ends, rates, row, whole, steepest, near, steepest, yes, none, yes, yes)
    return first.looked_at()


def _secant_length(bracket: _Bracket) -> Scalar:
    low, high = bracket.ends
    slow, fast = bracket.rates
    return low - slow * (high - low) / (fast - slow)


@program
def _secant(old: Place, bracket: _Bracket) -> tuple[Condition, Point]:
    """Return the plane on which to look next, and where to start there."""
    length = _secant_length(bracket)
    row = bracket.row
    at = bracket.place.at
    tangent = bracket.place.tangent
    missing = length - row.times(at.minus(old.at))
    start = at.plus(tangent, missing / row.times(tangent))
    return on_plane(row, row.times(old.at) + length, jnp.abs(bracket.whole)), start


@program
def _narrowed(curve: Curve, old: Place, bracket: _Bracket, place: Place) -> _Bracket:
    """Return the bracket with a place that was found in it as one of its ends."""
    low, high = bracket.ends
    slow, fast = bracket.rates
    length = _secant_length(bracket)
    rate = curve.rate(place.tangent)
    is_low = rate * curve.rate(old.tangent) > 0
    stays = jnp.where((bracket.count > 0) & (is_low == bracket.is_low), 0.5, 1)
    ends = jnp.where(is_low, jnp.stack([length, high]), jnp.stack([low, length]))
    rates = jnp.where(is_low, jnp.stack([rate, stays * fast]), jnp.stack([stays * slow, rate]))
    found = replace(bracket, ends=ends, rates=rates, place=place, rate=rate, is_low=is_low)
    return replace(found, count=bracket.count + 1).looked_at()

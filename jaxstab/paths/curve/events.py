"""Events along a curve of equilibria, and the active-set change ahead of one of its points.

The curve is smooth as long as the free points stay the same. At a fold its load turns back on such
a piece. At an active-set change a contact point loses its reaction (release) or a free point its
gap (touch).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.core.control_flow import choose, first_good
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.paths.curve.corrector import CLOSE, Correction, at_change, correct, on_plane
from jaxstab.paths.curve.curve import Curve, Place, Point

# Points tie that change sides within this part of the distance to the first of them.
_TIE = 1e-6
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
    at, tangent, is_free = place.at, place.tangent, place.is_free
    forces = curve.forces(at, is_free)
    rate = curve.net_rate(forces.curvature, tangent)
    # No gap over a core ever closes.
    closes = is_free & (tangent.gap < 0) & ~jnp.asarray(curve.contact.has_core)
    opens = ~is_free & (rate < 0)
    gap, net = jnp.maximum(at.gap, 0), jnp.maximum(forces.net, 0)
    distances = jnp.where(closes, gap / jnp.where(closes, -tangent.gap, 1), jnp.inf)
    distances = jnp.where(opens, net / jnp.where(opens, -rate, 1), distances)
    first = jnp.min(distances)
    places = jnp.arange(distances.size).reshape(distances.shape)
    point = places == jnp.argmin(distances)
    tied = distances <= (1 + _TIE) * first + shortest
    return ActiveSetChanges(forces.net, rate, distances, first, point, tied)


def beyond_change(
    curve: Curve, at: Place, changes: ActiveSetChanges, opens: Flag
) -> tuple[Place, Flag]:
    """Return the place beyond an active-set change, and whether its points change sides there.

    All points that tie change sides, or the first alone.
    """

    # The first has a gap that grows, or a reaction.
    unit = at_change(curve, changes.point, ~opens, jnp.ones_like(at.at.pressure))
    ahead = unit.gradient(curve, curve.forces(at.at, at.is_free))

    def beyond(number: Array) -> tuple[Place, Flag]:
        flips = jnp.where(number == 0, changes.tied, changes.point)
        is_free = at.is_free ^ flips
        point = Point(jnp.where(flips, 0, at.at.gap), at.at.pressure)
        place = Place(point, is_free, curve.tangent(point, is_free, ahead, at.tangent))
        rate = curve.net_rate(curve.contact.curvature(point.gap), place.tangent)
        # Released points open further along the tangent, others are pressed more.
        goes_on = jnp.where(is_free, place.tangent.gap, rate) > 0
        return place, jnp.all(goes_on | ~flips)

    return first_good(beyond, lambda found: found[1], 2)


class _Bracket(eqx.Module):
    """Two distances ahead of a place between which the load turns, and its rates there.

    Attributes:
        place: the last that was looked at.
        rate: of the load there.
        is_low: whether it took the place of the nearer end.
        count: how many points were looked at.
    """

    ends: Array
    rates: Array
    place: Place
    rate: Scalar
    is_low: Flag
    count: Array


def fold_between(curve: Curve, old: Place, new: Place) -> tuple[Point, Flag]:
    """Return where the load turns between two places of one smooth piece (Illinois method).

    And whether its rate vanishes there.
    """
    row = curve.gradient_of(old.tangent)
    whole = row.times(new.at.minus(old.at))
    dtype = whole.dtype.name
    narrow_enough, fine = _NARROW[dtype], _FINE[dtype]

    def goes_on(bracket: _Bracket) -> Flag:
        is_wide = bracket.ends[1] - bracket.ends[0] > narrow_enough * jnp.abs(whole)
        is_steep = jnp.abs(bracket.rate) > narrow_enough * steepest
        return is_wide & is_steep & (bracket.count < _MAX_SECANTS)

    def narrow(bracket: _Bracket) -> _Bracket:
        (low, high), (slow, fast) = bracket.ends, bracket.rates
        length = low - slow * (high - low) / (fast - slow)
        at, tangent = bracket.place.at, bracket.place.tangent
        missing = length - row.times(at.minus(old.at))
        start = at.plus(tangent, missing / row.times(tangent))
        plane = on_plane(row, row.times(old.at) + length, jnp.abs(whole))
        correction = Correction(curve, plane, old.is_free)
        place = correct(correction, start, row, tangent, CLOSE[dtype], fine).place
        rate = curve.rate(place.tangent)
        is_low = rate * rates[0] > 0
        # An end that stays a second time counts for half.
        stays = jnp.where((bracket.count > 0) & (is_low == bracket.is_low), 0.5, 1)
        ends = jnp.where(is_low, jnp.stack([length, high]), jnp.stack([low, length]))
        halved = jnp.where(is_low, jnp.stack([rate, stays * fast]), jnp.stack([stays * slow, rate]))
        return _Bracket(ends, halved, place, rate, is_low, bracket.count + 1)

    rates = jnp.stack([curve.rate(old.tangent), curve.rate(new.tangent)])
    steepest = jnp.max(jnp.abs(rates))
    ends = jnp.stack([jnp.zeros_like(whole), whole])
    near = choose(jnp.abs(rates[0]) < jnp.abs(rates[1]), old, new)
    first = _Bracket(ends, rates, near, steepest, jnp.array(True), jnp.array(0))
    found = jax.lax.while_loop(goes_on, narrow, first)
    return found.place.at, jnp.abs(found.rate) < _FLAT * steepest

"""A step along the curve of equilibria: to the next state, to a corner, or to a turning point.

Pseudo-arclength (Keller 1977): the next state lies on the plane across the tangent at a distance
ahead. Steps go over corners where the curve hardly bends. Where it does, they are cut until one
corner is left ahead, which is then taken exactly: the point that touches or lets go there, and the
tangent of the piece behind it, along which that point moves on.
"""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.core.conditional import first_good
from jaxstab.core.enumeration import Enumeration, member
from jaxstab.core.loop import Iteration
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.paths.branch.curve import (
    Corner,
    Curve,
    CurveNewton,
    CurveProblem,
    Iterate,
    Plane,
    Point,
)

# The least cosine between the tangents at both ends of a step, and that from which steps grow.
_LEAST_COSINE, _STRAIGHT = 0.9, 0.98
_GROWTH, _CUT = 1.5, 3
# How far from where it is predicted a state may be, over the step: farther ones were seen to lie on
# other parts of a branch.
_FARTHEST = 0.3
# Steps of Newton's method from which steps grow no more.
_EASY = 4
# What ties: points that touch or let go within this part of the way to the first of them.
_TIE = 1e-6
# The shortest step, over the longest.
_SHORTEST = {"float64": 1e-9, "float32": 1e-5}
_MAX_SECANTS = 40
# How closely a fold is found, over the step that it lies in, and by what tangents.
_CLOSE = {"float64": 1e-9, "float32": 1e-4}
_FINE = {"float64": 1e-7, "float32": 1e-4}


class TURNS(Enumeration):
    """Why the load turns back along a branch."""

    none = member("it does not turn")
    fold = member("an eigenvalue on the free points vanishes")
    release = member("a contact point lets go")
    touch = member("a free point touches")


class Place(eqx.Module):
    """A point of the curve, its free points, and the direction in which the branch goes on."""

    at: Point
    is_free: Mask
    tangent: Point


class Stride(eqx.Module):
    """What a step has led to.

    Attributes:
        here: the last state.
        length: of the step that is tried next [length].
        turn: the turning point passed on the way to it, if there is one.
        kind: of that.
        is_new: whether it is a new state; otherwise the step was cut.
        is_lost: whether steps have become too short.
    """

    here: Place
    length: Scalar
    turn: Point
    kind: TURNS
    is_new: Flag
    is_lost: Flag


class Way(eqx.Module):
    """A curve, the value of the load that ends a branch, and the longest step on it."""

    curve: Curve
    last: Scalar
    longest: Scalar

    def corrected(
        self, start: Point, condition: Plane | Corner, is_free: Mask | None = None
    ) -> Iteration[Iterate]:
        """Return what Newton's method finds from a start."""
        problem = CurveProblem(self.curve, condition, is_free)
        return CurveNewton().run(problem, start)

    def direction(self, place: Place) -> Scalar:
        """Return how the load goes on at a place, over the change of gap and pressure."""
        return self.curve.load_gradient.times(place.tangent)


def next_stride(way: Way, stride: Stride) -> Stride:
    """Return the state after the next step, or the same with a shorter one to try."""
    old, length = stride.here, stride.length
    found, is_good, num_steps, cosine = _plain_step(way, old, length)

    def accept() -> tuple[Place, Scalar, Flag]:
        is_easy = (num_steps <= _EASY) & (cosine > _STRAIGHT)
        longer = jnp.minimum(jnp.where(is_easy, _GROWTH * length, length), way.longest)
        return found, longer, jnp.array(True)

    def look_ahead() -> tuple[Place, Scalar, Flag]:
        return _corner_step(way, old, length)

    here, length, is_new = jax.lax.cond(is_good, accept, look_ahead)
    shortest = _SHORTEST[length.dtype.name] * way.longest
    new = replace(stride, here=here, length=length, is_new=is_new, is_lost=length < shortest)
    return jax.lax.cond(is_new, lambda: _concluded(way, old, new), lambda: new)


def _plain_step(way: Way, old: Place, length: Scalar) -> tuple[Place, Flag, Array, Scalar]:
    """Return the place on the plane ahead, whether it is one, and how hard it was to find."""
    curve = way.curve
    predicted = old.at.plus(old.tangent, length)
    iteration = way.corrected(predicted, ahead_of(curve, old, length))
    at = iteration.state.at
    is_found = iteration.result == RESULTS.successful
    is_free = at.gap > 0
    tangent = jax.lax.cond(
        is_found,
        lambda: curve.tangent(at, is_free, curve.gradient_of(old.tangent)),
        lambda: old.tangent,
    )
    cosine = curve.cosine(tangent, old.tangent)
    is_near = curve.length(at.minus(predicted)) < _FARTHEST * length
    # Else it is beyond a corner where the curve turns back, and the tangent leads back to that.
    curvature = iteration.state.forces.curvature
    is_ahead = _follow(curve, curvature, tangent, is_free, is_free != old.is_free)
    found = Place(at, is_free, tangent)
    # A turn in a step over corners may be one of them: it is cut until that is taken exactly.
    turns = way.direction(old) * way.direction(found) < 0
    is_clear = ~turns | jnp.all(is_free == old.is_free)
    is_good = is_found & is_near & is_ahead & is_clear & (cosine > _LEAST_COSINE)
    return found, is_good, iteration.num_steps, cosine


def _follow(curve: Curve, curvature: Field, tangent: Point, is_free: Mask, flips: Mask) -> Flag:
    """Return whether points that let go open further along a tangent, or are pressed more."""
    moved = jnp.where(is_free, tangent.gap, curve.net_rate(curvature, tangent))
    return jnp.all(jnp.where(flips, moved > 0, True))


def ahead_of(curve: Curve, place: Place, length: Scalar) -> Plane:
    """Return the plane across the tangent of a place, at a distance from it."""
    row = curve.gradient_of(place.tangent)
    return Plane(row, row.times(place.at) + length, length)


def _corner_step(way: Way, old: Place, length: Scalar) -> tuple[Place, Scalar, Flag]:
    """Return the place at the corner ahead if it is the only one, or else a shorter step."""
    curve, at, tangent = way.curve, old.at, old.tangent
    forces = curve.forces(at)
    rate = curve.net_rate(forces.curvature, tangent)
    opens = ~old.is_free & (rate < 0)
    closes = old.is_free & (tangent.gap < 0)
    ways = jnp.where(closes, at.gap / jnp.where(closes, -tangent.gap, 1), jnp.inf)
    ways = jnp.where(opens, jnp.maximum(forces.net, 0) / jnp.where(opens, -rate, 1), ways)
    first = jnp.min(ways)
    point = (jnp.arange(ways.size) == jnp.argmin(ways)).reshape(ways.shape)
    tied = ways <= (1 + _TIE) * first + _SHORTEST[length.dtype.name] * way.longest
    is_alone = (first <= length) & (jnp.sum(ways <= length) <= jnp.sum(tied))

    def take(number: Array) -> tuple[Place, Flag]:
        return _beyond_corner(way, old, first, point, jnp.where(number == 0, tied, point))

    def shorten() -> tuple[Place, Flag]:
        return old, jnp.array(False)

    def turn() -> tuple[Place, Flag]:
        return first_good(take, lambda taken: taken[1])

    here, is_new = jax.lax.cond(is_alone, turn, shorten)
    shorter = jnp.where(is_new, length, length / _CUT)
    return jax.tree.map(partial(jnp.where, is_new), here, old), shorter, is_new


def _beyond_corner(
    way: Way, old: Place, length: Scalar, point: Mask, flips: Mask
) -> tuple[Place, Flag]:
    """Return the corner ahead, with the direction behind it, and whether all points follow it."""
    curve = way.curve
    opens = jnp.any(point & ~old.is_free)
    corner = Corner(point, opens)
    start = old.at.plus(old.tangent, length)
    iteration = way.corrected(start, corner, old.is_free)
    forces, at = iteration.state.forces, iteration.state.at
    at = replace(at, gap=jnp.where(flips, 0, at.gap))
    is_free = jnp.where(opens, old.is_free | flips, old.is_free & ~flips)
    # Behind it the point that let go has a gap that grows, that which touches a reaction.
    behind = Corner(point, ~opens).gradient(curve, at, forces)
    tangent = curve.tangent(at, is_free, behind)
    follows = _follow(curve, forces.curvature, tangent, is_free, flips)
    return Place(at, is_free, tangent), (iteration.result == RESULTS.successful) & follows


def _concluded(way: Way, old: Place, stride: Stride) -> Stride:
    """Return a stride with the turning point that it has passed."""
    new = stride.here
    turns = way.direction(old) * way.direction(new) < 0
    is_corner = jnp.any(new.is_free != old.is_free)

    def none() -> tuple[Point, TURNS]:
        return new.at, TURNS.none

    def at_corner() -> tuple[Point, TURNS]:
        opened = jnp.sum(new.is_free) > jnp.sum(old.is_free)
        return new.at, TURNS.where(opened, TURNS.release, TURNS.touch)

    def at_fold() -> tuple[Point, TURNS]:
        return _fold_between(way, old, new), TURNS.fold

    turn, kind = jax.lax.cond(
        turns,
        lambda: jax.lax.cond(is_corner, at_corner, at_fold),
        none,
    )
    return replace(stride, turn=turn, kind=kind)


class _Bracket(eqx.Module):
    """Two distances ahead of a place between which the load turns, and its speeds there.

    Attributes:
        at: the last point that was looked at.
        is_low: whether it took the place of the nearer end.
    """

    ends: Array
    speeds: Array
    at: Point
    is_low: Flag
    count: Array


def _fold_between(way: Way, old: Place, new: Place) -> Point:
    """Return where the load turns between two places of equal free points (Illinois method)."""
    curve = way.curve
    row = curve.gradient_of(old.tangent)
    whole = row.times(new.at.minus(old.at))
    close, fine = _CLOSE[whole.dtype.name], _FINE[whole.dtype.name]

    def goes_on(bracket: _Bracket) -> Flag:
        is_wide = bracket.ends[1] - bracket.ends[0] > close * jnp.abs(whole)
        is_steep = jnp.min(jnp.abs(bracket.speeds)) > close * jnp.max(jnp.abs(first.speeds))
        return is_wide & is_steep & (bracket.count < _MAX_SECANTS)

    def narrow(bracket: _Bracket) -> _Bracket:
        (low, high), (slow, fast) = bracket.ends, bracket.speeds
        length = low - slow * (high - low) / (fast - slow)
        start = old.at.plus(new.at.minus(old.at), length / whole)
        at = way.corrected(start, ahead_of(curve, old, length), old.is_free).state.at
        speed = curve.load_gradient.times(curve.tangent(at, old.is_free, row, fine))
        is_low = speed * first.speeds[0] > 0
        # An end that stays a second time counts for half.
        stays = jnp.where((bracket.count > 0) & (is_low == bracket.is_low), 0.5, 1)
        ends = jnp.where(is_low, jnp.stack([length, high]), jnp.stack([low, length]))
        speeds = jnp.where(
            is_low, jnp.stack([speed, stays * fast]), jnp.stack([stays * slow, speed])
        )
        return _Bracket(ends, speeds, at, is_low, bracket.count + 1)

    ends = jnp.stack([jnp.zeros_like(whole), whole])
    speeds = jnp.stack([way.direction(old), way.direction(new)])
    first = _Bracket(ends, speeds, old.at, jnp.array(True), jnp.array(0))
    return jax.lax.while_loop(goes_on, narrow, first).at

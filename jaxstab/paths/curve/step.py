"""A step along the curve of equilibria that cannot cross to another one unseen.

Pseudo-arclength (Keller 1977): the next point lies on the plane across the tangent at a distance
ahead, or at the corner ahead if that is nearer. With the free points held, the curve between is
smooth. A step is accepted only if

- Newton's method converges fast, to near the prediction, and the tangents at both ends agree;
- the cubics through both ends, gap by gap and reaction by reaction, stay positive between them, and
  the cubic of the load turns no more often than the rates at the ends say;
- the number of negative eigenvalues changes as the events in the step say: by one at a fold, by one
  at a corner where the load turns, by none elsewhere.

On large grids a step may pass several corners at once, where the curve hardly bends.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact.hessian import Block
from jaxstab.core.control_flow import choose
from jaxstab.core.types import Flag, Scalar
from jaxstab.paths.curve.between import (
    Cubics,
    leaps_as_foreseen,
    most_changes,
    stays_positive,
    turns_as_said,
)
from jaxstab.paths.curve.corrector import CLOSE, TOLERANCE, Correction, at_corner, correct, on_plane
from jaxstab.paths.curve.curve import Place, Point, Way
from jaxstab.paths.curve.events import Corners, behind, corners_ahead, fold_between
from jaxstab.paths.curve.morse_index import MOST, UNKNOWN, driven_index_of, index_of
from jaxstab.paths.kinds import KINDS

# The least cosine between the tangents at both ends of a step, and that from which steps grow.
_LEAST_COSINE, _STRAIGHT = 0.95, 0.99
_GROWTH, _CUT, _TO_TURN = 1.5, 0.4, 0.9
# How far from where it is predicted a state may be, over the step: on one smooth piece, and over
# several corners.
_FARTHEST, _FARTHEST_LEAP = 0.1, 0.3
# Steps of Newton's method from which steps grow no more, and that a step may take at most.
_EASY, _HARD = 4, 8
# Steps shorter than this part of the longest may pass a bifurcation.
_ACROSS = 1e-3
# Corners so near the end of a step to the last load, over its length, are passed with it.
_AT_END = 1e-6
# Nearer corners than this part of the longest step are one.
_NEAREST = {"float64": 1e-8, "float32": 1e-5}


class Stride(eqx.Module):
    """The outcome of a step, and the next one to try.

    Attributes:
        here: the last state.
        length: of the step that is tried next [length].
        index: the number of negative eigenvalues there.
        expected: the number with which the branch goes on, `UNKNOWN` where it may be any.
        modes: the lowest modes there.
        turn: the turning point passed on the way to it, if there is one.
        kind: its kind.
        turns: whether there is one.
        lands: whether the next step is one to the last load.
        is_there: whether this one was.
        is_new: whether it is a new state; otherwise the step was cut.
        is_found: whether a state was found at all, of this branch or not.
    """

    here: Place
    length: Scalar
    index: Int[Array, ""]
    expected: Int[Array, ""]
    modes: Block
    turn: Point
    kind: KINDS
    turns: Flag
    lands: Flag
    is_there: Flag
    is_new: Flag
    is_found: Flag


class _Aim(NamedTuple):
    """The target of a step.

    Attributes:
        reach: how far ahead it leads [length].
        is_corner: whether to the first corner ahead.
        opens: whether a contact point lets go there.
        follows: whether the free points may change on the way.
    """

    reach: Scalar
    is_corner: Flag
    opens: Flag
    follows: Flag


class _Arrival(NamedTuple):
    """The point that a step has found.

    Attributes:
        place: the point with the free points that it was found with.
        is_found: whether it is one of some curve.
        is_sound: whether it is one of this curve, as far as the ends of the step tell.
        share: the part of the step to try next if this one is not taken.
        is_easy: whether the next step may be longer.
    """

    place: Place
    is_found: Flag
    is_sound: Flag
    share: Scalar
    is_easy: Flag


def next_stride(way: Way, stride: Stride) -> Stride:
    """Return the state after the next step, or the same with a shorter one to try."""
    curve, old = way.curve, stride.here
    shortest = _NEAREST[stride.length.dtype.name] * way.longest
    corners = corners_ahead(curve, old, shortest)
    aim = _aim(corners, old, stride.length, stride.lands)
    arrival = _arrival(way, stride, corners, aim)
    new = arrival.place
    turns = curve.rate(old.tangent) * curve.rate(new.tangent) < 0
    beyond = way.is_beyond(new.at) & ~(stride.lands & ~aim.is_corner)
    is_sound = arrival.is_sound & ~(turns & (aim.is_corner | stride.lands | beyond))
    accepted = jax.lax.cond(
        is_sound & ~beyond,
        lambda: _accepted(way, stride, corners, aim, new, turns),
        lambda: replace(stride, is_new=jnp.array(False)),
    )
    is_new = accepted.is_new
    longer = jnp.where(arrival.is_easy & ~aim.is_corner, _GROWTH * aim.reach, stride.length)
    longer = jnp.minimum(jnp.maximum(longer, stride.length), way.longest)
    # It ends at the load, or it is cut to where all gaps and reactions are positive, or cut.
    before, after = curve.value(old.at), curve.value(new.at)
    part = (way.last - before) / jnp.where(after == before, 1, after - before)
    lands = is_sound & beyond
    # Where the load has turned in a step that may not, up to about where it turns.
    before, after = curve.rate(old.tangent), curve.rate(new.tangent)
    to_turn = before / jnp.where(turns, before - after, 1)
    share = jnp.where(turns, jnp.clip(_TO_TURN * to_turn, _CUT, _TO_TURN), arrival.share)
    shorter = aim.reach * jnp.where(lands, part, share)
    return replace(
        accepted,
        length=jnp.where(is_new, longer, shorter),
        lands=lands,
        is_there=is_new & stride.lands & ~aim.is_corner,
        is_found=arrival.is_found,
    )


def _aim(corners: Corners, old: Place, length: Scalar, lands: Flag) -> _Aim:
    """Return the target of the next step: a distance, or the first corner before it.

    A step to the last load has no corner there as its target: it would be cut there without end.
    """
    most = most_changes(corners.net.size)
    number = jnp.sum(corners.distances <= jnp.where(lands, 1 - _AT_END, 1) * length)
    follows = (number > jnp.sum(corners.tied)) & (most > 1)
    if most > 1:
        length = jnp.minimum(length, jnp.sort(corners.distances.ravel())[most])
    is_corner = (number > 0) & ~follows
    opens = jnp.any(corners.point & ~old.is_free)
    return _Aim(jnp.where(is_corner, corners.first, length), is_corner, opens, follows)


def _arrival(way: Way, stride: Stride, corners: Corners, aim: _Aim) -> _Arrival:
    """Return the point that the corrector finds, and whether it lies on the same curve."""
    curve, old, reach = way.curve, stride.here, aim.reach
    row = curve.gradient_of(old.tangent)
    scale = jnp.maximum(reach, 1e-5 * way.longest)
    ahead = on_plane(row, row.times(old.at) + reach, scale)
    span = jnp.abs(way.last - way.first)
    end = on_plane(curve.load_gradient, way.last - curve.load_offset, span)
    condition = choose(stride.lands, end, ahead)
    corner = at_corner(curve, corners.point, aim.opens, way.longest)
    condition = choose(aim.is_corner, corner, condition)
    predicted = old.at.plus(old.tangent, reach)
    least = jnp.where(jnp.asarray(curve.contact.has_core), old.at.gap / 5, -jnp.inf)
    least = jnp.where(aim.follows, jnp.maximum(least, 0), least)
    start = Point(jnp.maximum(predicted.gap, least), predicted.pressure)
    problem = Correction(curve, condition, old.is_free, aim.follows)
    dtype = reach.dtype.name
    closely = jnp.where(aim.is_corner, CLOSE[dtype], TOLERANCE[dtype])
    found = correct(problem, start, row, old.tangent, closely)
    place, tangent = found.place, found.place.tangent
    length, cosine = row.times(place.at.minus(old.at)), curve.cosine(tangent, old.tangent)
    farthest = jnp.where(aim.follows, _FARTHEST_LEAP, _FARTHEST)
    is_near = curve.length(place.at.minus(predicted)) <= farthest * reach
    is_straight = (length > 0) & (cosine > _LEAST_COSINE) & (found.num_steps <= _HARD)
    pieces = Cubics(old, place, length, cosine)
    forces = found.forces
    after = forces.net, curve.net_rate(forces.curvature, tangent)
    leaps = leaps_as_foreseen(pieces, corners, after)
    smooth, share = stays_positive(curve, pieces, corners, aim.is_corner, after, forces.scale)
    # Where gaps or reactions alone are at fault, up to where they are positive.
    is_over = found.is_found & is_near & is_straight & ~aim.follows & (share < 1)
    share = jnp.where(is_over, jnp.maximum(0.9 * share, 0.1), _CUT)
    is_smooth = jnp.where(aim.follows, leaps, smooth & turns_as_said(curve, pieces))
    is_easy = (found.num_steps <= _EASY) & (cosine > _STRAIGHT)
    is_sound = found.is_found & is_near & is_straight & is_smooth
    return _Arrival(place, found.is_found, is_sound, share, is_easy)


def _accepted(
    way: Way, stride: Stride, corners: Corners, aim: _Aim, arrived: Place, turns: Flag
) -> Stride:
    """Return the state that a step has led to, if the events in it explain the changes."""
    curve, old = way.curve, stride.here
    gap = jnp.where(arrived.is_free, jnp.maximum(arrived.at.gap, 0), 0)
    gap = jnp.where(aim.is_corner & corners.point, 0, gap)
    arrived = replace(arrived, at=Point(gap, arrived.at.pressure))
    is_clear = ~(turns & jnp.any(arrived.is_free != old.is_free))

    def at_fold() -> tuple[Point, Flag]:
        return fold_between(curve, old, arrived)

    def behind_corner() -> tuple[Place, Flag]:
        return behind(curve, arrived, corners, aim.opens)

    turn, is_flat = jax.lax.cond(turns & is_clear, at_fold, lambda: (arrived.at, jnp.array(True)))
    new, goes_on = jax.lax.cond(aim.is_corner, behind_corner, lambda: (arrived, is_clear))
    gap = new.at.gap
    index, modes = index_of(
        curve.contact, curve.load, gap, stride.modes, counts_all=not way.to_limit
    )
    turns_back = curve.rate(arrived.tangent) * curve.rate(new.tangent) < 0
    # At a release the point that lets go has no part in it yet.
    touches = aim.is_corner & ~aim.opens
    change = jnp.where(turns, 1, jnp.where(touches & turns_back, -1, 0))
    flips = jnp.sum(new.is_free != arrived.is_free)
    # Points that tie, by symmetry, take modes with them that break it.
    agrees = (flips > 1) | _explains(way, stride, arrived, index, change, turns, touches)
    expected = index + (aim.is_corner & aim.opens & turns_back)
    expected = jnp.where((flips > 1) | (index >= MOST) | (index < 0), UNKNOWN, expected)
    kind = KINDS.where(aim.opens, KINDS.release, KINDS.touch)
    is_good = goes_on & is_flat & agrees & ~(turns & way.is_beyond(turn))
    taken = replace(
        stride,
        here=new,
        index=index,
        expected=expected,
        modes=modes,
        turn=turn,
        kind=KINDS.where(aim.is_corner, kind, KINDS.fold),
        turns=turns | turns_back,
        is_new=jnp.array(True),
    )
    return choose(is_good, taken, replace(stride, is_new=jnp.array(False)))


def _explains(
    way: Way,
    stride: Stride,
    arrived: Place,
    index: Int[Array, ""],
    change: Int[Array, ""],
    turns: Flag,
    touches: Flag,
) -> Flag:
    """Return whether the number of negative eigenvalues changes as it does in such a step.

    Modes that have no part in the branch, since they break a symmetry, may change as they like:
    there other branches cross it.
    """
    curve, old = way.curve, stride.here

    def is_as_said(before: Int[Array, ""], after: Int[Array, ""]) -> Flag:
        is_known = (before >= 0) & (after >= 0) & (after < MOST)
        found = jnp.where(turns, jnp.abs(after - before), after - before)
        return ~is_known | (found == change)

    def is_driven() -> Flag:
        def driven(place: Place) -> Int[Array, ""]:
            gap, tangent = place.at.gap, place.tangent.gap
            return driven_index_of(curve.contact, curve.load, gap, place.is_free, tangent)

        is_free = arrived.is_free & (~touches | (arrived.at.gap > 0))
        ends = old, replace(arrived, is_free=is_free)
        before, after = jax.lax.map(driven, jax.tree.map(lambda *pair: jnp.stack(pair), *ends))
        return (before >= 0) & (after >= 0) & is_as_said(before, after)

    agrees = is_as_said(stride.expected, index)
    if way.to_limit:
        # A bifurcation is a limit, however long the step.
        return agrees | ((stride.index == 0) & (index > 0) & ~turns)
    # The farther from a bifurcation, the less a mode that does break the branch off has part in it.
    is_short = stride.length <= _ACROSS * way.longest
    return jax.lax.cond(~agrees & is_short, is_driven, lambda: agrees)

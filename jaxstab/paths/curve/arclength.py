"""An arclength step along the curve of equilibria that cannot cross to another one unseen.

Pseudo-arclength (Keller 1977): the next point lies on the plane across the tangent at a distance
ahead, or at the active-set change ahead if that is nearer. With the free points held, the curve
between is smooth. A step is accepted only if

- Newton's method converges fast, to near the prediction, and the tangents at both ends agree;
- the cubics through both ends, gap by gap and reaction by reaction, stay positive between them, and
  the cubic of the load turns no more often than the rates at the ends say;
- the number of negative eigenvalues changes as the events in the step say: by one at a fold, by one
  at an active-set change where the load turns, by none elsewhere.

On large grids a step may pass several active-set changes at once, where the curve hardly bends.
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
from jaxstab.paths.curve.corrector import AT_STATES, CLOSE, Correction, at_change, correct, on_plane
from jaxstab.paths.curve.curve import ContinuationProblem, Place, Point
from jaxstab.paths.curve.events import ActiveSetChanges, beyond_change, changes_ahead, fold_between
from jaxstab.paths.curve.interpolation import (
    Cubics,
    changes_as_predicted,
    most_changes,
    stays_positive,
    turns_as_predicted,
)
from jaxstab.paths.curve.morse_index import MOST, UNKNOWN, driven_index_of, index_of
from jaxstab.paths.kinds import KINDS

# The least cosine between the tangents at both ends of a step, and that from which steps grow.
_LEAST_COSINE, _STRAIGHT = 0.95, 0.99
_GROWTH, _CUT, _TO_TURN = 1.5, 0.4, 0.9
# How far from its prediction a state may be, over the step: on a smooth piece, and over several.
_FARTHEST, _FARTHEST_LEAP = 0.1, 0.3
# Steps of Newton's method from which steps grow no more, and that a step may take at most.
_EASY, _HARD = 4, 8
# Steps shorter than this part of the longest may pass a bifurcation.
_ACROSS = 1e-3
# Active-set changes within this part of a step to the last load before its end are passed with it.
_AT_END = 1e-6
# Active-set changes nearer to each other than this part of the longest step are one.
_NEAREST = {"float64": 1e-8, "float32": 1e-5}


class ArclengthStep(eqx.Module):
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


class _Target(NamedTuple):
    """The target of a step.

    Attributes:
        reach: how far ahead it leads [length].
        is_change: whether to the first active-set change ahead.
        opens: whether a contact point is released there.
        follows: whether the free points may change on the way.
    """

    reach: Scalar
    is_change: Flag
    opens: Flag
    follows: Flag


class _Candidate(NamedTuple):
    """The point that the corrector has found.

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


def take_step(problem: ContinuationProblem, step: ArclengthStep) -> ArclengthStep:
    """Return the state after the next step, or the same with a shorter one to try."""
    curve, old = problem.curve, step.here
    changes = changes_ahead(curve, old, _NEAREST[step.length.dtype.name] * problem.max_step)
    target = _target_of(changes, old, step.length, step.lands)
    candidate = _candidate_of(problem, step, changes, target)
    new = candidate.place
    turns = curve.rate(old.tangent) * curve.rate(new.tangent) < 0
    beyond = problem.is_beyond(new.at) & ~(step.lands & ~target.is_change)
    is_sound = candidate.is_sound & ~(turns & (target.is_change | step.lands | beyond))
    accepted = jax.lax.cond(
        is_sound & ~beyond,
        lambda: _accepted(problem, step, changes, target, new, turns),
        lambda: replace(step, is_new=jnp.array(False)),
    )
    is_new = accepted.is_new
    longer = jnp.where(candidate.is_easy & ~target.is_change, _GROWTH * target.reach, step.length)
    longer = jnp.minimum(jnp.maximum(longer, step.length), problem.max_step)
    # It ends at the load, or it is cut to where all gaps and reactions are positive, or cut.
    before, after = curve.value(old.at), curve.value(new.at)
    part = (problem.last - before) / jnp.where(after == before, 1, after - before)
    lands = is_sound & beyond
    # Where the load has turned in a step that may not, up to about where it turns.
    before, after = curve.rate(old.tangent), curve.rate(new.tangent)
    to_turn = before / jnp.where(turns, before - after, 1)
    share = jnp.where(turns, jnp.clip(_TO_TURN * to_turn, _CUT, _TO_TURN), candidate.share)
    shorter = target.reach * jnp.where(lands, part, share)
    return replace(
        accepted,
        length=jnp.where(is_new, longer, shorter),
        lands=lands,
        is_there=is_new & step.lands & ~target.is_change,
        is_found=candidate.is_found,
    )


def _target_of(changes: ActiveSetChanges, old: Place, length: Scalar, lands: Flag) -> _Target:
    """Return the target of the next step: a distance, or the first active-set change before it.

    A step to the last load has no active-set change there as its target: it would be cut there
    without end.
    """
    most = most_changes(changes.net.size)
    number = jnp.sum(changes.distances <= jnp.where(lands, 1 - _AT_END, 1) * length)
    follows = (number > jnp.sum(changes.tied)) & (most > 1)
    if most > 1:
        length = jnp.minimum(length, jnp.sort(changes.distances.ravel())[most])
    is_change = (number > 0) & ~follows
    opens = jnp.any(changes.point & ~old.is_free)
    return _Target(jnp.where(is_change, changes.first, length), is_change, opens, follows)


def _candidate_of(
    problem: ContinuationProblem, step: ArclengthStep, changes: ActiveSetChanges, target: _Target
) -> _Candidate:
    """Return the point that the corrector finds, and whether it lies on the same curve."""
    curve, old, reach = problem.curve, step.here, target.reach
    row = curve.gradient_of(old.tangent)
    scale = jnp.maximum(reach, 1e-5 * problem.max_step)
    ahead = on_plane(row, row.times(old.at) + reach, scale)
    span = jnp.abs(problem.last - problem.first)
    end = on_plane(curve.load_gradient, problem.last - curve.load_offset, span)
    condition = choose(step.lands, end, ahead)
    event = at_change(curve, changes.point, target.opens, problem.max_step)
    condition = choose(target.is_change, event, condition)
    predicted = old.at.plus(old.tangent, reach)
    least = jnp.where(curve.contact.has_core, old.at.gap / 5, -jnp.inf)
    least = jnp.where(target.follows, jnp.maximum(least, 0), least)
    start = Point(jnp.maximum(predicted.gap, least), predicted.pressure)
    correction = Correction(curve, condition, old.is_free, target.follows)
    dtype = reach.dtype.name
    closely = jnp.where(target.is_change, CLOSE[dtype], AT_STATES[dtype])
    found = correct(correction, start, row, old.tangent, closely)
    place, tangent = found.place, found.place.tangent
    length, cosine = row.times(place.at.minus(old.at)), curve.cosine(tangent, old.tangent)
    farthest = jnp.where(target.follows, _FARTHEST_LEAP, _FARTHEST)
    is_near = curve.length(place.at.minus(predicted)) <= farthest * reach
    is_straight = (length > 0) & (cosine > _LEAST_COSINE) & (found.num_steps <= _HARD)
    cubics = Cubics(old, place, length, cosine)
    forces = found.forces
    after = forces.net, curve.net_rate(forces.curvature, tangent)
    leaps = changes_as_predicted(cubics, changes, after)
    smooth, share = stays_positive(curve, cubics, changes, target.is_change, after, forces.scale)
    # Where gaps or reactions alone are at fault, up to where they are positive.
    is_over = found.is_found & is_near & is_straight & ~target.follows & (share < 1)
    share = jnp.where(is_over, jnp.maximum(0.9 * share, 0.1), _CUT)
    is_smooth = jnp.where(target.follows, leaps, smooth & turns_as_predicted(curve, cubics))
    is_easy = (found.num_steps <= _EASY) & (cosine > _STRAIGHT)
    is_sound = found.is_found & is_near & is_straight & is_smooth
    return _Candidate(place, found.is_found, is_sound, share, is_easy)


def _accepted(
    problem: ContinuationProblem,
    step: ArclengthStep,
    changes: ActiveSetChanges,
    target: _Target,
    reached: Place,
    turns: Flag,
) -> ArclengthStep:
    """Return the state that a step has led to, if the events in it explain the changes."""
    curve, old = problem.curve, step.here
    gap = jnp.where(reached.is_free, jnp.maximum(reached.at.gap, 0), 0)
    gap = jnp.where(target.is_change & changes.point, 0, gap)
    reached = replace(reached, at=Point(gap, reached.at.pressure))
    is_clear = ~(turns & jnp.any(reached.is_free != old.is_free))

    def at_fold() -> tuple[Point, Flag]:
        return fold_between(curve, old, reached)

    def past_change() -> tuple[Place, Flag]:
        return beyond_change(curve, reached, changes, target.opens)

    turn, is_flat = jax.lax.cond(turns & is_clear, at_fold, lambda: (reached.at, jnp.array(True)))
    new, goes_on = jax.lax.cond(target.is_change, past_change, lambda: (reached, is_clear))
    index, modes = index_of(
        curve.contact, curve.load, new.at.gap, step.modes, counts_all=not problem.to_limit
    )
    turns_back = curve.rate(reached.tangent) * curve.rate(new.tangent) < 0
    # At a release the released point has no part in the index yet.
    touches = target.is_change & ~target.opens
    change = jnp.where(turns, 1, jnp.where(touches & turns_back, -1, 0))
    flips = jnp.sum(new.is_free != reached.is_free)
    # Points that tie, by symmetry, take modes with them that break it.
    agrees = (flips > 1) | _explains(problem, step, reached, index, change, turns, touches)
    expected = index + (target.is_change & target.opens & turns_back)
    expected = jnp.where((flips > 1) | (index >= MOST) | (index < 0), UNKNOWN, expected)
    kind = KINDS.where(target.opens, KINDS.release, KINDS.touch)
    is_good = goes_on & is_flat & agrees & ~(turns & problem.is_beyond(turn))
    taken = replace(
        step,
        here=new,
        index=index,
        expected=expected,
        modes=modes,
        turn=turn,
        kind=KINDS.where(target.is_change, kind, KINDS.fold),
        turns=turns | turns_back,
        is_new=jnp.array(True),
    )
    return choose(is_good, taken, replace(step, is_new=jnp.array(False)))


def _explains(
    problem: ContinuationProblem,
    step: ArclengthStep,
    reached: Place,
    index: Int[Array, ""],
    change: Int[Array, ""],
    turns: Flag,
    touches: Flag,
) -> Flag:
    """Return whether the number of negative eigenvalues changes as the events in a step require.

    Modes that have no part in the branch, since they break a symmetry, may change as they like:
    there other branches cross it.
    """
    curve, old = problem.curve, step.here

    def is_explained(before: Int[Array, ""], after: Int[Array, ""]) -> Flag:
        is_known = (before >= 0) & (after >= 0) & (after < MOST)
        found = jnp.where(turns, jnp.abs(after - before), after - before)
        return ~is_known | (found == change)

    def is_driven() -> Flag:
        def driven(place: Place) -> Int[Array, ""]:
            gap, tangent = place.at.gap, place.tangent.gap
            return driven_index_of(curve.contact, curve.load, gap, place.is_free, tangent)

        ends = old, replace(reached, is_free=reached.is_free & (~touches | (reached.at.gap > 0)))
        before, after = jax.lax.map(driven, jax.tree.map(lambda *pair: jnp.stack(pair), *ends))
        return (before >= 0) & (after >= 0) & is_explained(before, after)

    agrees = is_explained(step.expected, index)
    if problem.to_limit:
        # A bifurcation is a limit, however long the step.
        return agrees | ((step.index == 0) & (index > 0) & ~turns)
    # The farther from a bifurcation, the smaller the part of the mode that does belong to it.
    is_short = step.length <= _ACROSS * problem.max_step
    return jax.lax.cond(~agrees & is_short, is_driven, lambda: agrees)

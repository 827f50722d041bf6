"""An arclength step along the curve of equilibria that cannot cross to another one unseen.

Pseudo-arclength (Keller 1977): the next point lies on the plane across the tangent at a distance
ahead, or at the active-set change ahead if that is nearer. With the free points held, the curve
between is smooth. A step is accepted only if

- Newton's method converges fast, to near the prediction, and the tangents at both ends agree;
- the cubics through both ends, gap by gap and reaction by reaction, stay positive between them, and
  the cubic of the load turns no more often than the rates at the ends say;
- the number of negative eigenvalues changes as the events in the step say: by one at a fold, by one
  at an active-set change where the load turns, by none elsewhere, except where another branch
  crosses: there modes change sign that have no part in this one.

On large grids a step may pass several active-set changes at once, where the curve hardly bends.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.corrector import (
    AT_STATES,
    Condition,
    CorrectorOutcome,
    CorrectorProblem,
    at_change,
    correct,
    on_plane,
)
from jaxstab.branches.curve import BorderedVector, ContinuationProblem, Place
from jaxstab.branches.events import (
    ActiveSetChanges,
    Beyond,
    beyond_change,
    beyond_none,
    changes_ahead,
    fold_between,
)
from jaxstab.branches.interpolation import (
    Cubics,
    changes_as_predicted,
    most_changes,
    stays_positive,
    turns_as_predicted,
)
from jaxstab.branches.morse_index import (
    MOST,
    UNKNOWN,
    DrivenIndex,
    driven_index_of,
    index_of,
    no_modes,
)
from jaxstab.contact.hessian import Block
from jaxstab.core.accuracy import EQUILIBRIUM, EXACT, rounding_of_numbers
from jaxstab.core.checks import array, concrete
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose, cond
from jaxstab.core.grid import mean_over, total
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.states.kinds import KINDS

# The least cosine between the tangents at both ends of a step, and that from which steps grow.
_LEAST_COSINE = 0.95
_STRAIGHT = 0.99
_GROWTH = 1.5
_CUT = 0.4
# Where the corrector has found no point, the curve bends on a much smaller scale.
_CUT_IF_LOST = 0.1
_TO_TURN = 0.9
# How far from its prediction a state may be, over the step: on a smooth piece, and over several.
_FARTHEST = 0.1
_FARTHEST_LEAP = 0.3
# Steps shorter than this part of the longest may pass a bifurcation.
_ACROSS = 1e-3


class ArclengthStep(eqx.Module):
    """The outcome of a step, and the next one to try.

    Attributes:
        here: the last state.
        length: of the step that is tried next [length].
        index: the number of negative eigenvalues there.
        expected: the number with which the branch goes on, `UNKNOWN` where it may be any.
        modes: the lowest modes there.
        turn: the turning point or bifurcation passed on the way to it, if there is one.
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
    turn: "TurnInStep"
    lands: Flag
    is_there: Flag
    is_new: Flag
    is_found: Flag


class TurnInStep(eqx.Module):
    """A turning point or a bifurcation in a step.

    Attributes:
        is_there: whether there is one.
        at: the point.
        kind: its kind.
        mode: the direction of the branch there, or of another one that crosses it.
    """

    is_there: Flag
    at: BorderedVector
    kind: KINDS
    mode: Field


class _Target(eqx.Module):
    """The target of a step, and the problem of its corrector.

    Attributes:
        changes: the active-set changes ahead.
        reach: how far ahead it leads [length].
        is_change: whether to the first active-set change ahead.
        opens: whether a contact point is released there.
        follows: whether the free points may change on the way.
        predicted: the point on the tangent.
        start: the point where the corrector starts.
        row: the gradient of the distance along the tangent.
        condition: the condition that the corrector meets.
        close: the residual that it is to reach.
    """

    changes: ActiveSetChanges
    reach: Scalar
    is_change: Flag
    opens: Flag
    follows: Flag
    predicted: BorderedVector
    start: BorderedVector
    row: BorderedVector
    condition: Condition
    close: Scalar


class _Judgement(eqx.Module):
    """The point that the corrector has found, judged by the two ends of the step.

    Attributes:
        gap: its gap, without the corrector's error where it is taken [length].
        is_found: whether it is a point of some curve.
        is_taken: whether it is the next state, if the events in the step explain it.
        lands: whether it lies on this curve, but beyond the last load: the next step leads there.
        turns: whether the load turns in the step.
        share: the part of the step to try next if this one is not taken.
        is_easy: whether the next step may be longer.
    """

    gap: Field
    is_found: Flag
    is_taken: Flag
    lands: Flag
    turns: Flag
    share: Scalar
    is_easy: Flag


class _Events(eqx.Module):
    """The events in a step.

    Attributes:
        fold: the place where the load turns at a fold.
        is_flat: whether the rate of the load vanishes there.
        beyond: the place beyond the step.
        index: the number of negative eigenvalues there.
        modes: the lowest modes there.
        opened_index: the number with all points free that change sides together; without such
            points the same.
        opened_modes: the lowest modes with these.
    """

    fold: Place
    is_flat: Flag
    beyond: Beyond
    index: Int[Array, ""]
    modes: Block
    opened_index: Int[Array, ""]
    opened_modes: Block


class _Account(eqx.Module):
    """The account that the events in a step give of the Morse index behind it.

    Attributes:
        is_sound: whether the branch goes on behind them, and has not reached the last load before.
        agrees: whether they explain the index.
        is_open: whether they do not, but another branch that crosses may.
        index: the index at the place behind, `UNKNOWN` too where that of its change is.
        expected: the index with which the branch goes on, `UNKNOWN` where it may be any.
        turn: the turn at one of them, or the bifurcation.
    """

    is_sound: Flag
    agrees: Flag
    is_open: Flag
    index: Int[Array, ""]
    expected: Int[Array, ""]
    turn: TurnInStep


class _StepTrial(NamedTuple):
    """A step that is tried.

    Attributes:
        problem: the problem of the branch.
        step: the step before, from whose state this one begins.
        target: its target.
        judgement: of the point that the corrector has found.
        reached: the place there.
    """

    problem: ContinuationProblem
    step: ArclengthStep
    target: _Target
    judgement: _Judgement
    reached: Place


def take_step(problem: ContinuationProblem, step: ArclengthStep) -> ArclengthStep:
    """Return the state after the next step, or the same with a shorter one to try.

    1. Aim at a distance ahead, at an active-set change before it, or at the last load.
    2. Correct the point on the tangent, and judge it by the two ends of the step.
    3. If it is sound, locate the events in the step: the fold, the place beyond the active-set
       change, and the number of negative eigenvalues there.
    4. Take the step if the events explain that number, or if not, in a short step, if a mode does
       that has no part in the branch: there another branch crosses.
    5. Choose the length of the next step.
    """
    old = step.here
    target = _target_of(problem, step)
    correction = CorrectorProblem(problem.curve, target.condition, old.is_free, target.follows)
    found = correct(correction, target.start, target.row, old.tangent, target.close)
    judgement = _judged(problem, step, target, found)
    reached = replace(found.place, at=replace(found.place.at, gap=judgement.gap))
    trial = _StepTrial(problem, step, target, judgement, reached)
    refused = replace(step, is_new=array(False))

    def explained() -> ArclengthStep:
        events = _events_in(trial)
        account = _account_of(trial, events)
        turn = account.turn
        agrees = account.agrees
        # To a limit no branch leads across another one: a bifurcation is a limit.
        if not problem.to_limit:
            turn, agrees = cond(
                account.is_open,
                lambda: _crossing(trial, events, turn),
                lambda: (turn, account.agrees),
            )
        taken = replace(
            step,
            here=events.beyond.place,
            index=account.index,
            expected=account.expected,
            modes=events.modes,
            turn=turn,
            is_new=array(True),
        )
        is_explained = concrete(account.is_sound) & concrete(agrees)
        return cond(is_explained, lambda: taken, lambda: refused)

    after = cond(judgement.is_taken, explained, lambda: refused)
    length, is_there = _next_length(trial, after.is_new)
    return replace(
        after,
        length=length,
        lands=judgement.lands,
        is_there=is_there,
        is_found=judgement.is_found,
    )


@program
def _target_of(problem: ContinuationProblem, step: ArclengthStep) -> _Target:
    """Return the target of the next step: a distance, or the first active-set change before it.

    A step to the last load has no active-set change there as its target: it would be cut there
    without end.
    """
    curve = problem.curve
    old = step.here
    length = step.length
    dtype = step.length.dtype
    changes = changes_ahead(curve, old, problem.min_step)
    most = most_changes(changes.net.size)
    # A change right before the last load is passed with it.
    number = jnp.sum(changes.distances <= length - step.lands * problem.min_step)
    follows = (number > jnp.sum(changes.tied)) & (most > 1)
    if most > 1:
        length = jnp.minimum(length, jnp.sort(changes.distances.ravel())[most])
    is_change = (number > 0) & ~follows
    opens = jnp.any(changes.point & ~old.is_free)
    reach = jnp.where(is_change, changes.first, length)

    row = curve.gradient_of(old.tangent)
    # In a short step the place along it is known to no more digits than the state.
    rounding = rounding_of_numbers(dtype) * curve.length(old.at)
    scale = jnp.maximum(reach, rounding / EQUILIBRIUM[dtype.name])
    ahead = on_plane(row, row.times(old.at) + reach, scale)
    span = jnp.abs(problem.last - problem.first)
    end = on_plane(curve.load_gradient, problem.last - curve.load_offset, span)
    event = at_change(curve, changes.point, opens, problem.max_step)
    condition = choose(is_change, event, choose(step.lands, end, ahead))

    predicted = old.at.plus(old.tangent, reach)
    least = jnp.where(curve.contact.has_core, old.at.gap / 5, -jnp.inf)
    least = jnp.where(follows, jnp.maximum(least, 0), least)
    start = BorderedVector(jnp.maximum(predicted.gap, least), predicted.pressure)
    close = jnp.where(is_change, *jnp.array([EXACT[dtype.name], AT_STATES[dtype.name]], dtype))
    return _Target(
        changes, reach, is_change, opens, follows, predicted, start, row, condition, close
    )


@program
def _judged(
    problem: ContinuationProblem, step: ArclengthStep, target: _Target, found: CorrectorOutcome
) -> _Judgement:
    """Return whether the point that the corrector has found lies on the same curve."""
    curve = problem.curve
    old = step.here
    changes = target.changes
    reach = target.reach
    place = found.place
    tangent = found.place.tangent
    length = target.row.times(place.at.minus(old.at))
    cosine = curve.product(tangent, old.tangent)
    farthest = jnp.where(target.follows, _FARTHEST_LEAP, _FARTHEST)
    is_near = curve.length(place.at.minus(target.predicted)) <= farthest * reach
    is_straight = (length > 0) & (cosine > _LEAST_COSINE)
    cubics = Cubics(old, place, length, cosine)
    forces = found.forces
    after = forces.net, curve.net_rate(forces.curvature, tangent)
    leaps = changes_as_predicted(cubics, changes, after)
    smooth, share = stays_positive(curve, cubics, changes, target.is_change, after, forces.scale)
    # Where gaps or reactions alone are at fault, up to where they are positive.
    is_over = found.is_found & is_near & is_straight & ~target.follows & (share < 1)
    cut = jnp.where(found.is_found, _CUT, _CUT_IF_LOST)
    share = jnp.where(is_over, jnp.maximum(0.9 * share, 0.1), cut)
    is_smooth = jnp.where(target.follows, leaps, smooth & turns_as_predicted(curve, cubics))
    is_easy = cosine > _STRAIGHT

    turns = curve.rate(old.tangent) * curve.rate(tangent) < 0
    beyond = problem.is_beyond(place.at) & ~(step.lands & ~target.is_change)
    is_sound = found.is_found & is_near & is_straight & is_smooth
    is_sound &= ~(turns & (target.is_change | step.lands | beyond))
    gap = jnp.where(place.is_free, jnp.maximum(place.at.gap, 0), 0)
    gap = jnp.where(target.is_change & changes.point, 0, gap)
    # Of a turn beside a change of the free points it is not known which came first.
    is_clear = ~(turns & jnp.any(place.is_free != old.is_free))
    is_taken = is_sound & is_clear & ~beyond
    gap = jnp.where(is_taken, gap, place.at.gap)
    return _Judgement(
        gap=gap,
        is_found=found.is_found,
        is_taken=is_taken,
        lands=is_sound & beyond,
        turns=turns,
        share=share,
        is_easy=is_easy,
    )


def _events_in(trial: _StepTrial) -> _Events:
    """Return the fold in a step, the place beyond it, and its number of negative eigenvalues."""
    problem, step, target, judgement, reached = trial
    curve = problem.curve
    fold, is_flat = cond(
        judgement.turns,
        lambda: fold_between(curve, step.here, reached),
        lambda: (reached, array(True)),
    )
    beyond = cond(
        target.is_change,
        lambda: beyond_change(curve, reached, target.changes, target.opens),
        lambda: beyond_none(reached),
    )
    inputs = curve.contact, curve.load, beyond.place.at.gap
    if problem.to_limit:
        # It matters whether the branch goes on unstable, and not by which mode.
        found = index_of(*inputs, step.modes, opened=beyond.opened, counts_all=False)
        return _Events(fold, is_flat, beyond, *found, *found)
    found = index_of(*inputs, step.modes)
    opened = cond(
        beyond.is_tied,
        lambda: index_of(*inputs, no_modes(beyond.opened), opened=beyond.opened, precise=True),
        lambda: found,
    )
    return _Events(fold, is_flat, beyond, *found, *opened)


class _Turning(eqx.Module):
    """How the load turns in a step, and how that changes the Morse index.

    Attributes:
        back: whether the load turns back at the active-set change.
        touches: whether a point touches there.
        is_tied: whether several points change sides there, at once.
        change: the change of the index, without a sign where the load turns at a fold; until points
            change sides at once.
    """

    back: Flag
    touches: Flag
    is_tied: Flag
    change: Int[Array, ""]

    @classmethod
    def at(cls, trial: _StepTrial, beyond: Beyond) -> "_Turning":
        problem, _, target, judgement, reached = trial
        curve = problem.curve
        new = beyond.place
        back = curve.rate(reached.tangent) * curve.rate(new.tangent) < 0
        # At a release the released point has no part in the index yet.
        touches = target.is_change & ~target.opens
        loses_one = touches & back & ~beyond.is_tied
        change = jnp.where(judgement.turns, 1, jnp.where(loses_one, -1, 0))
        return cls(back, touches, beyond.is_tied, change)

    def explains(self, turns: Flag, before: Int[Array, ""], after: Int[Array, ""]) -> Flag:
        """Return whether it explains the number of negative eigenvalues after the step."""
        is_known = (before >= 0) & (after >= 0) & (after < MOST)
        found = jnp.where(turns, jnp.abs(after - before), after - before)
        return ~is_known | (found == self.change)


@program
def _account_of(trial: _StepTrial, events: _Events) -> _Account:
    """Return whether the events in a step explain the Morse index behind it, or modes might.

    Modes that have no part in the branch, since they break a symmetry, may change sign as they
    like: there other branches cross it. Points that tie, by symmetry, take such modes with them at
    once.
    """
    problem, step, target, judgement, _ = trial
    turning = _Turning.at(trial, events.beyond)
    is_tied = turning.is_tied
    index = jnp.where(is_tied & (events.opened_index < 0), UNKNOWN, events.index).astype(int)
    before = jnp.where(is_tied & turning.touches, events.opened_index, index)
    agrees = turning.explains(judgement.turns, step.expected, before)
    splits = is_tied & ~turning.back & (index >= 0) & (index != events.opened_index)
    if problem.to_limit:
        # A bifurcation is a limit, however long the step.
        agrees |= is_tied | ((step.index == 0) & (index > 0) & ~judgement.turns)
        splits = is_tied & ~turning.back & (step.index == 0) & (index > 0)
    is_beyond = judgement.turns & problem.is_beyond(events.fold.at)
    opens = target.is_change & target.opens
    expected = jnp.where(is_tied & opens, events.opened_index, index + (opens & turning.back))
    is_unknown = (expected >= MOST) | (index < 0)
    if problem.to_limit:
        is_unknown |= is_tied
    kind = KINDS.where(target.opens, KINDS.release, KINDS.touch)
    kind = KINDS.where(target.is_change, kind, KINDS.fold)
    mode = jnp.where(judgement.turns, events.fold.tangent.gap, events.beyond.place.tangent.gap)
    if not problem.to_limit:
        mode = jnp.where(splits, _mode_of_tie(trial, events), mode)
    return _Account(
        is_sound=events.beyond.goes_on & events.is_flat & ~is_beyond,
        agrees=agrees,
        # The farther from a bifurcation, the smaller the part of the mode that does belong to it.
        is_open=~agrees & ~splits & (step.length <= _ACROSS * problem.max_step),
        index=index,
        expected=jnp.where(is_unknown, UNKNOWN, expected).astype(int),
        turn=TurnInStep(
            is_there=judgement.turns | turning.back | splits,
            at=events.fold.at,
            kind=KINDS.where(splits, KINDS.bifurcation, kind),
            mode=mode,
        ),
    )


def _mode_of_tie(trial: _StepTrial, events: _Events) -> Field:
    """Return the unstable mode that most moves points apart that change sides together."""
    flips = events.beyond.place.is_free != trial.reached.is_free
    modes = events.opened_modes[:-1]

    def apart(mode: Field) -> Scalar:
        return total(jnp.where(flips, (mode - mean_over(flips, mode)) ** 2, 0))

    parts = jax.vmap(apart)(modes)
    is_unstable = jnp.arange(len(modes)) < events.opened_index
    return modes[jnp.argmax(jnp.where(is_unstable, parts, -1))]


class _Crossing(eqx.Module):
    """Another branch that crosses in a step.

    Attributes:
        is_there: whether one does: a mode changes its sign that has no part in this branch.
        agrees: whether events explain the signs of the modes that have a part.
        start: where the eigenvalue of the mode vanishes, on the chord.
        condition: the condition of that point on the curve.
        mode: the mode.
    """

    is_there: Flag
    agrees: Flag
    start: BorderedVector
    condition: Condition
    mode: Field


def _crossing(trial: _StepTrial, events: _Events, turn: TurnInStep) -> tuple[TurnInStep, Flag]:
    """Return the bifurcation in a step, or the turn otherwise, and whether it is explained.

    The signs of the modes that have a part in the branch are explained by events. Where another one
    changes its sign is found to second order in the length of the step.
    """
    old = trial.step.here
    crossing = _crossed(trial, events)
    correction = CorrectorProblem(trial.problem.curve, crossing.condition, old.is_free)
    close = EXACT[trial.step.length.dtype.name]
    found = correct(correction, crossing.start, trial.target.row, old.tangent, close)
    return _with_crossing(turn, crossing, found), crossing.agrees


@program
def _crossed(trial: _StepTrial, events: _Events) -> _Crossing:
    """Return the branch that crosses in a step, to first order."""
    problem, step, target, judgement, reached = trial
    curve = problem.curve
    old = step.here
    turning = _Turning.at(trial, events.beyond)

    def driven(place: Place) -> DrivenIndex:
        gap = place.at.gap
        tangent = place.tangent.gap
        return driven_index_of(curve.contact, curve.load, gap, place.is_free, tangent)

    touched = turning.touches & ~turning.is_tied
    ends = old, choose(touched, replace(reached, is_free=events.beyond.place.is_free), reached)
    both = jax.lax.map(driven, jax.tree.map(lambda *pair: jnp.stack(pair), *ends))
    before, after = both.index
    agrees = (before >= 0) & (after >= 0) & turning.explains(judgement.turns, before, after)
    # Of the eigenvalues in order, the lowest one that has changed its sign.
    numbers = jnp.sum(both.eigenvalues < 0, axis=1)
    first = jnp.minimum(jnp.min(numbers), both.eigenvalues.shape[1] - 1)
    low, high = both.eigenvalues[:, first]
    share = jnp.where(low * high < 0, low / jnp.where(low == high, 1, low - high), 1)
    start = old.at.plus(reached.at.minus(old.at), share)
    here, there = both.modes[:, first]
    there *= jnp.where(total(here * there) < 0, -1, 1)
    return _Crossing(
        is_there=agrees & ~judgement.turns & ~turning.back,
        agrees=agrees,
        start=start,
        condition=on_plane(target.row, target.row.times(start), target.reach),
        mode=here + share * (there - here),
    )


@program
def _with_crossing(turn: TurnInStep, crossing: _Crossing, found: CorrectorOutcome) -> TurnInStep:
    is_there = crossing.is_there
    at = choose(found.is_found, found.place.at, crossing.start)
    return TurnInStep(
        is_there=turn.is_there | is_there,
        at=choose(is_there, at, turn.at),
        kind=KINDS.where(is_there, KINDS.bifurcation, turn.kind),
        mode=jnp.where(is_there, crossing.mode, turn.mode),
    )


@program
def _next_length(trial: _StepTrial, is_new: Flag) -> tuple[Scalar, Flag]:
    """Return the length of the step after one, taken or not, and whether this is at the last load.

    1. After an easy step it is longer, after another one as long.
    2. If the step leads beyond the last load, it ends about there.
    3. If the load turns in a step that may not, it ends about where it turns.
    4. Otherwise the step is cut, to where all gaps and reactions are positive, or by a factor.
    """
    problem, step, target, judgement, reached = trial
    curve = problem.curve
    old = step.here
    is_easy = judgement.is_easy & ~target.is_change
    longer = jnp.where(is_easy, _GROWTH * target.reach, step.length)
    longer = jnp.minimum(jnp.maximum(longer, step.length), problem.max_step)
    before = curve.value(old.at)
    after = curve.value(reached.at)
    to_load = (problem.last - before) / jnp.where(after == before, 1, after - before)
    before = curve.rate(old.tangent)
    after = curve.rate(reached.tangent)
    to_turn = before / jnp.where(judgement.turns, before - after, 1)
    to_turn = jnp.clip(_TO_TURN * to_turn, _CUT, _TO_TURN)
    share = jnp.where(judgement.turns, to_turn, judgement.share)
    share = jnp.where(judgement.lands, to_load, share)
    length = jnp.where(is_new, longer, share * target.reach)
    return length, is_new & step.lands & ~target.is_change

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

import jax.numpy as jnp

from jaxstab.branches.bifurcation import bifurcation_in
from jaxstab.branches.corrector import CorrectorProblem, correct
from jaxstab.branches.curve import ContinuationProblem
from jaxstab.branches.step_events import account_of, events_in
from jaxstab.branches.step_trial import CUT, ArclengthStep, StepTrial, judge, target_of
from jaxstab.core.checks import array, concrete
from jaxstab.core.compile import program
from jaxstab.core.control_flow import cond
from jaxstab.core.types import Flag, Scalar

# An easy step is followed by one that is so many times longer.
_GROWTH = 1.5
# A step in which the load turns and may not is cut to this part of the distance to the turn.
_TO_TURN = 0.9


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
    target = target_of(problem, step)
    correction = CorrectorProblem(problem.curve, target.condition, old.is_free, target.follows)
    found = correct(correction, target.start, target.row, old.tangent, target.close)
    judgement = judge(problem, step, target, found)
    reached = replace(found.place, at=replace(found.place.at, gap=judgement.gap))
    trial = StepTrial(problem, step, target, judgement, reached)
    refused = replace(step, is_new=array(False))

    def accepted_step() -> ArclengthStep:
        events = events_in(trial)
        account = account_of(trial, events)
        turn = account.turn
        agrees = account.agrees
        # To a limit no branch leads across another one: a bifurcation is a limit.
        if not problem.to_limit:
            turn, agrees = cond(
                account.is_unexplained,
                lambda: bifurcation_in(trial, events, turn),
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

    after = cond(judgement.is_taken, accepted_step, lambda: refused)
    length, reached_last_load = _next_length(trial, after.is_new)
    return replace(
        after,
        length=length,
        aims_at_last_load=judgement.overshoots,
        reached_last_load=reached_last_load,
        is_found=judgement.is_found,
    )


@program
def _next_length(trial: StepTrial, is_new: Flag) -> tuple[Scalar, Flag]:
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
    to_load = (problem.last_load - before) / jnp.where(after == before, 1, after - before)
    before = curve.rate(old.tangent)
    after = curve.rate(reached.tangent)
    to_turn = before / jnp.where(judgement.turns, before - after, 1)
    to_turn = jnp.clip(_TO_TURN * to_turn, CUT, _TO_TURN)
    share = jnp.where(judgement.turns, to_turn, judgement.share)
    share = jnp.where(judgement.overshoots, to_load, share)
    length = jnp.where(is_new, longer, share * target.reach)
    return length, is_new & step.aims_at_last_load & ~target.is_change

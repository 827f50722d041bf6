"""The bifurcation in a step along the curve, where another branch crosses.

There a mode changes its sign that has no part in the branch, since it breaks a symmetry.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from jaxstab.branches.corrector import (
    Condition,
    CorrectorOutcome,
    CorrectorProblem,
    correct,
    on_plane,
)
from jaxstab.branches.curve import Place
from jaxstab.branches.morse_index import DrivenIndex, driven_index_of
from jaxstab.branches.step_events import IndexChange, StepEvents
from jaxstab.branches.step_trial import StepTrial, TurnInStep
from jaxstab.core.accuracy import EXACT
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose
from jaxstab.core.grid import total
from jaxstab.core.types import Flag
from jaxstab.states.kinds import KINDS


def bifurcation_in(
    trial: StepTrial, events: StepEvents, turn: TurnInStep
) -> tuple[TurnInStep, Flag]:
    """Return the bifurcation in a step, or the turn otherwise, and whether it is explained.

    The signs of the modes that have a part in the branch are explained by events. Where another one
    changes its sign is found to second order in the length of the step.
    """
    old = trial.step.here
    crossing, condition, agrees = _crossing_on_chord(trial, events)
    correction = CorrectorProblem(trial.problem.curve, condition, old.is_free)
    close = EXACT[trial.step.length.dtype.name]
    found = correct(correction, crossing.at, trial.target.row, old.tangent, close)
    return _turn_or_crossing(turn, crossing, found), agrees


@program
def _crossing_on_chord(trial: StepTrial, events: StepEvents) -> tuple[TurnInStep, Condition, Flag]:
    """Return the branch that crosses in a step, to first order, and a condition for its place.

    There the eigenvalue of the mode vanishes on the chord, in the plane of the condition. And
    whether events explain the signs of the modes that have a part in the branch.
    """
    problem, step, target, judgement, reached = trial
    curve = problem.curve
    old = step.here
    index_change = IndexChange.at(trial, events.beyond)

    def driven_index_at(place: Place) -> DrivenIndex:
        gap = place.at.gap
        tangent = place.tangent.gap
        return driven_index_of(curve.contact, curve.load, gap, place.is_free, tangent)

    touched = index_change.touches & ~index_change.is_tied
    ends = old, choose(touched, replace(reached, is_free=events.beyond.place.is_free), reached)
    both = jax.lax.map(driven_index_at, jax.tree.map(lambda *pair: jnp.stack(pair), *ends))
    before, after = both.index
    agrees = (before >= 0) & (after >= 0) & index_change.explains(judgement.turns, before, after)
    # Of the eigenvalues in order, the lowest one that has changed its sign.
    numbers = jnp.sum(both.eigenvalues < 0, axis=1)
    first = jnp.minimum(jnp.min(numbers), both.eigenvalues.shape[1] - 1)
    low, high = both.eigenvalues[:, first]
    share = jnp.where(low * high < 0, low / jnp.where(low == high, 1, low - high), 1)
    start = old.at.plus(reached.at.minus(old.at), share)
    here, there = both.modes[:, first]
    there *= jnp.where(total(here * there) < 0, -1, 1)
    crossing = TurnInStep(
        exists=agrees & ~judgement.turns & ~index_change.back,
        at=start,
        kind=KINDS.bifurcation,
        mode=here + share * (there - here),
    )
    return crossing, on_plane(target.row, target.row.times(start), target.reach), agrees


@program
def _turn_or_crossing(
    turn: TurnInStep, crossing: TurnInStep, found: CorrectorOutcome
) -> TurnInStep:
    """Return the crossing if there is one, at the point that the corrector has found."""
    exists = crossing.exists
    at = choose(found.is_found, found.place.at, crossing.at)
    return TurnInStep(
        exists=turn.exists | exists,
        at=choose(exists, at, turn.at),
        kind=KINDS.where(exists, crossing.kind, turn.kind),
        mode=jnp.where(exists, crossing.mode, turn.mode),
    )

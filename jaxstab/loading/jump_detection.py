"""A step along a load path, judged: whether it stayed on the branch or jumped; the bisection then.

A step is one of the load, from a prediction by the two states before. On a branch the potential
E + W, with W the energy of the load, changes by the work of the load: dE + dW = F dl. A step whose
potential falls by more has left the branch. So has one over which F does not go on as before. The
errors of a jump in energy and force cannot both vanish by chance. Steps shrink until both are next
to nothing, or are as short as jumps are located. So the loss of a jump is the difference of the
potentials of two states at one load.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxstab.branches.branch_steps import FARTHER
from jaxstab.core.checks import concrete
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Flag, Scalar
from jaxstab.equilibrium import Equilibrium
from jaxstab.loading.event import Event
from jaxstab.loading.load_path import LoadPath, Start
from jaxstab.loads import Load
from jaxstab.states.point import PathPoint, point_of
from jaxstab.states.record import Record

# The share of the curvature of F in the work on a step, over the smallest loss that is located: a
# step with more is too long for the trapezoid.
_MAX_CURVATURE = 4
# How far the potential of a step may fall below its prediction, over the smallest loss that is
# located. The prediction extrapolates F, and may err by many times the loss that a step on the
# branch may show. Once a step has failed the second number counts: to reject a step too early then
# costs no more than another halving.
_MAX_FALL = 20
_MAX_FALL_IN_BRACKET = 5
# The error that a step aims at, over the largest one of a step on a branch.
_AIM = 0.7


class JumpBracket(eqx.Module):
    """The bracket of the load at which the branch ends: a step has failed to reach its far end.

    Attributes:
        distance: how far ahead the nearest such load lies; infinite if there is none.
        error: the error of a step there, over the tolerance, as far as it is known.
        nearness: how near the end of the branch is to be located.
    """

    distance: Scalar
    error: Scalar
    nearness: Scalar

    @property
    def is_active(self) -> Flag:
        """Whether there is such a load."""
        return jnp.isfinite(self.distance)


class PathSearch(eqx.Module):
    """How far load stepping has come.

    Attributes:
        here: the last state accepted.
        previous: the state accepted before that.
        next_length: the length of the next step.
        bracket: for the end of the branch.
        leg: the number of the leg of the load path, from one turning point to the next.
        is_apart: whether the load has pulled the surfaces apart.
        state_number: the number of the last state recorded.
        result: how it went so far.
    """

    here: PathPoint
    previous: PathPoint
    next_length: Scalar
    bracket: JumpBracket
    leg: Int[Array, ""]
    is_apart: Flag
    state_number: Int[Array, ""]
    result: RESULTS

    def goes_on(self, load: Load) -> Flag:
        """Return whether there is a step to take along a load path."""
        # NumPy compiles nothing.
        is_before_end = concrete(self.leg) < load.value.size - 1
        return is_before_end & concrete(self.result == RESULTS.successful)

    def fraction_done(self, load: Load) -> float:
        """Return the fraction of a load path that is done, outside of a trace."""
        turns, leg, here = (concrete(x) for x in (load.value, self.leg, self.here.value))
        lengths = np.abs(np.diff(turns))
        done = lengths[:leg].sum() + abs(here - turns[leg])
        return float(done / lengths.sum())


class TrialStep(eqx.Module):
    """A step to be tried.

    Attributes:
        value: the load it leads to.
        length: its length.
        start: where the equilibrium there is sought from.
        is_end: whether it leads to the end of this leg of the load path.
        is_final: whether a jump is located there, if there is one.
    """

    value: Scalar
    length: Scalar
    start: Start
    is_end: Flag
    is_final: Flag


class StepOutcome(eqx.Module):
    """A step that was tried, and its meaning.

    Attributes:
        dissipation: the loss of its jump, the difference of two potentials at the load of its start
            [energy].
        error: of loss and force, over the tolerance on a branch; infinite if it has no end.
        is_smooth: whether it stayed on the branch.
        is_jump: whether it left the branch, at its end.
        is_pulled: whether the surfaces fell apart in that jump.
        is_apart: whether surfaces that were apart stayed so.
        is_touch: whether surfaces that were apart came together, as near as that is located.
        is_lost: whether no equilibrium was found where the branch has ended.
    """

    dissipation: Scalar
    error: Scalar
    is_smooth: Flag
    is_jump: Flag
    is_pulled: Flag
    is_apart: Flag
    is_touch: Flag
    is_lost: Flag

    @property
    def is_event(self) -> Flag:
        """Whether it has located a jump or a touch."""
        return self.is_jump | self.is_touch

    @property
    def is_accepted(self) -> Flag:
        """Whether the path goes on from where it led to."""
        return self.is_smooth | self.is_event | self.is_apart


@program
def next_step(load_path: LoadPath, search: PathSearch) -> TrialStep:
    """Return the next step to try."""
    here = search.here
    bracket = search.bracket
    target = load_path.load.value[search.leg + 1]
    left = jnp.abs(target - here.value)
    # Where it failed by its length alone, the rest of the step is right.
    tries_whole = (bracket.distance <= bracket.nearness) | (bracket.error <= 1)
    within = jnp.where(tries_whole, bracket.distance, bracket.distance / 2)
    length = jnp.minimum(jnp.where(bracket.is_active, within, search.next_length), left)
    # No step is left over that is shorter than jumps are located.
    is_end = left <= length + load_path.resolution
    length = jnp.where(is_end, left, length)
    # The last step to a load that failed is a jump, if it fails again.
    distance = bracket.distance
    if load_path.finds_all:
        distance = length
    is_final = bracket.is_active & (distance <= bracket.nearness)
    change = jnp.sign(target - here.value) * length
    value = jnp.where(is_end, target, here.value + change)
    moved = here.signed_gap - search.previous.signed_gap
    rate = moved / _nonzero(here.value - search.previous.value)
    # At the end of a branch the energy is lowered from its last state.
    stays = bracket.is_active
    if load_path.finds_all:
        stays = is_final
    moves = here.value != search.previous.value
    if here.indentation is not None:
        # A surface that yields does not go back as it came.
        moves = change * (here.value - search.previous.value) > 0
        stays |= ~moves
    gap = here.gap + jnp.where(stays, 0, change * rate)
    gap = jnp.where(search.is_apart, load_path.apart(here), gap)
    is_predicted = ~search.is_apart & ~is_final & moves & load_path.finds_all
    least = jnp.where(is_predicted, _least_potential(load_path, search, change), -jnp.inf)
    start = load_path.start_at(value, gap, least, is_final, here)
    return TrialStep(value, length, start, is_end, is_final)


def _least_potential(load_path: LoadPath, search: PathSearch, change: Scalar) -> Scalar:
    """Return the potential below which a state ahead of the last lies on another branch."""
    here = search.here
    previous = search.previous
    slope = (here.force - previous.force) / _nonzero(here.value - previous.value)
    predicted = here.potential + change * (here.force + change * slope / 2)
    fall = jnp.where(search.bracket.is_active, _MAX_FALL_IN_BRACKET, _MAX_FALL)
    return predicted - fall * load_path.smallest_loss(here)


def _outcome_of(
    load_path: LoadPath, search: PathSearch, trial: TrialStep, new: PathPoint, result: RESULTS
) -> StepOutcome:
    """Return the meaning of a step: whether it is on the branch, and the loss if it is a jump."""
    here = search.here
    previous = search.previous
    value = trial.value
    is_found = result == RESULTS.successful
    change = value - here.value
    before = here.value - previous.value
    slope = (new.force - here.force) / _nonzero(change)
    turn = (slope - (here.force - previous.force) / _nonzero(before)) / _nonzero(change + before)
    # The error of the trapezoid, where F is a parabola through three states.
    is_known = (change * before > 0) & load_path.finds_all
    curved = jnp.where(is_known, turn * change**3 / 6, 0)
    loss = here.potential + change * (here.force + new.force) / 2 - curved - new.potential
    least = load_path.smallest_loss(here)
    error = jnp.maximum(jnp.abs(loss), jnp.abs(curved) / _MAX_CURVATURE) / least
    is_together = is_found & ~search.is_apart
    is_smooth = is_together & ((error <= 1) | (trial.is_final & (loss <= least)))
    is_pulled = (result == RESULTS.pulled_off) & ~search.is_apart
    is_jump = ~is_smooth & trial.is_final & (is_together | is_pulled)
    control = load_path.contact.after(here).control(load_path.at(value))
    touches = search.is_apart & is_found & control.presses
    return StepOutcome(
        dissipation=here.potential + change * new.force - new.potential,
        error=jnp.where(is_together, error, jnp.inf),
        is_smooth=is_smooth,
        is_jump=is_jump,
        is_pulled=is_jump & is_pulled,
        is_apart=search.is_apart & ~touches,
        is_touch=touches & trial.is_final,
        is_lost=~is_found & ~is_pulled & trial.is_final & ~search.is_apart,
    )


@program
def apply_step(
    load_path: LoadPath, search: PathSearch, trial: TrialStep, equilibrium: Equilibrium
) -> tuple[PathSearch, Record]:
    """Return the search after a step to an equilibrium, and the record of the step.

    1. Judge the step by the equilibrium.
    2. If it is accepted, the path goes on from there, otherwise from where it was.
    3. Narrow the bracket of the end of the branch, if a step has failed, and choose the length of
       the next step.
    """
    found = point_of(load_path.contact, equilibrium, trial.value, search.here)
    outcome = _outcome_of(load_path, search, trial, found, equilibrium.result)
    is_event = outcome.is_event
    accepts = outcome.is_accepted

    # The loss is unknown where surfaces fall apart, and states of separated ones are not recorded.
    lost = jnp.where(outcome.is_pulled | outcome.is_touch, jnp.nan, outcome.dissipation)
    new = replace(found, dissipation=search.here.dissipation + jnp.where(is_event, lost, 0))
    here = choose(accepts, new, search.here)
    previous = choose(accepts, search.here, search.previous)
    previous = choose(is_event, here, previous)
    is_apart = (search.is_apart & ~outcome.is_touch) | outcome.is_pulled
    is_state = accepts & ~is_apart

    bracket = _narrow_bracket(load_path, search.bracket, trial, outcome)
    next_length = _next_length(load_path, search, trial, outcome)
    # The solver may find its way from further on, but not from anywhere.
    has_failed = outcome.is_lost & (trial.is_end | (trial.length > load_path.max_step / FARTHER))
    after = PathSearch(
        here=here,
        previous=previous,
        next_length=jnp.where(accepts & ~bracket.is_active, next_length, search.next_length),
        bracket=bracket,
        leg=search.leg + (accepts & trial.is_end),
        is_apart=is_apart,
        state_number=search.state_number + is_state,
        result=RESULTS.where(has_failed, equilibrium.result, search.result),
    )
    event = Event(
        before=search.here,
        after=here,
        ahead=here.value - search.here.value,
        dissipation=lost,
        state=search.state_number,
        is_jump=outcome.is_jump,
        is_pulled=outcome.is_pulled,
        is_touch=outcome.is_touch,
    )
    return after, Record(here, is_state, event, is_event)


def _narrow_bracket(
    load_path: LoadPath, bracket: JumpBracket, trial: TrialStep, outcome: StepOutcome
) -> JumpBracket:
    """Return the bracket of the end of the branch after a step, which `next_step` halves."""
    accepts = outcome.is_accepted
    distance = jnp.where(accepts, bracket.distance - trial.length, trial.length)
    is_over = outcome.is_event | (distance <= 0) | (accepts & trial.is_end)
    # An error of quadrature falls with the cube of the length, the loss of a jump does not.
    error = jnp.where(accepts, bracket.error / 8, outcome.error)
    # Where the solver is lost right beyond the end, it may find its way from further on.
    distance = jnp.where(outcome.is_lost, FARTHER * distance, distance)
    nearness = jnp.where(outcome.is_lost, distance, bracket.nearness)
    return JumpBracket(
        jnp.where(is_over, jnp.inf, distance),
        error,
        jnp.where(is_over, load_path.resolution, nearness),
    )


def _next_length(
    load_path: LoadPath, search: PathSearch, trial: TrialStep, outcome: StepOutcome
) -> Scalar:
    """Return the length of the next step where none has failed, after a step."""
    growth = jnp.cbrt(_AIM / jnp.maximum(outcome.error, jnp.finfo(outcome.error.dtype).tiny))
    next_length = jnp.minimum(trial.length * jnp.clip(growth, 0.5, 2), load_path.max_step)
    # A load that was only too far away is passed by steps that grow again.
    next_length = jnp.where(search.bracket.is_active, 2 * trial.length, next_length)
    # A step cut short by the end of a leg, to no length even, says nothing against a long one.
    next_length = jnp.where(trial.is_end, jnp.maximum(next_length, search.next_length), next_length)
    next_length = jnp.where(outcome.is_event, load_path.first_step, next_length)
    return jnp.where(outcome.is_apart | outcome.is_pulled, load_path.max_step, next_length)


def _nonzero(value: Scalar) -> Scalar:
    return jnp.where(value == 0, 1, value)

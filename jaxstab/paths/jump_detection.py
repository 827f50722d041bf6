"""A step along a programme of loads: its target, its meaning, and the state after it.

A step is one of the load, from a prediction by the two states before. On a branch the potential
E + W, with W the energy of the load, changes by the work of the load: dE + dW = F dl. A step whose
potential falls by more has left the branch. So has one over which F does not go on as before. The
errors of a jump in energy and force cannot both vanish by chance. Steps shrink until both are next
to nothing, or are as short as jumps are located. So the loss of a jump is the difference of the
potentials of two states at one load.
"""

from dataclasses import replace
from typing import Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.core.checks import concrete
from jaxstab.core.control_flow import choose
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.loads import Load
from jaxstab.paths.programme import Programme
from jaxstab.paths.record import Event, PathPoint, Strongest, Tables

# A state is sought further on by this factor where the solver fails beyond the end of a branch.
_FURTHER = 8
# How much of the smallest loss the curvature of F may take from the work on a step.
_MAX_CURVATURE = 4
# The errors on a branch that may add up in a predicted potential, and for steps once one has
# failed: to reject these too early costs less.
_LEEWAY, _LEEWAY_IN_SEARCH = 20, 5
# The part of the errors allowed that a step aims at.
_AIM = 0.7


class Bisection(eqx.Module):
    """The knowledge of a load ahead that a step has failed to reach.

    Attributes:
        distance: how far ahead the nearest such load lies; infinite if there is none.
        error: the error of a step there, over the tolerance, as far as it is known.
        nearness: how near the end of the branch is to be located.
    """

    distance: Scalar
    error: Scalar
    nearness: Scalar

    @property
    def is_on(self) -> Flag:
        """Whether there is such a load."""
        return jnp.isfinite(self.distance)


Records = TypeVar("Records", Tables, Strongest)


class Progress(eqx.Module, Generic[Records]):
    """Where the path is, and all that it has recorded.

    Attributes:
        here: the last state accepted.
        last: the state before.
        stride: the length of the next step.
        bisection: for the end of the branch.
        part: the number of the monotone part of the programme.
        is_apart: whether the load has pulled the surfaces apart.
        gap: of the last state recorded.
        num_states: of states recorded.
        records: these states and the jumps, or the jumps alone.
        result: how it goes.
    """

    here: PathPoint
    last: PathPoint
    stride: Scalar
    bisection: Bisection
    part: Int[Array, ""]
    is_apart: Flag
    gap: Field
    num_states: Int[Array, ""]
    records: Records
    result: RESULTS

    def is_open(self, load: Load) -> Flag:
        """Return whether there is a step to take along a programme."""
        # NumPy compiles nothing.
        is_before_end = concrete(self.part) < load.value.size - 1
        return is_before_end & concrete(self.result == RESULTS.successful)


class TrialStep(eqx.Module):
    """A step to be tried.

    Attributes:
        value: the load it leads to.
        length: its length.
        gap: from which the equilibrium there is sought.
        least_potential: below which the state sought is known to lie on another branch [energy].
        is_end: whether it leads to the end of this part of the programme.
        is_final: whether a jump is located there, if there is one.
    """

    value: Scalar
    length: Scalar
    gap: Field
    least_potential: Scalar
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


def next_step(programme: Programme, walk: Progress) -> TrialStep:
    """Return the next step to try."""
    here, bisection = walk.here, walk.bisection
    target = programme.load.value[walk.part + 1]
    left = jnp.abs(target - here.value)
    # Where it failed by its length alone, the rest of the step is right.
    tries_whole = (bisection.distance <= bisection.nearness) | (bisection.error <= 1)
    within = jnp.where(tries_whole, bisection.distance, bisection.distance / 2)
    length = jnp.minimum(jnp.where(bisection.is_on, within, walk.stride), left)
    is_end = length >= left
    # The last step to a load that failed is a jump, if it fails again.
    is_near = (length if programme.finds_all else bisection.distance) <= bisection.nearness
    is_final = bisection.is_on & is_near
    change = jnp.sign(target - here.value) * length
    value = jnp.where(is_end, target, here.value + change)
    rate = (here.gap - walk.last.gap) / _nonzero(here.value - walk.last.value)
    # From the end of a branch the way goes down from its last state.
    stays = is_final if programme.finds_all else bisection.is_on
    gap = here.gap + jnp.where(stays, 0, change * rate)
    gap = jnp.where(walk.is_apart, programme.apart(), gap)
    moves = here.value != walk.last.value
    is_foreseen = ~walk.is_apart & ~is_final & moves & programme.finds_all
    least = jnp.where(is_foreseen, _least_potential(programme, walk, change), -jnp.inf)
    return TrialStep(value, length, gap, least, is_end, is_final)


def _least_potential(programme: Programme, walk: Progress, change: Scalar) -> Scalar:
    """Return the potential below which a state ahead of the last lies on another branch."""
    here, last = walk.here, walk.last
    slope = (here.force - last.force) / _nonzero(here.value - last.value)
    foreseen = here.potential + change * (here.force + change * slope / 2)
    leeway = jnp.where(walk.bisection.is_on, _LEEWAY_IN_SEARCH, _LEEWAY)
    return foreseen - leeway * programme.smallest_loss(here)


def _outcome_of(
    programme: Programme, walk: Progress, aim: TrialStep, new: PathPoint, result: RESULTS
) -> StepOutcome:
    here, last, value = walk.here, walk.last, aim.value
    is_found = result == RESULTS.successful
    change, before = value - here.value, here.value - last.value
    slope = (new.force - here.force) / _nonzero(change)
    turn = (slope - (here.force - last.force) / _nonzero(before)) / _nonzero(change + before)
    # The error of the trapezoid, where F is a parabola through three states.
    is_known = (change * before > 0) & programme.finds_all
    curved = jnp.where(is_known, turn * change**3 / 6, 0)
    loss = here.potential + change * (here.force + new.force) / 2 - curved - new.potential
    least = programme.smallest_loss(here)
    error = jnp.maximum(jnp.abs(loss), jnp.abs(curved) / _MAX_CURVATURE) / least
    is_together = is_found & ~walk.is_apart
    is_smooth = is_together & ((error <= 1) | (aim.is_final & (loss <= least)))
    is_pulled = (result == RESULTS.pulled_off) & ~walk.is_apart
    is_jump = ~is_smooth & aim.is_final & (is_together | is_pulled)
    control = programme.contact.control(programme.at(value))
    touches = walk.is_apart & is_found & control.presses
    return StepOutcome(
        dissipation=here.potential + change * new.force - new.potential,
        error=jnp.where(is_together, error, jnp.inf),
        is_smooth=is_smooth,
        is_jump=is_jump,
        is_pulled=is_jump & is_pulled,
        is_apart=walk.is_apart & ~touches,
        is_touch=touches & aim.is_final,
        is_lost=~is_found & ~is_pulled & aim.is_final & ~walk.is_apart,
    )


def apply_step(
    programme: Programme, walk: Progress[Records], aim: TrialStep, found: PathPoint, result: RESULTS
) -> Progress[Records]:
    """Return the walk after a step, from the state that it led to and how the solver ended."""
    trial = _outcome_of(programme, walk, aim, found, result)
    is_event, accepts = trial.is_event, trial.is_accepted
    is_apart = (walk.is_apart & ~trial.is_touch) | trial.is_pulled
    # The loss is unknown where surfaces fall apart, and states of separated ones are not recorded.
    lost = jnp.where(trial.is_pulled | trial.is_touch, jnp.nan, trial.dissipation)
    new = replace(found, dissipation=walk.here.dissipation + jnp.where(is_event, lost, 0))
    here = choose(accepts, new, walk.here)
    last = choose(accepts, walk.here, walk.last)
    event = Event(walk.here, here, lost, walk.num_states - 1, trial.is_touch)
    is_state = accepts & ~is_apart
    # The solver may find its way from further on, but not from anywhere.
    has_failed = trial.is_lost & (aim.is_end | (aim.length > programme.longest / _FURTHER))
    bisection = _bisected(programme, walk.bisection, aim, trial)
    stride = _stride(programme, walk, aim, trial)
    return Progress(
        here=here,
        last=choose(is_event, here, last),
        stride=jnp.where(accepts & ~bisection.is_on, stride, walk.stride),
        bisection=bisection,
        part=walk.part + (accepts & aim.is_end),
        is_apart=is_apart,
        gap=jnp.where(is_state, here.gap, walk.gap),
        num_states=walk.num_states + is_state,
        records=walk.records.with_step(here, is_state, event, is_event),
        result=RESULTS.where(has_failed, result, walk.result),
    )


def _bisected(
    programme: Programme, bisection: Bisection, aim: TrialStep, trial: StepOutcome
) -> Bisection:
    """Return the knowledge of a load ahead after a step."""
    accepts = trial.is_accepted
    distance = jnp.where(accepts, bisection.distance - aim.length, aim.length)
    is_over = trial.is_event | (distance <= 0) | (accepts & aim.is_end)
    # An error of quadrature falls with the cube of the length, the loss of a jump does not.
    error = jnp.where(accepts, bisection.error / 8, trial.error)
    # Where the solver is lost right beyond the end, it may find its way from further on.
    distance = jnp.where(trial.is_lost, _FURTHER * distance, distance)
    nearness = jnp.where(trial.is_lost, distance, bisection.nearness)
    return Bisection(
        jnp.where(is_over, jnp.inf, distance),
        error,
        jnp.where(is_over, programme.resolution, nearness),
    )


def _stride(programme: Programme, walk: Progress, aim: TrialStep, trial: StepOutcome) -> Scalar:
    """Return the length of the next step where none has failed, after a step."""
    growth = jnp.cbrt(_AIM / jnp.maximum(trial.error, jnp.finfo(trial.error.dtype).tiny))
    stride = jnp.minimum(aim.length * jnp.clip(growth, 0.5, 2), programme.longest)
    # A load that was only too far away is passed by steps that grow again.
    stride = jnp.where(walk.bisection.is_on, 2 * aim.length, stride)
    # A step cut short by the end of a part, to no length even, says nothing against a long one.
    stride = jnp.where(aim.is_end, jnp.maximum(stride, walk.stride), stride)
    stride = jnp.where(trial.is_event, programme.longest / 8, stride)
    return jnp.where(trial.is_apart | trial.is_pulled, programme.longest, stride)


def _nonzero(value: Scalar) -> Scalar:
    return jnp.where(value == 0, 1, value)

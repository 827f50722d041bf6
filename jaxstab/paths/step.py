"""A step along a programme of loads: where it aims, what it means, and where the walk is after it.

A step is one of the load, from a prediction by the two states before. On a branch the potential
E + W, W being that of the load, changes by what the load does: dE + dW = F dl. What a step loses
beyond that, it lost in a jump. Steps shrink until they lose next to nothing, or are as short as
jumps are located.
"""

from dataclasses import replace
from functools import partial
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact
from jaxstab.loads import Load
from jaxstab.paths.course import Course
from jaxstab.paths.store import Event, Field, Flag, Place, Record, Scalar, Store, Strongest
from jaxstab.results import RESULTS

# By what factor further on a state is sought where the solver is lost beyond the end of a branch.
_FURTHER = 8


class Search(eqx.Module):
    """What is known of a load ahead that a step has failed to reach.

    Attributes:
        distance: how far ahead the nearest such load lies; infinite if there is none.
        loss: what a step there would lose, as far as that is known.
        nearness: how near the end of the branch is to be located.
    """

    distance: Scalar
    loss: Scalar
    nearness: Scalar

    @property
    def is_on(self) -> Flag:
        """Whether there is such a load."""
        return jnp.isfinite(self.distance)


# A store of jumps.
Jumps = TypeVar("Jumps", Store, Strongest)


class Walk(eqx.Module, Generic[Jumps]):
    """Where the path is, and all that it has recorded.

    Attributes:
        here: the last state accepted, with what the load has supplied on branches, the integral of
            F up to here, and what was lost.
        last: the state before.
        stride: the length of the next step.
        search: for the end of the branch.
        part: the number of the monotone part of the programme.
        is_apart: whether the load has pulled the surfaces apart.
        states: those recorded.
        jumps: those recorded.
        result: how it goes.
    """

    here: Record
    last: Place
    stride: Scalar
    search: Search
    part: Int[Array, ""]
    is_apart: Flag
    states: Store
    jumps: Jumps
    result: RESULTS

    def is_open(self, load: Load) -> Flag:
        """Return whether there is a step to take along a programme."""
        return (self.part < load.value.size - 1) & (self.result == RESULTS.successful)


class Aim(eqx.Module):
    """A step to be tried.

    Attributes:
        value: the load it leads to.
        length: its length.
        start: where the equilibrium there is sought from, brought under that load.
        is_end: whether it leads to the end of this part of the programme.
        is_final: whether a jump is located there, if there is one.
    """

    value: Scalar
    length: Scalar
    start: Field
    is_end: Flag
    is_final: Flag


class Trial(eqx.Module):
    """A step that was tried, and what it means.

    Attributes:
        supplied: what the load supplied on it [energy].
        loss: what was lost on it [energy].
        is_smooth: whether it stayed on the branch.
        is_jump: whether it left the branch, at its end.
        is_pulled: whether the surfaces fell apart in that jump.
        is_apart: whether surfaces that were apart stayed so.
        is_touch: whether surfaces that were apart came together, as near as that is located.
        is_lost: whether no equilibrium was found where the branch has ended.
    """

    supplied: Scalar
    loss: Scalar
    is_smooth: Flag
    is_jump: Flag
    is_pulled: Flag
    is_apart: Flag
    is_touch: Flag
    is_lost: Flag


def aimed(course: Course, walk: Walk) -> Aim:
    """Return the next step to try."""
    here, search = walk.here.place, walk.search
    target = course.load.value[walk.part + 1]
    left = jnp.abs(target - here.value)
    # The last step to a load that failed is a jump, if it fails again.
    is_final = search.distance <= search.nearness
    # Where it lost by its length alone, what is left of the step loses less.
    tries_whole = is_final | (search.loss <= course.smallest_loss(here))
    within = jnp.where(tries_whole, search.distance, search.distance / 2)
    length = jnp.minimum(jnp.where(search.is_on, within, walk.stride), left)
    is_end = length >= left
    value = jnp.where(is_end, target, here.value + jnp.sign(target - here.value) * length)
    rate = (here.gap - walk.last.gap) / _nonzero(here.value - walk.last.value)
    gap = here.gap + jnp.where(search.is_on, 0, (value - here.value) * rate)
    gap = jnp.where(walk.is_apart, course.apart(), jnp.maximum(gap, 0))
    return Aim(value, length, course.start(value, walk.part, gap), is_end, is_final)


def _judged(course: Course, walk: Walk, aim: Aim, place: Place, result: RESULTS) -> Trial:
    """Return what a step means."""
    here, value = walk.here.place, aim.value
    is_found = result == RESULTS.successful
    supplied = (here.force + place.force) / 2 * (value - here.value)
    loss = here.potential + supplied - place.potential
    is_smooth = is_found & (jnp.abs(loss) <= course.smallest_loss(here)) & ~walk.is_apart
    is_pulled = (result == RESULTS.pulled_off) & ~walk.is_apart
    is_jump = ~is_smooth & aim.is_final & (is_found | is_pulled) & ~walk.is_apart
    presses = _brings_together(course.contact, course.at(value, walk.part))
    is_together = walk.is_apart & is_found & presses
    return Trial(
        supplied=supplied,
        loss=jnp.where(is_found & ~walk.is_apart, loss, jnp.inf),
        is_smooth=is_smooth,
        is_jump=is_jump,
        is_pulled=is_jump & is_pulled,
        is_apart=walk.is_apart & ~is_together,
        is_touch=is_together & aim.is_final,
        is_lost=~is_found & ~is_pulled & aim.is_final & ~walk.is_apart,
    )


def after(
    course: Course, walk: Walk[Jumps], aim: Aim, place: Place, result: RESULTS
) -> Walk[Jumps]:
    """Return the walk after a step, from the state that it led to and how the solver ended."""
    trial = _judged(course, walk, aim, place, result)
    is_event = trial.is_jump | trial.is_touch
    accepts = trial.is_smooth | is_event | trial.is_apart
    is_apart = (walk.is_apart & ~trial.is_touch) | trial.is_pulled
    # Of surfaces that fall apart nothing is known, and of those that are, nothing is recorded.
    is_known = ~walk.is_apart & ~trial.is_pulled
    unknown = jnp.where(trial.is_pulled, jnp.nan, 0)
    new = Record(
        place,
        walk.here.supplied + jnp.where(is_known, trial.supplied, unknown),
        walk.here.dissipation + jnp.where(is_known, trial.loss, unknown),
    )
    here = _choose(accepts, new, walk.here)
    last = _choose(accepts, walk.here.place, walk.last)
    is_kept = accepts & ~is_apart
    lost = jnp.where(trial.is_touch | trial.is_pulled, jnp.nan, trial.loss)
    event = Event(walk.here.place, here.place, lost, walk.states.count - 1, trial.is_touch)
    # The solver may find its way from further on, but not from anywhere.
    has_failed = trial.is_lost & (aim.is_end | (aim.length > course.longest / _FURTHER))
    search = _search(course, walk, aim, trial, accepts, is_event)
    new = Walk(
        here=here,
        last=_choose(is_event, here.place, last),
        stride=_stride(course, walk, aim, trial, is_event, is_apart, accepts & ~search.is_on),
        search=search,
        part=walk.part + (accepts & aim.is_end),
        is_apart=is_apart,
        states=walk.states.with_entry(here, is_kept),
        jumps=walk.jumps.with_entry(event, is_event),
        result=RESULTS.where(has_failed, result, walk.result),
    )
    is_short = new.is_open(course.load) & (new.states.is_full | new.jumps.is_full)
    return replace(new, result=RESULTS.where(is_short, RESULTS.store_full, new.result))


def _search(
    course: Course, walk: Walk, aim: Aim, trial: Trial, accepts: Flag, is_event: Flag
) -> Search:
    """Return what is known of a load ahead after a step."""
    distance = jnp.where(accepts, walk.search.distance - aim.length, aim.length)
    is_over = is_event | (distance <= 0) | (accepts & aim.is_end)
    # An error of quadrature falls with the cube of the length, what a jump loses does not.
    loss = jnp.where(accepts, walk.search.loss / 8, jnp.abs(trial.loss))
    # Where the solver is lost right beyond the end, it may find its way from further on.
    distance = jnp.where(trial.is_lost, _FURTHER * distance, distance)
    nearness = jnp.where(trial.is_lost, distance, walk.search.nearness)
    return Search(
        jnp.where(is_over, jnp.inf, distance),
        loss,
        jnp.where(is_over, course.resolution, nearness),
    )


def _stride(
    course: Course,
    walk: Walk,
    aim: Aim,
    trial: Trial,
    is_event: Flag,
    is_apart: Flag,
    is_free: Flag,
) -> Scalar:
    """Return the length of the next step where none has failed, after a step."""
    is_slow = jnp.abs(trial.loss) > course.smallest_loss(walk.here.place) / 8
    stride = jnp.where(is_slow, walk.stride / 2, jnp.minimum(2 * walk.stride, course.longest))
    # A load that was only too far away is passed by steps that grow again.
    stride = jnp.where(walk.search.is_on, 2 * aim.length, stride)
    stride = jnp.where(is_event, course.longest / 8, stride)
    stride = jnp.where(is_apart, course.longest, stride)
    return jnp.where(is_free, stride, walk.stride)


def _brings_together(contact: Contact, load: Load) -> Flag:
    control = contact.control(load)
    return control.energy(jnp.ones(())) > control.energy(jnp.zeros(()))


def _choose(condition: Flag, one: Any, other: Any) -> Any:
    return jax.tree.map(partial(jnp.where, condition), one, other)


def _nonzero(value: Scalar) -> Scalar:
    return jnp.where(value == 0, 1, value)

"""The walk along a programme of loads, step by step, through jumps.

A step is one of the load, from a prediction by the two states before. On a branch the potential
E + W, W being that of the load, changes by what the load does: dE + dW = F dl. What a step loses
beyond that, it lost in a jump. Steps shrink until they lose next to nothing, or are as short as
jumps are located.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int

from jaxstab.contact import Contact
from jaxstab.equilibrium import PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find
from jaxstab.loads import Load
from jaxstab.paths.store import Event, Field, Flag, Place, Record, Scalar, place_of, put, room
from jaxstab.results import RESULTS

# By default, over the rms height.
DISTURBANCE = 1e-6
# Steps of a monotone part of the programme, at least.
_NUM_STEPS = 32
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


class Walk(eqx.Module):
    """Where the path is, and all that it has recorded.

    Attributes:
        here: the last state accepted, with what the load has supplied on branches, the integral of
            F up to here, and what was lost.
        last: the state before.
        stride: the length of the next step.
        search: for the end of the branch.
        part: the number of the monotone part of the programme.
        is_apart: whether the load has pulled the surfaces apart.
        states: room for records, and how many are in use.
        jumps: room for events, and how many are in use.
        result: how it goes.
    """

    here: Record
    last: Place
    stride: Scalar
    search: Search
    part: Int[Array, ""]
    is_apart: Flag
    states: Record
    num_states: Int[Array, ""]
    jumps: Event
    num_jumps: Int[Array, ""]
    result: RESULTS


class Trial(eqx.Module):
    """A step that was tried, and what it means.

    Attributes:
        place: where it led.
        result: how the solver ended.
        length: of the step.
        is_end: whether it leads to the end of this part of the programme.
        supplied: what the load supplied on it [energy].
        loss: what was lost on it [energy].
        is_smooth: whether it stayed on the branch.
        is_jump: whether it left the branch, at its end.
        is_pulled: whether the surfaces fell apart in that jump.
        is_touch: whether surfaces that were apart came together.
        is_lost: whether no equilibrium was found where the branch has ended.
    """

    place: Place
    result: RESULTS
    length: Scalar
    is_end: Flag
    supplied: Scalar
    loss: Scalar
    is_smooth: Flag
    is_jump: Flag
    is_pulled: Flag
    is_touch: Flag
    is_lost: Flag


class Course(eqx.Module):
    """What is the same all the way.

    Attributes:
        contact: the contact problem, in units of its own.
        load: the turning points of the programme.
        threshold: the loss from which a jump is located [energy].
        resolution: how near it is located [that of the load].
        disturbance: a field that is added to where each equilibrium starts [length].
    """

    contact: Contact
    load: Load
    threshold: Scalar
    resolution: Scalar
    disturbance: Field

    @property
    def longest(self) -> Scalar:
        """The longest step."""
        turns = self.load.value
        return jnp.maximum((jnp.max(turns) - jnp.min(turns)) / _NUM_STEPS, self.resolution)

    def at(self, value: Scalar, part: Int[Array, ""]) -> Load:
        """Return the load at a value on a part of the programme."""
        return jax.tree.map(lambda leaf: leaf[part], self.load).at(value)

    def state(self, value: Scalar, part: Int[Array, ""], start: Field) -> tuple[Place, RESULTS]:
        """Return the equilibrium at a load that the solver finds from a gap."""
        solver = PreconditionedConjugateGradient()
        # Contact points stay where they are.
        disturbed = jnp.where(start > 0, jnp.maximum(start + self.disturbance, 0), 0)
        found = find(self.contact, self.at(value, part), solver, disturbed)
        return place_of(self.contact, found, value), found.result

    def apart(self) -> Field:
        """Return the gap of surfaces that are about to touch."""
        return jnp.max(self.contact.heights) - self.contact.heights


def course_of(
    contact: Contact,
    load: Load,
    smallest_jump: ArrayLike,
    disturbance: ArrayLike,
    resolution: ArrayLike = 1e-6,
) -> Course:
    """Return the course of a programme.

    Arguments:
        contact: the contact problem, in units of its own.
        load: the turning points of the programme.
        smallest_jump: the loss from which a jump is located, over the problem's own energy.
        disturbance: the size of a random field, over the rms height.
        resolution: how near a jump is located, over the range of the loads.
    """
    turns, heights = load.value, contact.heights
    noise = jax.random.normal(jax.random.key(0), heights.shape, heights.dtype)
    # Loads that are nearer to each other are the same.
    finest = 4 * jnp.finfo(turns.dtype).eps * jnp.max(jnp.abs(turns))
    return Course(
        contact,
        load,
        threshold=jnp.asarray(smallest_jump) * _own_energy(contact),
        resolution=jnp.maximum(resolution * (jnp.max(turns) - jnp.min(turns)), finest),
        disturbance=jnp.asarray(disturbance) * jnp.std(contact.solid.surface(heights)) * noise,
    )


def walk(course: Course, start: Field, sizes: tuple[int, int], fields: bool) -> Walk:
    """Return where a path ends and what it has recorded, as `begin` and `go_on` do."""
    return go_on(course, begin(course, start, sizes, fields))


def begin(course: Course, start: Field, sizes: tuple[int, int], fields: bool) -> Walk:
    """Return a walk at the first turning point.

    Arguments:
        course: what is the same all the way.
        start: where the first equilibrium starts.
        sizes: of the stores of states and of jumps.
        fields: whether to record the gaps of states.
    """
    turns = course.load.value
    span = jnp.max(turns) - jnp.min(turns)
    none, zero = jnp.array(0), jnp.zeros_like(span)
    first, result = course.state(turns[0], none, jnp.maximum(start, 0))
    here = Record(first, zero, zero)
    event = Event(first, first, zero, none, jnp.array(False))
    return Walk(
        here=here,
        last=first,
        stride=course.longest / 8,
        search=Search(zero + jnp.inf, zero + jnp.inf, course.resolution),
        part=none,
        is_apart=jnp.array(False),
        states=put(room(here, sizes[0], fields), here, none, jnp.array(True)),
        num_states=none + 1,
        jumps=room(event, sizes[1], True),
        num_jumps=none,
        # Towards a load that is no number no step would ever end.
        result=RESULTS.where(jnp.isfinite(span), result, RESULTS.infeasible_load),
    )


def go_on(course: Course, walk: Walk, num_steps: ArrayLike | None = None) -> Walk:
    """Return a walk after a number of steps more, or at its end."""
    turns = course.load.value
    max_states, max_jumps = walk.states.dissipation.size, walk.jumps.dissipation.size

    def goes_on(carry: tuple[Walk, Int[Array, ""]]) -> Flag:
        walk, number = carry
        is_open = (walk.part < turns.size - 1) & (walk.result == RESULTS.successful)
        return is_open if num_steps is None else is_open & (number < num_steps)

    def step(carry: tuple[Walk, Int[Array, ""]]) -> tuple[Walk, Int[Array, ""]]:
        walk, number = carry
        new = _after(course, walk, _try(course, walk))
        has_room = (new.num_states < max_states) & (new.num_jumps < max_jumps)
        is_short = ~has_room & (new.result == RESULTS.successful) & (new.part < turns.size - 1)
        result = RESULTS.where(is_short, RESULTS.store_full, new.result)
        return replace(new, result=result), number + 1

    return jax.lax.while_loop(goes_on, step, (walk, jnp.array(0)))[0]


def _try(course: Course, walk: Walk) -> Trial:
    """Return the next step, tried."""
    here, search = walk.here.place, walk.search
    target = course.load.value[walk.part + 1]
    left = jnp.abs(target - here.value)
    # The last step to a load that failed is a jump, if it fails again.
    is_final = search.distance <= search.nearness
    # Where it lost by its length alone, what is left of the step loses less.
    tries_whole = is_final | (search.loss <= course.threshold)
    within = jnp.where(tries_whole, search.distance, search.distance / 2)
    length = jnp.minimum(jnp.where(search.is_on, within, walk.stride), left)
    is_end = length >= left
    value = jnp.where(is_end, target, here.value + jnp.sign(target - here.value) * length)
    rate = (here.gap - walk.last.gap) / _nonzero(here.value - walk.last.value)
    gap = here.gap + jnp.where(search.is_on, 0, (value - here.value) * rate)
    gap = jnp.where(walk.is_apart, course.apart(), jnp.maximum(gap, 0))
    place, result = course.state(value, walk.part, gap)

    is_found = result == RESULTS.successful
    supplied = (here.force + place.force) / 2 * (value - here.value)
    loss = here.potential + supplied - place.potential
    is_smooth = is_found & (jnp.abs(loss) <= course.threshold) & ~walk.is_apart
    is_pulled = (result == RESULTS.pulled_off) & ~walk.is_apart
    is_jump = ~is_smooth & is_final & (is_found | is_pulled) & ~walk.is_apart
    presses = _brings_together(course.contact, course.at(value, walk.part))
    return Trial(
        place=replace(place, value=value),
        result=result,
        length=length,
        is_end=is_end,
        supplied=supplied,
        loss=jnp.where(is_found, loss, jnp.inf),
        is_smooth=is_smooth,
        is_jump=is_jump,
        is_pulled=is_jump & is_pulled,
        is_touch=walk.is_apart & is_found & presses,
        is_lost=~is_found & ~is_pulled & is_final & ~walk.is_apart,
    )


def _after(course: Course, walk: Walk, trial: Trial) -> Walk:
    """Return the walk after a step that was tried."""
    is_event = trial.is_jump | trial.is_touch
    accepts = trial.is_smooth | is_event | walk.is_apart
    is_apart = (walk.is_apart & ~trial.is_touch) | trial.is_pulled
    # Of surfaces that fall apart nothing is known, and of those that are, nothing is recorded.
    is_known = ~walk.is_apart & ~trial.is_pulled
    unknown = jnp.where(trial.is_pulled, jnp.nan, 0)
    new = Record(
        trial.place,
        walk.here.supplied + jnp.where(is_known, trial.supplied, unknown),
        walk.here.dissipation + jnp.where(is_known, trial.loss, unknown),
    )
    here = _choose(accepts, new, walk.here)
    last = _choose(accepts, walk.here.place, walk.last)
    is_kept = accepts & ~is_apart
    lost = jnp.where(trial.is_touch | trial.is_pulled, jnp.nan, trial.loss)
    event = Event(walk.here.place, here.place, lost, walk.num_states - 1, trial.is_touch)
    # The solver may find its way from further on, but not from anywhere.
    has_failed = trial.is_lost & (trial.is_end | (trial.length > course.longest / _FURTHER))
    search = _search(course, walk, trial, accepts, is_event)
    return Walk(
        here=here,
        last=_choose(is_event, here.place, last),
        stride=_stride(course, walk, trial, is_event, is_apart, accepts & ~search.is_on),
        search=search,
        part=walk.part + (accepts & trial.is_end),
        is_apart=is_apart,
        states=put(walk.states, here, walk.num_states, is_kept),
        num_states=walk.num_states + is_kept,
        jumps=put(walk.jumps, event, walk.num_jumps, is_event),
        num_jumps=walk.num_jumps + is_event,
        result=RESULTS.where(has_failed, trial.result, walk.result),
    )


def _search(course: Course, walk: Walk, trial: Trial, accepts: Flag, is_event: Flag) -> Search:
    """Return what is known of a load ahead after a step."""
    distance = jnp.where(accepts, walk.search.distance - trial.length, trial.length)
    is_over = is_event | (distance <= 0) | (accepts & trial.is_end)
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
    course: Course, walk: Walk, trial: Trial, is_event: Flag, is_apart: Flag, is_free: Flag
) -> Scalar:
    """Return the length of the next step where none has failed, after a step."""
    is_slow = jnp.abs(trial.loss) > course.threshold / 8
    stride = jnp.where(is_slow, walk.stride / 2, jnp.minimum(2 * walk.stride, course.longest))
    # A load that was only too far away is passed by steps that grow again.
    stride = jnp.where(walk.search.is_on, 2 * trial.length, stride)
    stride = jnp.where(is_event, course.longest / 8, stride)
    stride = jnp.where(is_apart, course.longest, stride)
    return jnp.where(is_free, stride, walk.stride)


@jax.jit
def travelled(load: Load, walk: Walk) -> Scalar:
    """Return the part of the programme that is done."""
    turns, here = load.value, walk.here.place.value
    lengths = jnp.abs(jnp.diff(turns))
    done = jnp.sum(jnp.where(jnp.arange(lengths.size) < walk.part, lengths, 0))
    return (done + jnp.abs(here - turns[walk.part])) / jnp.sum(lengths)


def _own_energy(contact: Contact) -> Scalar:
    """Return the elastic energy of full contact and that of the deepest adhesion everywhere."""
    values = contact.profile.values
    deepest = -jnp.min(jnp.where(jnp.isfinite(values), values, 0))
    solid = contact.solid
    elastic = solid.share * solid.held_by(0).energy(solid.flush(contact.heights))
    return elastic + contact.area * deepest


def _brings_together(contact: Contact, load: Load) -> Flag:
    control = contact.control(load)
    return control.energy(jnp.ones(())) > control.energy(jnp.zeros(()))


def _choose(condition: Flag, one: Any, other: Any) -> Any:
    return jax.tree.map(partial(jnp.where, condition), one, other)


def _nonzero(value: Scalar) -> Scalar:
    return jnp.where(value == 0, 1, value)

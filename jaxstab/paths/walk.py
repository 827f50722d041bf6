"""The walk along a programme of loads, step by step, through jumps."""

from collections.abc import Callable
from time import perf_counter
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int

from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.loads import Load
from jaxstab.paths.programme import Course
from jaxstab.paths.record import Count, Event, Place, Record, Store
from jaxstab.paths.step import Jumps, Search, Walk, after, aimed

States = Store | Count
AnyWalk = TypeVar("AnyWalk", bound=Walk)

_BATCH_SECONDS, _BATCH_STEPS = 0.5, 1024


def walk(
    course: Course,
    start: Field,
    states: Callable[[Record], States],
    jumps: Callable[[Event], Jumps],
) -> Walk[Jumps]:
    """Return where a path ends and what it has recorded, as `begin` and `go_on` do."""
    return go_on(course, begin(course, start, states, jumps))


def begin(
    course: Course,
    start: Field,
    states: Callable[[Record], States],
    jumps: Callable[[Event], Jumps],
) -> Walk[Jumps]:
    """Return a walk at the first turning point, whose equilibrium is sought from a gap.

    The other arguments are those of `begin_at`.
    """
    value, part = course.load.value[0], jnp.array(0)
    start = course.start(value, part, jnp.maximum(start, 0))
    return begin_at(course, course.state(value, part, start), states, jumps)


def begin_at(
    course: Course,
    first: tuple[Place, RESULTS],
    states: Callable[[Record], States],
    jumps: Callable[[Event], Jumps],
) -> Walk[Jumps]:
    """Return a walk at the first turning point.

    Arguments:
        course: what is the same all the way.
        first: the equilibrium there, and how the solver ended.
        states: makes an empty store of states like one of them.
        jumps: the same of jumps.
    """
    turns = course.load.value
    span = jnp.max(turns) - jnp.min(turns)
    none, zero = jnp.array(0), jnp.zeros_like(span)
    place, result = first
    is_endless = (result == RESULTS.successful) & ~jnp.isfinite(span)
    here = Record(place, zero)
    return Walk(
        here=here,
        last=place,
        stride=course.longest / 8,
        search=Search(zero + jnp.inf, zero, course.resolution),
        part=none,
        is_apart=jnp.array(False),
        states=states(here).with_entry(here, jnp.array(True)),
        jumps=jumps(Event(place, place, zero, none, jnp.array(False))),
        # Towards a load that is no number no step would ever end.
        result=RESULTS.where(is_endless, RESULTS.infeasible_load, result),
    )


def go_on(course: Course, walk: Walk[Jumps], num_steps: ArrayLike | None = None) -> Walk[Jumps]:
    """Return a walk after a number of steps more, where its room is full, or at its end."""

    def goes_on(carry: tuple[Walk[Jumps], Int[Array, ""]]) -> Flag:
        walk, number = carry
        is_open = walk.is_open(course.load) & ~walk.is_full
        return is_open if num_steps is None else is_open & (number < num_steps)

    def step(carry: tuple[Walk[Jumps], Int[Array, ""]]) -> tuple[Walk[Jumps], Int[Array, ""]]:
        walk, number = carry
        aim = aimed(course, walk)
        state = course.state(aim.value, walk.part, *aim.search)
        return after(course, walk, aim, *state), number + 1

    return jax.lax.while_loop(goes_on, step, (walk, jnp.array(0)))[0]


@jax.jit
def travelled(load: Load, walk: Walk) -> Scalar:
    """Return the part of the programme that is done."""
    turns, here = load.value, walk.here.place.value
    lengths = jnp.abs(jnp.diff(turns))
    done = jnp.sum(jnp.where(jnp.arange(lengths.size) < walk.part, lengths, 0))
    return (done + jnp.abs(here - turns[walk.part])) / jnp.sum(lengths)


def in_batches(
    walk: AnyWalk, further: Callable[[AnyWalk, int], AnyWalk], load: Load, bar: Any
) -> AnyWalk:
    """Return a walk at its end, taken there in batches of steps of about a second each.

    Arguments:
        walk: where it begins.
        further: returns a walk after a number of steps more.
        load: the programme.
        bar: shows the part of it that is done, in per cent.
    """
    num_steps = 1
    while walk.is_open(load):
        start = perf_counter()
        # While it waits, an interrupt stays pending.
        walk = jax.block_until_ready(further(walk, num_steps))
        if not bar.disable:
            bar.update(int(100 * travelled(load, walk)) - bar.n)
        # The first time it is compiled.
        if perf_counter() - start < _BATCH_SECONDS:
            num_steps = min(2 * num_steps, _BATCH_STEPS)
    return walk

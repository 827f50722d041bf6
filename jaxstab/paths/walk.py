"""The walk along a programme of loads, step by step, through jumps."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int

from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag
from jaxstab.paths.jump_detection import Bisection, Jumps, Progress, apply_step, next_step
from jaxstab.paths.programme import Programme
from jaxstab.paths.record import Count, Event, PathPoint, Place, Table

States = Table | Count


def begin(
    programme: Programme,
    start: Field | None,
    states: Callable[[PathPoint], States],
    jumps: Callable[[Event], Jumps],
) -> Progress[Jumps]:
    """Return a walk at the first turning point, its equilibrium sought from a gap if given."""
    contact, value, part = programme.contact, programme.load.value[0], jnp.array(0)
    if start is None:
        start = contact.control(programme.load[0]).starting_gap(contact.heights)
    start = programme.start(value, part, jnp.maximum(start, 0))
    return begin_at(programme, programme.state(value, part, start), states, jumps)


def begin_at(
    programme: Programme,
    first: tuple[Place, RESULTS],
    states: Callable[[PathPoint], States],
    jumps: Callable[[Event], Jumps],
) -> Progress[Jumps]:
    """Return a walk at the first turning point, given the equilibrium there and how it was found.

    `states` and `jumps` make an empty store of entries like one of them.
    """
    turns = programme.load.value
    span = jnp.max(turns) - jnp.min(turns)
    none, zero = jnp.array(0), jnp.zeros_like(span)
    place, result = first
    is_endless = (result == RESULTS.successful) & ~jnp.isfinite(span)
    here = PathPoint(place, zero)
    return Progress(
        here=here,
        last=place,
        stride=programme.longest / 8,
        bisection=Bisection(zero + jnp.inf, zero, programme.resolution),
        part=none,
        is_apart=jnp.array(False),
        states=states(here).with_entry(here, jnp.array(True)),
        jumps=jumps(Event(place, place, zero, none, jnp.array(False))),
        # Towards a load that is no number no step would ever end.
        result=RESULTS.where(is_endless, RESULTS.infeasible_load, result),
    )


def go_on(
    programme: Programme, walk: Progress[Jumps], num_steps: ArrayLike | None = None
) -> Progress[Jumps]:
    """Return a walk after a number of steps more, where its room is full, or at its end."""

    def goes_on(carry: tuple[Progress[Jumps], Int[Array, ""]]) -> Flag:
        walk, number = carry
        is_open = walk.is_open(programme.load) & ~walk.is_full
        return is_open if num_steps is None else is_open & (number < num_steps)

    def step(
        carry: tuple[Progress[Jumps], Int[Array, ""]],
    ) -> tuple[Progress[Jumps], Int[Array, ""]]:
        walk, number = carry
        aim = next_step(programme, walk)
        state = programme.state(aim.value, walk.part, aim.start, aim.least_potential, aim.is_final)
        return apply_step(programme, walk, aim, *state), number + 1

    return jax.lax.while_loop(goes_on, step, (walk, jnp.array(0)))[0]

"""The walk along a programme of loads, step by step, through jumps.

`travel` takes it to its end: in batches that a bar shows, or inside of a trace in one program.
"""

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Generic, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.core.batching import by_entries
from jaxstab.core.checks import is_traced
from jaxstab.core.compile import program
from jaxstab.core.progress import advance_to
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.loads import Load
from jaxstab.paths.jump_detection import Bisection, Jumps, Progress, apply_step, next_step
from jaxstab.paths.programme import Programme
from jaxstab.paths.record import Count, Event, PathPoint, Table

_BATCH_SECONDS, _BATCH_STEPS = 0.5, 1024

States = Table[PathPoint] | Count


class Stores(NamedTuple, Generic[Jumps]):
    """Functions that make an empty store of states, and of jumps, like one of them."""

    states: Callable[[PathPoint], States]
    jumps: Callable[[Event], Jumps]


def begin(stores: Stores[Jumps], programme: Programme, start: Field | None) -> Progress[Jumps]:
    """Return a walk at the first turning point, its equilibrium sought from a gap if given."""
    contact, turns, none = programme.contact, programme.load.value, jnp.array(0)
    if start is None:
        start = contact.control(programme.load[0]).starting_gap(contact.heights)
    start = programme.start(turns[0], jnp.maximum(start, 0))
    here, result = programme.state(turns[0], start)
    span = jnp.max(turns) - jnp.min(turns)
    zero = jnp.zeros_like(span)
    is_passable = jnp.isfinite(span) & (programme.resolution > 0)
    is_endless = (result == RESULTS.successful) & ~is_passable
    return Progress(
        here=here,
        last=here,
        stride=programme.longest / 8,
        bisection=Bisection(zero + jnp.inf, zero, programme.resolution),
        part=none,
        is_apart=jnp.array(False),
        states=stores.states(here).with_entry(here, jnp.array(True)),
        jumps=stores.jumps(Event(here, here, zero, none, jnp.array(False))),
        # Towards a load that is no number, or from zero to zero, no step would ever end.
        result=RESULTS.where(is_endless, RESULTS.infeasible_load, result),
    )


def go_on(
    programme: Programme, walk: Progress[Jumps], num_steps: ArrayLike | None = None
) -> Progress[Jumps]:
    """Return a walk after a number of steps more, where its room is full, or at its end."""

    Carry = tuple[Progress[Jumps], Int[Array, ""]]

    def goes_on(carry: Carry) -> Flag:
        walk, number = carry
        is_open = walk.is_open(programme.load) & ~walk.is_full
        return is_open if num_steps is None else is_open & (number < num_steps)

    def step(carry: Carry) -> Carry:
        walk, number = carry
        aim = next_step(programme, walk)
        state = programme.state(aim.value, aim.start, aim.least_potential, aim.is_final)
        return apply_step(programme, walk, aim, *state), number + 1

    return jax.lax.while_loop(goes_on, step, (walk, jnp.array(0)))[0]


def travel(
    stores: Stores[Jumps],
    programme: Programme,
    start: Field | None,
    keep: Callable[[Progress[Jumps]], Progress[Jumps]] = lambda walk: walk,
) -> Progress[Jumps]:
    """Return a walk at its end; outside of a trace in batches, inside of one if it has room.

    The first equilibrium is sought from the start. The bar shows the part of the way that is done,
    in per cent. The records can be taken out after each batch, of about a second.
    """
    walk = keep(_begin(stores, programme, start))
    if is_traced((programme, start)):
        return _go_on(programme, walk, None)
    num_steps = 1
    while walk.is_open(programme.load):
        begun = perf_counter()
        # While it waits, an interrupt stays pending.
        walk = keep(jax.block_until_ready(_go_on(programme, walk, num_steps)))
        advance_to(lambda walk=walk: int(100 * travelled(programme.load, walk)))
        # The first time it is compiled.
        if perf_counter() - begun < _BATCH_SECONDS:
            num_steps = min(2 * num_steps, _BATCH_STEPS)
    return walk


@partial(program, static_argnums=0)
def _begin(stores: Stores[Jumps], programme: Programme, start: Field | None) -> Progress[Jumps]:
    return by_entries(partial(begin, stores))(programme, start)


_go_on = program(by_entries(go_on))


@jax.jit
def travelled(load: Load, walk: Progress) -> Scalar:
    """Return the part of the programme that is done."""
    turns, here = load.value, walk.here.value
    lengths = jnp.abs(jnp.diff(turns))
    done = jnp.sum(jnp.where(jnp.arange(lengths.size) < walk.part, lengths, 0))
    return (done + jnp.abs(here - turns[walk.part])) / jnp.sum(lengths)

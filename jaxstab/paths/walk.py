"""The walk along a programme of loads, step by step, through jumps.

`travel` takes it to its end: in batches that a bar shows, or inside of a trace in one program.
"""

from collections.abc import Callable
from functools import partial
from time import perf_counter

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.core.checks import is_traced
from jaxstab.core.compile import program
from jaxstab.core.control_flow import by_entries
from jaxstab.core.progress import advance_to
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.loads import Load
from jaxstab.paths.jump_detection import Bisection, Progress, Records, apply_step, next_step
from jaxstab.paths.programme import Programme
from jaxstab.paths.record import Event

_BATCH_SECONDS, _BATCH_STEPS = 0.5, 1024


def _first(
    store: Callable[[Event], Records], programme: Programme, start: Field | None
) -> Progress[Records]:
    """Return a walk at the first turning point, its equilibrium sought from a gap if given.

    The store makes empty records of jumps like one, and of their states.
    """
    contact, turns, none = programme.contact, programme.load.value, jnp.array(0)
    if start is None:
        start = contact.control(programme.load[0]).starting_gap(contact.heights)
    here, result = programme.state(turns[0], start)
    span = jnp.max(turns) - jnp.min(turns)
    zero = jnp.zeros_like(span)
    is_passable = jnp.isfinite(span) & (programme.resolution > 0)
    is_endless = (result == RESULTS.successful) & ~is_passable
    yes, no = jnp.array(True), jnp.array(False)
    event = Event(here, here, zero, none, no)
    return Progress(
        here=here,
        last=here,
        stride=programme.longest / 8,
        bisection=Bisection(zero + jnp.inf, zero, programme.resolution),
        part=none,
        is_apart=no,
        gap=here.gap,
        num_states=none + 1,
        records=store(event).with_step(here, yes, event, no),
        # Towards a load that is no number, or from zero to zero, no step would ever end.
        result=RESULTS.where(is_endless, RESULTS.infeasible_load, result),
    )


@partial(program, static_argnums=0)
def _begin(
    store: Callable[[Event], Records], programme: Programme, start: Field | None
) -> Progress[Records]:
    return by_entries(partial(_first, store))(programme, start)


@program
@by_entries
def _go_on(
    programme: Programme, walk: Progress[Records], num_steps: ArrayLike | None = None
) -> Progress[Records]:
    """Return a walk after a number of steps more, where its room is full, or at its end."""

    Carry = tuple[Progress[Records], Int[Array, ""]]

    def goes_on(carry: Carry) -> Flag:
        walk, number = carry
        is_open = walk.is_open(programme.load) & ~walk.records.is_full
        return is_open if num_steps is None else is_open & (number < num_steps)

    def step(carry: Carry) -> Carry:
        walk, number = carry
        aim = next_step(programme, walk)
        state = programme.state(aim.value, aim.gap, aim.least_potential, aim.is_final)
        return apply_step(programme, walk, aim, *state), number + 1

    return jax.lax.while_loop(goes_on, step, (walk, jnp.array(0)))[0]


def travel(
    store: Callable[[Event], Records],
    programme: Programme,
    start: Field | None,
    keep: Callable[[Progress[Records]], Progress[Records]] = lambda walk: walk,
) -> Progress[Records]:
    """Return a walk at its end; outside of a trace in batches, inside of one if it has room.

    The first equilibrium is sought from the start. The bar shows the part of the way that is done,
    in per cent. The records can be taken out after each batch, of about a second.
    """
    walk = keep(_begin(store, programme, start))
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


@jax.jit
def travelled(load: Load, walk: Progress) -> Scalar:
    """Return the part of the programme that is done."""
    turns, here = load.value, walk.here.value
    lengths = jnp.abs(jnp.diff(turns))
    done = jnp.sum(jnp.where(jnp.arange(lengths.size) < walk.part, lengths, 0))
    return (done + jnp.abs(here - turns[walk.part])) / jnp.sum(lengths)

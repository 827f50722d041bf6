"""A walk to its end: in batches that a bar shows, or inside of a trace in one program."""

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any, Generic, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact
from jaxstab.core.batching import by_lanes
from jaxstab.core.checks import is_traced
from jaxstab.core.compile import program
from jaxstab.core.types import Field, Scalar
from jaxstab.loads import Load
from jaxstab.paths.jump_detection import Jumps, Progress
from jaxstab.paths.programme import Programme
from jaxstab.paths.record import Count, Event, PathPoint, Table
from jaxstab.paths.walk import begin, go_on

_BATCH_SECONDS, _BATCH_STEPS = 0.5, 1024


class WalkSetup(NamedTuple, Generic[Jumps]):
    """The choices made before compiling.

    Attributes:
        programme_of: makes the programme of a contact, its loads, and settings.
        states: makes an empty store of states like one of them.
        jumps: the same of jumps.
    """

    programme_of: Callable[..., Programme]
    states: Callable[[PathPoint], Table | Count]
    jumps: Callable[[Event], Jumps]


def travel(
    setup: WalkSetup[Jumps],
    bar: Any,
    *inputs: Any,
    keep: Callable[[Progress[Jumps]], Progress[Jumps]] = lambda walk: walk,
) -> Progress[Jumps]:
    """Return a walk at its end; outside of a trace in batches, inside of one if it has room.

    The inputs are contact, load, where the first equilibrium starts, and settings of the programme.
    The bar shows the part of it that is done, in per cent. The records can be taken out after each
    batch, of about a second.
    """
    walk, load = keep(_begin(setup, *inputs)), inputs[1]
    if is_traced(inputs):
        return _go_on(setup, walk, None, *inputs)
    num_steps = 1
    while walk.is_open(load):
        start = perf_counter()
        # While it waits, an interrupt stays pending.
        walk = keep(jax.block_until_ready(_go_on(setup, walk, num_steps, *inputs)))
        if not bar.disable:
            bar.update(int(100 * travelled(load, walk)) - bar.n)
        # The first time it is compiled.
        if perf_counter() - start < _BATCH_SECONDS:
            num_steps = min(2 * num_steps, _BATCH_STEPS)
    return walk


@partial(program, static_argnums=0)
def _begin(setup: WalkSetup[Jumps], *inputs: Any) -> Progress[Jumps]:
    def first(contact: Contact, load: Load, start: Field | None, *settings: Scalar) -> Progress:
        return begin(setup.programme_of(contact, load, *settings), start, setup.states, setup.jumps)

    return by_lanes(first)(*inputs)


@partial(program, static_argnums=0)
def _go_on(
    setup: WalkSetup[Jumps], walk: Progress[Jumps], num_steps: int | None, *inputs: Any
) -> Progress[Jumps]:
    def further(
        walk: Progress,
        num_steps: Int[Array, ""] | None,
        contact: Contact,
        load: Load,
        _: Field | None,
        *settings: Scalar,
    ) -> Progress:
        return go_on(setup.programme_of(contact, load, *settings), walk, num_steps)

    return by_lanes(further)(walk, num_steps, *inputs)


@jax.jit
def travelled(load: Load, walk: Progress) -> Scalar:
    """Return the part of the programme that is done."""
    turns, here = load.value, walk.here.place.value
    lengths = jnp.abs(jnp.diff(turns))
    done = jnp.sum(jnp.where(jnp.arange(lengths.size) < walk.part, lengths, 0))
    return (done + jnp.abs(here - turns[walk.part])) / jnp.sum(lengths)

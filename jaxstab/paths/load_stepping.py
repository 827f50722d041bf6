"""Load stepping along a load path, through jumps.

`step_to_end` goes to its end: in batches that a bar shows, or inside of a trace in one program.
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
from jaxstab.paths.load_path import LoadPath
from jaxstab.paths.record import Event

_BATCH_SECONDS, _BATCH_STEPS = 0.5, 1024


def _first(
    store: Callable[[Event], Records], load_path: LoadPath, start: Field | None
) -> Progress[Records]:
    """Return the progress at the first turning point, its equilibrium sought from a gap if given.

    The store makes empty records of jumps like one, and of their states.
    """
    contact, turns, none = load_path.contact, load_path.load.value, jnp.array(0)
    if start is None:
        start = contact.control(load_path.load[0]).starting_gap(contact.heights)
    here, result = load_path.state(turns[0], start)
    span = jnp.max(turns) - jnp.min(turns)
    zero = jnp.zeros_like(span)
    is_passable = jnp.isfinite(span) & (load_path.resolution > 0)
    is_endless = (result == RESULTS.successful) & ~is_passable
    yes, no = jnp.array(True), jnp.array(False)
    event = Event(here, here, zero, none, no)
    return Progress(
        here=here,
        last=here,
        next_length=load_path.max_step / 8,
        bisection=Bisection(zero + jnp.inf, zero, load_path.resolution),
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
    store: Callable[[Event], Records], load_path: LoadPath, start: Field | None
) -> Progress[Records]:
    return by_entries(partial(_first, store))(load_path, start)


@program
@by_entries
def _advance(
    load_path: LoadPath, progress: Progress[Records], num_steps: ArrayLike | None
) -> Progress[Records]:
    """Return the progress after a number of steps more, where its room is full, or at its end."""

    Carry = tuple[Progress[Records], Int[Array, ""]]

    def goes_on(carry: Carry) -> Flag:
        progress, number = carry
        is_open = progress.is_open(load_path.load) & ~progress.records.is_full
        return is_open if num_steps is None else is_open & (number < num_steps)

    def step(carry: Carry) -> Carry:
        progress, number = carry
        trial = next_step(load_path, progress)
        state = load_path.state(trial.value, trial.gap, trial.least_potential, trial.is_final)
        return apply_step(load_path, progress, trial, *state), number + 1

    return jax.lax.while_loop(goes_on, step, (progress, jnp.array(0)))[0]


def step_to_end(
    store: Callable[[Event], Records],
    load_path: LoadPath,
    start: Field | None,
    keep: Callable[[Progress[Records]], Progress[Records]] = lambda progress: progress,
) -> Progress[Records]:
    """Return the progress at its end; outside of a trace in batches, inside of one if it has room.

    The first equilibrium is sought from the start. The bar shows the fraction of the load path that
    is done. The records can be taken out after each batch, of about a second.
    """
    progress = keep(_begin(store, load_path, start))
    if is_traced((load_path, start)):
        return _advance(load_path, progress, None)
    num_steps = 1
    while progress.is_open(load_path.load):
        begun = perf_counter()
        # While it waits, an interrupt stays pending.
        progress = keep(jax.block_until_ready(_advance(load_path, progress, num_steps)))
        advance_to(lambda progress=progress: int(100 * fraction_done(load_path.load, progress)))
        # The first time it is compiled.
        if perf_counter() - begun < _BATCH_SECONDS:
            num_steps = min(2 * num_steps, _BATCH_STEPS)
    return progress


@jax.jit
def fraction_done(load: Load, progress: Progress) -> Scalar:
    """Return the fraction of the load path that is done."""
    turns, here = load.value, progress.here.value
    lengths = jnp.abs(jnp.diff(turns))
    done = jnp.sum(jnp.where(jnp.arange(lengths.size) < progress.part, lengths, 0))
    return (done + jnp.abs(here - turns[progress.part])) / jnp.sum(lengths)

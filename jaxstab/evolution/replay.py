"""The accepted steps of an evolution once more, for their derivatives."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.contact import Contact
from jaxstab.core.control_flow import entry_of
from jaxstab.core.implicit import nan_if, tangent_of
from jaxstab.core.table import Table
from jaxstab.core.types import Flag, Scalar
from jaxstab.evolution.evolution import Memory, Totals
from jaxstab.evolution.jump_time import time_of_jump
from jaxstab.evolution.legs import Increment, LegEnd, along
from jaxstab.evolution.step import StepRecord, take_step
from jaxstab.loads import Load


class Replay(NamedTuple):
    """The results of steps that depend on the contact, the load and the times.

    Attributes:
        totals: the scalars at the given times.
        losses: of each increment.
        pressures: the mean pressure at the start, and at the end of each increment.
        delays: of the end of each increment, all zero; their derivatives are those of jump times.
        last: gap and strains at the end.
    """

    totals: Totals
    losses: Float[Array, " increments"]
    pressures: Float[Array, " states"]
    delays: Float[Array, " increments"]
    last: Memory


def changes(
    _: Replay, known: tuple[Table[Increment], LegEnd], inputs: tuple, tangents: tuple
) -> tuple[Replay, Flag]:
    """Return how the results of steps change with the inputs of a replay, a rule for `attach`."""
    increments, ends = known
    moved: Replay = tangent_of(partial(replay, increments, ends.num_steps), inputs, tangents)
    totals = jax.tree.map(partial(jax.vmap(nan_if), ~ends.is_found), moved.totals)
    return moved._replace(totals=totals), jnp.array(False)


def replay(
    increments: Table[Increment],
    counts: Int[Array, " times"],
    contact: Contact,
    load: Load,
    times: Float[Array, " times"],
    start: StepRecord,
) -> Replay:
    """Take the accepted steps again, as a scan, which has derivatives.

    1. An increment ends at its fraction of a leg, whose ends are the given times.
    2. An increment with a jump is delayed as the jump is: the increment of no length before it ends
       when the contact jumps, and the increment of the jump has the same length after every change.
       So its states do not follow the time ever faster.
    3. Take the step to the load at the end.

    Arguments:
        increments: the accepted steps.
        counts: the number of increments up to each of the times.
        contact, load, times: as in `evolve`.
        start: the record at the first time.
    """
    Carry = tuple[StepRecord, Scalar]

    def one(carry: Carry, i: Int[Array, ""]) -> tuple[Carry, tuple[Totals, Scalar]]:
        old, delay_before = carry

        def step() -> Carry:
            leg, begin, end, loss, _ = entry_of(increments.rows, i)
            span = times[leg + 1] - times[leg]
            rate = (load.value[leg + 1] - load.value[leg]) / span
            has_jumped = loss > 0

            def delayed_load(delay: Scalar) -> Load:
                return load[0].at(along(load.value, leg, end) + rate * delay)

            def delay_of_jump() -> Scalar:
                until = (entry_of(increments.rows, i + 1).end - end) * span
                ahead = delayed_load(delay_before)
                return delay_before + time_of_jump(contact, ahead, rate, old.memory, until)

            # A value at the time of a jump has no derivative.
            stays = jnp.where(has_jumped, nan_if(end == 1, delay_before), 0)
            delay = jax.lax.cond(begin == end, delay_of_jump, lambda: stays)
            dt = (end - begin) * span + delay - delay_before
            _, with_loss = take_step(contact, delayed_load(delay), old, dt)
            return with_loss(has_jumped), delay

        return jax.lax.cond(i < increments.count, step, lambda: carry), (old.totals, delay_before)

    # Reverse mode keeps one record for each step, and computes the rest of it again.
    numbers = jnp.arange(len(increments.rows.leg) + 1)
    begin = start, jnp.zeros_like(times[0])
    (last, _), (totals, delays) = jax.lax.scan(jax.checkpoint(one), begin, numbers)
    return Replay(
        totals=jax.tree.map(lambda leaf: leaf[counts], totals),
        losses=jnp.diff(totals.jump_dissipation),
        pressures=totals.mean_pressure,
        delays=delays[1:],
        last=last.memory,
    )

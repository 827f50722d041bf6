"""Time steps of adaptive length along the legs of a load, which are linear in time."""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.contact import Contact
from jaxstab.core.accuracy import rounding_of_numbers
from jaxstab.core.checks import array
from jaxstab.core.compile import program
from jaxstab.core.control_flow import by_entries, choose
from jaxstab.core.results import RESULTS
from jaxstab.core.table import Table
from jaxstab.core.types import Flag, Scalar
from jaxstab.evolution.evolution import Memory, Totals, or_nan
from jaxstab.evolution.step import StepRecord, errors_of_step, take_step
from jaxstab.loads import Load

# The error of a step by default. In float32 less is the rounding of equilibria.
RTOL = {"float64": 1e-3, "float32": 1e-2}
# The shortest step, over the leg and over the shortest relaxation time.
_SHORTEST_OF_LEG = 1e-6
_SHORTEST_OF_RELAXATION = 1e-4
# How much longer or shorter than the last a step may be.
_GROWTH = 4.0
_SHRINKAGE = 0.1
_CAUTION = 0.9


class TimeStepping(eqx.Module):
    """A contact in time, and how it is stepped.

    Attributes:
        contact: the contact, of a `Viscoelastic` solid.
        load: the kind of load, of which all but its value is used.
        rtol: the tolerance of the error of a step.
        keeps_memory: whether to keep gap and strains at the given times.
    """

    contact: Contact
    load: Load
    rtol: Scalar
    keeps_memory: bool = eqx.field(static=True)


class Leg(NamedTuple):
    """A leg of the load, between two given times: its number, and times and loads at both ends.

    Before the first time there is none: its number is -1, and both ends are the same.
    """

    number: Int[Array, "..."]
    times: Float[Array, "... 2"]
    loads: Float[Array, "... 2"]


class Increment(NamedTuple):
    """A step that was accepted. Before one with a jump stands one of no length.

    Attributes:
        leg: the number of its leg.
        start, end: the fractions of the leg at its ends.
        loss: of a jump.
        mean_pressure: at its end.
    """

    leg: Int[Array, "..."]
    start: Float[Array, "..."]
    end: Float[Array, "..."]
    loss: Float[Array, "..."]
    mean_pressure: Float[Array, "..."]


class LegEnd(NamedTuple):
    """The state at a given time, NaN if there is none; its result, and the number of all steps."""

    totals: Totals
    memory: Memory | None
    result: RESULTS
    num_steps: Int[Array, "..."]

    @property
    def is_found(self) -> Flag:
        """Whether there is a state."""
        return self.result == RESULTS.successful


Steps = tuple[StepRecord, Table[Increment]]


def legs_between(times: Any, loads: Any) -> Leg:
    """Return the legs that end at given times, the first one of no length."""
    numbers = np.arange(times.size) - 1
    ends = np.stack([np.maximum(numbers, 0), numbers + 1], axis=-1)
    return Leg(numbers, times[ends], loads[ends])


def no_increments(max_steps: int, dtype: Any) -> Table[Increment]:
    """Return a table of increments with room for a number of steps."""
    # A jump takes two entries.
    zeros = np.zeros(max_steps + 1)
    column = array(zeros, dtype)
    return Table(Increment(array(zeros, int), *[column] * 4), array(0))


def along(column: Float[Array, " times"], leg: Int[Array, "..."] | int, fraction: Array) -> Array:
    """Return the time or the value of the load at a fraction of a leg."""
    return column[leg] + fraction * (column[leg + 1] - column[leg])


def _follow_leg(stepping: TimeStepping, steps: Steps, leg: Leg) -> tuple[Steps, LegEnd]:
    """Return the last record and all increments at the end of a leg, and its end.

    1. Choose the length of the step: that of the last error, but not beyond the end of the leg.
    2. Take the step, and estimate its errors over the tolerance.
    3. Accept a step that is smooth, with errors of at most one, or that is the shortest one. In a
       shortest step that does not balance the energies the contact has jumped: count its loss.
    4. Choose the length that the error allows: that of the next step, or of another try.
    """
    Carry = tuple[StepRecord, Table[Increment], Scalar]
    contact = stepping.contact
    span = leg.times[1] - leg.times[0]
    shortest = _shortest(contact, span)
    room = len(steps[1].rows.leg)

    def goes_on(carry: Carry) -> Flag:
        record, increments, fraction = carry
        # Under JAX transformations nothing has refused times that do not increase.
        has_time = (fraction < 1) & (span > 0) & (increments.count + 1 < room)
        return has_time & (record.result == RESULTS.successful)

    def step(carry: Carry) -> Carry:
        old, increments, start = carry
        left = (1 - start) * span
        dt = _cut(old.dt, left)
        end = jnp.where(dt < left, start + dt / span, 1)

        load = stepping.load.at(along(leg.loads, 0, end))
        new, with_loss = take_step(contact, load, old, dt)
        is_solved = new.result == RESULTS.successful
        error, energy_error = errors_of_step(contact, old, new, dt, stepping.rtol)
        error = jnp.maximum(error, energy_error)
        error = jnp.where(is_solved & ~jnp.isnan(error), error, jnp.inf)

        is_smooth = error <= 1
        is_shortest = ~(dt > shortest)
        is_accepted = (is_smooth | is_shortest) & is_solved
        # The shortest step may bend much, behind a turn of the load, and lose nothing.
        new = with_loss(is_accepted & (energy_error > 1))
        loss = new.totals.jump_dissipation - old.totals.jump_dissipation
        # A step of no length before a jump moves with it in derivatives.
        none = jnp.zeros_like(loss)
        pause = Increment(leg.number, start, start, none, old.totals.mean_pressure)
        increments = increments.with_entry(pause, loss > 0)
        step = Increment(leg.number, start, end, loss, new.totals.mean_pressure)
        increments = increments.with_entry(step, is_accepted)

        record, fraction = choose(is_accepted, (new, end), (old, start))
        next_dt = jnp.maximum(_next_length(old.dt, dt, error), shortest)
        # A step without an equilibrium is tried again, unless there is no shorter one.
        result = RESULTS.where(is_shortest, new.result, RESULTS.successful)
        return replace(record, dt=next_dt, result=result), increments, fraction

    start = jnp.where(leg.number < 0, jnp.ones_like(span), 0)
    record, increments, fraction = jax.lax.while_loop(goes_on, step, (*steps, start))
    is_short = (fraction < 1) & (record.result == RESULTS.successful)
    why = RESULTS.where(span > 0, RESULTS.store_full, RESULTS.unordered_times)
    result = RESULTS.where(is_short, why, record.result)
    memory = None
    if stepping.keeps_memory:
        memory = or_nan(record.memory, result)
    end = LegEnd(or_nan(record.totals, result), memory, result, increments.count)
    return (replace(record, result=result), increments), end


follow_leg = program(_follow_leg)


@program
@by_entries
def follow_legs(stepping: TimeStepping, steps: Steps, legs: Leg) -> tuple[Steps, LegEnd]:
    """Return the last record and all increments at the end of several legs, and the end of each."""
    return jax.lax.scan(partial(_follow_leg, stepping), steps, legs)


def _shortest(contact: Contact, span: Scalar) -> Scalar:
    """Return the length of the shortest step on a leg."""
    solid: Any = contact.solid
    shortest = jnp.minimum(_SHORTEST_OF_LEG * span, _SHORTEST_OF_RELAXATION * solid.times[0])
    return jnp.maximum(shortest, rounding_of_numbers(span.dtype) * span)


def _cut(dt: Scalar, left: Scalar) -> Scalar:
    """Return the length of a step, with as much time left on its leg."""
    dt = jnp.minimum(dt, left)
    # Two equal steps rather than a long one and a tiny one.
    return jnp.where((dt < left) & (2 * dt > left), left / 2, dt)


def _next_length(allowed: Scalar, dt: Scalar, error: Scalar) -> Scalar:
    """Return the length that the error of a step allows, which falls with its square.

    The end of a leg cuts a step below the length that was allowed before, which stands unless the
    error calls for a shorter one.
    """
    factor = jnp.clip(_CAUTION / jnp.sqrt(error), _SHRINKAGE, _GROWTH)
    longer = jnp.where(factor >= 1, jnp.maximum(allowed, dt * factor), dt * factor)
    return jnp.where(error <= 1, longer, dt * jnp.minimum(factor, 0.5))

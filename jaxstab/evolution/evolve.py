"""A viscoelastic contact in time, under a load with one value for each time."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.branches.states import PathInterrupted
from jaxstab.contact import Contact, require_same_contact
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.checks import (
    concrete,
    integer,
    is_transformed,
    parameter,
    positive_parameter,
    require,
    require_finite,
    scalar_parameter,
)
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.control_flow import by_entries, entry_of
from jaxstab.core.implicit import attach, nan_if, pushed, undefined
from jaxstab.core.interrupts import early_ends, interrupts_after, interrupts_held
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.stack import stacked
from jaxstab.core.table import Table
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.warn import warn
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrate import initial_gap
from jaxstab.equilibrium.window import padded_start
from jaxstab.evolution.evolution import Evolution, Internal, Totals, relaxed_contact
from jaxstab.evolution.jump_time import time_of_jump
from jaxstab.evolution.step import RTOL, Interval, Moment, Step, along, first_moment, march, stepped
from jaxstab.loads import Load, require_load, require_same_machine


# After a failure numbers are NaN.
@own_conventions()
def evolve(
    contact: Contact,
    load: Load,
    times: ArrayLike,
    *,
    initial: ArrayLike | Equilibrium | Evolution | None = None,
    rtol: ArrayLike | None = None,
    fields: bool = False,
    progress: bool | None = None,
    max_steps: int = 2000,
    throw: bool = True,
) -> Evolution:
    """Return the history of a viscoelastic contact under a load that changes in time.

    Inertia is neglected: at each time the contact is in equilibrium. A time step is an elastic
    equilibrium with a stiffness between the glassy and the relaxed one, on a surface moved by the
    memory of the solid (`jaxstab.evolution.step`). Between the given times the load is
    linear in time, and steps adapt to an estimate of their error. Where the glassy solid itself
    loses its stability, the contact jumps: the jump is located in time, and its loss counted
    separately from the dissipation in the solid.

    The scalars, the last state and the jumps are differentiable functions of contact, load and
    times, in both modes, at the steps that were taken, which move with the jumps. Derivatives of
    the states in `fields` are NaN, and so are those behind a jump that is neither at a fold nor at
    the release of one point, or at a given time.

    Arguments:
        contact: the contact, of a `Viscoelastic` solid.
        load: a load with one value for each time.
        times: two times or more, in increasing order [time].
        initial: where to start. From an `Evolution` the run goes on from its end, or from one of
            its states. A state of the relaxed contact under another load, such as an `Equilibrium`,
            responds to the first load at once. Otherwise the contact is relaxed at the first load;
            a gap is then the start of its equilibrium, as in `equilibrate`.
        rtol: the error of a step in deformation, over the largest so far, and in the balance of
            energies, over the energy exchanged in the step; by default 1e-3, in float32 1e-2. Below
            1e-5, and 1e-3 in float32, the rounding of equilibria may be seen.
        fields: whether to keep gap and memory at each time, for verdicts and growth rates.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        max_steps: how many steps there is room for in all.
        throw: raise an error if the end is not reached; otherwise look at `result`.

    Returns:
        The states at the given times; if interrupted, with a warning, those reached so far.
        After a failure, for instance once the surfaces are pulled apart, NaN.

    Raises:
        TypeError: for a solid that is not viscoelastic, and something that is not a load.
        ValueError: for times that do not increase, a load with another number of values, and an
            initial evolution of another contact.
        SolverError: if `throw`, where an equilibrium is not found, or there is no room left.
    """
    relaxed = relaxed_contact(contact)
    require_load(load)
    instants = parameter(times, "The times").astype(contact.heights.dtype)
    known = concrete(instants)
    if known.ndim != 1 or known.size < 2 or load.value.shape != known.shape:
        raise ValueError(
            f"The times have shape {known.shape}, the load has {load.value.shape}: give one value "
            "of the load for each of two or more times."
        )
    require_finite("The load", load.value)
    require_finite("The times", known)
    cure = f"the times must increase, in {known.dtype} too."
    require("A time after the first", known[1:], known[1:] > known[:-1], cure)
    require_same_machine(load)
    given_rtol = RTOL[instants.dtype.name] if rtol is None else rtol
    tolerance = scalar_parameter(given_rtol, "rtol").astype(instants.dtype)
    tolerance = positive_parameter(tolerance, "rtol")
    size = integer("max_steps", max_steps)
    require("max_steps", size, size > 0, "it must be positive.")
    warn_if_coarse(contact, FOR_JUMPS)
    # A jump takes two entries.
    room = jnp.zeros(size + 1, instants.dtype)
    inputs: Any = contact.padded, load, instants, _start(contact, relaxed, load[0], initial)
    padded, held, given_times, moment = jax.lax.stop_gradient(inputs)
    state = moment, Table((room.astype(int), room, room, room), jnp.array(0))
    given = padded, held[0], jax.lax.stop_gradient(tolerance)
    rows = []
    numbers = np.arange(known.size)
    is_alone = not is_transformed((inputs, given))
    keeps = jnp.array(True) if fields or is_alone else None
    pairs = np.stack([np.maximum(numbers - 1, 0), numbers], axis=-1)
    intervals = Interval(numbers, concrete(held.value)[pairs], concrete(given_times)[pairs])
    watch = progress_bar(numbers.size, "time", shown=progress, inputs=(inputs, given))
    with watch as bar:
        # Time by time, so that it can be watched, and interrupted: one program, whatever is kept.
        for interval in map(Interval, *intervals) if is_alone else [intervals]:
            try:
                after, row = jax.block_until_ready(_march(*given, keeps, state, interval))
                # The state and its row belong together.
                with interrupts_after():
                    state = after
                    rows.append(row if fields else (row[0], None, *row[2:]))
                bar.update()
            except early_ends():
                if not rows:
                    raise
                done = f"{len(rows) - 1} of {numbers.size - 1} times after the first"
                warn(f"The evolution was interrupted: {done}.", PathInterrupted)
                break
    # An interrupt here would lose it.
    with interrupts_held() as held:
        moment, steps = state
        found = stacked(rows, rows[0]) if is_alone else rows[0]
        totals, kept, result, counts = found
        known = steps, counts, result == RESULTS.successful
        ways, _, parts, losses = steps.rows
        values = totals, losses, jnp.zeros_like(losses), moment.internal
        totals, losses, late, last = attach(_changes, values, known, inputs)
        ends = along(instants, ways, parts) + late
        has_jumped = np.asarray(losses) > 0 if is_alone else slice(None)
        evolution = Evolution(
            **vars(totals) | {"stored": totals.stored - totals.stored[0]},
            contact=contact,
            # Fewer than all, if it was interrupted.
            load=load[: counts.size],
            times=instants[: counts.size],
            force=totals.mean_pressure * contact.area,
            fields=attach(undefined, kept, None, inputs),
            last=last,
            reached=jnp.where(steps.count > 0, ends[steps.count - 1], instants[0]),
            jump_times=ends[has_jumped],
            dissipation=losses[has_jumped],
            num_steps=jnp.diff(counts, prepend=0),
            result=result,
        )
    if held and counts.size == numbers.size:
        warn("The evolution was interrupted after its last time; it is complete.", PathInterrupted)
    return throw_failure(result, evolution, lambda: _describe(evolution, tolerance), throw)


def _start(contact: Any, relaxed: Contact, load: Load, initial: Any) -> Moment:
    """Return the state at the first time."""
    padded = contact.padded
    dtype = contact.heights.dtype
    if isinstance(initial, Evolution):
        require_same_contact(contact, initial.contact, "The initial evolution")
        memory = initial.internal
        result = RESULTS.promote("successful")
        cure = "start from a state that was found."
        require_finite("The gap of the initial evolution", memory.gap, cure)
    else:
        held = getattr(initial, "load", load)
        solid = contact.solid
        gap: Any = padded_start(relaxed, held, initial_gap(relaxed, held, initial))[1]
        if gap is None:
            gap = padded.control(held).starting_gap(padded.heights)
        strains = jnp.zeros((1 + solid.times.size, *padded.grid.shape), dtype)
        # A step that takes for ever leaves the relaxed solid.
        long = solid.times[-1] / jnp.finfo(dtype).eps ** 2
        rest = first_moment(padded, held, Internal(gap, strains), long)
        memory = rest.internal
        result = rest.result
    # It answers to the load at once.
    start = first_moment(padded, load, memory, jnp.zeros((), dtype))
    is_found = result == RESULTS.successful
    return replace(start, result=RESULTS.where(is_found, start.result, result))


@program
@by_entries
def _march(*inputs: Any) -> tuple[Any, Any]:
    """Return the state at a given time, or after several, and the rows of these times."""
    *given, state, intervals = inputs
    one = partial(march, *given)
    return jax.lax.scan(one, state, intervals) if intervals.number.ndim else one(state, intervals)


def _changes(
    values: Any, known: tuple[Table[Step], Array, Array], inputs: tuple, changes: tuple
) -> tuple[Any, Any]:
    """Return how the scalars, the losses and the last state change, a rule for `attach`."""
    steps, counts, is_found = known
    totals, losses, late, last = pushed(partial(_replay, steps, counts), inputs, changes)
    totals = jax.tree.map(partial(jax.vmap(nan_if), ~is_found), totals)
    return (totals, losses, late, last), jnp.array(False)


def _replay(
    steps: Table[Step],
    counts: Int[Array, " times"],
    contact: Contact,
    load: Load,
    times: Float[Array, " times"],
    moment: Moment,
) -> tuple[Totals, Array, Array, Internal]:
    """Return scalars, loss and delay of each step, and the last state anew, by known steps.

    That is a scan, which has derivatives. The ends of a step with a jump move with it, so that its
    states do not follow the time ever faster.
    """
    Carry = tuple[Moment, Scalar]

    def one(carry: Carry, i: Int[Array, ""]) -> tuple[Carry, tuple[Totals, Scalar]]:
        old, late = carry

        def step() -> Carry:
            way, start, end, lost = entry_of(steps.rows, i)
            span = times[way + 1] - times[way]
            has_jumped = lost > 0
            slope = (load.value[way + 1] - load.value[way]) / span

            def held(late: Scalar) -> Load:
                return load[0].at(along(load.value, way, end) + slope * late)

            def jump() -> Scalar:
                until = (entry_of(steps.rows, i + 1)[2] - end) * span
                return late + time_of_jump(contact, held(late), slope, old.internal, until)

            # A value at the time of a jump has no derivative.
            stays = jnp.where(has_jumped, nan_if(end == 1, late), 0)
            delay = jax.lax.cond(start == end, jump, lambda: stays)
            dt = (end - start) * span + delay - late
            _, with_loss = stepped(contact, held(delay), old, dt)
            return with_loss(has_jumped), delay

        return jax.lax.cond(i < steps.count, step, lambda: carry), (old.totals, late)

    # Reverse mode keeps one state for each step, and computes the rest of it again.
    numbers = jnp.arange(len(steps.rows[0]) + 1)
    start = moment, jnp.zeros_like(times[0])
    (end, _), (totals, late) = jax.lax.scan(jax.checkpoint(one), start, numbers)
    at_times = jax.tree.map(lambda leaf: leaf[counts], totals)
    return at_times, jnp.diff(totals.lost), late[1:], end.internal


def _describe(evolution: Evolution, rtol: Scalar) -> str:
    evolution, rtol = jax.lax.stop_gradient((evolution, rtol))
    load = evolution.load
    place = int(jnp.argmax(evolution.result != RESULTS.successful))
    times = [f"t = {float(t):.6g}" for t in evolution.times[: place + 1]]
    where = f"ended between {times[-2]} and {times[-1]}" if place else f"has no start at {times[0]}"
    under = f"{type(load).__name__}({float(load.value[place]):.6g})"
    return f"The evolution {where}, under {under} with rtol = {float(rtol):.3g}"

"""A viscoelastic contact in time, under a load with one value for each time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

from jaxstab.contact import Contact, require_same_contact
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.checks import (
    array,
    cast,
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
from jaxstab.core.control_flow import cond
from jaxstab.core.implicit import attach, no_derivatives
from jaxstab.core.interrupts import early_ends, interrupts_after, interrupts_held
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.stack import stack_of
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.warn import warn
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.posing import PosedLoad, as_given, pose
from jaxstab.equilibrium.start import start_of
from jaxstab.evolution.evolution import (
    Evolution,
    Memory,
    relaxed_contact,
    require_viscoelastic,
)
from jaxstab.evolution.legs import (
    RTOL,
    Leg,
    LegEnd,
    Steps,
    TimeStepping,
    along,
    follow_leg,
    follow_legs,
    legs_between,
    no_increments,
)
from jaxstab.evolution.replay import Replay, changes
from jaxstab.evolution.step import StepRecord, first_record
from jaxstab.loads import Load, require_load, require_same_machine
from jaxstab.states.sequence import PathInterrupted


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

    Inertia is neglected: at each time the contact is in equilibrium.

    1. At the first time the contact is relaxed, or as `initial` says.
    2. Between two given times, on a leg, the load is linear in time. A time step is an elastic
       equilibrium with a stiffness between the glassy and the relaxed one, on a surface moved by
       the memory of the solid (`jaxstab.evolution.step`).
    3. An estimate of the step's error says whether to accept it, and how long the next one is
       (`jaxstab.evolution.legs`).
    4. Where the glassy solid itself loses its stability, the contact jumps: steps shorten until the
       jump is located in time, and its loss is counted separately from the dissipation in the
       solid.

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
            The time of a jump behind a slow creep is less exact than that.
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

    Example:
        >>> rubber = js.Viscoelastic(solid, ratios=(1.0,), times=(0.1,))
        >>> contact = js.Contact(rubber, heights, law)
        >>> evolution = js.evolve(contact, js.MeanGap([0.3, 0.05]), [0.0, 1.0])
        >>> f"{evolution.mean_pressure[-1]:.4f}, {evolution.dissipated[-1]:.1e}"
        '-0.1289, 1.1e-03'
    """
    require_viscoelastic(contact)
    require_load(load)
    instants = parameter(times, "The times").astype(contact.heights.dtype)
    _require_value_at_each_time(load, concrete(instants))
    require_same_machine(load)
    if rtol is None:
        rtol = RTOL[instants.dtype.name]
    tolerance = cast(scalar_parameter(rtol, "rtol"), instants.dtype)
    tolerance = positive_parameter(tolerance, "rtol")
    room = integer("max_steps", max_steps)
    require("max_steps", room, room > 0, "it must be positive.")
    warn_if_coarse(contact, FOR_JUMPS)

    if isinstance(initial, Evolution):
        require_same_contact(contact, initial.contact, "The initial evolution")
    problem = pose(contact, load)
    start = _start(problem, initial)
    inputs = problem, instants, start, tolerance
    is_alone = not is_transformed(inputs)
    known, known_times, known_start, known_tolerance = jax.lax.stop_gradient(inputs)
    # Leg by leg it is one program, whatever the evolution keeps.
    keeps_memory = fields or is_alone
    stepping = TimeStepping(known.contact, known.load[0], known_tolerance, keeps_memory)
    legs = legs_between(concrete(known_times), concrete(known.load.value))
    steps: Steps = known_start, no_increments(room, instants.dtype)
    if is_alone:
        with progress_bar("evolution", legs.number.size, "time", shown=progress) as bar:
            steps, ends = _leg_by_leg(stepping, steps, legs, fields, bar)
    else:
        steps, ends = follow_legs(stepping, steps, legs)
    # An interrupt here would lose it.
    with interrupts_held() as interrupts:
        if isinstance(ends, list):
            ends = stack_of(ends, ends[0])
        evolution = _evolution(contact, problem, instants, start, steps, ends)
        # As they were given, without the rounding of conversions.
        evolution = replace(evolution, contact=contact, load=load[: len(evolution)])
        if is_alone:
            has_jumped = np.asarray(evolution.jump_losses) > 0
            evolution = replace(
                evolution,
                jump_times=array(np.asarray(evolution.jump_times)[has_jumped]),
                jump_losses=array(np.asarray(evolution.jump_losses)[has_jumped]),
            )
    if interrupts and len(evolution) == len(instants):
        warn("The evolution was interrupted after its last time; it is complete.", PathInterrupted)
    return throw_failure(
        evolution.result, evolution, lambda: _describe(evolution, tolerance), throw
    )


def _require_value_at_each_time(load: Load, times: Any) -> None:
    if times.ndim != 1 or times.size < 2 or load.value.shape != times.shape:
        raise ValueError(
            f"The times have shape {times.shape}, the load has {load.value.shape}: give one value "
            "of the load for each of two or more times."
        )
    require_finite("The load", load.value)
    require_finite("The times", times)
    cure = f"the times must increase, in {times.dtype} too."
    require("A time after the first", times[1:], times[1:] > times[:-1], cure)


@program
def _endless_step(times: Array) -> Scalar:
    """Return a step so long that it leaves the relaxed solid."""
    return times[-1] / jnp.finfo(times.dtype).eps ** 2


def _start(problem: PosedLoad, initial: Any) -> StepRecord:
    """Return the record at the first time."""
    contact = problem.contact
    load = problem.load[0]
    dtype = contact.heights.dtype
    if isinstance(initial, Evolution):
        memory = initial.memory
        result = RESULTS.promote("successful")
        cure = "start from a state that was found."
        require_finite("The gap of the initial evolution", memory.gap, cure)
    else:
        held = load
        if hasattr(initial, "load"):
            held = initial.load.in_units_of(problem.unit)
        solid: Any = contact.solid
        gap = start_of(relaxed_contact(contact), held, initial)
        strains = array(np.zeros((1 + solid.times.size, *contact.grid.shape)), dtype)
        rest = first_record(contact, held, Memory(gap, strains), _endless_step(solid.times))
        memory = rest.memory
        result = rest.result
    # It responds to the load at once.
    start = first_record(contact, load, memory, array(0, dtype))
    is_found = result == RESULTS.successful
    return replace(start, result=cond(is_found, lambda: start.result, lambda: result))


def _leg_by_leg(
    stepping: TimeStepping, steps: Steps, legs: Leg, fields: bool, bar: tqdm
) -> tuple[Steps, list[LegEnd]]:
    """Return the steps to the end of the legs, or until interrupted, and the ends reached."""
    ends: list[LegEnd] = []
    for leg in map(Leg, *legs):
        try:
            after, end = jax.block_until_ready(follow_leg(stepping, steps, leg))
            if not fields:
                end = end._replace(memory=None)
            # The steps and the end of their leg belong together.
            with interrupts_after():
                steps = after
                ends.append(end)
            bar.update()
        except early_ends():
            if not ends:
                raise
            done = f"{len(ends) - 1} of {legs.number.size - 1} times after the first"
            warn(f"The evolution was interrupted: {done}.", PathInterrupted)
            break
    return steps, ends


@program
def _evolution(
    contact: Contact,
    problem: PosedLoad,
    times: Float[Array, " times"],
    start: StepRecord,
    steps: Steps,
    ends: LegEnd,
) -> Evolution:
    """Return the evolution of a contact to the ends that were reached, with derivatives."""
    inputs = problem.contact, problem.load, times, start
    record, increments = steps
    legs, _, fractions, losses, pressures = increments.rows
    pressures = jnp.append(ends.totals.mean_pressure[:1], pressures)
    found = Replay(ends.totals, losses, pressures, jnp.zeros_like(losses), record.memory)
    totals, losses, pressures, delays, last = attach(changes, found, (increments, ends), inputs)
    step_ends = along(times, legs, fractions) + delays
    number = ends.num_steps.size
    # The room behind the last increment is empty. The state before a jump is there twice, and the
    # second one moves with the jump.
    order = jnp.arange(pressures.size)
    signed = jnp.stack([-pressures, pressures])
    signed = jnp.where(order <= increments.count, signed, -jnp.inf)
    is_extreme = signed == jnp.max(signed, axis=1, keepdims=True)
    extremes = jnp.max(jnp.where(is_extreme, order, 0), axis=1)
    tension, compression = jnp.take_along_axis(signed, extremes[:, None], axis=1)[:, 0]
    # Which step is the extreme one has no derivative.
    instants = attach(no_derivatives, jnp.append(times[:1], step_ends)[extremes], None, inputs)
    evolution = Evolution(
        **vars(totals) | {"stored": totals.stored - totals.stored[0]},
        contact=contact,
        load=problem.load[:number],
        times=times[:number],
        force=totals.mean_pressure * contact.area,
        largest_tension=tension,
        largest_tension_time=instants[0],
        largest_compression=compression,
        largest_compression_time=instants[1],
        fields=attach(no_derivatives, ends.memory, None, inputs),
        last=last,
        reached=jnp.where(increments.count > 0, step_ends[increments.count - 1], times[0]),
        jump_times=step_ends,
        jump_losses=losses,
        num_steps=jnp.diff(ends.num_steps, prepend=0),
        result=ends.result,
    )
    return as_given(evolution, problem)


def _describe(evolution: Evolution, rtol: Scalar) -> str:
    evolution, rtol = jax.lax.stop_gradient((evolution, rtol))
    load = evolution.load
    place = int(jnp.argmax(evolution.result != RESULTS.successful))
    times = [f"t = {float(t):.6g}" for t in evolution.times[: place + 1]]
    where = f"has no start at {times[0]}"
    if place > 0:
        where = f"ended between {times[-2]} and {times[-1]}"
    under = f"{type(load).__name__}({float(load.value[place]):.6g})"
    return f"The evolution {where}, under {under} with rtol = {float(rtol):.3g}"

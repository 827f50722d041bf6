"""A viscoelastic contact in time, under a load with one value for each time."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.contact import Contact, require_contact, require_same_contact
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.batching import by_entries, entry_of
from jaxstab.core.checks import (
    concrete,
    integer,
    is_traced,
    is_transformed,
    parameter,
    require,
    require_finite,
    require_positive,
)
from jaxstab.core.compile import program
from jaxstab.core.implicit import attach, pushed
from jaxstab.core.progress import can_be_shown, progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.stack import stacked
from jaxstab.core.types import ArrayLike
from jaxstab.core.warn import warn
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrate import initial_gap
from jaxstab.equilibrium.window import padded_start
from jaxstab.loads import Load, require_load, require_same_machine
from jaxstab.paths.evolution.evolution import Evolution, Totals, or_nan, relaxed_contact
from jaxstab.paths.evolution.march import (
    Leg,
    Moment,
    Step,
    between,
    first_moment,
    march,
    stepped,
    with_loss,
)
from jaxstab.paths.evolution.step import Internal, next_state, springs
from jaxstab.paths.path import PathInterrupted
from jaxstab.paths.record import Table
from jaxstab.solids.viscoelastic import Viscoelastic

Tree = TypeVar("Tree")
State = tuple[Moment, Table]
# Scalars, memory, result and number of steps of a state.
Entry = tuple[Totals, Internal | None, RESULTS, Int[Array, ""]]


def evolve(
    contact: Contact,
    load: Load,
    times: ArrayLike,
    *,
    initial: ArrayLike | Equilibrium | Evolution | None = None,
    rtol: ArrayLike = 1e-3,
    fields: bool = False,
    progress: bool | None = None,
    max_steps: int = 2000,
    throw: bool = True,
) -> Evolution:
    """Return the history of a viscoelastic contact under a load that changes in time.

    Inertia is neglected: at each time the contact is in equilibrium. A time step is an elastic
    equilibrium with a stiffness between the glassy and the relaxed one, on a surface moved by the
    memory of the solid (`jaxstab.paths.evolution.step`). Between the given times the load is
    linear in time, and steps adapt to an estimate of their error. Where the glassy solid itself
    loses its stability, the contact jumps: the jump is located in time, and its loss counted
    separately from the dissipation in the solid.

    The scalars and the last state are differentiable functions of contact, load and times, in both
    modes, at the steps that were taken; the states in `fields` count as constants.

    Arguments:
        contact: the contact, of a `Viscoelastic` solid.
        load: a load with one value for each time.
        times: two times or more, in increasing order [time].
        initial: where to start. From an `Evolution` the run goes on from its end, or from one of
            its states. A state of the relaxed contact under another load, such as an `Equilibrium`,
            responds to the first load at once. Otherwise the contact is relaxed at the first load;
            a gap is then the start of its equilibrium, as in `equilibrate`.
        rtol: the error of a step, in deformation and in the balance of energies, over the largest
            ones so far. Below 1e-5, and 1e-3 in float32, the rounding of equilibria may be seen.
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
    instants = _checked(contact, load, times)
    dtype = instants.dtype
    tolerance = parameter(rtol).astype(dtype)
    require_positive("rtol", tolerance)
    number = integer("max_steps", max_steps)
    require("max_steps", number, number > 0, "it must be positive.")
    room = jnp.zeros(number, dtype)
    padded = contact.padded
    inputs = padded, load, instants, _start(contact, load[0], initial)
    constant, held, _, begin = jax.lax.stop_gradient(inputs)
    legs = jax.lax.stop_gradient(_legs(load, instants))
    start = begin, Table(Step(room.astype(int), room, room, room), jnp.array(0))
    given = constant, held[0], jax.lax.stop_gradient(tolerance), start, legs
    is_alone = not is_transformed(given)
    bar = progress_bar(instants.size - 1, "time", shown=can_be_shown(progress, given))
    with jax.debug_nans(False), bar as bar:
        find = partial(_one_by_one, bar.update) if is_alone else _along
        (end, steps), rest = find(*given, fields=fields)
    totals, internal, result, numbers = _with_first(_entry(start, fields), rest)
    # Fewer than all, if it was interrupted.
    load, instants = load[: numbers.size], instants[: numbers.size]
    last = end.internal
    if is_traced((contact, load, times)):
        totals, last = attach(_changes, (totals, last), (steps, numbers), inputs)
    taken = steps.rows
    ends = between(legs.times[taken.leg], taken.end)
    jumps = ends, taken.lost
    if is_alone:
        has_jumped = np.asarray(taken.lost) > 0
        jumps = tuple(jnp.asarray(np.asarray(column)[has_jumped]) for column in jumps)
    evolution = Evolution(
        **vars(totals) | {"stored": totals.stored - totals.stored[0]},
        contact=contact,
        load=load,
        times=instants,
        force=totals.mean_pressure * contact.area,
        fields=internal,
        last=last,
        reached=jnp.where(steps.count > 0, ends[steps.count - 1], instants[0]),
        jump_times=jumps[0],
        dissipation=jumps[1],
        num_steps=jnp.diff(numbers, prepend=0),
        result=result,
    )
    return throw_failure(result[-1], evolution, lambda: _describe(evolution), throw)


def require_viscoelastic(contact: Contact) -> None:
    """Raise `TypeError` for a contact whose solid has no relaxation times."""
    require_contact(contact)
    if not isinstance(contact.solid, Viscoelastic):
        raise TypeError(
            f"The solid is a {type(contact.solid).__name__}, which has no relaxation times: give "
            "the contact a Viscoelastic(solid, ratios, times)."
        )


def _checked(contact: Contact, load: Load, times: ArrayLike) -> Float[Array, " times"]:
    """Check the arguments, and return the times in the precision of the contact."""
    require_viscoelastic(contact)
    require_load(load)
    instants = parameter(times, "The times").astype(contact.heights.dtype)
    given = concrete(instants)
    if given.ndim != 1 or given.size < 2 or load.value.shape != given.shape:
        raise ValueError(
            f"The times have shape {given.shape}, the load has {load.value.shape}: give one value "
            "of the load for each of two or more times."
        )
    require_finite("The times", given)
    cure = f"the times must increase, in {given.dtype} too."
    require("A time", given[1:], given[1:] > given[:-1], cure)
    require_same_machine(load)
    warn_if_coarse(contact, FOR_JUMPS)
    return instants


def _start(contact: Contact, load: Load, initial: Any) -> Moment:
    """Return the state at the first time."""
    padded, dtype = contact.padded, contact.heights.dtype
    if isinstance(initial, Evolution):
        require_same_contact(contact, initial.contact, "The initial evolution")
        memory = initial.internal
        cure = "start from a state that was found."
        require_finite("The gap of the initial evolution", memory.gap, cure)
    else:
        # A step that takes for ever leaves the relaxed solid.
        relaxed, long = relaxed_contact(contact), jnp.asarray(jnp.finfo(dtype).max)
        held = getattr(initial, "load", load)
        gap: Any = padded_start(relaxed, held, initial_gap(relaxed, held, initial))[1]
        strains = jnp.zeros((springs(padded)[0].size, *padded.grid.shape), dtype)
        memory, found = next_state(padded, held, Internal(gap, strains), long)
        if held is load:
            return first_moment(padded, load, memory, found)
    # A state with a memory, or of another load, answers to the load at once.
    return first_moment(padded, load, *next_state(padded, load, memory, jnp.zeros((), dtype)))


def _legs(load: Load, times: Float[Array, " times"]) -> Leg:
    """Return the legs between the times, along a leading axis."""
    columns = times, load.value.astype(times.dtype)
    return Leg(jnp.arange(times.size - 1), *(jnp.stack([c[:-1], c[1:]], 1) for c in columns))


def _entry(state: State, fields: bool) -> Entry:
    """Return the record of a state, NaN where it was not found."""
    moment, steps = state
    kept = moment.totals, moment.internal if fields else None
    return *or_nan(kept, moment.result), moment.result, steps.count


@partial(program, static_argnames="fields")
def _along(*inputs: Any, fields: bool) -> tuple[State, Entry]:
    """Return the state after all legs along a leading axis, and the record at the end of each."""

    def along(*inputs: Any) -> tuple[State, Entry]:
        contact, load, rtol, state, legs = inputs

        def one(state: State, leg: Leg) -> tuple[State, Entry]:
            state = march(contact, load, rtol, *state, leg)
            return state, _entry(state, fields)

        return jax.lax.scan(one, state, legs)

    return by_entries(along)(*inputs)


def _one_by_one(report: Callable[[], object], *inputs: Any, fields: bool) -> tuple[State, Entry]:
    """Return the same leg by leg, so that it can be watched, and interrupted after the first."""
    *given, state, legs = inputs
    entries, number = [], legs.number.size
    for i in range(number):
        leg = jax.tree.map(lambda leaf, i=i: leaf[i : i + 1], legs)
        try:
            state, entry = jax.block_until_ready(_along(*given, state, leg, fields=fields))
        except KeyboardInterrupt:
            if not entries:
                raise
            message = f"The evolution was interrupted: {i} of {number} times after the first."
            warn(message, PathInterrupted)
            break
        entries.append(jax.tree.map(lambda leaf: leaf[0], entry))
        report()
    return state, stacked(entries, entries[0])


def _with_first(first: Tree, rest: Tree) -> Tree:
    """Return a stack with an entry before its first."""
    return jax.tree.map(lambda one, others: jnp.concatenate([one[None], others]), first, rest)


def _changes(
    values: Any, known_of: tuple[Table, Int[Array, " times"]], inputs: tuple, changes: tuple
) -> tuple[Any, Any]:
    """Return how the scalars and the last state change, a rule for `attach`."""
    return pushed(partial(_replay, *known_of), inputs, changes), jnp.array(False)


def _replay(
    steps: Table,
    numbers: Int[Array, " times"],
    contact: Contact,
    load: Load,
    times: Float[Array, " times"],
    moment: Moment,
) -> tuple[Totals, Internal]:
    """Return scalars and last state anew, by known steps: a scan, which has derivatives."""
    legs = _legs(load, times)

    def one(old: Moment, i: Int[Array, ""]) -> tuple[Moment, Totals]:
        taken = entry_of(steps.rows, i)
        leg = entry_of(legs, taken.leg)
        dt = (taken.end - taken.start) * (leg.times[1] - leg.times[0])
        held = load[0].at(between(leg.values, taken.end))

        def step() -> Moment:
            new = stepped(contact, held, old, dt)
            return with_loss(contact, held, old, new, dt, taken.lost > 0)

        new = jax.lax.cond(i < steps.count, step, lambda: old)
        return new, new.totals

    # Reverse mode keeps one state for each step, and computes the rest of it again.
    end, totals = jax.lax.scan(jax.checkpoint(one), moment, jnp.arange(len(steps.rows.leg)))
    totals = _with_first(moment.totals, totals)
    return jax.tree.map(lambda leaf: leaf[numbers], totals), end.internal


def _describe(evolution: Evolution) -> str:
    results = jax.lax.stop_gradient(evolution.result)
    place = int(jnp.argmax(results != RESULTS.successful))
    load, times = evolution.load, [f"t = {float(t):.6g}" for t in evolution.times[: place + 1]]
    where = f"ended between {times[-2]} and {times[-1]}" if place else f"has no start at {times[0]}"
    return f"The evolution {where}, under {type(load).__name__}({float(load.value[place]):.6g})"

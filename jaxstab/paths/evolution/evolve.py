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
    integer,
    is_traced,
    is_transformed,
    known,
    parameter,
    require,
    require_finite,
    require_positive,
)
from jaxstab.core.compile import program
from jaxstab.core.grid import mean
from jaxstab.core.implicit import attach, pushed
from jaxstab.core.progress import can_be_shown, progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.stack import stacked
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find_equilibrium, initial_gap, with_derivatives
from jaxstab.equilibrium.equilibrium import equilibrium_of
from jaxstab.equilibrium.window import whole_start, whole_state
from jaxstab.loads import Load, require_load, require_same_machine
from jaxstab.paths.evolution.evolution import Evolution, Totals, medium_of, relaxed_contact
from jaxstab.paths.evolution.march import (
    Leg,
    Moment,
    Steps,
    after_jump,
    first_moment,
    loss_of,
    march,
    stepped,
)
from jaxstab.paths.evolution.step import Internal, Medium
from jaxstab.solids.viscoelastic import Viscoelastic

Tree = TypeVar("Tree")
State = tuple[Moment, Steps]
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
    loses its stability, the contact jumps: the jump is located in time, and its loss counted apart
    from the dissipation in the solid.

    The scalars and the last state are differentiable functions of contact, load and times, in both
    modes, at the steps that were taken; the states in `fields` count as constants.

    Arguments:
        contact: the contact, of a `Viscoelastic` solid.
        load: a load with one value for each time.
        times: two times or more, in increasing order [time].
        initial: where to start. An `Evolution` goes on from its end, or from one of its states; an
            `Equilibrium` of the relaxed contact, at its own load, answers to the first load at
            once. Otherwise the contact is relaxed at the first load, a gap being where its
            equilibrium is sought, as in `equilibrate`.
        rtol: the error of a step, in deformation and in the balance of energies, over the largest
            ones so far.
        fields: whether to keep gap and memory at each time, for verdicts and growth rates.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        max_steps: how many steps there is room for in all.
        throw: raise an error if the end is not reached; otherwise look at `result`.

    Returns:
        The states at the given times. Where the surfaces are pulled apart, NaN follows.

    Raises:
        TypeError: for a solid that is not viscoelastic, and something that is not a load.
        ValueError: for times that do not increase, a load with another number of values, and an
            initial evolution of another contact.
        SolverError: if `throw`, where an equilibrium is not found, or there is no room left.
    """
    medium = _checked(contact, load, times)
    dtype = contact.heights.dtype
    instants, tolerance = parameter(times, "The times").astype(dtype), parameter(rtol).astype(dtype)
    require_positive("rtol", tolerance)
    room = integer("max_steps", max_steps)
    moment = _start(contact, medium, load[0], initial)
    inputs = medium, load, instants, moment
    held = jax.lax.stop_gradient((medium, load[0], tolerance))
    legs, begin = jax.lax.stop_gradient((_legs(load, instants), moment))
    state = begin, Steps.none(room, dtype)
    given = *held, state, legs
    is_alone = not is_transformed(given)
    bar = progress_bar(instants.size - 1, "time", shown=can_be_shown(progress, given))
    with jax.debug_nans(False), bar as bar:
        find = partial(_one_by_one, bar.update) if is_alone else _along_all
        (end, steps), rest = find(*given, fields=fields)
    totals, internal, result, numbers = with_first(_entry(state, fields), rest)
    last = end.internal
    if is_traced((contact, load, times)):
        totals, last = attach(_changes, (totals, last), (steps, numbers), inputs)
    ends = legs.start[steps.legs] + steps.ends * (legs.end - legs.start)[steps.legs]
    jumps = ends, steps.lost
    if is_alone:
        has_jumped = np.asarray(steps.lost) > 0
        jumps = tuple(jnp.asarray(np.asarray(column)[has_jumped]) for column in jumps)
    evolution = Evolution(
        **vars(totals),
        contact=contact,
        load=load,
        times=instants,
        force=totals.mean_pressure * contact.area,
        fields=internal,
        last=last,
        reached=jnp.where(steps.number > 0, ends[steps.number - 1], legs.start[0]),
        jump_times=jumps[0],
        dissipation=jumps[1],
        num_steps=jnp.diff(numbers, prepend=0),
        result=result,
    )
    return throw_failure(result[-1], evolution, lambda: _describe(evolution), throw)


def require_viscoelastic(contact: Contact) -> None:
    """Raise `TypeError` for a contact whose solid has no relaxation times."""
    if not isinstance(contact.solid, Viscoelastic):
        raise TypeError(
            f"The solid is a {type(contact.solid).__name__}, which has no relaxation times: give "
            "the contact a Viscoelastic(solid, ratios, times)."
        )


def _checked(contact: Contact, load: Load, times: ArrayLike) -> Medium:
    require_contact(contact)
    require_load(load)
    require_viscoelastic(contact)
    given = known(parameter(times, "The times"))
    if given.ndim != 1 or given.size < 2 or load.value.shape != given.shape:
        raise ValueError(
            f"The times have shape {given.shape}, the load has {load.value.shape}: give one value "
            "of the load for each of two or more times."
        )
    require_finite("The times", given)
    require("A time", given[1:], given[1:] > given[:-1], "the times must increase.")
    require_same_machine(load)
    warn_if_coarse(contact, FOR_JUMPS)
    return medium_of(contact)


def _start(contact: Contact, medium: Medium, load: Load, initial: Any) -> Moment:
    """Return the state at the first time."""
    whole, relaxed = medium.contact, relaxed_contact(contact)
    if isinstance(initial, Evolution):
        require_same_contact(contact, initial.contact, "The initial evolution")
        internal = initial.internal
    elif isinstance(initial, Equilibrium):
        internal = _relaxed(medium, whole_state(relaxed, equilibrium_of(relaxed, initial))[1])
    else:
        _, start = whole_start(relaxed, load, initial_gap(relaxed, load, initial))
        solver = PreconditionedConjugateGradient()
        found = find_equilibrium(*jax.lax.stop_gradient((whole, load, solver, start)))
        found = with_derivatives(whole, load, found)
        return first_moment(medium, load, _relaxed(medium, found), found)
    # A state with a memory, or of another load, answers to the load at once.
    internal, found, _ = medium.advance(internal, load, jnp.zeros((), whole.heights.dtype))
    return first_moment(medium, load, internal, found)


def _relaxed(medium: Medium, found: Equilibrium) -> Internal:
    """Return the memory of a relaxed equilibrium: branches without strain."""
    stiffness, displacement = medium.uniform_stiffness, found.gap + medium.contact.heights
    has_mean = stiffness > 0
    level = mean(found.pressure) / jnp.where(has_mean, stiffness, 1)
    deformation = displacement - mean(displacement) + jnp.where(has_mean, level, 0)
    branches = jnp.zeros((medium.times.size, *displacement.shape), displacement.dtype)
    return Internal(found.gap, deformation, branches)


def _legs(load: Load, times: Float[Array, " times"]) -> Leg:
    """Return the legs between the times, along a leading axis."""
    values = load.value.astype(times.dtype)
    return Leg(jnp.arange(times.size - 1), times[:-1], times[1:], values[:-1], values[1:])


def _entry(state: State, fields: bool) -> Entry:
    """Return what is recorded of a state: scalars, memory or none, result, steps up to it."""
    moment, steps = state
    return moment.totals, moment.internal if fields else None, moment.result, steps.number


@partial(program, static_argnames="fields")
def _along(
    medium: Medium, load: Load, rtol: Scalar, state: State, leg: Leg, *, fields: bool
) -> tuple[State, Entry]:
    """Return the state at the end of a leg, and its record."""
    state = march(medium, load, rtol, *state, leg)
    return state, _entry(state, fields)


@partial(program, static_argnames="fields")
def _along_all(*inputs: Any, fields: bool) -> tuple[State, Entry]:
    """Return the same for legs along a leading axis."""

    def scanned(
        medium: Medium, load: Load, rtol: Scalar, state: State, legs: Leg
    ) -> tuple[State, Entry]:
        return jax.lax.scan(partial(_along, medium, load, rtol, fields=fields), state, legs)

    return by_entries(scanned)(*inputs)


def _one_by_one(report: Callable[[], object], *inputs: Any, fields: bool) -> tuple[State, Entry]:
    """Return the same by a program for each leg, so that it can be watched and interrupted."""
    medium, load, rtol, state, legs = inputs
    entries = []
    for i in range(legs.number.size):
        leg = jax.tree.map(lambda leaf, i=i: leaf[i], legs)
        state, entry = _along(medium, load, rtol, state, leg, fields=fields)
        entries.append(entry)
        report()
    return state, stacked(entries, entries[0])


def with_first(first: Tree, rest: Tree) -> Tree:
    """Return a stack with an entry before its first."""
    return jax.tree.map(lambda one, others: jnp.concatenate([one[None], others]), first, rest)


def _changes(
    values: Any, known_of: tuple[Steps, Int[Array, " times"]], inputs: tuple, changes: tuple
) -> tuple[Any, Any]:
    """Return how the scalars and the last state change, a rule for `attach`."""
    return pushed(partial(_replay, *known_of), inputs, changes), jnp.array(False)


def _replay(
    steps: Steps,
    numbers: Int[Array, " times"],
    medium: Medium,
    load: Load,
    times: Float[Array, " times"],
    moment: Moment,
) -> tuple[Totals, Internal]:
    """Return scalars and last state anew, by known steps: a scan, which has derivatives."""
    legs = _legs(load, times)

    def one(old: Moment, i: Int[Array, ""]) -> tuple[Moment, Totals]:
        leg = entry_of(legs, steps.legs[i])
        dt = (steps.ends[i] - steps.starts[i]) * (leg.end - leg.start)
        at_end = load[0].at(leg.value(steps.ends[i]))

        def step() -> Moment:
            new = stepped(medium, at_end, old, dt)
            loss = partial(loss_of, medium, at_end, old, new, dt)
            lost = jax.lax.cond(steps.lost[i] > 0, loss, lambda: jnp.zeros_like(dt))
            return after_jump(new, lost)

        new = jax.lax.cond(i < steps.number, step, lambda: old)
        return new, new.totals

    # Reverse mode keeps one state for each step, and computes the rest of it again.
    end, totals = jax.lax.scan(jax.checkpoint(one), moment, jnp.arange(steps.legs.size))
    totals = with_first(moment.totals, totals)
    return jax.tree.map(lambda leaf: leaf[numbers], totals), end.internal


def _describe(evolution: Evolution) -> str:
    results = jax.lax.stop_gradient(evolution.result)
    place = int(jnp.argmax(results != RESULTS.successful))
    load = evolution.load
    return (
        f"The evolution ended between t = {float(evolution.times[place - 1]):.6g} and "
        f"{float(evolution.times[place]):.6g}, under {type(load).__name__}"
        f"({float(load.value[place]):.6g})"
    )

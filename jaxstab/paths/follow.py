"""The path of a contact under a programme of loads, through its jumps.

A step is one of the load, from a prediction by the two states before. On a branch the potential
E + W, W being that of the load, changes by what the load does: dE + dW = F dl. What a step loses
beyond that, it lost in a jump. Steps shrink until they lose next to nothing, or are as short as
jumps are located.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxstab.checks import (
    integer,
    is_traced,
    known,
    parameter,
    require,
    require_finite,
    require_positive,
)
from jaxstab.contact import Contact
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find_equilibrium, initial_gap
from jaxstab.equilibrium.state import State, equilibrium_at
from jaxstab.grid import mean
from jaxstab.iterate import History, refuse_derivatives
from jaxstab.lanes import by_lanes
from jaxstab.loads import Load, require_load, require_same_machine
from jaxstab.paths.explain import reason_of
from jaxstab.paths.path import KINDS, Jump, Path, States
from jaxstab.programs import program
from jaxstab.resolution import warn_if_coarse
from jaxstab.results import RESULTS, throw_failure

Field = Float[Array, " *grid"]
Scalar = Float[Array, ""]

# How near a jump is located, over the range of the loads.
_RESOLUTION = 1e-6
# Steps of a monotone part of the programme, at least.
_NUM_STEPS = 32


class _Place(eqx.Module):
    """A state on the way: its load and gap, and what follows from these."""

    value: Scalar
    gap: Field
    mean_gap: Scalar
    mean_pressure: Scalar
    contact_area: Scalar
    energy: Scalar
    stored: Scalar
    potential: Scalar
    force: Scalar


class _Walk(eqx.Module):
    """Where the path is, and all that it has recorded.

    Attributes:
        here: the last state accepted.
        last: the one before.
        stride: the length of the next step.
        bad: how far ahead the nearest load lies that a step has failed to reach.
        bad_loss: what a step there would lose, as far as that is known.
        part: the number of the monotone part of the programme.
        is_apart: whether the load has pulled the surfaces apart.
        supplied: what the load has given on branches, the integral of F up to here.
        dissipation: what was lost up to here.
        states: the states recorded, with what was supplied and lost.
        jumps: the states before and after each jump, its dissipation, the number of the state, and
            whether it is a touch.
    """

    here: _Place
    last: _Place
    stride: Scalar
    bad: Scalar
    bad_loss: Scalar
    part: Int[Array, ""]
    is_apart: Bool[Array, ""]
    supplied: Scalar
    dissipation: Scalar
    num_states: Int[Array, ""]
    states: tuple[_Place, Scalar, Scalar]
    num_jumps: Int[Array, ""]
    jumps: tuple[_Place, _Place, Scalar, Int[Array, ""], Bool[Array, ""]]
    result: RESULTS


def follow(
    contact: Contact,
    load: Load,
    *,
    initial: ArrayLike | State | None = None,
    smallest_jump: ArrayLike = 1e-4,
    disturbance: ArrayLike = 1e-6,
    fields: bool = False,
    max_states: int = 512,
    max_jumps: int = 64,
    throw: bool = True,
) -> Path:
    """Return the equilibria that a contact goes through as its load goes from value to value.

    Where a branch ends, the contact goes down in energy from its last state, by the conjugate
    gradients of `equilibrate`, to the equilibrium at a load that is further by a part of 1e-6 of
    the range of loads. Jumps that lose less than `smallest_jump` are not located, but what they
    lose is counted. Surfaces that a tension has pulled apart stay so until there is a pressure.

    Arguments:
        contact: the contact problem.
        load: the turning points of the programme, in order: two or more.
        initial: where the first equilibrium starts, as in `equilibrate`.
        smallest_jump: the loss from which a jump is located, over the problem's own energy: that
            of the elastic deformation in full contact and of the deepest adhesion.
        disturbance: the size of a random field, the same at every step, that is added to where
            each equilibrium starts, over the rms height: it leaves branches that only a symmetry
            holds. Zero for none.
        fields: whether to keep the gap of every recorded state.
        max_states: how many states and jumps there is room for.
        max_jumps: how many jumps.
        throw: raise where the path does not reach its end; otherwise look at `result`.

    Returns:
        The path. Under JAX transformations arrays have `max_states` and `max_jumps` entries, NaN
        where there is none; otherwise as many as there are. It cannot be differentiated, and says
        so.

    Raises:
        ValueError: for a load that does not hold two finite values or more in one dimension, or
            machines that differ; for room that is too small.
        SolverError: if `throw`, where an equilibrium is not found, or the store is full.
    """
    require_load(load)
    if load.value.ndim != 1 or load.value.size < 2:
        raise ValueError(
            f"follow takes the turning points of a load, two or more in one dimension, but "
            f"{type(load).__name__} holds an array of shape {load.value.shape}."
        )
    require_finite("The load", load.value)
    require_same_machine(load)
    share, noise = parameter(smallest_jump), parameter(disturbance)
    require_positive("smallest_jump", share)
    require("The disturbance", noise, known(noise) >= 0, "it must not be negative.")
    sizes = integer("max_states", max_states), integer("max_jumps", max_jumps)
    require("max_states", sizes[0], sizes[0] >= 2, "a path has two states at least.")
    require("max_jumps", sizes[1], sizes[1] >= 1, "leave room for one.")
    warn_if_coarse(contact)
    start = initial_gap(contact, load[0], initial)
    inputs = contact, load, start, share, noise
    # What was not found is NaN.
    with jax.debug_nans(False):
        path, num_states, num_jumps = _follow(sizes, fields, *inputs)
    if not is_traced(num_states):
        path = _cut(path, int(num_states), int(num_jumps))
    if not throw:
        return path
    return throw_failure(path.result, path, lambda: _describe(path, load))


@partial(program, static_argnums=(0, 1))
def _follow(sizes: tuple[int, int], fields: bool, *inputs: Any) -> tuple[Path, Array, Array]:
    constants: Any = refuse_derivatives(inputs)
    return by_lanes(partial(_follow_one, sizes, fields))(*constants)


def _follow_one(
    sizes: tuple[int, int],
    fields: bool,
    contact: Contact,
    load: Load,
    start: Field | None,
    share: Scalar,
    disturbance: Scalar,
) -> tuple[Path, Int[Array, ""], Int[Array, ""]]:
    turns = load.value
    span = jnp.max(turns) - jnp.min(turns)
    resolution = _RESOLUTION * span
    threshold = share * _own_energy(contact)
    noise = jax.random.normal(jax.random.key(0), contact.heights.shape, contact.heights.dtype)
    noise = disturbance * jnp.std(contact.heights) * noise

    def at(value: Scalar, part: Int[Array, ""]) -> Load:
        return jax.tree.map(lambda leaf: leaf[part], load).at(value)

    def solve(value: Scalar, part: Int[Array, ""], gap: Field) -> tuple[_Place, RESULTS]:
        solver = PreconditionedConjugateGradient()
        # Contact points stay where they are.
        disturbed = jnp.where(gap > 0, jnp.maximum(gap + noise, 0), 0)
        found = find_equilibrium(contact, at(value, part), solver, disturbed)
        return _place(contact, found, value), found.result

    def step(walk: _Walk) -> _Walk:
        here = walk.here
        target = turns[walk.part + 1]
        left = jnp.abs(target - here.value)
        is_searching = jnp.isfinite(walk.bad)
        # The last step to a load that failed is a jump, if it fails again.
        is_final = walk.bad <= resolution
        # Where it lost by its length alone, what is left of the step loses less.
        tries_whole = is_final | (walk.bad_loss <= threshold)
        within = jnp.where(tries_whole, walk.bad, walk.bad / 2)
        ahead = jnp.where(is_searching, within, walk.stride)
        length = jnp.minimum(ahead, left)
        is_end = length >= left
        value = jnp.where(is_end, target, here.value + jnp.sign(target - here.value) * length)
        rate = (here.gap - walk.last.gap) / _nonzero(here.value - walk.last.value)
        gap = here.gap + jnp.where(is_searching, 0, (value - here.value) * rate)
        gap = jnp.where(walk.is_apart, _apart(contact), jnp.maximum(gap, 0))
        new, result = solve(value, walk.part, gap)

        is_found = result == RESULTS.successful
        expected = (here.force + new.force) / 2 * (value - here.value)
        loss = here.potential + expected - new.potential
        is_smooth = is_found & (jnp.abs(loss) <= threshold)
        is_pulled = (result == RESULTS.pulled_off) & ~walk.is_apart
        is_jump = ~is_smooth & is_final & (is_found | is_pulled) & ~walk.is_apart
        is_touch = walk.is_apart & is_found & _brings_together(contact, at(value, walk.part))
        is_apart = (walk.is_apart & ~is_touch) | (is_jump & is_pulled)
        accepts = (is_smooth & ~walk.is_apart) | is_jump | is_touch | walk.is_apart
        # Loads that hold the gap never pull surfaces apart: what else fails, fails for good.
        has_failed = ~is_found & ~is_pulled & is_final & ~walk.is_apart

        lost = jnp.where(is_found & ~is_touch, loss, jnp.nan)
        # Of surfaces that fall apart nothing is known.
        missing = jnp.where(is_jump, jnp.nan, 0)
        dissipation = walk.dissipation + jnp.where(is_found & ~walk.is_apart, loss, missing)
        supplied = walk.supplied + jnp.where(is_found & ~walk.is_apart, expected, missing)
        place = jax.tree.map(partial(jnp.where, accepts), replace(new, value=value), here)
        last = jax.tree.map(partial(jnp.where, accepts), here, walk.last)
        last = jax.tree.map(partial(jnp.where, is_jump | is_touch), place, last)
        is_kept = accepts & ~is_apart & (~is_searching | is_jump | is_end)
        at_end = accepts & is_end
        longest = span / _NUM_STEPS
        slow = jnp.abs(loss) > threshold / 8
        stride = jnp.where(slow, walk.stride / 2, jnp.minimum(2 * walk.stride, longest))
        # A load that was only too far away is passed by steps that grow again.
        stride = jnp.where(is_searching, 2 * length, stride)
        stride = jnp.where(is_jump | is_touch, longest / 8, stride)
        stride = jnp.where(is_apart, longest, stride)
        bad = jnp.where(accepts, walk.bad - length, length)
        failed_loss = jnp.where(is_found, jnp.abs(loss), jnp.inf)
        bad = jnp.where(is_jump | is_touch | (bad <= 0) | at_end, jnp.inf, bad)
        sums = supplied, dissipation
        sums = jax.tree.map(partial(jnp.where, accepts), sums, (walk.supplied, walk.dissipation))
        record = place, *sums
        # The way to a jump is left out, but for the last state before it.
        is_end_of_branch = is_jump & is_searching
        before = here, walk.supplied, walk.dissipation
        states = _put(walk.states, before, walk.num_states, is_end_of_branch)
        num_states = walk.num_states + is_end_of_branch
        is_event = is_jump | is_touch
        event = here, place, lost, num_states - 1, is_touch
        return _Walk(
            here=place,
            last=last,
            stride=jnp.where(accepts & ~jnp.isfinite(bad), stride, walk.stride),
            bad=bad,
            # An error of quadrature falls with the cube of the length, what a jump loses does not.
            bad_loss=jnp.where(accepts, walk.bad_loss / 8, failed_loss),
            part=walk.part + at_end,
            is_apart=is_apart,
            supplied=sums[0],
            dissipation=sums[1],
            num_states=num_states + is_kept,
            states=_put(states, record, num_states, is_kept),
            num_jumps=walk.num_jumps + is_event,
            jumps=_put(walk.jumps, event, walk.num_jumps, is_event),
            result=RESULTS.where(has_failed, result, walk.result),
        )

    def goes_on(walk: _Walk) -> Bool[Array, ""]:
        # A step records two states at most.
        has_room = (walk.num_states < sizes[0] - 1) & (walk.num_jumps < sizes[1])
        is_well = walk.result == RESULTS.successful
        return (walk.part < turns.size - 1) & has_room & is_well

    none = jnp.array(0)
    first_load = at(turns[0], none)
    if start is None:
        start = contact.control(first_load).starting_gap(contact.heights)
    first, result = solve(turns[0], none, jnp.maximum(start, 0))
    zero = jnp.zeros_like(first.energy)
    states, jumps = (first, zero, zero), (first, first, zero, none, jnp.array(False))
    walk = _Walk(
        here=first,
        last=first,
        stride=span / _NUM_STEPS / 8,
        bad=jnp.array(jnp.inf, span.dtype),
        bad_loss=jnp.array(jnp.inf, span.dtype),
        part=none,
        is_apart=jnp.array(False),
        supplied=zero,
        dissipation=zero,
        num_states=none + 1,
        states=_put(_store(states, sizes[0], fields), states, none, jnp.array(True)),
        num_jumps=none,
        jumps=_store(jumps, sizes[1], True),
        # Towards a load that is no number no step would ever end.
        result=RESULTS.where(jnp.isfinite(span), result, RESULTS.infeasible_load),
    )
    walk = jax.lax.while_loop(goes_on, step, walk)
    is_done = walk.part == turns.size - 1
    is_short = (walk.result == RESULTS.successful) & ~is_done
    result = RESULTS.where(is_short, RESULTS.store_full, walk.result)
    return _path(contact, load, walk, result, fields), walk.num_states, walk.num_jumps


def _place(contact: Contact, found: Equilibrium, value: Scalar) -> _Place:
    area = contact.grid.cell_area * contact.grid.size
    load = found.load.at(value)
    mean_gap = mean(found.gap)

    def of_load(value: Scalar) -> Scalar:
        return area * contact.control(load.at(value)).energy(mean_gap)

    held, force = jax.value_and_grad(of_load)(value)
    control = contact.control(load)
    if control.fixes_mean:
        # What holds the gap does the work of its pressure.
        force = -area * found.mean_pressure
    return _Place(
        value,
        found.gap,
        mean_gap,
        found.mean_pressure,
        found.contact_area,
        found.energy,
        found.energy + (held if control.stores_energy else 0),
        found.energy + held,
        force,
    )


def _own_energy(contact: Contact) -> Scalar:
    """Return the elastic energy of full contact and that of the deepest adhesion everywhere."""
    values = contact.profile.values
    deepest = -jnp.min(jnp.where(jnp.isfinite(values), values, 0))
    elastic = contact.solid.held_by(0).energy(contact.heights)
    return elastic + contact.grid.cell_area * contact.grid.size * deepest


def _apart(contact: Contact) -> Field:
    """Return the gap of surfaces that are about to touch."""
    return jnp.max(contact.heights) - contact.heights


def _brings_together(contact: Contact, load: Load) -> Bool[Array, ""]:
    control = contact.control(load)
    return control.energy(jnp.ones(())) > control.energy(jnp.zeros(()))


def _store(entry: Any, size: int, fields: bool) -> Any:
    """Return room for a number of entries, without their gaps if these are not kept."""

    def room(leaf: Array) -> Array:
        is_field = leaf.ndim > 0
        if is_field and not fields:
            return jnp.zeros((size, 0), leaf.dtype)
        return jnp.full((size, *leaf.shape), jnp.nan if leaf.dtype.kind == "f" else 0, leaf.dtype)

    return jax.tree.map(room, entry)


def _put(store: Any, entry: Any, index: Int[Array, ""], is_kept: Bool[Array, ""]) -> Any:
    """Return a store with an entry, if it is kept."""

    def put(rows: Array, leaf: Array) -> Array:
        if rows.shape[1:] != leaf.shape:
            return rows
        return rows.at[jnp.where(is_kept, index, len(rows))].set(leaf, mode="drop")

    return jax.tree.map(put, store, entry)


def _path(contact: Contact, load: Load, walk: _Walk, result: RESULTS, fields: bool) -> Path:
    states, supplied, dissipation = walk.states

    def work(place: _Place, supplied: Array) -> Array:
        # A dead weight is no part of what is worked on.
        start = states.stored[0] - states.potential[0]
        return supplied + (place.stored - place.potential) - start

    one = jax.tree.map(lambda leaf: leaf[0], load)

    def loads(values: Array) -> Load:
        # What else a load has is the same all along.
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, values.shape), one).at(values)

    def event(jump: tuple[_Place, _Place, Scalar, Int[Array, ""], Bool[Array, ""]]) -> Jump:
        before, after, lost, number, is_touch = jump
        start, end = (one.at(place.value) for place in (before, after))
        kind, mode = reason_of(contact, start, before.gap, jax.random.key(0))
        kind = KINDS.where(is_touch, KINDS.touch, kind)
        return Jump(
            load=start,
            kind=kind,
            before=_state(contact, start, before.gap),
            after=_state(contact, end, after.gap),
            mode=mode,
            dissipation=lost,
            state=number,
        )

    return Path(
        load=loads(states.value),
        equilibrium=States(
            states.mean_gap,
            states.mean_pressure,
            states.contact_area,
            states.energy,
            work(states, supplied),
            dissipation,
            states.gap if fields else None,
        ),
        jumps=jax.lax.map(event, walk.jumps),
        work=work(walk.here, walk.supplied),
        dissipation=walk.dissipation,
        result=result,
    )


def _state(contact: Contact, load: Load, gap: Field) -> Equilibrium:
    """Return the equilibrium of a gap that was found before."""
    balance = contact.balance(contact.control(load))(gap)
    is_finite = jnp.isfinite(balance.residual)
    return equilibrium_at(
        contact,
        load,
        gap,
        balance,
        residual=balance.residual,
        num_steps=jnp.array(0),
        result=RESULTS.where(is_finite, RESULTS.successful, RESULTS.nonfinite),
        history=History.empty(["residual"], gap.dtype),
    )


def _cut(path: Path, num_states: int, num_jumps: int) -> Path:
    """Return a path with as many entries as there are."""

    def first(tree: Any, number: int) -> Any:
        return jax.tree.map(lambda leaf: jax.device_put(np.asarray(leaf)[:number]), tree)

    load, equilibrium = first((path.load, path.equilibrium), num_states)
    return replace(path, load=load, equilibrium=equilibrium, jumps=first(path.jumps, num_jumps))


def _describe(path: Path, load: Load) -> str:
    last = float(path.load.value[-1]) if len(path.load.value) else float(load.value[0])
    return (
        f"The path ended at {type(load).__name__}({last:.6g}) after {len(path.load.value)} states "
        f"and {len(path.jumps.state)} jumps"
    )


def _nonzero(value: Scalar) -> Scalar:
    return jnp.where(value == 0, 1, value)

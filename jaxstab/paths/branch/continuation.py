"""The branch of equilibria from one load to another, around its folds and corners."""

from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact, require_contact
from jaxstab.contact.hessian import Block
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.batching import by_entries
from jaxstab.core.checks import integer, is_traced, known, require, require_finite
from jaxstab.core.compile import program
from jaxstab.core.implicit import refuse_derivatives
from jaxstab.core.progress import can_be_shown, progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.stack import stacked
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.core.warn import warn
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient, SaddleNewton
from jaxstab.equilibrium.equilibrate import find, initial_gap
from jaxstab.equilibrium.equilibrium import State, state_at
from jaxstab.equilibrium.window import whole_start
from jaxstab.loads import Load, require_loads, require_same_machine
from jaxstab.paths.branch.branch import ENDS, Branch, Turn
from jaxstab.paths.branch.curve import Curve, Plane, Point
from jaxstab.paths.branch.morse_index import index_of, some_modes
from jaxstab.paths.branch.step import TURNS, Place, Stride, Way, next_stride
from jaxstab.paths.follow import PathInterrupted
from jaxstab.paths.path import States
from jaxstab.paths.record import Place as Recorded
from jaxstab.paths.record import Room, place_of

# The longest step, and the first, over the way from load to load.
_LONGEST, _FIRST = 0.1, 0.02
# Turns that there is room for under JAX transformations.
_MAX_TURNS = 16


def continuation(
    contact: Contact,
    load: Load,
    *,
    initial: ArrayLike | State | None = None,
    fields: bool = False,
    progress: bool | None = None,
    max_states: int = 512,
    throw: bool = True,
) -> Branch:
    """Return the branch of equilibria that begins at one load and leads on towards another.

    It goes on around folds, where an eigenvalue vanishes, and around the corners where a point lets
    go or touches, through states that are not stable: those that `follow` jumps over. Equilibria
    are curves in the gap and the mean pressure, which pseudo-arclength follows (Keller 1977), by
    Newton's method with sets of free points that change. A branch ends at the second load, where it
    closes in itself, or at a number of states. Two turns within one step are passed over.

    Arguments:
        contact: the contact problem.
        load: two loads: where the branch begins, and where it is to end.
        initial: an equilibrium at the first load, stable or not, or a gap to start from.
        fields: whether to keep the gap of every state.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        max_states: the number of states after which to stop.
        throw: raise where the branch is lost; otherwise look at `result` and `end`.

    Returns:
        The branch. Under JAX transformations it has `max_states` states and room for 16 turns, NaN
        where there is none; once these are full, it ends as "store_full". It cannot be
        differentiated, and says so; its turns are ends of stable branches whose loads
        `critical_load` differentiates.

    Raises:
        ValueError: for other than two finite loads that differ, or machines that do.
        SolverError: if `throw`, where there is no equilibrium at the first load, or the branch is
            lost.
    """
    require_contact(contact)
    cure = "give that at which the branch begins and that where it ends."
    require_loads(load, (2,), "continuation takes two loads", cure)
    require_finite("The load", load.value)
    ends = known(load.value)
    require("The load", ends[1:], ends[1:] != ends[:-1], "give two loads that differ.")
    require_same_machine(load)
    number = integer("max_states", max_states)
    require("max_states", number, number >= 2, "a branch has two states at least.")
    warn_if_coarse(contact, FOR_JUMPS)
    is_state = isinstance(getattr(initial, "equilibrium", initial), Equilibrium)
    start = initial_gap(contact, load[0], initial)
    whole, start = whole_start(contact, load[0], start)
    own, unit = whole.in_own_units()
    loads = load.in_units_of(unit)
    inputs: Any = refuse_derivatives((own, loads, start))
    bar = progress_bar(number, "states", shown=can_be_shown(progress, inputs))
    # What was not found is NaN.
    with jax.debug_nans(False), bar as bar:
        search = _traced if is_traced(inputs) else _eager
        branch = search(number, fields, bar, is_state, *inputs)
    branch = branch.in_units_of(1 / unit).on_surface(whole.solid)
    return throw_failure(branch.result, branch, lambda: _describe(branch, load), throw)


class Walk(eqx.Module):
    """A branch under way.

    Attributes:
        stride: the last step.
        start: where the branch began.
        longest: the longest step [length].
        modes: the lowest modes of the last state, once they are known.
        count: the number of its states.
        end: where it has ended, `ENDS.states` while it has not.
        result: that of the first equilibrium.
    """

    stride: Stride
    start: Place
    longest: Scalar
    modes: Block
    count: Int[Array, ""]
    end: ENDS
    result: RESULTS

    @property
    def is_on(self) -> Flag:
        """Whether it goes on."""
        return (self.end == ENDS.states) & (self.result == RESULTS.successful)


class Entry(eqx.Module):
    """A state of a branch."""

    place: Recorded
    index: Int[Array, ""]


def _way(contact: Contact, loads: Load, longest: Scalar) -> Way:
    last = loads.value[1].astype(contact.heights.dtype)
    return Way(Curve.of(contact, loads[0]), last, longest)


def _begin(is_state: bool, contact: Contact, loads: Load, start: Field | None) -> Walk:
    """Return a branch at its first state."""
    first, values = loads[0], loads.value
    solver = SaddleNewton() if is_state else PreconditionedConjugateGradient()
    found = find(contact, first, solver, start)
    at = Point(found.gap, _pressure(contact, first, found.gap))
    curve = Curve.of(contact, first)
    row = curve.load_gradient
    span = (values[1] - values[0]).astype(found.gap.dtype)
    ahead = Point(jnp.sign(span) * row.gap, jnp.sign(span) * row.pressure)
    is_free = found.gap > 0
    here = Place(at, is_free, curve.tangent(at, is_free, ahead))
    speed = jnp.abs(row.times(here.tangent))
    longest = _LONGEST * jnp.abs(span) / jnp.where(speed > 0, speed, 1)
    longest = jnp.minimum(longest, curve.length(at))
    no = jnp.array(False)
    stride = Stride(here, _FIRST / _LONGEST * longest, at, TURNS.none, ~no, no)
    one = jnp.array(1)
    return Walk(stride, here, longest, some_modes(found.gap), one, ENDS.states, found.result)


def _pressure(contact: Contact, load: Load, gap: Field) -> Scalar:
    """Return p0 of an equilibrium, of the grid that it is solved on."""
    gradient = contact.gradient(gap)
    return jnp.mean(contact.control(load).net_pressure(gradient, gap) - gradient)


def _next(way: Way, walk: Walk) -> Walk:
    """Return a branch after a step, which may have been cut."""
    old = walk.stride.here
    stride = next_stride(way, walk.stride)
    new = stride.here
    before, after = way.curve.value(old.at), way.curve.value(new.at)
    is_there = stride.is_new & ((after - way.last) * (before - way.last) <= 0)
    stride = jax.lax.cond(is_there, lambda: _landed(way, old, stride), lambda: stride)
    end = ENDS.where(is_there, ENDS.load, ENDS.states)
    end = ENDS.where(stride.is_new & _closes(way.curve, walk, new.at), ENDS.loop, end)
    end = ENDS.where(stride.is_lost, ENDS.lost, end)
    return replace(walk, stride=stride, count=walk.count + stride.is_new, end=end)


def _landed(way: Way, old: Place, stride: Stride) -> Stride:
    """Return a step that has gone beyond the last load at the load itself."""
    curve, new = way.curve, stride.here
    before, after = curve.value(old.at), curve.value(new.at)
    start = old.at.plus(new.at.minus(old.at), (way.last - before) / (after - before))
    plane = Plane(curve.load_gradient, way.last - curve.load_offset, jnp.abs(after - before))
    iteration = way.corrected(start, plane)
    at = iteration.state.at
    landed = replace(stride, here=replace(new, at=at, is_free=at.gap > 0))
    is_good = iteration.result == RESULTS.successful
    return jax.tree.map(partial(jnp.where, is_good), landed, stride)


def _closes(curve: Curve, walk: Walk, at: Point) -> Flag:
    """Return whether the last step has come back to where the branch began."""
    row = curve.gradient_of(walk.start.tangent)
    before = row.times(walk.stride.here.at.minus(walk.start.at))
    after = row.times(at.minus(walk.start.at))
    step = curve.length(at.minus(walk.stride.here.at))
    is_near = curve.length(at.minus(walk.start.at)) <= step
    return (walk.count > 3) & (before < 0) & (after >= 0) & is_near


def _entry(way: Way, walk: Walk) -> tuple[Walk, Entry, Turn]:
    """Return the last state of a branch, and the turn before it; the branch knows its modes."""
    gap = walk.stride.here.at.gap
    index, modes = index_of(way.curve.contact, way.curve.load, gap, walk.modes)
    entry = Entry(_recorded(way, walk.stride.here.at), index)
    return replace(walk, modes=modes), entry, _turn(way, walk)


def _recorded(way: Way, at: Point) -> Recorded:
    value = way.curve.value(at)
    return place_of(way.curve.contact, _state(way, at), value)


def _state(way: Way, at: Point) -> Equilibrium:
    return state_at(way.curve.contact, way.curve.load.at(way.curve.value(at)), at.gap)


def _turn(way: Way, walk: Walk) -> Turn:
    stride = walk.stride
    equilibrium = _state(way, stride.turn)
    change = stride.here.tangent.gap
    mode = change / jnp.sqrt(jnp.sum(change**2))
    return Turn(equilibrium.load, stride.kind, equilibrium, mode, walk.count - 1)


_begun = partial(program, static_argnums=0)(_begin)


@program
def _gone_on(contact: Contact, loads: Load, walk: Walk) -> tuple[Walk, Entry, Turn]:
    """Return a branch after the next new state, which it also returns, or at its end."""
    way = _way(contact, loads, walk.longest)
    fresh = replace(walk, stride=replace(walk.stride, is_new=jnp.array(False)))
    ended = jax.lax.while_loop(
        lambda walk: walk.is_on & ~walk.stride.is_new, partial(_next, way), fresh
    )
    return _entry(way, ended)


@program
def _first_entry(contact: Contact, loads: Load, walk: Walk) -> tuple[Walk, Entry, Turn]:
    return _entry(_way(contact, loads, walk.longest), walk)


def _eager(
    number: int, fields: bool, bar: Any, is_state: bool, contact: Contact, loads: Load, start: Any
) -> Branch:
    """Return a branch to its end, or until interrupted, state by state."""
    walk = _begun(is_state, contact, loads, start)
    walk, entry, like = _first_entry(contact, loads, walk)
    entries, turns = [_kept(entry, fields)], []
    try:
        while walk.is_on and len(entries) < number:
            walk, entry, turn = jax.block_until_ready(_gone_on(contact, loads, walk))
            if walk.stride.is_new:
                entries.append(_kept(entry, fields))
                bar.update(1)
                if turn.kind != TURNS.none:
                    turns.append(turn)
    except KeyboardInterrupt:
        warn(f"The branch was interrupted after {len(entries)} states.", PathInterrupted)
        walk = replace(walk, result=RESULTS.interrupted)
    return _branch(contact, loads, walk, stacked(entries, entry), stacked(turns, like))


def _kept(entry: Entry, fields: bool) -> Entry:
    return entry if fields else replace(entry, place=replace(entry.place, gap=jnp.zeros((0,))))


def _traced(
    number: int, fields: bool, bar: Any, is_state: bool, contact: Contact, loads: Load, start: Any
) -> Branch:
    """Return a branch in room for a number of states, within a program."""

    def search(contact: Contact, loads: Load, start: Any) -> Branch:
        walk = _begin(is_state, contact, loads, start)
        way = _way(contact, loads, walk.longest)
        walk, entry, turn = _entry(way, walk)
        states = Room(number, fields)(entry).with_entry(entry, jnp.array(True))
        turns = Room(_MAX_TURNS)(turn)

        def further(state: Any) -> Any:
            walk, states, turns = state
            walk = _next(way, walk)
            is_new = walk.stride.is_new
            walk, entry, turn = _entry(way, walk)
            is_turn = is_new & (walk.stride.kind != TURNS.none)
            return walk, states.with_entry(entry, is_new), turns.with_entry(turn, is_turn)

        def goes_on(state: Any) -> Flag:
            return state[0].is_on & ~state[1].is_full & ~state[2].is_full

        walk, states, turns = jax.lax.while_loop(goes_on, further, (walk, states, turns))
        is_cut = walk.is_on & turns.is_full & ~states.is_full
        walk = replace(walk, result=RESULTS.where(is_cut, RESULTS.store_full, walk.result))
        return _branch(contact, loads, walk, states.rows, turns.rows)

    return by_entries(search)(contact, loads, start)


def _branch(contact: Contact, loads: Load, walk: Walk, entries: Entry, turns: Turn) -> Branch:
    place = entries.place
    result = RESULTS.where(walk.end == ENDS.lost, RESULTS.stagnated, walk.result)
    states = States(
        place.mean_gap,
        place.mean_pressure,
        place.contact_area,
        jnp.broadcast_to(contact.area, place.energy.shape),
        place.energy,
        place.stored - place.stored[0],
        jnp.zeros_like(place.energy),
        place.gap if place.gap.size else None,
        contact.units,
        contact.solid.is_window,
    )
    load = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[0], place.value.shape), loads)
    return Branch(load.at(place.value), states, entries.index, turns, walk.end, result)


def _describe(branch: Branch, load: Load) -> str:
    count, last = len(branch.load.value), float(branch.load.value[-1])
    return f"The branch ended at {type(load).__name__}({last:.6g}) after {count} states"

"""The path of a contact along a load path, through its jumps."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax

from jaxstab.branches.differentiable_limit import differentiable_value
from jaxstab.contact import Contact, require_contact
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.checks import (
    cast,
    concrete,
    integer,
    is_traced,
    parameter,
    require,
    require_finite,
    require_positive,
    scalar_parameter,
)
from jaxstab.core.compile import own_conventions
from jaxstab.core.display import several
from jaxstab.core.implicit import attach, no_derivatives, where_traced
from jaxstab.core.interrupts import early_ends, interrupts_held
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field, Scalar
from jaxstab.core.warn import warn
from jaxstab.equilibrium.equilibrium import State
from jaxstab.equilibrium.posing import finish, pose
from jaxstab.equilibrium.start import initial_of_path, start_of
from jaxstab.equilibrium.validity import warn_beyond_hardness
from jaxstab.loading.jump_detection import PathSearch
from jaxstab.loading.load_path import DISTURBANCE, LoadPath, load_path_of
from jaxstab.loading.load_stepping import step_to_end
from jaxstab.loading.path import Jump, Path
from jaxstab.loading.recorded_path import path_of, path_with_room, with_jump
from jaxstab.loads import Load, require_load, require_same_machine
from jaxstab.states.point import PathPoint
from jaxstab.states.record import RecordList, Room
from jaxstab.states.sequence import PathInterrupted

# Jumps are located by default from this loss: over the problem's characteristic energy, and over
# the earlier losses.
_SMALLEST_JUMP = 2e-7
_SMALLEST_SHARE = 3e-3


def follow(
    contact: Contact,
    load: Load,
    *,
    initial: ArrayLike | State | None = None,
    smallest_jump: ArrayLike | None = None,
    disturbance: ArrayLike = DISTURBANCE,
    fields: bool = False,
    progress: bool | None = None,
    max_states: int = 1024,
    max_jumps: int = 64,
    throw: bool = True,
) -> Path:
    """Return the equilibria through which a contact goes as its load goes from value to value.

    A step is predicted from the two states before, and corrected by conjugate gradients. Where a
    branch ends, the load goes on by 1e-6 of its range, and conjugate gradients lower the energy
    from the last state to an equilibrium. An overdamped relaxation, g' = -(K u + p0 + f'), reached
    the same contact points in all of 162 jumps of rough surfaces (benchmarks/results/jumps.md).
    Between jumps a branch is reversible. So the loss of the path is the sum over its jumps of the
    differences of two potentials at one load. `unlocated` estimates the loss in smaller jumps.
    Surfaces that a tension has pulled apart stay so until there is a pressure.

    On a contact with a hardness the indentation z is kept from state to state, and never falls: a
    step is the equilibrium over the surface that the state before has left. Where nothing yields a
    path is elastic. Loads count from the surface with which the path began, `MeanGap` too.
    `plastic_work` is known exactly, and `path.contact` is the contact over the surface that is
    left. Kind, mode and barrier of a jump are those of the branch on which points at the pressure H
    yield on; a branch also ends where a point begins to yield, if that lowers the energy. Loads of
    jumps then have no derivatives.

    Ctrl-C ends a path after the current steps, in about a second, and returns the states so far.

    Arguments:
        contact: the contact problem.
        load: the turning points of the load path, in order: two or more.
        initial: where the first equilibrium starts, as in `equilibrate`.
        smallest_jump: the loss from which a jump is located, over the problem's characteristic
            energy: the elastic energy of full contact and the deepest adhesion. By default 2e-7, or
            0.3 % of the earlier losses of the path if that is more: jumps of 1 % of a loop's loss
            are located. Of those below, some of several times the loss asked for are passed over,
            where the change of the force in a step balances it; `unlocated_error` includes them.
        disturbance: the size of a random field over the rms height; zero for none. The field is the
            same at every step, and is added to the start of each equilibrium. On a surface flatter
            than the range of the law and the spacing of the grid, the size is relative to the
            smaller of these. So the path leaves branches that are stable only by symmetry.
        fields: whether to keep the gap of every recorded state.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        max_states: how many states there is room for under JAX transformations. Elsewhere a path
            has as many as it needs.
        max_jumps: how many jumps, likewise; eleven fields of memory for each.
        throw: raise an error if the path does not reach its end; otherwise look at `result`.

    Returns:
        The path. Under JAX transformations arrays have `max_states` and `max_jumps` entries, with
        NaN, zero or the first member of an enumeration where there is none; otherwise as many as
        there are. `path.recorded` and `batch[3]` leave the empty entries out. The loads of the
        jumps can be differentiated with respect to the contact, as `critical_load` can. The
        derivatives of anything else are NaN.

    Raises:
        ValueError: for a load without two finite values or more in one dimension, or with a value
            that repeats the one before. For machines that differ, and for too little room.
        SolverError: if `throw`, where an equilibrium is not found, or there is no room left.

    Example:
        >>> path = js.follow(contact, js.MeanGap([0.3, 0.03, 0.3]), fields=True)
        >>> [f"{jump.load.value:.4f} {jump.kind}" for jump in path.jumps]
        ['0.0621 fold', '0.0627 release']
    """
    require_contact(contact)
    require_load(load)
    if load.value.ndim != 1 or load.value.size < 2:
        raise ValueError(
            f"follow takes the turning points of a load, two or more in one dimension, but "
            f"{type(load).__name__} holds an array of shape {load.value.shape}."
        )
    # Turning points may be given in a higher precision than the contact has.
    load = cast(load, contact.heights.dtype)
    require_finite("The load", load.value)
    turns = concrete(load.value)
    cure = "a turning point repeats the one before: leave it out."
    require("The load", turns, (turns[1:] != turns[:-1]).all(), cure)
    require_same_machine(load)
    share = parameter(0.0)
    if smallest_jump is None:
        smallest_jump = _SMALLEST_JUMP
        share = parameter(_SMALLEST_SHARE)
    least = scalar_parameter(smallest_jump, "smallest_jump")
    noise = scalar_parameter(disturbance, "The disturbance")
    require_positive("smallest_jump", least)
    require("The disturbance", noise, concrete(noise) >= 0, "it must not be negative.")
    room = Room(integer("max_states", max_states), integer("max_jumps", max_jumps), fields)
    require("max_states", room.num_states, room.num_states >= 2, "a path has two states at least.")
    require("max_jumps", room.num_events, room.num_events >= 1, "leave room for one.")
    warn_if_coarse(contact, FOR_JUMPS)
    load.warn_if_soft(contact.solid)
    problem = pose(contact, load)
    initial = initial_of_path(contact, load[0], initial)
    start = start_of(problem.contact, problem.load[0], initial)
    inputs = problem.contact, problem.load
    others = start, least, noise
    constants = jax.lax.stop_gradient((*inputs, *others))
    with own_conventions(), progress_bar("path", 100, "%", shown=progress, inputs=constants):
        known, turning_points, start, least, noise = constants
        load_path = load_path_of(known, turning_points, least, noise, share=share, finds_all=True)
        if is_traced((load_path, start)):
            path = path_with_room(room, load_path, start)
        else:
            path = _known_path(fields, load_path, start)
        path = _with_derivatives(path, inputs, others)
    # An interrupt here would lose a long path.
    with interrupts_held() as held:
        path = finish(path, problem, partial(_describe, load), throw)
        if path.last_indentation is not None:
            path = replace(path, contact=contact.with_indentation(path.last_indentation))
    states = path.equilibrium
    warn_beyond_hardness(contact, states.mean_pressure, states.contact_area)
    if held:
        warn(
            "Ctrl-C came after the last step of the path, of which nothing is lost.",
            PathInterrupted,
        )
    return path


@where_traced
def _with_derivatives(path: Path, inputs: tuple[Contact, Load], others: tuple) -> Path:
    """Return a path with derivatives of the loads of its jumps; all others are NaN."""
    contact, load = inputs

    def value(jump: Jump) -> Scalar:
        shared = load[0].at(jump.load.value)
        ahead = jump.after.load.value - jump.load.value
        return differentiable_value(shared, jump.before.gap, ahead, contact)

    values = jax.lax.map(value, path.jumps)
    numbers, rest = eqx.partition(path, eqx.is_inexact_array)
    path = eqx.combine(attach(no_derivatives, numbers, None, (contact, load, others)), rest)
    if contact.hardness is not None:
        return path
    return replace(path, jumps=replace(path.jumps, load=path.jumps.load.at(values)))


def _known_path(fields: bool, load_path: LoadPath, start: Field) -> Path:
    """Return the path to the end, or until interrupted."""
    load = load_path.load
    recording: RecordList[PathSearch, PathPoint, Jump] = RecordList(fields)
    was_interrupted = False
    try:
        step_to_end(load_path, start, lambda _: recording, partial(with_jump, load_path))
    except early_ends():
        if recording.search is None:
            raise
        was_interrupted = True
    search = recording.search
    is_cut = bool(search.goes_on(load))
    result = search.result
    if is_cut:
        result = RESULTS.interrupted
    with interrupts_held() as held:
        path = path_of(load_path, recording, result)
    if is_cut:
        part = 100 * search.fraction_done(load)
        warn(f"The path was interrupted at {part:.0f} %.", PathInterrupted)
    elif was_interrupted or held:
        warn("The path was interrupted after its last step; it is complete.", PathInterrupted)
    return path


def _describe(load: Load, path: Path) -> str:
    last = load.value[0]
    if len(path.load.value):
        last = path.load.value[-1]
    return (
        f"The path ended at {type(load).__name__}({float(last):.6g}) after "
        f"{several(len(path.load.value), 'state')} and {several(len(path.jumps.state), 'jump')}"
    )

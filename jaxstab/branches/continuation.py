"""The branch of equilibria from one load to another, around its folds and active-set changes."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from jaxstab.branches.branch import Branch, Turn
from jaxstab.branches.branch_steps import (
    BranchState,
    Entry,
    begin,
    entry_of,
    is_same,
    next_state,
    two_loads,
)
from jaxstab.branches.curve import ContinuationProblem
from jaxstab.contact import Contact, require_contact, require_elastic
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.checks import (
    concrete,
    integer,
    is_traced,
    require,
    require_positive,
    scalar_parameter,
)
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.control_flow import by_entries, cond, while_loop
from jaxstab.core.display import several
from jaxstab.core.implicit import refuse_derivatives
from jaxstab.core.interrupts import early_ends, interrupts_held
from jaxstab.core.progress import advance_to, progress_bar
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import first_entries
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.core.warn import warn
from jaxstab.equilibrium import (
    EquilibriumSolver,
    PreconditionedConjugateGradient,
    SaddleNewton,
)
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.equilibrium import State
from jaxstab.equilibrium.posing import finish, pose
from jaxstab.equilibrium.start import start_of
from jaxstab.loads import Load
from jaxstab.states.kinds import ENDS
from jaxstab.states.point import states_along
from jaxstab.states.record import Record, RecordList, Room, Tables
from jaxstab.states.sequence import PathInterrupted

# Turns that there is room for under JAX transformations.
_MAX_TURNS = 16
Store = TypeVar("Store", RecordList[BranchState, Entry, Turn], Tables[Entry, Turn])


def continuation(
    contact: Contact,
    load: Load,
    *,
    initial: ArrayLike | State | None = None,
    fields: bool = False,
    progress: bool | None = None,
    max_states: int = 512,
    max_step: ArrayLike | None = None,
    min_step: ArrayLike | None = None,
    throw: bool = True,
) -> Branch:
    """Return the branch of equilibria that begins at one load and leads on towards another.

    It goes on around folds, where an eigenvalue vanishes, and active-set changes, where a point is
    released or touches, through unstable states, over which `follow` jumps. Equilibria
    are curves in the gap and the mean pressure, which pseudo-arclength follows (Keller 1977). They
    are smooth between active-set changes, which are located one by one; on grids of 128 points or
    more, one point in 64 may change sides in a step. A step that the events in it do not explain is
    cut: where Newton's method is slow, where tangents turn, gaps or reactions do not stay positive,
    or the number of negative eigenvalues changes otherwise than at these events. So a branch does
    not cross to another one unseen. It goes straight on through a bifurcation, where by symmetry
    another branch crosses, and records it among its turns: also where points that are equal by
    symmetry detach or touch together, and one of them alone would lead elsewhere. Pairs of turns
    closer than `min_step` may be passed over.

    Lengths of steps are the rms change of the gap, together with the change of p0 over the
    stiffness of the solid's softest wave.

    Arguments:
        contact: the contact problem.
        load: two loads: where the branch begins, and where it is to end.
        initial: an equilibrium at the first load, stable or not, or a gap to start from.
        fields: whether to keep the gap of every state.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        max_states: the number of states after which to stop.
        max_step: the longest step [length]; by default a tenth of the way from load to load, as the
            branch begins.
        min_step: the shortest step [length]; by default 1e-7 of the longest, in float32 1e-4.
        throw: raise where the branch cannot be followed on; otherwise look at `result` and `end`.

    Returns:
        The branch; `end` says why it ends. Under JAX transformations it has `max_states` states and
        room for 16 turns; `branch.recorded` and `batch[3]` leave out the empty entries, with loads
        of NaN. Once there is no room for a turn, it ends as "store_full". It cannot be
        differentiated, and says so; its turns are ends of stable branches whose loads
        `critical_load` differentiates.

    Raises:
        ValueError: for other than two finite loads that differ, or machines that do; for steps that
            are not positive, and a shortest one that exceeds the longest.
        SolverError: if `throw`, where there is no equilibrium at the first load, or the branch ends
            as "uncertain" or "lost".

    Example:
        >>> branch = js.continuation(contact, js.MeanGap([0.05, 0.3]), initial=state)
        >>> [f"{turn.load.value:.4f} {turn.kind}" for turn in branch.turns]
        ['0.0627 release', '0.0621 fold']
    """
    require_contact(contact)
    require_elastic(contact, "continuation")
    cure = "give the load where the branch begins and the load where it ends."
    load = two_loads(load, contact, "continuation takes two loads", cure)
    number = integer("max_states", max_states)
    require("max_states", number, number >= 2, "a branch has two states at least.")
    longest = _positive("max_step", max_step)
    shortest = _positive("min_step", min_step)
    if longest is not None and shortest is not None:
        require("min_step", shortest, shortest <= longest, "give at most `max_step`.")
    load.warn_if_soft(contact.solid)
    warn_if_coarse(contact, FOR_JUMPS)
    problem = pose(contact, load)
    start = start_of(problem.contact, problem.load[0], initial)
    solver = PreconditionedConjugateGradient()
    if isinstance(initial, eqx.Module):
        solver = SaddleNewton()
    given = problem.contact, problem.load, solver, start, [longest, shortest]
    constants = jax.lax.stop_gradient(refuse_derivatives(given))
    with (
        own_conventions(),
        progress_bar("branch", number, "states", shown=progress, inputs=constants),
    ):
        if is_traced(constants):
            branch = _branch_with_room(Room(number, _MAX_TURNS, fields), *constants)
        else:
            branch = _known_branch(number, fields, *constants)
    # An interrupt here would lose a long branch.
    with interrupts_held() as held:
        branch = finish(branch, problem, partial(_describe, load), throw)
    if held:
        warn("Ctrl-C came after the last state of the branch, which is kept.", PathInterrupted)
    return branch


def _positive(name: str, step: ArrayLike | None) -> Scalar | None:
    if step is None:
        return None
    length = scalar_parameter(step, name)
    require_positive(name, length)
    return length


def _first_record(
    contact: Contact,
    load: Load,
    solver: EquilibriumSolver,
    start: Field,
    steps: list[Scalar | None],
) -> tuple[ContinuationProblem, BranchState, Record[Entry, Turn]]:
    """Return the problem of a branch, the branch at its first state, and the record of that."""
    problem, branch = begin(contact, load, find(contact, load[0], solver, start), *steps)
    return problem, branch, _record_of(problem, branch)


def _record_of(problem: ContinuationProblem, branch: BranchState) -> Record[Entry, Turn]:
    """Return the record of the last step of a branch: its state, and the turn before it."""
    entry, turn = entry_of(problem, branch)
    is_new = concrete(branch.step.is_new)
    return Record(entry, is_new, turn, is_new & concrete(branch.step.turn.exists))


def _follow(
    problem: ContinuationProblem, branch: BranchState, store: Store
) -> tuple[BranchState, Store]:
    """Return a branch at its end, or where its store is full, and the store.

    1. Step along the curve until there is a new state, or the branch ends.
    2. If the load turns there where it has turned before, the branch is a loop, and ends.
    3. Append the state, and the turn.
    """

    def goes_on(state: tuple[BranchState, Store]) -> Flag:
        branch, store = state
        return branch.goes_on & ~concrete(store.is_full)

    def further(state: tuple[BranchState, Store]) -> tuple[BranchState, Store]:
        branch, store = state
        branch = _next_new_state(problem, branch)
        record = _record_of(problem, branch)
        is_known = partial(is_same, problem, record.event)
        is_loop = cond(record.is_event, lambda: store.has_event(is_known), lambda: False)
        end = cond(is_loop, lambda: ENDS.loop, lambda: branch.end)
        branch = replace(branch, end=end)
        store = store.append(branch, record)
        advance_to(lambda: int(branch.count))
        return branch, store

    return while_loop(goes_on, further, (branch, store))


def _next_new_state(problem: ContinuationProblem, branch: BranchState) -> BranchState:
    """Return a branch after its next new state, or at its end."""
    fresh = replace(branch, step=replace(branch.step, is_new=np.array(False)))
    return while_loop(
        lambda branch: branch.goes_on & ~concrete(branch.step.is_new),
        partial(next_state, problem),
        fresh,
    )


def _known_branch(number: int, fields: bool, *inputs: PyTree) -> Branch:
    """Return a branch to its end, or until interrupted."""
    problem, branch, record = _first_record(*inputs)
    recording: RecordList[BranchState, Entry, Turn] = RecordList(fields, number)
    recording.append(branch, record)
    try:
        _follow(problem, branch, recording)
    except early_ends():
        states = several(len(recording.states), "state")
        warn(f"The branch was interrupted after {states}.", PathInterrupted)
        recording.search = replace(recording.search, result=RESULTS.interrupted)
    with interrupts_held():
        entries, turns = recording.rows(record.event)
        found = _branch(problem, recording.search, recording.table())
        number = len(recording.states)
        load = first_entries(found.load, number)
        states = first_entries(found.equilibrium, number)
        index = first_entries(found.index, number)
        gap = None
        if fields:
            gap = entries.point.gap
        states = replace(states, gap=gap)
        return replace(found, load=load, equilibrium=states, index=index, turns=turns)


@program
@by_entries
def _branch_with_room(room: Room, *inputs: PyTree) -> Branch:
    """Return a branch in room for a number of states, within a program."""
    problem, branch, record = _first_record(*inputs)
    branch, tables = _follow(problem, branch, room(record).append(branch, record))
    is_cut = branch.goes_on & tables.events.is_full & ~tables.states.is_full
    branch = replace(branch, result=RESULTS.where(is_cut, RESULTS.store_full, branch.result))
    found = _branch(problem, branch, tables.states.rows)
    return replace(found, turns=tables.events.rows)


@program
def _branch(problem: ContinuationProblem, branch: BranchState, entries: Entry) -> Branch:
    """Return the branch through its states, without its turns."""
    is_unclear = (branch.end == ENDS.lost) | (branch.end == ENDS.uncertain)
    result = RESULTS.where(is_unclear, RESULTS.lost_branch, branch.result)
    load, states = states_along(problem.curve.contact, problem.curve.load, entries.point)
    none: Any = None
    return Branch(load, states, entries.index, none, branch.end, result)


def _describe(load: Load, branch: Branch) -> str:
    number = several(len(branch), "state")
    last = float(branch.load.value[-1])
    # Without a first state there is no load, nor an end.
    if math.isnan(last):
        last = float(load.value[0])
    sentence = f"The branch ended at {type(load).__name__}({last:.6g}) after {number}"
    if branch.end != ENDS.states:
        sentence += f", {ENDS[branch.end]}"
    return sentence

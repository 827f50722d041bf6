"""The load at which a stable branch of equilibria ends, in a fold or a release.

At a fold the smallest eigenvalue on the free points vanishes, and the branch turns back:

    K u + p0 + f'(g) = 0 on the free points,   lambda(g) = 0.

At a release the reaction of a contact point vanishes instead, and the energy falls as it opens.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.branch_steps import FARTHER, BranchState, begin, two_loads
from jaxstab.branches.corrector import AT_STATES
from jaxstab.branches.differentiable_limit import CriticalLoad, critical_load_at
from jaxstab.branches.limit import Limit, limit_of, no_limit
from jaxstab.contact import Contact, require_contact, require_elastic
from jaxstab.contact.energy import characteristic_energy, supply_of
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.accuracy import EQUILIBRIUM, rounding_of_numbers
from jaxstab.core.checks import array
from jaxstab.core.compile import in_pieces, own_conventions, program
from jaxstab.core.control_flow import choose, cond, while_loop
from jaxstab.core.grid import mean
from jaxstab.core.progress import advance_if_known, advance_to, progress_bar
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.equilibrium import State, fields_of
from jaxstab.equilibrium.posing import finish, pose
from jaxstab.equilibrium.solvers.conjugate_gradients import MAX_MOVE_IN_JUMP
from jaxstab.equilibrium.start import initial_of_path, start_of
from jaxstab.loads import Load
from jaxstab.states.kinds import KINDS

# Where the branches from the two loads start.
Starts = list[Field]
# A branch is followed from either load.
_NUM_SEARCHES = 2
# Releases that lose a smaller part of the problem's characteristic energy do not end a branch: so
# little is known in float32. The next one is sought so far beyond, over the distance between the
# loads.
_SMALLEST_LOSS = 1e-5
_BEYOND = 1e-6
# A branch has not left the release before it if it ends at so many times the distance from there at
# which it was begun, or nearer.
_STILL_NEAR = 10.0


def critical_load(
    contact: Contact,
    bracket: Load,
    *,
    initial: ArrayLike | State | None = None,
    progress: bool | None = None,
    throw: bool = True,
) -> CriticalLoad:
    """Return the load at which a branch of stable equilibria ends between two loads.

    The branch is followed as by `jaxstab.continuation` to its first fold or release. That need not
    be a pull-off: beyond it the contact may go on in another state, as rough surfaces often do.
    `jaxstab.pull_off` gives the last one, `jaxstab.follow` all of them. A release that loses less
    than 1e-5 of the problem's characteristic energy (`follow`), as when the edge of contact moves
    by a point of the grid, is passed over. In float32 the branch beyond it may be lost, as the
    result says.

    Arguments:
        contact: the contact problem.
        bracket: a load that holds two values: one at which the branch is stable, and one beyond
            its end. If the branch from the first does not end before the second, the branch
            from the second is followed towards the first.
        initial: where equilibria at both loads start, as in `equilibrate`.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        throw: raise an error if no end is found; otherwise look at `result`.

    Returns:
        The end of the branch. Its load, equilibrium and mode can be differentiated with respect to
        the contact: dl = -(x.dr) / (x.dr/dl), with r the net pressure. At a fold x is the mode; at
        a release it is the perturbation that opens the point, with the free points following. The
        derivative is NaN at a bifurcation of a symmetric state, where two events coincide (another
        point touches or is released at the same load), and where no end was found exactly.

    Raises:
        ValueError: for other than two finite loads that differ, machines that do, or an initial gap
            that is invalid in `equilibrate`.
        SolverError: if `throw`, where the first load has no stable equilibrium, or its branch does
            not end in the bracket.

    Example:
        >>> end = js.critical_load(contact, js.MeanGap([0.05, 0.3]), initial=state)
        >>> f"{end.load.value:.4f} {end.kind}"
        '0.0627 release'
    """
    require_contact(contact)
    require_elastic(contact, "critical_load")
    cure = "give one on the stable branch and one beyond its end."
    bracket = two_loads(bracket, contact, "critical_load takes two loads", cure)
    bracket.warn_if_soft(contact.solid)
    warn_if_coarse(contact, FOR_JUMPS)
    problem = pose(contact, bracket)
    inputs = problem.contact, problem.load
    starts = [
        start_of(problem.contact, load, initial_of_path(problem.contact, load, initial))
        for load in problem.load
    ]
    constants = jax.lax.stop_gradient((*inputs, starts))
    with own_conventions():
        with progress_bar(
            "critical load", _NUM_SEARCHES, "search", shown=progress, inputs=constants
        ):
            limit = _find(*constants)
            # Not all searches are needed.
            advance_to(lambda: _NUM_SEARCHES)
        end = critical_load_at(*inputs, limit)
    return finish(end, problem, partial(_describe, bracket), throw)


@in_pieces
def _find(contact: Contact, bracket: Load, starts: Starts) -> Limit:
    """Return the end of the branch from the first load, or else of that from the second.

    If there is neither, the message is about the first. A branch that could not be followed is no
    reason to take the end of another one.
    """
    first = _limit(contact, bracket, starts[0])
    advance_if_known(first)

    def from_second() -> Limit:
        second = _limit(contact, bracket[::-1], starts[1])
        advance_if_known(second)
        return cond(_is_answer(second), lambda: second, lambda: first)

    return cond(_is_answer(first), lambda: first, from_second)


def _is_answer(limit: Limit) -> Flag:
    return limit.is_found | (limit.result == RESULTS.lost_branch)


class _CriticalSearch(eqx.Module):
    """The limit of the branch before, or none yet, and where the next branch is sought.

    Attributes:
        limit: the limit.
        loads: the load at which it begins, and the last one.
        step: how far the first lies beyond the limit, or beyond the load that was tried before.
        max_move: how far a step of the solver may move a point there.
        number: of branches that were followed.
        is_over: whether the limit is the answer.
        is_stuck: whether no stable state has been found behind it yet.
        goes_on: whether another branch is to be followed.
    """

    limit: Limit
    loads: Load
    step: Scalar
    max_move: Scalar
    number: Int[Array, ""]
    is_over: Flag
    is_stuck: Flag
    goes_on: Flag


def _limit(contact: Contact, loads: Load, start: Field) -> Limit:
    """Return where the branch from the first load ends as the load goes to the second.

    At a contact edge that moves by one point of the grid a release may lose next to nothing. Then
    the next branch counts as the same one.

    1. Find an equilibrium: first at the first load, then just beyond the last release, from there.
    2. If there is none beyond the release, or energy has been lost, the release is the answer.
    3. Otherwise follow the branch of the equilibrium to its limit.
    4. If that is a release, repeat from 1 beyond it.
    5. If the branch was lost, or has not left the release before, repeat from 1 farther beyond.
    6. If it is any other limit, or the branch has none, that is the answer.
    """

    def next_limit(search: _CriticalSearch) -> _CriticalSearch:
        # In single precision a looser solver takes the last state of a branch for balanced behind
        # its end: it goes on as far as rounding allows, which is close enough.
        tolerance = AT_STATES[contact.heights.dtype.name]
        solver = PreconditionedConjugateGradient(max_move=search.max_move, tolerance=tolerance)
        found = find(contact, search.loads[0], solver, search.limit.gap)
        result, is_left = leaves_branch(contact, search, found)
        found = replace(found, result=result)
        limit, is_stable = cond(
            is_left,
            lambda: (search.limit, array(True)),
            lambda: _limit_from(contact, search.loads, found),
        )
        return _search_after(search, loads, limit, is_stable, is_left)

    begun = search_from(contact, loads, start)
    search = while_loop(lambda search: search.goes_on, next_limit, begun)
    return replace(search.limit, result=_result(search))


@program
def search_from(contact: Contact, loads: Load, start: Field) -> _CriticalSearch:
    """Return that no limit is known, and the search for the first branch."""
    dtype = contact.heights.dtype
    loads = loads.at(loads.value.astype(dtype))
    no = jnp.array(False)
    infinite = jnp.full((), jnp.inf, dtype)
    # Between equal loads, or such that are not finite, no branch is followed.
    goes_on = (loads.value[1] - loads.value[0]) ** 2 > 0
    none = no_limit(contact, loads[0], start)
    number = jnp.zeros((), int)
    return _CriticalSearch(none, loads, _just_beyond(loads), infinite, number, no, no, goes_on)


def _just_beyond(loads: Load) -> Scalar:
    """Return how far behind a release the next branch is sought."""
    first, last = loads.value
    rounding = rounding_of_numbers(first.dtype) * jnp.maximum(jnp.abs(first), jnp.abs(last))
    return jnp.sign(last - first) * jnp.maximum(_BEYOND * jnp.abs(last - first), rounding)


@program
def leaves_branch(
    contact: Contact, search: _CriticalSearch, found: Equilibrium
) -> tuple[RESULTS, Flag]:
    """Return how an equilibrium was found, and whether the branch was left for good before it."""
    close = 10 * EQUILIBRIUM[contact.heights.dtype.name]
    is_close = (found.result == RESULTS.stagnated) & (found.residual <= close)
    result = RESULTS.where(is_close, RESULTS.successful, found.result)

    def potential(load: Load, gap: Field) -> tuple[Scalar, Scalar]:
        fields, _ = fields_of(contact, load, gap)
        held, force = supply_of(contact, load, mean(gap), fields["mean_pressure"])
        return fields["energy"] + held, force

    limit = search.limit
    before, force = potential(limit.load, limit.gap)
    after, force_after = potential(found.load, found.gap)
    # Behind a release the force is another one.
    force = jnp.where(limit.is_found, force_after, force)
    work = (found.load.value - limit.load.value) * (force + force_after) / 2
    is_lost = before + work - after > _SMALLEST_LOSS * characteristic_energy(contact)
    return result, (search.number > 0) & ((result != RESULTS.successful) | is_lost)


def _limit_from(contact: Contact, loads: Load, found: Equilibrium) -> tuple[Limit, Flag]:
    """Return the limit of the branch of an equilibrium at the first load, and whether it is stable.

    An unstable one is on no stable branch.
    """
    problem, branch = begin(contact, loads, found, to_limit=True)
    result, is_stable = _if_stable(branch)
    return limit_of(problem, replace(branch, result=result)), is_stable


@program
def _if_stable(branch: BranchState) -> tuple[RESULTS, Flag]:
    is_stable = branch.step.index == 0
    result = RESULTS.where(is_stable, RESULTS.successful, RESULTS.no_fold)
    return RESULTS.where(branch.result == RESULTS.successful, result, branch.result), is_stable


@program
def _search_after(
    search: _CriticalSearch, loads: Load, limit: Limit, is_stable: Flag, is_left: Flag
) -> _CriticalSearch:
    """Return the search after the limit of a branch, given whether the branch began stable.

    Arguments:
        search: the search before.
        loads: the first and the last load.
        limit: the limit of the branch.
        is_stable: whether the branch began stable.
        is_left: whether the limit before is the answer.
    """
    old = search.limit
    first, last = loads.value.astype(search.step.dtype)
    value = search.loads.value[0]
    # Right behind a release the solver may stay where the point has not opened yet.
    is_lost = limit.result == RESULTS.lost_branch
    # Where every perturbation costs energy the branch does not end, whatever its tangents say.
    is_lost |= (limit.kind == KINDS.uncertain) & (limit.critical.eigenvalue > limit.critical.error)
    distance = jnp.abs(value - old.load.value)
    is_near = jnp.abs(limit.load.value - old.load.value) <= _STILL_NEAR * distance
    is_stuck = (search.number > 0) & (~is_stable | (is_lost & is_near & old.is_found))
    is_lost |= is_stuck
    is_release = limit.is_found & (limit.kind == KINDS.release)
    is_over = is_left | (~is_lost & ~is_release)
    # Never back, so that the search has an end.
    reached = jnp.where(is_stuck, old.load.value, limit.load.value)
    reached = jnp.where((reached - value) * (last - first) > 0, reached, value)
    # From beyond where a curve could not be followed it is the same branch, if nothing is lost.
    just_beyond = _just_beyond(loads).astype(search.step.dtype)
    step = jnp.where(is_lost, FARTHER * search.step, just_beyond)
    value = reached + step
    return _CriticalSearch(
        limit=choose(is_stuck, old, limit),
        loads=loads.at(jnp.stack([value, last])),
        step=step,
        max_move=jnp.full_like(search.max_move, MAX_MOVE_IN_JUMP),
        number=search.number + 1,
        is_over=is_over,
        is_stuck=is_stuck,
        goes_on=~is_over & ((last - value) * (last - first) > 0),
    )


@program
def _result(search: _CriticalSearch) -> RESULTS:
    """Return how a search for a limit has ended."""
    result = search.limit.result
    is_lost = (search.number > 0) & (search.is_stuck | (result == RESULTS.lost_branch))
    otherwise = RESULTS.where(is_lost, RESULTS.lost_branch, RESULTS.no_fold)
    return RESULTS.where(search.is_over, result, otherwise)


def _describe(bracket: Load, found: CriticalLoad) -> str:
    first, last = (float(value) for value in jax.lax.stop_gradient(bracket.value))
    equilibrium = jax.lax.stop_gradient(found.equilibrium)
    return (
        f"No end of a branch found between {type(bracket).__name__}({first:.6g}) and ({last:.6g}): "
        f"the search ended at {float(equilibrium.load.value):.6g} with a residual of "
        f"{float(equilibrium.residual):.3g}"
    )

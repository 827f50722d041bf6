"""The load at which a stable branch of equilibria ends, in a fold or a release.

At a fold the smallest eigenvalue on the free points vanishes, and the branch turns back:

    K u + p0 + f'(g) = 0 on the free points,   lambda(g) = 0.

At a release the reaction of a contact point vanishes instead, and the energy falls as it opens.
"""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.branch_steps import BranchState, begin, two_loads
from jaxstab.branches.differentiable_limit import CriticalLoad, critical_load_at
from jaxstab.branches.energy import characteristic_energy, supply_of
from jaxstab.branches.kinds import KINDS
from jaxstab.branches.limit import Limit, limit_of, no_limit
from jaxstab.contact import Contact, require_contact
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.checks import array
from jaxstab.core.compile import in_pieces, own_conventions, program
from jaxstab.core.control_flow import choose, cond, while_loop
from jaxstab.core.grid import mean
from jaxstab.core.interrupts import interrupts_held
from jaxstab.core.progress import advance_if_known, advance_to, progress_bar
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.equilibrium import State, fields_of
from jaxstab.equilibrium.posing import finished, posed
from jaxstab.equilibrium.start import initial_of_path, start_of
from jaxstab.loads import Load

# Where the branches from the two loads start.
Starts = list[Field]
# A branch is followed from either load.
_NUM_SEARCHES = 2
# Releases that lose a smaller part of the problem's characteristic energy do not end a branch: so
# little is known in float32. The next one is sought so far beyond, over the distance between the
# loads, by steps of the solver that are no longer.
_SMALLEST_LOSS = 1e-5
_BEYOND = 1e-6
_MAX_MOVE = 0.03
# A branch that is lost within so many of these distances behind a release has not left it.
_NEAR = 10
# So far beyond where the curve could not be followed: the same branch, if nothing is lost.
_OVER = 1e-3
# In single precision a looser solver takes the last state of a branch for balanced behind its end:
# it goes on as far as rounding allows, which is close enough.
_TOLERANCE = {**PreconditionedConjugateGradient.default_tolerance, "float32": 1e-6}
_ROUNDED = {"float64": 0.0, "float32": 1e-3}
# A solver that has not left a release begins farther beyond it by this factor.
_GROWTH = 10.0


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
    """
    require_contact(contact)
    cure = "give one on the stable branch and one beyond its end."
    bracket = two_loads(bracket, contact, "critical_load takes two loads", cure)
    bracket.warn_if_soft(contact.solid)
    warn_if_coarse(contact, FOR_JUMPS)
    problem = posed(contact, bracket)
    inputs = problem.contact, problem.state
    starts = [
        start_of(problem.contact, load, initial_of_path(problem.contact, load, initial))
        for load in problem.state
    ]
    constants = jax.lax.stop_gradient((*inputs, starts))
    with own_conventions():
        with progress_bar(_NUM_SEARCHES, "search", shown=progress, inputs=constants):
            limit = _find(*constants)
            # Not all searches are needed.
            advance_to(lambda: _NUM_SEARCHES)
        # An interrupt here would lose a long search.
        with interrupts_held():
            end = critical_load_at(*inputs, limit)
    return finished(end, problem, partial(_describe, bracket), throw)


@in_pieces
def _find(contact: Contact, bracket: Load, starts: Starts) -> Limit:
    """Return the end of the branch from the first load, or else of that from the second.

    If there is neither, the message is about the first. A branch that could not be followed is no
    reason to take the end of another one.
    """
    first = _limit(contact, bracket, starts[0])
    advance_if_known(first)

    def from_second() -> Limit:
        second = _limit(contact, _reversed(bracket), starts[1])
        advance_if_known(second)
        return cond(_is_answer(second), lambda: second, lambda: first)

    return cond(_is_answer(first), lambda: first, from_second)


@program
def _reversed(loads: Load) -> Load:
    return loads[::-1]


def _is_answer(limit: Limit) -> Flag:
    return limit.is_found | (limit.result == RESULTS.lost_branch)


class _Search(eqx.Module):
    """The limit of the branch before, or none yet, and where its next branch is sought.

    Attributes:
        limit: the last limit.
        first: the load at which the search began.
        last: the load at which it ends.
        value: the load at which the next branch begins.
        step: how far this lies beyond the limit, or the last load that was tried.
        number: of branches that were followed.
        is_over: whether the limit is the answer.
        is_stuck: whether no stable state has been found behind it yet.
        is_open: whether another branch is to be followed.
    """

    limit: Limit
    first: Scalar
    last: Scalar
    value: Scalar
    step: Scalar
    number: Int[Array, ""]
    is_over: Flag
    is_stuck: Flag
    is_open: Flag

    def looked_at(self) -> "_Search":
        """Return the search with a flag that tells whether it goes on."""
        is_ahead = (self.last - self.value) * (self.last - self.first) > 0
        return replace(self, is_open=~self.is_over & is_ahead)


def _limit(contact: Contact, loads: Load, start: Field) -> Limit:
    """Return where the branch from the first load ends as the load goes to the second.

    At a contact edge that moves by one point of the grid a release may lose next to nothing. Then
    the next branch counts as the same one.
    """
    search = _begun(contact, loads, start)

    def next_limit(search: _Search) -> _Search:
        rest = _rest(loads, search)
        found = _found(contact, rest, search)
        is_over = _is_left(contact, search, found)
        limit, is_stable = cond(
            is_over,
            lambda: (search.limit, array(True)),
            lambda: _limit_from(contact, rest, found),
        )
        return _followed(search, limit, is_stable, is_over)

    return _concluded(while_loop(lambda search: search.is_open, next_limit, search))


@program
def _begun(contact: Contact, loads: Load, start: Field) -> _Search:
    first, last = loads.value.astype(contact.heights.dtype)
    no = jnp.array(False)
    none = jnp.array(0)
    limit = no_limit(contact, loads[0], start)
    search = _Search(limit, first, last, first, jnp.zeros_like(first), none, no, no, no)
    return replace(search, step=_just_beyond(search)).looked_at()


def _just_beyond(search: _Search) -> Scalar:
    """Return how far behind a release the next branch is sought."""
    first = search.first
    last = search.last
    rounding = 4 * jnp.finfo(first.dtype).eps * jnp.maximum(jnp.abs(first), jnp.abs(last))
    return jnp.sign(last - first) * jnp.maximum(_BEYOND * jnp.abs(last - first), rounding)


@program
def _rest(loads: Load, search: _Search) -> Load:
    """Return the loads between which the next branch is followed."""
    return loads.at(jnp.stack([search.value, search.last]))


@program
def _found(contact: Contact, rest: Load, search: _Search) -> Equilibrium:
    """Return the equilibrium with which the next branch begins."""
    dtype = contact.heights.dtype
    farthest = jnp.where(search.number == 0, jnp.inf, _MAX_MOVE).astype(dtype)
    solver = PreconditionedConjugateGradient(max_move=farthest, tolerance=_TOLERANCE[dtype.name])
    found = find(contact, rest[0], solver, search.limit.gap)
    is_close = (found.result == RESULTS.stagnated) & (found.residual <= _ROUNDED[dtype.name])
    return replace(found, result=RESULTS.where(is_close, RESULTS.successful, found.result))


@program
def _is_left(contact: Contact, search: _Search, found: Equilibrium) -> Flag:
    """Return whether the branch has been left for good at the limit before."""

    def potential(load: Load, gap: Field) -> tuple[Scalar, Scalar]:
        fields, _ = fields_of(contact, load, gap)
        held, force = supply_of(contact, load, mean(gap), fields["mean_pressure"])
        return fields["energy"] + held, force

    is_found = found.result == RESULTS.successful
    before, force = potential(search.limit.load, search.limit.gap)
    after, force_after = potential(found.load, found.gap)
    # Behind a release the force is another one.
    force = jnp.where(search.limit.is_found, force_after, force)
    work = (search.value - search.limit.load.value) * (force + force_after) / 2
    threshold = _SMALLEST_LOSS * characteristic_energy(contact)
    return (search.number > 0) & (~is_found | (before + work - after > threshold))


def _limit_from(contact: Contact, loads: Load, found: Equilibrium) -> tuple[Limit, Flag]:
    """Return the limit of the branch of an equilibrium at the first load, and whether it is stable.

    An unstable one is on no stable branch.
    """
    problem, branch = begin(contact, loads, found, to_limit=True)
    branch, is_stable = _if_stable(branch)
    return limit_of(problem, branch), is_stable


@program
def _if_stable(branch: BranchState) -> tuple[BranchState, Flag]:
    is_stable = branch.step.index == 0
    result = RESULTS.where(is_stable, RESULTS.successful, RESULTS.no_fold)
    result = RESULTS.where(branch.result == RESULTS.successful, result, branch.result)
    return replace(branch, result=result), is_stable


@program
def _followed(search: _Search, limit: Limit, is_stable: Flag, is_over: Flag) -> _Search:
    """Return the search after another branch, from its limit and whether it began stable."""
    first = search.first
    last = search.last
    old = search.limit
    over = _OVER * (last - first)
    # Right behind a release the solver may stay where the point has not opened yet.
    is_lost = limit.result == RESULTS.lost_branch
    distance = jnp.abs(search.value - old.load.value)
    is_near = jnp.abs(limit.load.value - old.load.value) <= _NEAR * distance
    is_stuck = (search.number > 0) & (~is_stable | (is_lost & is_near & old.is_found))
    limit = choose(is_stuck, old, limit)
    is_lost |= is_stuck
    is_over |= ~is_lost & (~limit.is_found | (limit.kind != KINDS.release))
    # Never back, so that the search has an end.
    is_ahead = (limit.load.value - search.value) * (last - first) > 0
    reached = jnp.where(is_ahead, limit.load.value, search.value)
    is_short = jnp.abs(_GROWTH * search.step) < jnp.abs(over)
    farther = jnp.where(is_stuck & is_short, _GROWTH * search.step, over)
    step = jnp.where(is_lost, farther, _just_beyond(search))
    return replace(
        search,
        limit=limit,
        value=reached + step,
        step=step,
        number=search.number + 1,
        is_over=is_over,
        is_stuck=is_stuck,
    ).looked_at()


@program
def _concluded(search: _Search) -> Limit:
    result = search.limit.result
    is_lost = (search.number > 0) & (search.is_stuck | (result == RESULTS.lost_branch))
    otherwise = RESULTS.where(is_lost, RESULTS.lost_branch, RESULTS.no_fold)
    return replace(search.limit, result=RESULTS.where(search.is_over, result, otherwise))


def _describe(bracket: Load, found: CriticalLoad) -> str:
    first, last = (float(value) for value in jax.lax.stop_gradient(bracket.value))
    equilibrium = jax.lax.stop_gradient(found.equilibrium)
    return (
        f"No end of a branch found between {type(bracket).__name__}({first:.6g}) and ({last:.6g}): "
        f"the search ended at {float(equilibrium.load.value):.6g} with a residual of "
        f"{float(equilibrium.residual):.3g}"
    )

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

from jaxstab.contact import Contact, require_contact
from jaxstab.contact.entry import answer
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.checks import is_traced
from jaxstab.core.compile import program
from jaxstab.core.control_flow import by_entries, choose, first_good, if_needed, zeros_of
from jaxstab.core.grid import mean
from jaxstab.core.progress import advance_if_known, advance_to
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find, first_gap
from jaxstab.equilibrium.equilibrium import State, fields_of
from jaxstab.equilibrium.window import padded_start
from jaxstab.loads import Load
from jaxstab.paths.curve.branch import begin, two_loads
from jaxstab.paths.curve.critical_load import CriticalLoad, critical_load_at
from jaxstab.paths.curve.limit import Limit, limit_of
from jaxstab.paths.energy import characteristic_energy, supply_of
from jaxstab.paths.kinds import KINDS

# Where the branches from the two loads start.
Starts = list[Field | None]
# A branch is followed from either load.
_NUM_SEARCHES = 2
# Releases that lose a smaller part of the problem's characteristic energy do not end a branch: so
# little is known in float32. The next one is sought so far beyond, over the distance between the
# loads, by steps of the solver that are no longer.
_SMALLEST_LOSS = 1e-5
_BEYOND, _MAX_MOVE = 1e-6, 0.03
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
    warn_if_coarse(contact, FOR_JUMPS)
    padded, starts = contact, []
    for load in bracket:
        padded, start = padded_start(contact, load, first_gap(contact, load, initial))
        starts.append(start)
    return answer(
        _search,
        padded,
        bracket,
        starts,
        bar=(_NUM_SEARCHES, "search", progress),
        differentiable=critical_load_at,
        describe=partial(_describe, bracket),
        throw=throw,
    )


def _search(contact: Contact, bracket: Load, starts: Starts) -> Limit:
    # Outside of a trace nothing is compiled for a search that is not needed.
    find = _find_batch if is_traced((contact, bracket, starts)) else _find
    limit = find(contact, bracket, starts)
    # Not all searches are needed.
    advance_to(lambda: _NUM_SEARCHES)
    return limit


def _find(contact: Contact, bracket: Load, starts: Starts) -> Limit:
    """Return the end of the branch from the first load, or else of that from the second.

    If there is neither, the message is about the first.
    """

    def end_of(number: ArrayLike) -> Limit:
        there = bracket, starts[0]
        end = _limit(contact, *if_needed(number == 1, lambda: (bracket[::-1], starts[1]), there))
        advance_if_known(end)
        return end

    def is_answer(limit: Limit) -> Flag:
        # A branch that could not be followed is no reason to take the end of another one.
        return limit.is_found | (limit.result == RESULTS.lost_branch)

    return first_good(end_of, is_answer, _NUM_SEARCHES)


# A program, or `jax.vmap` outside of `jax.jit` would compile it anew with each call.
_find_batch = program(by_entries(_find))


class _Search(eqx.Module):
    """The limit of the branch before, or none yet, and where its next branch is sought.

    Attributes:
        limit: the last limit.
        value: the load at which the next branch begins.
        step: how far this lies beyond the limit, or the last load that was tried.
        number: of branches that were followed.
        is_over: whether the limit is the answer.
        is_stuck: whether no stable state has been found behind it yet.
    """

    limit: Limit
    value: Scalar
    step: Scalar
    number: Int[Array, ""]
    is_over: Flag
    is_stuck: Flag


@program
def _limit(contact: Contact, loads: Load, start: Field | None) -> Limit:
    """Return where the branch from the first load ends as the load goes to the second.

    At a contact edge that moves by one point of the grid a release may lose next to nothing. Then
    the next branch counts as the same one.
    """
    first, last = loads.value.astype(contact.heights.dtype)
    if start is None:
        start = contact.control(loads[0]).starting_gap(contact.heights)
    threshold = _SMALLEST_LOSS * characteristic_energy(contact)
    rounding = 4 * jnp.finfo(start.dtype).eps * jnp.maximum(jnp.abs(first), jnp.abs(last))
    beyond = jnp.sign(last - first) * jnp.maximum(_BEYOND * jnp.abs(last - first), rounding)
    over = _OVER * (last - first)

    def potential(load: Load, gap: Field) -> tuple[Scalar, Scalar]:
        fields, _ = fields_of(contact, load, gap)
        held, force = supply_of(contact, load, mean(gap), fields["mean_pressure"])
        return fields["energy"] + held, force

    def next_limit(search: _Search) -> _Search:
        is_first = search.number == 0
        rest = loads.at(jnp.stack([search.value, last]))
        farthest = jnp.where(is_first, jnp.inf, _MAX_MOVE).astype(start.dtype)
        found = _found(contact, rest[0], farthest, search.limit.gap)
        is_found = found.result == RESULTS.successful
        before, force = potential(search.limit.load, search.limit.gap)
        after, force_after = potential(found.load, found.gap)
        # Behind a release the force is another one.
        force = jnp.where(search.limit.is_found, force_after, force)
        work = (search.value - search.limit.load.value) * (force + force_after) / 2
        loses = ~is_found | (before + work - after > threshold)
        is_over = ~is_first & loses
        limit, is_stable = jax.lax.cond(
            is_over,
            lambda: (search.limit, jnp.array(True)),
            lambda: _limit_from(contact, rest, found),
        )
        # Right behind a release the solver may stay where the point has not opened yet.
        is_lost = limit.result == RESULTS.lost_branch
        distance = jnp.abs(search.value - search.limit.load.value)
        is_near = jnp.abs(limit.load.value - search.limit.load.value) <= _NEAR * distance
        is_stuck = ~is_first & (~is_stable | (is_lost & is_near & search.limit.is_found))
        limit = choose(is_stuck, search.limit, limit)
        is_lost |= is_stuck
        is_over |= ~is_lost & (~limit.is_found | (limit.kind == KINDS.fold))
        # Never back, so that the search has an end.
        is_ahead = (limit.load.value - search.value) * (last - first) > 0
        reached = jnp.where(is_ahead, limit.load.value, search.value)
        is_short = jnp.abs(_GROWTH * search.step) < jnp.abs(over)
        farther = jnp.where(is_stuck & is_short, _GROWTH * search.step, over)
        step = jnp.where(is_lost, farther, beyond)
        return _Search(limit, reached + step, step, search.number + 1, is_over, is_stuck)

    def goes_on(search: _Search) -> Flag:
        return ~search.is_over & ((last - search.value) * (last - first) > 0)

    none = zeros_of(lambda: _limit_from(contact, loads, _found(contact, loads[0], last, start))[0])
    no = jnp.array(False)
    search = _Search(replace(none, gap=start), first, beyond, jnp.array(0), no, no)
    search = jax.lax.while_loop(goes_on, next_limit, search)
    result = search.limit.result
    is_lost = (search.number > 0) & (search.is_stuck | (result == RESULTS.lost_branch))
    otherwise = RESULTS.where(is_lost, RESULTS.lost_branch, RESULTS.no_fold)
    return replace(search.limit, result=RESULTS.where(search.is_over, result, otherwise))


# Apart, so that each is traced once.
@jax.jit
def _found(contact: Contact, load: Load, farthest: Scalar, start: Field) -> Equilibrium:
    dtype = start.dtype.name
    solver = PreconditionedConjugateGradient(max_move=farthest, tolerance=_TOLERANCE[dtype])
    found = find(contact, load, solver, start)
    is_close = (found.result == RESULTS.stagnated) & (found.residual <= _ROUNDED[dtype])
    return replace(found, result=RESULTS.where(is_close, RESULTS.successful, found.result))


@jax.jit
def _limit_from(contact: Contact, loads: Load, found: Equilibrium) -> tuple[Limit, Flag]:
    """Return the limit of the branch of an equilibrium at the first load, and whether it is stable.

    An unstable one is on no stable branch.
    """
    problem, branch = begin(contact, loads, found, to_limit=True)
    is_stable = branch.step.index == 0
    result = RESULTS.where(is_stable, RESULTS.successful, RESULTS.no_fold)
    result = RESULTS.where(branch.result == RESULTS.successful, result, branch.result)
    return limit_of(problem, replace(branch, result=result)), is_stable


def _describe(bracket: Load, found: CriticalLoad) -> str:
    first, last = (float(value) for value in jax.lax.stop_gradient(bracket.value))
    equilibrium = jax.lax.stop_gradient(found.equilibrium)
    return (
        f"No end of a branch found between {type(bracket).__name__}({first:.6g}) and ({last:.6g}): "
        f"the search ended at {float(equilibrium.load.value):.6g} with a residual of "
        f"{float(equilibrium.residual):.3g}"
    )

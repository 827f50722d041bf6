"""The limit of a stable branch: the first event beyond which its states are no minima.

The curve is followed towards a load until the load turns back on it, at a fold or a release. At a
bifurcation, which a symmetry makes, it does not turn, but an eigenvalue vanishes.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.branch_steps import (
    LONGEST,
    BranchState,
    branch_from,
    next_state,
    pressure_of,
    shortest_of,
)
from jaxstab.branches.corrector import (
    AT_STATES,
    Condition,
    CorrectorOutcome,
    CorrectorProblem,
    Undirected,
    at_change,
    correct,
    on_plane,
    place_of,
)
from jaxstab.branches.curve import BorderedVector, ContinuationProblem, Curve, Place
from jaxstab.branches.morse_index import UNKNOWN, lowest_pair, no_modes
from jaxstab.contact import Contact
from jaxstab.core.accuracy import EQUILIBRIUM, NEGLIGIBLE
from jaxstab.core.checks import array, concrete
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose, cond, first_good, while_loop, zeros_of
from jaxstab.core.grid import mean, total
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.loads import Load
from jaxstab.stability.eigenpair import Eigenpair
from jaxstab.states.kinds import ENDS, KINDS

# Steps along the curve towards a limit, at most.
_MAX_STEPS = 2000
# The least cosine between the tangent of a branch and the mode of a fold: at a fold both are one
# direction, at a bifurcation they are orthogonal.
_LEAST_COSINE = 0.5
# The distance in load within which a limit is sought ahead of a state, over the distance within
# which load stepping has found no state any more (`_horizon`). Disturbed starts leave a branch
# early. And the imbalance of a state, which is small in the mean over N points, may be that of one:
# then it is sqrt(N) times as large there, a thousand times on 1024 x 1024 points.
_SEARCH_WIDTH = 1000
# The first step of a search from a state nearby, over its longest one.
_FIRST = 1e-3
# The distances back along the curve at which such a search begins, over a negligible part of the
# size of the state. They are tried in this order: most limits are found from the first.
_BACKS = 1.0, 1e-2, 10.0, 100.0


class Limit(eqx.Module):
    """Where a stable branch ends.

    Attributes:
        load: the load there.
        gap: the last gap of the branch [length].
        kind: a fold, a release or a bifurcation; uncertain if none could be told.
        point: the contact point that is released; none elsewhere.
        is_tied: whether others are released with it.
        critical: the lowest eigenpair on the points that are free or released.
        residual: of the balance of pressures and the condition of the kind.
        num_steps: along the curve to find it.
        result: how the search ended.
    """

    load: Load
    gap: Field
    kind: KINDS
    point: Mask
    is_tied: Flag
    critical: Eigenpair
    residual: Scalar
    num_steps: Int[Array, ""]
    result: RESULTS

    @property
    def is_found(self) -> Flag:
        """Whether there is one."""
        return self.result == RESULTS.successful

    @property
    def mode(self) -> Field:
        """The mode that leads away from the branch, along which contact points open."""
        mode = self.critical.mode
        return mode * jnp.where(mean(jnp.where(self.gap == 0, mode, 0)) < 0, -1, 1)


def limit_ahead(contact: Contact, load: Load, gap: Field, ahead: Scalar) -> Limit:
    """Return the limit of a branch from a state close to it.

    A load that is so far ahead, with its sign, has no state of this branch. The state itself may
    lie past the limit, by no more than its residual.

    1. Take the state, or if its limit is a release that it lies past, the state with its least open
       points closed.
    2. Go a little way back along the curve, so that the limit lies ahead.
    3. Follow the curve from there to its limit.
    4. If there is none, repeat from 1 by another of these starts, until all are used.
    5. Without a limit, return the state itself: as a bifurcation if an eigenvalue is negative,
       since it was passed where a symmetry held the state; otherwise as uncertain.
    """
    dtype = gap.dtype
    problem, state, row = _problem_ahead(contact, load, gap, ahead)
    curve = problem.curve

    def from_start(start: tuple[Scalar, Flag]) -> tuple[Limit, Flag]:
        distance, closes = start
        here = place_of(curve, _first_point(problem, state, row, closes))
        plane, at = _plane_behind(problem, state, distance, here)
        correction = CorrectorProblem(curve, plane, here.is_free)
        behind = correct(correction, at, plane.row, here.tangent, AT_STATES[dtype.name])
        branch, is_on_curve = _branch_behind(problem, row, behind)
        return limit_of(problem, branch), is_on_curve

    starts = [(array(back, dtype), array(closes)) for back in _BACKS for closes in (False, True)]
    limit, is_on_curve = first_good(from_start, lambda found: found[0].is_found, starts)
    return cond(
        # Ahead of a state past a bifurcation, a turn of the load is none of a stable branch.
        concrete(limit.is_found) & concrete(limit.kind != KINDS.uncertain),
        lambda: limit,
        lambda: _state_as_limit(contact, load, gap, limit, is_on_curve),
    )


@program
def _problem_ahead(
    contact: Contact, load: Load, gap: Field, ahead: Scalar
) -> tuple[ContinuationProblem, BorderedVector, BorderedVector]:
    """Return the problem towards a load ahead, the state, and the gradient of the load's change."""
    curve = Curve.of(contact, load)
    at = BorderedVector(gap, pressure_of(contact, load, gap))
    longest = LONGEST * curve.length(at)
    sign = jnp.sign(ahead)
    row = BorderedVector(sign * curve.load_gradient.gap, sign * curve.load_gradient.pressure)
    end = load.value + _SEARCH_WIDTH * _horizon(load, gap, ahead)
    problem = ContinuationProblem(
        curve, load.value, end, longest, shortest_of(longest), to_limit=True
    )
    return problem, at, row


@program
def _first_point(
    problem: ContinuationProblem, state: BorderedVector, row: BorderedVector, closes: Flag
) -> Undirected:
    """Return the state, also with its least open points closed, as a point of the curve."""
    gap = state.gap
    least_open = gap == jnp.min(jnp.where(gap > 0, gap, jnp.inf))
    is_free = (gap > 0) & ~(least_open & closes)
    at = BorderedVector(jnp.where(is_free, gap, 0), state.pressure)
    condition = on_plane(row, row.times(at), problem.max_step)
    return Undirected(at, is_free, condition, row, jax.tree.map(jnp.zeros_like, at))


@program
def _plane_behind(
    problem: ContinuationProblem, state: BorderedVector, distance: Scalar, here: Place
) -> tuple[Condition, BorderedVector]:
    """Return the plane behind a place, and a point there.

    The distance is given over a usual one.
    """
    at = here.at
    curve = problem.curve
    back = NEGLIGIBLE[at.gap.dtype.name] * curve.length(state) * distance
    row = curve.gradient_of(here.tangent)
    return on_plane(row, row.times(at) - back, problem.max_step), at.plus(here.tangent, -back)


@program
def _branch_behind(
    problem: ContinuationProblem, row: BorderedVector, found: CorrectorOutcome
) -> tuple[BranchState, Flag]:
    """Return the branch from the point found, and whether it is one towards the load."""
    place = found.place
    signs = jnp.where(place.is_free, place.at.gap, found.forces.net) > 0
    is_on_curve = found.is_found & jnp.all(signs) & (row.times(place.tangent) > 0)
    result = RESULTS.where(is_on_curve, RESULTS.successful, RESULTS.lost_branch)
    length = _FIRST * problem.max_step
    unknown = array(UNKNOWN), no_modes(place.at.gap)
    return branch_from(place, length, *unknown, result), is_on_curve


@program
def _state_as_limit(
    contact: Contact, load: Load, gap: Field, limit: Limit, is_on_curve: Flag
) -> Limit:
    """Return a state as a limit, if none was found ahead of it but this one that is uncertain."""
    residual = contact.balance(contact.control(load))(gap).residual
    is_unstable = is_on_curve & (limit.critical.eigenvalue < -limit.critical.error)
    return replace(
        limit,
        load=load,
        gap=gap,
        kind=KINDS.where(is_unstable, KINDS.bifurcation, KINDS.uncertain),
        point=jnp.zeros_like(limit.point),
        residual=residual,
        result=RESULTS.where(jnp.isfinite(residual), RESULTS.successful, RESULTS.nonfinite),
    )


def _horizon(load: Load, gap: Field, ahead: Scalar) -> Scalar:
    """Return how far ahead the end of a branch may lie, with its sign.

    It is known no better than the states of the branch are: to a part of their mean gap or of the
    pressure. The origin of lengths does not matter.
    """
    tolerance = EQUILIBRIUM[gap.dtype.name]
    size = jnp.abs(load.value)
    if load.unit == "length":
        size = mean(gap)
    return jnp.sign(ahead) * jnp.maximum(jnp.abs(ahead), tolerance * size)


class _LimitSearch(eqx.Module):
    """A branch before and after its last step, and how closely a bifurcation is bracketed.

    Attributes:
        before: the branch before.
        after: the branch after it.
        is_past: whether the last step has led past the limit.
        width: how far behind the last stable state a bifurcation lies at most [length]; infinite
            before one was passed.
        length: of the next step [length].
        count: of the steps.
        goes_on: whether the limit lies ahead, or is to be bracketed more closely.
    """

    before: BranchState
    after: BranchState
    is_past: Flag
    width: Scalar
    length: Scalar
    count: Int[Array, ""]
    goes_on: Flag


def limit_of(problem: ContinuationProblem, branch: BranchState) -> Limit:
    """Return the limit of a branch that begins so.

    1. Step along the curve until a step has led past the limit: the load turns, or an eigenvalue
       has become negative.
    2. If the load turns, at a fold or a release, the step has located where.
    3. If it does not, at a bifurcation, return to the state before and halve the step, until the
       states before and after the bifurcation are close to each other. If shorter steps pass the
       place by stable states, go on.
    4. There find the lowest eigenpair, and tell by its eigenvalue or the reaction of the released
       point whether it is a limit, and of which kind.
    """
    dtype = problem.max_step.dtype
    first = _LimitSearch(
        before=branch,
        after=branch,
        is_past=array(False),
        width=array(jnp.inf, dtype),
        length=branch.step.length,
        count=array(0),
        goes_on=branch.goes_on,
    )

    def step(search: _LimitSearch) -> _LimitSearch:
        old = cond(search.is_past, lambda: search.before, lambda: search.after)
        old = replace(old, step=replace(old.step, length=search.length))
        return _search_after(problem, search, old, next_state(problem, old))

    search = while_loop(lambda search: search.goes_on, step, first)
    candidate = _limit_candidate(problem, search)
    modes = search.after.step.modes
    contact = problem.curve.contact
    pair = lowest_pair(
        contact, candidate.load, candidate.at.gap, candidate.opened, modes, EQUILIBRIUM[dtype.name]
    )
    return limit_between(problem, branch.result, search, candidate, pair)


@program
def _search_after(
    problem: ContinuationProblem, search: _LimitSearch, old: BranchState, new: BranchState
) -> _LimitSearch:
    """Return the search after a step from an old to a new state."""
    taken = problem.curve.length(new.step.here.at.minus(old.step.here.at))
    is_unstable = (old.step.index == 0) & (new.step.index > 0)
    is_past = new.step.is_new & (new.step.turn.exists | is_unstable)
    width = jnp.where(is_past, taken, search.width - taken)
    width = jnp.where(new.step.is_new, width, search.width)
    # Stable states up to there and beyond: a long step had leapt to another branch.
    width = jnp.where(width < 0, jnp.inf, width)
    closest = EQUILIBRIUM[problem.max_step.dtype.name] * problem.max_step
    is_bracketed = is_past & (new.step.turn.exists | (width <= 2 * closest))
    count = search.count + 1
    next_length = jnp.where(is_past, old.step.length, new.step.length)
    return _LimitSearch(
        before=old,
        after=new,
        is_past=is_past,
        width=width,
        length=jnp.minimum(next_length, jnp.maximum(width / 2, closest)),
        count=count,
        goes_on=new.goes_on & ~is_bracketed & (count < _MAX_STEPS),
    )


class _Candidate(eqx.Module):
    """The limit between two states of a branch, but for its mode.

    Attributes:
        at: the point of the curve, of a gap that is not negative.
        load: the load there.
        is_free: the points that are free before and after.
        is_release: whether it is a release, or of several points at once a bifurcation; from the
            far side that is a touch.
        point: the point that is released, if there is one.
        is_tied: whether others are released with it.
        opened: positive on the points that are free or released.
    """

    at: BorderedVector
    load: Load
    is_free: Mask
    is_release: Flag
    point: Mask
    is_tied: Flag
    opened: Field


@program
def _limit_candidate(problem: ContinuationProblem, search: _LimitSearch) -> _Candidate:
    """Return where the limit lies between the states before and after the last step."""
    curve = problem.curve
    old = search.before.step
    new = search.after.step
    is_free = old.here.is_free & new.here.is_free
    turn = new.turn
    is_release = turn.exists & (turn.kind != KINDS.fold)
    released = (old.here.is_free ^ new.here.is_free) & is_release
    first = jnp.arange(released.size).reshape(released.shape) == jnp.argmax(released)
    at = choose(turn.exists, turn.at, new.here.at)
    gap = jnp.where(is_free, jnp.maximum(at.gap, 0), 0)
    at = BorderedVector(gap, at.pressure)
    return _Candidate(
        at=at,
        load=curve.load.at(curve.value(at)),
        is_free=is_free,
        is_release=is_release,
        point=released & first,
        is_tied=jnp.sum(released) > 1,
        opened=(is_free | released).astype(gap.dtype),
    )


@program
def limit_between(
    problem: ContinuationProblem,
    begun: RESULTS,
    search: _LimitSearch,
    candidate: _Candidate,
    pair: Eigenpair,
) -> Limit:
    """Return the limit that a search has come to, given the result of its first state.

    It is a bifurcation where an eigenvalue changes its sign, but the load does not turn. It is
    uncertain if the test function of its kind is not zero: at a release the reaction, and the
    energy must fall as the point opens; elsewhere the eigenvalue.
    """
    curve = problem.curve
    contact = curve.contact
    dtype = candidate.at.gap.dtype.name
    new = search.after.step
    is_release = candidate.is_release
    condition = at_change(curve, candidate.point, jnp.array(True), problem.max_step)
    correction = CorrectorProblem(curve, condition, candidate.is_free)
    imbalance, reaction = correction.residual(candidate.at, correction.forces(candidate.at))
    residual = jnp.maximum(imbalance, jnp.where(is_release, jnp.abs(reaction), 0))
    is_met = residual <= EQUILIBRIUM[dtype]
    is_flat = jnp.abs(pair.eigenvalue) <= NEGLIGIBLE[dtype] * contact.solid.min_stiffness
    is_event = is_met & jnp.where(is_release, pair.eigenvalue < pair.error, is_flat)
    # The branch runs along the mode of a fold, but across that of a bifurcation.
    tangent = new.here.tangent.gap
    mode = pair.mode
    along = jnp.abs(total(tangent * mode))
    crosses = ~new.turn.exists & (
        along < _LEAST_COSINE * jnp.sqrt(total(tangent**2) * total(mode**2))
    )
    splits = is_release & (new.turn.kind == KINDS.bifurcation)
    kind = KINDS.where(is_release, KINDS.release, KINDS.fold)
    kind = KINDS.where(crosses | splits, KINDS.bifurcation, kind)
    kind = KINDS.where(is_event, kind, KINDS.uncertain)
    # Between two states as near as steps can tell, a bifurcation is known by its eigenvalue.
    is_between = jnp.isfinite(search.width) & (kind != KINDS.uncertain)
    is_found = search.is_past | is_between
    ended = search.after.end
    is_unclear = (ended == ENDS.uncertain) | (ended == ENDS.lost) | search.after.goes_on
    failure = RESULTS.where(is_unclear, RESULTS.lost_branch, RESULTS.no_fold)
    failure = RESULTS.where(begun == RESULTS.successful, failure, begun)
    result = RESULTS.where(jnp.isfinite(residual), RESULTS.successful, RESULTS.nonfinite)
    return Limit(
        load=candidate.load,
        gap=candidate.at.gap,
        kind=kind,
        point=candidate.point,
        is_tied=candidate.is_tied,
        critical=pair,
        residual=residual,
        num_steps=search.count,
        result=RESULTS.where(is_found, result, failure),
    )


def no_limit(contact: Contact, load: Load, gap: Field) -> Limit:
    """Return that no limit is known yet, at a load and a gap from which to go on."""

    def pair() -> Eigenpair:
        return lowest_pair(contact, load, gap, gap, no_modes(gap), EQUILIBRIUM[gap.dtype.name])

    return Limit(
        load=load,
        gap=gap,
        kind=KINDS.uncertain,
        point=jnp.zeros_like(gap, bool),
        is_tied=jnp.array(False),
        critical=zeros_of(pair),
        residual=jnp.zeros((), gap.dtype),
        num_steps=jnp.zeros((), int),
        result=RESULTS.no_fold,
    )

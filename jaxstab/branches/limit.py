"""The limit of a stable branch: the first event beyond which its states are no minima.

The curve is followed towards a load until the load turns back on it, at a fold or a release. At a
bifurcation, which a symmetry makes, it does not turn, but an eigenvalue vanishes.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.arclength import ArclengthStep
from jaxstab.branches.branch_steps import (
    SHORTEST,
    BranchState,
    branch_from,
    next_state,
    pressure_of,
)
from jaxstab.branches.corrector import (
    TOLERANCE,
    Condition,
    Correction,
    Found,
    at_change,
    correct,
    direction_at,
    on_plane,
)
from jaxstab.branches.curve import ContinuationProblem, Curve, Point
from jaxstab.branches.kinds import KINDS
from jaxstab.branches.morse_index import UNKNOWN, refreshed, some_modes
from jaxstab.contact import Contact
from jaxstab.contact.hessian import Block
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose, first_good, while_loop, zeros_of
from jaxstab.core.grid import mean, total
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.equilibrium import PreconditionedConjugateGradient
from jaxstab.loads import Load
from jaxstab.stability.cones import Subspace
from jaxstab.stability.eigenpair import Eigenpair
from jaxstab.stability.lowest_pair import on_space
from jaxstab.stability.solvers.davidson import Davidson

# How closely the mode of the limit is found.
_MODE = {"float64": 1e-9, "float32": 1e-5}
# An eigenvalue below this counts as zero at a fold, over the stiffness of the softest wave.
ZERO = {"float64": 1e-6, "float32": 1e-3}
# How closely a bifurcation is bracketed, over the longest step.
_BRACKET = {"float64": 1e-10, "float32": 1e-5}
_MAX_STEPS = 2000
# The least part of a branch's direction that is along the mode of a fold.
_ALONG = 0.5
# How far from where it was seen to lie a limit may be found, over how near that is known: what is
# missing on the whole may be missing at one point, and disturbed starts leave a branch early.
_LEEWAY = {"float64": 1000, "float32": 100}
# From a state nearby: its longest step over its size, the first one over that, and how far back it
# begins, that too, to which side of the event whatever the state lies on. In single precision a
# state may lie farther past the event.
_SHARE = 0.1
_FIRST = 1e-3
_BACK = {"float64": 1e-5, "float32": 1e-3}
_BACKS = 1.0, 1e-2, 10.0, 100.0


# Of one of several searches.
Number = Int[Array, ""] | int


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


class _LimitSearch(eqx.Module):
    """A branch before and after its last step, and how closely a bifurcation is bracketed.

    Attributes:
        is_open: whether the limit lies ahead, or is to be bracketed more closely.
    """

    before: BranchState
    after: BranchState
    width: Scalar
    count: Int[Array, ""]
    is_open: Flag

    @property
    def is_past(self) -> Flag:
        """Whether the last step has led past the limit."""
        old = self.before.step
        new = self.after.step
        return new.is_new & (new.turns | ((old.index == 0) & (new.index > 0)))

    def looked_at(self, problem: ContinuationProblem) -> "_LimitSearch":
        """Return the search with a flag that tells whether it goes on."""
        is_wide = self.width > _closest(problem)
        is_wide &= ~(self.is_past & self.after.step.turns)
        return replace(self, is_open=self.after.is_on & is_wide & (self.count < _MAX_STEPS))


def _closest(problem: ContinuationProblem) -> Scalar:
    """Return how closely a bifurcation is bracketed [length]."""
    return _BRACKET[problem.max_step.dtype.name] * problem.max_step


class _Ahead(eqx.Module):
    """The problem of a limit ahead of a state.

    Attributes:
        problem: the curve towards the load ahead.
        at: the state.
        row: the gradient of the load, with the sign of its change.
        nothing: no direction.
        modes: random modes.
    """

    problem: ContinuationProblem
    at: Point
    row: Point
    nothing: Point
    modes: Block


def limit_ahead(contact: Contact, load: Load, gap: Field, ahead: Scalar) -> Limit:
    """Return the limit of a branch from a state close to it.

    A load that is so far ahead, with its sign, has no state of this branch. The state itself may
    lie past the limit, by no more than its residual; then the released point is the one that is
    least open. So the search begins a little further back, anew until it finds an event. If it
    finds none, the limit is the state itself: a bifurcation if an eigenvalue is negative already,
    since it was passed where a symmetry held the state; otherwise uncertain.
    """
    search = _ahead(contact, load, gap, ahead)
    curve = search.problem.curve
    close = TOLERANCE[gap.dtype.name]

    def from_back(number: Number) -> tuple[Limit, Flag]:
        start, is_free, condition = _start(search, number)
        tangent = direction_at(curve, condition, start, is_free, search.row, search.nothing)
        plane, ahead = _plane_behind(search, start, tangent, number)
        found = correct(Correction(curve, plane, is_free), start, ahead, tangent, close)
        branch, is_found = _branch_behind(search, found)
        return limit_of(search.problem, branch), is_found

    limit, is_found = first_good(from_back, lambda found: found[0].is_found, 2 * len(_BACKS))
    return _limit_or_state(contact, load, gap, limit, is_found)


@program
def _ahead(contact: Contact, load: Load, gap: Field, ahead: Scalar) -> _Ahead:
    curve = Curve.of(contact, load)
    at = Point(gap, pressure_of(contact, load, gap))
    dtype = gap.dtype
    longest = _SHARE * curve.length(at)
    sign = jnp.sign(ahead)
    row = Point(sign * curve.load_gradient.gap, sign * curve.load_gradient.pressure)
    end = load.value + _LEEWAY[dtype.name] * _horizon(load, gap, ahead)
    problem = ContinuationProblem(
        curve, load.value, end, longest, SHORTEST[dtype.name] * longest, to_limit=True
    )
    return _Ahead(problem, at, row, jax.tree.map(jnp.zeros_like, at), some_modes(gap))


@program
def _start(search: _Ahead, number: Number) -> tuple[Point, Mask, Condition]:
    """Return where one of the searches begins, its free points, and a condition."""
    gap = search.at.gap
    closes = gap == jnp.min(jnp.where(gap > 0, gap, jnp.inf))
    is_free = (gap > 0) & ~(closes & (number % 2 == 1))
    start = Point(jnp.where(is_free, gap, 0), search.at.pressure)
    longest = search.problem.max_step
    return start, is_free, on_plane(search.row, search.row.times(start), longest)


@program
def _plane_behind(
    search: _Ahead, start: Point, tangent: Point, number: Number
) -> tuple[Condition, Point]:
    """Return the plane behind the start of one of the searches, and the gradient across it."""
    longest = search.problem.max_step
    dtype = start.gap.dtype
    length = _BACK[dtype.name] * longest * jnp.array(_BACKS, dtype)[number // 2]
    ahead = search.problem.curve.gradient_of(tangent)
    return on_plane(ahead, ahead.times(start) - length, longest), ahead


@program
def _branch_behind(search: _Ahead, found: Found) -> tuple[BranchState, Flag]:
    """Return a branch from the point found behind a state, and whether it is one."""
    place = found.place
    signs = jnp.where(place.is_free, place.at.gap, found.forces.net) > 0
    is_found = found.is_found & jnp.all(signs)
    result = RESULTS.where(is_found, RESULTS.successful, RESULTS.lost_branch)
    first = _FIRST * search.problem.max_step
    return branch_from(place, first, jnp.array(UNKNOWN, int), search.modes, result), is_found


@program
def _limit_or_state(
    contact: Contact, load: Load, gap: Field, limit: Limit, is_found: Flag
) -> Limit:
    """Return the limit that was found ahead of a state, or the state itself.

    Ahead of a state past a bifurcation, a turn of the load is none of a stable branch.
    """
    residual = contact.balance(contact.control(load))(gap).residual
    result = RESULTS.where(jnp.isfinite(residual), RESULTS.successful, RESULTS.nonfinite)
    state = replace(limit, load=load, gap=gap, residual=residual, result=result)
    is_unstable = is_found & (limit.critical.eigenvalue < -limit.critical.error)
    kind = KINDS.where(is_unstable, KINDS.bifurcation, KINDS.uncertain)
    state = replace(state, kind=kind, point=jnp.zeros_like(limit.point))
    return choose(limit.is_found & (limit.kind != KINDS.uncertain), limit, state)


def _horizon(load: Load, gap: Field, ahead: Scalar) -> Scalar:
    """Return how far ahead the end of a branch may lie, with its sign.

    It is known no better than the states of the branch are: to a part of their mean gap or of the
    pressure. The origin of lengths does not matter.
    """
    tolerance = PreconditionedConjugateGradient().tolerance_in(gap.dtype)
    size = mean(gap) if load.unit == "length" else jnp.abs(load.value)
    return jnp.sign(ahead) * jnp.maximum(jnp.abs(ahead), tolerance * size)


def limit_of(problem: ContinuationProblem, branch: BranchState) -> Limit:
    """Return the limit of a branch that begins so.

    A step that has led past a bifurcation is taken again, half as long, until the bifurcation is
    bracketed closely. At a fold or a release the load turns back, and steps locate it.
    """

    def further(search: _LimitSearch) -> _LimitSearch:
        old = _last_state(search)
        return _bracketed(problem, search, old, next_state(problem, old))

    search = while_loop(lambda search: search.is_open, further, _begun(problem, branch))
    return _located(problem, branch.result, search)


@program
def _begun(problem: ContinuationProblem, branch: BranchState) -> _LimitSearch:
    infinite = jnp.full_like(problem.max_step, jnp.inf)
    search = _LimitSearch(branch, branch, infinite, jnp.array(0), jnp.array(True))
    return search.looked_at(problem)


@program
def _last_state(search: _LimitSearch) -> BranchState:
    """Return the last state before the limit, from which the next step begins."""
    old = choose(search.is_past, search.before, search.after)
    length = jnp.minimum(old.step.length, search.width / 2)
    return replace(old, step=replace(old.step, length=length, turns=jnp.array(False)))


@program
def _bracketed(
    problem: ContinuationProblem, search: _LimitSearch, old: BranchState, new: BranchState
) -> _LimitSearch:
    """Return the search after a step from an old to a new state."""
    taken = problem.curve.length(new.step.here.at.minus(old.step.here.at))
    after = _LimitSearch(old, new, search.width, search.count + 1, search.is_open)
    width = jnp.where(after.is_past, taken, search.width - taken)
    width = jnp.where(new.step.is_new, width, search.width)
    return replace(after, width=width).looked_at(problem)


@program
def _located(problem: ContinuationProblem, begun: RESULTS, search: _LimitSearch) -> Limit:
    """Return the limit that a search has come to, and how, given the result of its first state."""
    ended = search.after.end
    is_unclear = (ended == KINDS.uncertain) | (ended == KINDS.lost) | search.after.is_on
    result = RESULTS.where(is_unclear, RESULTS.lost_branch, RESULTS.no_fold)
    result = RESULTS.where(begun == RESULTS.successful, result, begun)
    limit = _between(problem, search.before.step, search.after.step, search.count)
    # Between two states as near as steps can tell, a bifurcation is known by its eigenvalue.
    is_between = jnp.isfinite(search.width) & (limit.kind != KINDS.uncertain)
    is_found = search.is_past | (search.width <= _closest(problem)) | is_between
    return replace(limit, result=RESULTS.where(is_found, limit.result, result))


def _between(
    problem: ContinuationProblem, old: ArclengthStep, new: ArclengthStep, count: Int[Array, ""]
) -> Limit:
    """Return the limit between two states of a branch.

    It is a bifurcation where an eigenvalue changes its sign, but the load does not turn. It is
    uncertain if the test function of its kind is not zero: at a release the reaction, and the
    energy must fall as the point opens; elsewhere the eigenvalue.
    """
    curve = problem.curve
    contact = curve.contact
    dtype = new.length.dtype
    is_free = old.here.is_free & new.here.is_free
    changes = old.here.is_free ^ new.here.is_free
    # From the far side a release is a touch.
    is_release = new.turns & (new.kind != KINDS.fold)
    opens = changes & is_release
    point = opens & (jnp.arange(opens.size).reshape(opens.shape) == jnp.argmax(opens))
    seen = choose(new.turns, new.turn, new.here.at)
    gap = jnp.where(is_free, jnp.maximum(seen.gap, 0), 0)
    at = Point(gap, seen.pressure)
    correction = Correction(
        curve, at_change(curve, point, jnp.array(True), problem.max_step), is_free
    )
    imbalance, reaction = correction.residual(at, correction.forces(at))
    residual = jnp.maximum(imbalance, jnp.where(is_release, jnp.abs(reaction), 0))
    load = curve.load.at(curve.value(at))
    pair = _lowest_pair(contact, load, gap, is_free | opens, new.modes)
    is_met = residual <= TOLERANCE[dtype.name]
    is_flat = jnp.abs(pair.eigenvalue) <= ZERO[dtype.name] * contact.solid.min_stiffness
    is_event = is_met & jnp.where(is_release, pair.eigenvalue < pair.error, is_flat)
    # The branch runs along the mode of a fold, but across that of a bifurcation.
    tangent = new.here.tangent.gap
    mode = pair.mode
    part = jnp.abs(total(tangent * mode))
    crosses = ~new.turns & (part < _ALONG * jnp.sqrt(total(tangent**2) * total(mode**2)))
    kind = KINDS.where(is_release, KINDS.release, KINDS.fold)
    kind = KINDS.where(crosses, KINDS.bifurcation, kind)
    return Limit(
        load=load,
        gap=gap,
        kind=KINDS.where(is_event, kind, KINDS.uncertain),
        point=point,
        is_tied=jnp.sum(opens) > 1,
        critical=pair,
        residual=residual,
        num_steps=count,
        result=RESULTS.where(jnp.isfinite(residual), RESULTS.successful, RESULTS.nonfinite),
    )


def _lowest_pair(
    contact: Contact, load: Load, gap: Field, is_moving: Mask, modes: Block
) -> Eigenpair:
    control = contact.control(load)
    space = Subspace(is_moving, control.fixes_mean)
    solver = Davidson(_MODE[gap.dtype.name])
    return on_space(solver, contact.hessian(gap, control), space, refreshed(modes)).pair


def no_limit(contact: Contact, load: Load, gap: Field) -> Limit:
    """Return that no limit is known yet, at a load and a gap from which to go on."""
    return Limit(
        load=load,
        gap=gap,
        kind=KINDS.uncertain,
        point=jnp.zeros_like(gap, bool),
        is_tied=jnp.array(False),
        critical=zeros_of(_lowest_pair, contact, load, gap, gap > 0, some_modes(gap)),
        residual=jnp.zeros((), gap.dtype),
        num_steps=jnp.array(0),
        result=RESULTS.no_fold,
    )

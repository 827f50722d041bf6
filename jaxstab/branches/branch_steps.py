"""Arclength steps along a branch of equilibria: its first state, its next one, and its end."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.arclength import take_step
from jaxstab.branches.branch import Turn
from jaxstab.branches.corrector import (
    CorrectorProblem,
    Undirected,
    correct,
    on_plane,
    place_of,
)
from jaxstab.branches.curve import BorderedVector, ContinuationProblem, Curve, Place
from jaxstab.branches.morse_index import index_of, no_modes
from jaxstab.branches.step_trial import ArclengthStep, TurnInStep
from jaxstab.contact import Contact
from jaxstab.contact.hessian import Block
from jaxstab.core.accuracy import EXACT, NEGLIGIBLE
from jaxstab.core.checks import array, cast, concrete, require, require_finite
from jaxstab.core.compile import program
from jaxstab.core.control_flow import cond
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrium import state_at
from jaxstab.loads import Load, require_loads, require_same_machine
from jaxstab.states.kinds import ENDS, KINDS
from jaxstab.states.point import PathPoint, point_of

# The longest step over the distance between the loads, and over the size of a state near a limit;
# the first over the longest.
LONGEST = 0.1
_FIRST = 0.2
# A state beyond the end of a branch is sought so many times farther on if the solver fails there.
FARTHER = 10.0


class BranchState(eqx.Module):
    """A branch as far as it has been followed.

    Attributes:
        step: the last step.
        start: where the branch began.
        count: the number of its states.
        end: why it is followed no more, `ENDS.states` while it is.
        result: the result of the first equilibrium.
    """

    step: ArclengthStep
    start: Place
    count: Int[Array, ""]
    end: ENDS
    result: RESULTS

    @property
    def goes_on(self) -> Flag:
        """Whether it goes on."""
        return (self.end == ENDS.states) & (self.result == RESULTS.successful)


class Entry(eqx.Module):
    """A state of a branch."""

    point: PathPoint
    index: Int[Array, ""]


def two_loads(loads: Load, contact: Contact, takes: str, cure: str) -> Load:
    """Return two loads in the precision of a contact, checked."""
    require_loads(loads, (2,), takes, cure)
    loads = cast(loads, contact.heights.dtype)
    require_finite("The load", loads.value)
    ends = concrete(loads.value)
    require("The load", ends, ends[0] != ends[1], f"give two loads that differ, in {ends.dtype}.")
    require_same_machine(loads)
    return loads


def begin(
    contact: Contact,
    loads: Load,
    found: Equilibrium,
    max_step: Scalar | None = None,
    min_step: Scalar | None = None,
    *,
    to_limit: bool = False,
) -> tuple[ContinuationProblem, BranchState]:
    """Return the problem between two loads, and a branch at its first state, an equilibrium."""
    curve, first, modes = _start(contact, loads, found)
    dtype = found.gap.dtype
    here = place_of(curve, first)
    if dtype == jnp.float32:
        # A solver may stop as far from the curve as a short step may from its prediction.
        correction = CorrectorProblem(curve, first.condition, first.is_free, follows=True)
        closer = correct(correction, first.at, first.ahead, here.tangent, EXACT[dtype.name])
        here = cond(closer.is_found, lambda: closer.place, lambda: here)
    load = curve.load
    index, modes = index_of(contact, load, here.at.gap, modes, counts_all=not to_limit)
    problem, length = _problem(to_limit, curve, loads, here, max_step, min_step)
    return problem, branch_from(here, length, index, modes, found.result)


@program
def _start(contact: Contact, loads: Load, found: Equilibrium) -> tuple[Curve, Undirected, Block]:
    """Return the curve, the first point of a branch, and that no modes are known there."""
    gap = found.gap
    load = loads[0]
    at = BorderedVector(gap, pressure_of(contact, load, gap))
    curve = Curve.of(contact, load)
    row = curve.load_gradient
    value, last = loads.value.astype(gap.dtype)
    span = last - value
    ahead = BorderedVector(jnp.sign(span) * row.gap, jnp.sign(span) * row.pressure)
    condition = on_plane(row, value - curve.load_offset, jnp.abs(span))
    first = Undirected(at, gap > 0, condition, ahead, jax.tree.map(jnp.zeros_like, at))
    return curve, first, no_modes(gap)


@partial(program, static_argnums=0)
def _problem(
    to_limit: bool,
    curve: Curve,
    loads: Load,
    here: Place,
    max_step: Scalar | None,
    min_step: Scalar | None,
) -> tuple[ContinuationProblem, Scalar]:
    """Return the problem of a branch from its first place, and the length of its first step."""
    dtype = here.at.gap.dtype
    first, last = loads.value.astype(dtype)
    speed = jnp.abs(curve.rate(here.tangent))
    size = curve.length(here.at)
    longest = LONGEST * jnp.abs(last - first) / jnp.where(speed > 0, speed, 1)
    longest = jnp.where(size > 0, jnp.minimum(longest, size), longest)
    if max_step is not None:
        longest = max_step.astype(dtype)
    shortest = shortest_of(longest)
    if min_step is not None:
        shortest = min_step.astype(dtype)
    problem = ContinuationProblem(curve, first, last, longest, shortest, to_limit)
    return problem, _FIRST * longest


def shortest_of(longest: Scalar) -> Scalar:
    """Return the shortest step by default."""
    return NEGLIGIBLE[longest.dtype.name] / 10 * longest


def branch_from(
    here: Place, length: Scalar, index: Int[Array, ""], modes: Block, result: RESULTS
) -> BranchState:
    """Return a branch that begins at a place with a step of a length."""
    step = ArclengthStep(
        here=here,
        length=length,
        index=index,
        expected=index,
        modes=modes,
        turn=TurnInStep(array(False), here.at, KINDS.fold, here.tangent.gap),
        aims_at_last_load=array(False),
        reached_last_load=array(False),
        is_new=array(True),
        is_found=array(True),
    )
    return BranchState(step, here, array(1), ENDS.states, result)


def pressure_of(contact: Contact, load: Load, gap: Field) -> Scalar:
    """Return p0 of an equilibrium, of the grid that it is solved on."""
    gradient = contact.gradient(gap)
    return jnp.mean(contact.control(load).net_pressure(gradient, gap) - gradient)


def next_state(problem: ContinuationProblem, branch: BranchState) -> BranchState:
    """Return a branch after a step, which may have been cut."""
    step = take_step(problem, branch.step)
    count, end = _after(problem, branch, step)
    return replace(branch, step=step, count=count, end=end)


@program
def _after(
    problem: ContinuationProblem, branch: BranchState, step: ArclengthStep
) -> tuple[Int[Array, ""], ENDS]:
    """Return the number of states of a branch after a step, and why it goes on no more."""
    # No step is long enough if the loads are equal or not finite, which under JAX nothing refuses.
    no_more = ~(step.length > problem.min_step)
    unclear = ENDS.where(step.is_found, ENDS.uncertain, ENDS.lost)
    end = ENDS.where(no_more & ~step.is_new & ~step.aims_at_last_load, unclear, ENDS.states)
    # In full contact a load that holds the gap stays where it is, whatever the pressure.
    is_stuck = ~jnp.any(step.here.is_free) & (problem.curve.load_gradient.pressure == 0)
    end = ENDS.where(is_stuck, ENDS.full_contact, end)
    # Unless the last load comes before.
    is_before = (problem.last_load - problem.curve.value(step.here.at)) * problem.last_load >= 0
    end = ENDS.where(goes_apart(problem.curve, step) & is_before, ENDS.separated, end)
    is_loop = step.is_new & closes_loop(problem.curve, branch, step.here.at)
    end = ENDS.where(is_loop, ENDS.loop, end)
    end = ENDS.where(step.reached_last_load, ENDS.load, end)
    return branch.count + step.is_new, end


def goes_apart(curve: Curve, step: ArclengthStep) -> Flag:
    """Return whether surfaces with hardly any attraction left go apart, towards zero pressure."""
    here = step.here
    is_far = jnp.all(here.at.gap > curve.farthest)
    return step.is_new & is_far & (jnp.mean(here.tangent.gap) > 0)


def closes_loop(curve: Curve, branch: BranchState, at: BorderedVector) -> Flag:
    """Return whether the last step has come back to where the branch began."""
    row = curve.gradient_of(branch.start.tangent)
    before = row.times(branch.step.here.at.minus(branch.start.at))
    after = row.times(at.minus(branch.start.at))
    step = curve.length(at.minus(branch.step.here.at))
    is_near = curve.length(at.minus(branch.start.at)) <= step
    return (branch.count > 3) & (before < 0) & (after >= 0) & is_near


@program
def entry_of(problem: ContinuationProblem, branch: BranchState) -> tuple[Entry, Turn]:
    """Return the last state of a branch, and the turn before it."""
    contact = problem.curve.contact
    load = problem.curve.load
    step = branch.step

    def state(at: BorderedVector) -> Equilibrium:
        return state_at(contact, load.at(problem.curve.value(at)), at.gap)

    here = step.here
    turn = step.turn
    equilibrium = state(turn.at)
    entry = Entry(point_of(contact, state(here.at), problem.curve.value(here.at)), step.index)
    size = jnp.sqrt(jnp.sum(turn.mode**2))
    mode = turn.mode / jnp.where(size > 0, size, 1)
    return entry, Turn(equilibrium.load, turn.kind, equilibrium, mode, branch.count - 1)


@program
def is_same(problem: ContinuationProblem, one: Turn, other: Turn) -> Flag:
    """Return whether a turn is one of others: then the branch comes back to where it has been."""
    gap = one.equilibrium.gap
    gaps = other.equilibrium.gap
    grid = tuple(range(-gap.ndim, 0))
    close = NEGLIGIBLE[gap.dtype.name]
    span = jnp.abs(problem.last_load - problem.first_load)
    is_near = jnp.max(jnp.abs(gap - gaps), axis=grid) <= close * jnp.max(gap)
    is_near &= jnp.abs(one.load.value - other.load.value) <= close * span
    return jnp.any(is_near & (one.kind.code == other.kind.code))

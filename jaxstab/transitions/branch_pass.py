"""The pass from a state to detached surfaces, under a dead load that pulls.

Detached surfaces have no equilibrium then: their energy falls without end. But the branch of the
state leads around its pull-off and back to the same load, where it is unstable. It may come back
several times, through further minima. Each saddle on it joins the states on its two sides, which
are minima or detached surfaces. The pass is the lowest saddle such that it and those below it join
the state with detached surfaces.

Minima that are met on the way may be deeper than the start. Each has a climb, up to the pass
between it and detached surfaces. The largest climb is the exponent of the time until detachment.

Under a small tension, or none, the last saddle lies far out, where hardly any attraction is left.
To it leads a displacement of the whole surface, along which the energy is largest there: without a
load at infinity.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxstab.branches.branch_steps import BranchState, begin, goes_apart, next_state
from jaxstab.branches.curve import ContinuationProblem
from jaxstab.contact import Contact
from jaxstab.core.accuracy import EQUILIBRIUM
from jaxstab.core.checks import array, concrete
from jaxstab.core.compile import program
from jaxstab.core.progress import advance_if_known
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import stack_of
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.equilibrium import detached_where
from jaxstab.loading.pull_off import dead_load
from jaxstab.loads import Load
from jaxstab.potentials.profile import HARDLY_ANY
from jaxstab.states.kinds import ENDS
from jaxstab.transitions.saddle import Saddle, are_apart, minima_beside, no_saddle, saddle_near
from jaxstab.transitions.string import Landscape

# After so many steps a branch is followed no more.
MAX_STEPS = 20_000
# Sides of saddles: detached surfaces, the start, and one that is not known; minima follow them.
_DETACHED = 0
_START = 1
_UNKNOWN = -1


class Image(eqx.Module):
    """A state of the branch: its gap [length], and the energy of it and the load [energy]."""

    gap: Field
    energy: Scalar


class BranchPass(NamedTuple):
    """A saddle on the branch of a state.

    Attributes:
        saddle: the saddle.
        minima: the states on its two sides, the one nearer to the start first.
        images: some states of the branch, from the start to the saddle.
    """

    saddle: Saddle
    minima: Equilibrium
    images: list[Image]


class Climb(NamedTuple):
    """A minimum, and the pass between it and detached surfaces, so high above it [energy]."""

    minimum: Equilibrium
    over: BranchPass
    height: float


def climbs_on_branch(
    contact: Contact, load: Load, start: Equilibrium, number: int
) -> tuple[list[Climb], RESULTS]:
    """Return the climbs on the way from an equilibrium to detached surfaces, its own first.

    The branch is followed until the saddles on it join both; the result is how that ended. Of its
    states less than twice the number are kept. The function does not run under JAX transformations.
    """
    images = [_image(contact, load, start.gap)]
    stride = 1
    result = start.result
    ways = _Ways(contact, load, start)
    branches = iter(())
    if result == RESULTS.successful:
        branches = _branch(contact, load, start)
    for count, (branch, is_at_load) in enumerate(branches, 1):
        gap = branch.step.here.at.gap
        is_apart = branch.end == ENDS.separated
        if is_apart or (is_at_load and concrete(branch.step.index) == 1):
            if is_apart:
                saddle, minima = _separation(contact, load, gap)
            else:
                saddle = saddle_near(contact, load, gap, array(-np.inf, gap.dtype))
                minima = minima_beside(contact, load, saddle, start.gap)
            images_there = [*images, _image(contact, load, gap)]
            climbs = ways.climbs_with(BranchPass(saddle, minima, images_there))
            if climbs:
                return climbs, RESULTS.successful
        if count % stride == 0:
            images.append(_image(contact, load, gap))
        if len(images) >= 2 * number:
            images = images[::2]
            stride = 2 * stride
        result = RESULTS.no_detachment
        if branch.end == ENDS.lost or branch.end == ENDS.uncertain:
            result = RESULTS.lost_branch
    saddle = no_saddle(start.gap)
    minima = minima_beside(contact, load, saddle, start.gap)
    return [Climb(start, BranchPass(saddle, minima, images), np.nan)], result


def _separation(contact: Contact, load: Load, gap: Field) -> tuple[Saddle, Equilibrium]:
    """Return the saddle beyond a gap with hardly any attraction left, and the states beside it.

    Far out no Newton's method tells the saddle from none, nor need it: surfaces that do not deform
    are in equilibrium there within the accuracy of all others.
    """
    near = find(contact, load, PreconditionedConjugateGradient(), gap)
    apart = _apart(contact, load)
    saddle = saddle_near(contact, load, apart.gap, _image(contact, load, near.gap).energy)
    if not saddle.is_found:
        saddle = apart
    sides = [near, detached_where(array(True), near)]
    return saddle, stack_of(sides, near)


@program
def _apart(contact: Contact, load: Load) -> Saddle:
    """Return the surfaces without deformation where their energy and the load's is largest."""
    landscape = Landscape(contact, contact.control(load))
    above = jnp.max(contact.heights) - contact.heights
    profile = contact.profile
    least, most = (
        profile.outermost_gap(part * profile.max_attraction)
        for part in (HARDLY_ANY, EQUILIBRIUM["float64"])
    )
    is_far = (profile.gaps >= least) & (profile.gaps <= most)
    energies = jax.lax.map(lambda level: landscape.energy(level + above), profile.gaps)
    gap = profile.gaps[jnp.argmax(jnp.where(is_far, energies, -jnp.inf))] + above
    return Saddle(gap, jnp.full_like(gap, gap.size**-0.5), landscape.energy(gap), jnp.array(True))


def _branch(contact: Contact, load: Load, start: Equilibrium) -> Iterator[tuple[BranchState, bool]]:
    """Yield a branch after each of its states and at its end, and whether it is at the load.

    From the load it goes to either side, and then comes back.
    """
    problem, branch = begin(contact, dead_load(contact, load.value), start)
    leaves = True
    for _ in range(MAX_STEPS):
        new = next_state(problem, branch)
        if leaves and new.step.is_new and not _has_left(problem, new):
            # The load turns back within this step.
            branch = _with_shorter_step(problem, branch)
        elif leaves and new.step.is_new:
            problem, branch = _turn_back(problem, new)
            leaves = False
        else:
            branch = new
            if not leaves:
                branch = _end_if_apart(problem, branch)
        is_at_load = not leaves and bool(branch.end == ENDS.load)
        if branch.step.is_new or not branch.goes_on:
            advance_if_known(branch)
            yield branch, is_at_load
        if is_at_load:
            problem, branch = _go_on(problem, branch)
            leaves = True
        if not branch.goes_on:
            return


@program
def _image(contact: Contact, load: Load, gap: Field) -> Image:
    return Image(gap, Landscape(contact, contact.control(load)).energy(gap))


@program
def _has_left(problem: ContinuationProblem, branch: BranchState) -> Flag:
    """Return whether a branch is between the first load and the last one."""
    value = problem.curve.value(branch.step.here.at)
    return (value - problem.first_load) * (problem.last_load - problem.first_load) > 0


@program
def _with_shorter_step(problem: ContinuationProblem, branch: BranchState) -> BranchState:
    """Return a branch with a shorter step to try, or at its end where it would be too short."""
    length = branch.step.length / 4
    end = ENDS.where(length > problem.min_step, ENDS.states, ENDS.uncertain)
    step = replace(branch.step, length=length, is_new=jnp.array(False))
    return replace(branch, step=step, end=end)


@program
def _turn_back(
    problem: ContinuationProblem, branch: BranchState
) -> tuple[ContinuationProblem, BranchState]:
    """Return the problem of a branch that is to come back to its first load."""
    end = ENDS.where(branch.end == ENDS.load, ENDS.states, branch.end)
    return replace(problem, first_load=problem.last_load, last_load=problem.first_load), replace(
        branch, end=end
    )


@program
def _end_if_apart(problem: ContinuationProblem, branch: BranchState) -> BranchState:
    """Return a branch, at its end where surfaces go apart, though its last load comes later."""
    is_apart = (branch.end == ENDS.states) & goes_apart(problem.curve, branch.step)
    end = ENDS.where(is_apart, ENDS.separated, branch.end)
    return replace(branch, end=end)


@program
def _go_on(
    problem: ContinuationProblem, branch: BranchState
) -> tuple[ContinuationProblem, BranchState]:
    """Return the problem of a branch that goes on from its last load."""
    ahead = jnp.sign(problem.curve.rate(branch.step.here.tangent))
    last = problem.last_load + ahead * jnp.abs(problem.last_load - problem.first_load)
    return replace(problem, first_load=problem.last_load, last_load=last), replace(
        branch, end=ENDS.states
    )


def passes_out(energies: Sequence[float], sides: Sequence[tuple[int, int]]) -> dict[int, int]:
    """Return the pass out of each state that is met on the way from the start.

    Before thermal motion leads out over a pass, all states are met that lower saddles join with the
    one before it. Behind it this is so again, until it leads to detached surfaces.

    Arguments:
        energies: of saddles.
        sides: the numbers of the states on both sides of each.

    Returns:
        The number of the saddle that is the pass out of each state, of the start first; none
        without a way.
    """
    joined: dict[int, set[int]] = {}
    # The states that are met, the pass out of them, and the state behind it.
    ways = {_DETACHED: (set[int](), -1, _DETACHED)}
    for number in np.argsort(energies).tolist():
        here, there = sides[number]
        if here in ways:
            here, there = there, here
        if here in ways:
            continue
        together = joined.get(here, {here})
        if there in ways:
            ways |= dict.fromkeys(together, (together, number, there))
        else:
            together = together | joined.get(there, {there})
            joined |= dict.fromkeys(together, together)
    passes = {}
    state = _START if _START in ways else _DETACHED
    while state != _DETACHED:
        together, number, state = ways[state]
        passes |= dict.fromkeys(sorted(together), number)
    return passes


class _Ways:
    """The ways that saddles make from a start to detached surfaces."""

    def __init__(self, contact: Contact, load: Load, start: Equilibrium):
        self._inputs = contact, load
        self._minima = {_START: start}
        self._passes: list[BranchPass] = []
        self._sides: list[tuple[int, int]] = []

    def climbs_with(self, one: BranchPass) -> list[Climb]:
        """Return the climbs on the lowest way, with one saddle more; none if there is no way."""
        near, far = map(self._number_of, one.minima)
        if _UNKNOWN in (near, far):
            return []
        self._passes.append(one)
        self._sides.append((near, far))
        passes = passes_out([float(x.saddle.energy) for x in self._passes], self._sides)
        return [self._climb(state, self._passes[number]) for state, number in passes.items()]

    def _climb(self, state: int, over: BranchPass) -> Climb:
        minimum = self._minima[state]
        energy = _image(*self._inputs, minimum.gap).energy
        return Climb(minimum, over, float(over.saddle.energy) - float(energy))

    def _number_of(self, side: Equilibrium) -> int:
        """Return the number of a state beside a saddle."""
        if side.result == RESULTS.pulled_off:
            return _DETACHED
        if side.result != RESULTS.successful:
            return _UNKNOWN
        for number, minimum in self._minima.items():
            if not are_apart(side, minimum):
                return number
        self._minima[_START + len(self._minima)] = side
        return len(self._minima)

"""The lowest eigenpair on a linear space, and on a cone from the lowest modes around it.

A search has several programs: for its random starts, for the solver, and for the eigenpair of what
that has found, which is one program on spaces and cones.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, PRNGKeyArray

from jaxstab.contact.hessian import Block, Hessian
from jaxstab.core.checks import array
from jaxstab.core.compile import program
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import Eigenpair, Minimum, eigenpair_of
from jaxstab.stability.ritz import norms
from jaxstab.stability.solvers.base import (
    BLOCK_SIZE,
    NUM_RANDOM,
    ConeProblem,
    ConeSolver,
    SpaceSolver,
    noise,
)

# Starts on a cone, which of them are needed, and whether the first is the answer.
ConeStarts = tuple[Block, Bool[Array, " starts"], Flag]
# Steps, and applications of A.
Cost = tuple[Int[Array, ""], Int[Array, ""]]
# Up to so many points each one that lifts alone is a start too: near full contact others failed.
_FEW = 24


class Lowest(eqx.Module):
    """The lowest pair on a set, its sign beyond doubt, and a block of modes to go on from."""

    pair: Eigenpair
    sign: Int[Array, ""]
    modes: Block

    def without_cost(self) -> "Lowest":
        """Return the same pair without its steps and applications, which are counted already."""
        none = array(0)
        return replace(self, pair=replace(self.pair, num_steps=none, num_applications=none))

    def costing(self, more: Int[Array, ""]) -> "Lowest":
        """Return the same pair at the cost of some applications more."""
        number = self.pair.num_applications + more
        return replace(self, pair=replace(self.pair, num_applications=number))

    @property
    def cost(self) -> Cost:
        """Steps, and applications of A."""
        return cost_of(self.pair)


def cost_of(pair: Eigenpair) -> Cost:
    """Return the steps to a pair, and the applications of A."""
    return pair.num_steps, pair.num_applications


def with_cost(before: Cost, pair: Eigenpair) -> Eigenpair:
    """Return a pair at its cost and that of what came before."""
    num_steps, num_applications = before
    return replace(
        pair,
        num_steps=num_steps + pair.num_steps,
        num_applications=num_applications + pair.num_applications,
    )


def on_space(solver: SpaceSolver, hessian: Hessian, space: Subspace, starts: Block) -> Lowest:
    """Return the lowest pair on a linear space."""
    restricted = hessian.restriction(space.is_moving)
    found = solver.solve(restricted, space, starts)
    pair = eigenpair_of(restricted, space, found, found.vector[0]).with_proof(True)
    return Lowest(pair, pair.sign, found.vector)


@program
def random_starts(key: PRNGKeyArray, hessian: Hessian) -> Block:
    """Return random fields, from which searches on all sets start."""
    return hessian.solid.grid.device_put(noise(key, NUM_RANDOM, hessian.curvature))


@program
def modes_around(solver: SpaceSolver, problem: ConeProblem, starts: Block) -> tuple[Minimum, Block]:
    """Return the lowest mode on the linear space around a cone, and a block of the lowest ones.

    The first few of the starts are used.
    """
    starts = problem.operator.solid.grid.device_put(starts[:BLOCK_SIZE])
    found = solver.solve(problem.operator, problem.domain.hull, starts)
    return replace(found, vector=found.vector[0]), found.vector


@program
def mode_on_cone(
    solver: ConeSolver,
    problem: ConeProblem,
    hull_result: RESULTS,
    modes: Block,
    random: Block,
    before: Field | None = None,
) -> tuple[Minimum, Flag]:
    """Return the lowest mode on a cone, and whether it is one of the linear space around it.

    Given are the lowest modes of that space, and how they were found.
    """
    if before is not None:
        random = jnp.concatenate([before[None], random])
    cone = problem.domain
    starts, is_needed, is_proved_lowest = cone_starts(solver, cone, hull_result, modes, random)
    return solver.solve(problem.operator, cone, starts, is_needed), is_proved_lowest


def lowest_of(
    problem: ConeProblem,
    found: Minimum,
    modes: Block,
    is_proved_lowest: Flag | None = None,
    before: Cost | None = None,
) -> Lowest:
    """Return the lowest pair on a cone, or on the linear space around it, from the mode found.

    Arguments:
        problem: A, and the cone.
        found: the mode, as a solver has left it.
        modes: the lowest ones of the linear space.
        is_proved_lowest: whether none on the cone is lower; None for a mode of the linear space.
        before: the cost of what the solver started from.
    """
    is_space = is_proved_lowest is None
    if is_proved_lowest is None:
        is_proved_lowest = array(True)
    if before is None:
        before = array(0), array(0)
    pair, sign = _pair_of(problem, found, before, array(is_space), is_proved_lowest)
    return Lowest(pair, sign, modes)


@program
def _pair_of(
    problem: ConeProblem,
    found: Minimum,
    before: Cost,
    is_space: Flag,
    is_proved_lowest: Flag,
) -> tuple[Eigenpair, Int[Array, ""]]:
    """Return the eigenpair of a vector on a cone, or on the space around it, and its sign."""
    cone = problem.domain
    pair = eigenpair_of(problem.operator, cone.hull_if(is_space), found, found.vector)
    # In any other case a lower minimum may have been missed.
    pair = pair.with_proof(is_proved_lowest | cone.is_trivial)
    pair = with_cost(before, pair)
    return pair, pair.sign


def cone_starts(
    solver: ConeSolver, cone: AdmissibleCone, hull_result: RESULTS, modes: Block, random: Block
) -> ConeStarts:
    """Return starts on a cone, which of them are needed, and whether the first is the answer.

    They are the two lowest modes of the linear space around it with both signs, and random vectors.
    On few points each contact point that lifts is one too. If the lowest mode converged and lies in
    the cone, it is the answer and the only start.
    """
    on_contact = jnp.where(cone.one_sided, cone.inward(modes[0]), 0)
    entering, away = norms([jnp.minimum(on_contact, 0), jnp.maximum(on_contact, 0)])
    is_admissible = jnp.minimum(entering, away) <= solver.tolerance_in(entering.dtype)
    is_proved_lowest = (hull_result == RESULTS.successful) & is_admissible
    lowest = jnp.where(is_proved_lowest & (away < entering), -modes[0], modes[0])
    starts = jnp.concatenate([lowest[None], modes[1:2], -modes[:2], random])
    is_needed = ~is_proved_lowest | (jnp.arange(len(starts)) == 0)
    size = cone.one_sided.size
    one_sided = cone.one_sided
    if size <= _FEW:
        lifted = cone.inward(jnp.eye(size, dtype=starts.dtype).reshape(size, *one_sided.shape))
        starts = jnp.concatenate([starts, lifted])
        is_needed = jnp.concatenate([is_needed, ~is_proved_lowest & one_sided.ravel()])
    return starts, is_needed, is_proved_lowest

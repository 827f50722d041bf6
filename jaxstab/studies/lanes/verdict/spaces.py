"""The two linear spaces, searched side by side, as a stage of a case."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int

from jaxstab.contact.hessian import Block
from jaxstab.core.loop import Loop
from jaxstab.core.types import Flag, Mask
from jaxstab.stability.coarse_start import space_starts
from jaxstab.stability.cones import Subspace
from jaxstab.stability.lowest_modes import BLOCK_SIZE
from jaxstab.stability.lowest_pair import Lowest, again, costing, found_on_space
from jaxstab.stability.search import Search
from jaxstab.stability.solvers.base import ModesProblem
from jaxstab.studies.lanes.stage import Record, Stage
from jaxstab.studies.lanes.verdict.ready import chosen, ready_in, space_solver


class _OnSpace(eqx.Module):
    """A search of a linear space.

    Attributes:
        is_moving: the points that move.
        is_needed: whether it is of use.
        starts: a block to start from.
        cost: what that took, in applications of A.
        loop: where the search is.
    """

    is_moving: Mask
    is_needed: Flag
    starts: Block
    cost: Int[Array, ""]
    loop: Loop[Any]


class SpacesStage(Stage):
    """The linear spaces around V0+ and around the critical cone."""

    # A search is a dozen steps long.
    pace = 2

    def begin(self, record: Record) -> _OnSpace:
        """Return both searches before their first step."""
        search = ready_in(record).search
        hulls = search.cone.hull.is_moving, search.critical_cone.hull.is_moving

        def begun(is_moving: Array, is_needed: Array) -> _OnSpace:
            space, random = _space(search, is_moving), search.random[:BLOCK_SIZE]
            solver = space_solver(random.dtype)
            starts, cost = space_starts(solver, search.hessian, space, random)
            loop = solver.begin(_problem(search, is_moving, starts), starts)
            return _OnSpace(is_moving, is_needed, starts, cost, loop)

        is_needed = jnp.stack([jnp.array(True), search.touches])
        return jax.vmap(begun)(jnp.stack(hulls), is_needed)

    def advance(self, record: Record, state: _OnSpace, max_steps: ArrayLike) -> _OnSpace:
        """Return a search after at most so many steps more."""
        problem = _problem(ready_in(record).search, state.is_moving, state.starts)
        solver = space_solver(state.starts.dtype)
        return replace(state, loop=solver.advance(problem, state.loop, max_steps))

    def is_over(self, record: Record, state: _OnSpace) -> Flag:
        """Return whether a search has ended, or is not needed."""
        return ~state.is_needed | space_solver(state.starts.dtype).is_over(state.loop)

    def num_steps(self, state: _OnSpace) -> Int[Array, ""]:
        """Return the number of steps taken."""
        return state.loop.num_steps

    def found(self, record: Record) -> tuple[Lowest, Lowest]:
        """Return the lowest pairs of the two."""
        search, states = ready_in(record).search, record[3]

        def lowest(state: _OnSpace) -> Lowest:
            problem = _problem(search, state.is_moving, state.starts)
            solver = space_solver(state.starts.dtype)
            found = solver.minimum(problem, solver.outcome(state.loop))
            return costing(found_on_space(problem, found), state.cost)

        both = jax.vmap(lowest)(states)
        around, hull = (jax.tree.map(lambda leaf, i=i: leaf[i], both) for i in range(2))
        return around, chosen(search.touches, hull, again(around))


def _problem(search: Search, is_moving: Mask, starts: Block) -> ModesProblem:
    space = _space(search, is_moving)
    return ModesProblem(search.hessian.restricted(space.is_moving), space, starts)


def _space(search: Search, is_moving: Mask) -> Subspace:
    return Subspace(is_moving, search.cone.fixes_mean)

"""The search for a proof as a stage of a case."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int

from jaxstab.contact.hessian import Block
from jaxstab.core.loop import Loop
from jaxstab.core.types import Flag, Scalar
from jaxstab.stability.certificate import SHARES, bound_by, bounding_problem, is_sought
from jaxstab.stability.search import Search
from jaxstab.stability.solvers.base import ModesProblem
from jaxstab.studies.lanes.stage import Record, Stage
from jaxstab.studies.lanes.verdict.cones import ConesStage
from jaxstab.studies.lanes.verdict.ready import ready_in, space_solver
from jaxstab.studies.lanes.verdict.spaces import SpacesStage


class _Bounding(eqx.Module):
    """A bound that is sought.

    Attributes:
        eigenvalue: the smallest found on the cone.
        modes: those of the space around it.
        number: that of the share.
        is_needed: whether a bound is of use.
        best, cost: what is known so far, and at what cost.
        loop: where the search is; None where the solid knows of no bound.
    """

    eigenvalue: Scalar
    modes: Block
    number: Int[Array, ""]
    is_needed: Flag
    best: Scalar
    cost: Int[Array, ""]
    loop: Loop[Any] | None


class BoundStage(Stage):
    """The proof that the eigenvalue on V0+ is positive, where that is open.

    Arguments:
        spaces, cones: the stages before.
    """

    has_rounds = True
    pace = 2

    def __init__(self, spaces: SpacesStage, cones: ConesStage):
        self._spaces, self._cones = spaces, cones

    def begin(self, record: Record) -> _Bounding:
        """Return the search for the first bound."""
        search, (around, _) = ready_in(record).search, self._spaces.found(record)
        cone, _ = self._cones.found(record)
        is_open = (cone.sign > 0) & (around.sign <= 0) & ~cone.pair.proved
        eigenvalue, none = cone.pair.eigenvalue, jnp.array(0)
        state = _Bounding(
            eigenvalue,
            around.modes,
            none,
            search.touches & is_open & ~search.is_doubtful,
            jnp.full_like(eigenvalue, -jnp.inf),
            none,
            None,
        )
        return jax.tree.map(lambda leaf: leaf[None], self._begun(search, state))

    def advance(self, record: Record, state: _Bounding, max_steps: ArrayLike) -> _Bounding:
        """Return the search after at most so many steps more."""
        problem = _problem(ready_in(record).search, state)
        if problem is None or state.loop is None:
            return state
        solver = space_solver(state.best.dtype)
        return replace(state, loop=solver.advance(problem, state.loop, max_steps))

    def is_over(self, record: Record, state: _Bounding) -> Flag:
        """Return whether the search has ended, or is not needed."""
        if state.loop is None:
            return jnp.array(True)
        return ~state.is_needed | space_solver(state.best.dtype).is_over(state.loop)

    def num_steps(self, state: _Bounding) -> Int[Array, ""]:
        """Return the number of steps taken."""
        return jnp.array(0) if state.loop is None else state.loop.num_steps

    def turn(self, record: Record, states: _Bounding) -> _Bounding:
        """Return the search for the next bound, where one is needed."""
        search, state = ready_in(record).search, jax.tree.map(lambda leaf: leaf[0], states)
        problem, solver = _problem(search, state), space_solver(state.best.dtype)
        if problem is None or state.loop is None:
            return states
        found = solver.minimum(problem, solver.outcome(state.loop))
        bound, cost = bound_by(problem, found)
        best = jnp.where(state.is_needed, jnp.maximum(state.best, bound), state.best)
        turned = replace(
            state,
            number=state.number + 1,
            best=best,
            cost=state.cost + jnp.where(state.is_needed, cost, 0),
            is_needed=state.is_needed & is_sought(state.number + 1, best),
        )
        return jax.tree.map(lambda leaf: leaf[None], self._begun(search, turned))

    def _begun(self, search: Search, state: _Bounding) -> _Bounding:
        problem, solver = _problem(search, state), space_solver(state.best.dtype)
        if problem is None:
            return state
        return replace(state, loop=solver.begin(problem, state.modes))


def _problem(search: Search, state: _Bounding) -> ModesProblem | None:
    number = jnp.minimum(state.number, len(SHARES) - 1)
    return bounding_problem(search.hessian, search.cone, state.eigenvalue, state.modes, number)

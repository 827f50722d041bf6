"""The competition of starts on a cone, in rounds: who goes on, and who has won."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxstab.core.batching import lane_of
from jaxstab.core.loop import NO_LIMIT, Iteration, IterativeSolver, integer_parameter
from jaxstab.core.procedure import Rounds
from jaxstab.core.results import RESULTS
from jaxstab.stability.eigenpair import Minimum, descended
from jaxstab.stability.ritz import norms
from jaxstab.stability.solvers.base import Eigenproblem

# Steps in each round, and how many may go on to the next.
_LENGTHS = 4, 8, 10, 15, 25, 40, 60, NO_LIMIT
_NUM_KEPT = 12, 3, 3, 3, 3, 3, 3, 1
# The place of those that are beaten, which no round lets go on.
_OUT = max(_NUM_KEPT)
# The inner product from which two unit vectors are taken to lead to the same minimiser.
_SAME = 0.95


class Competition(Rounds):
    """Starts on a cone, of which fewer and fewer go on.

    The state of a start has a `point` and its `num_applications`.

    Attributes:
        solver, problem: those of all starts.
        wins: which of them are not beaten.
        number: that of the round.
    """

    solver: IterativeSolver
    problem: Eigenproblem
    wins: Bool[Array, " loops"]
    number: Int[Array, ""] = eqx.field(converter=integer_parameter, default=0)

    @property
    def search(self) -> tuple[IterativeSolver, Eigenproblem]:
        """The solver and its problem."""
        return self.solver, self.problem

    @property
    def length(self) -> Int[Array, ""]:
        """The steps in this round."""
        return lane_of(jnp.array(_LENGTHS), self.number)

    @property
    def found(self) -> Minimum:
        """The minimiser of the one start that has won, if any has."""
        operator, cone = self.problem.operator, self.problem.domain
        starts = self._starts
        best = lane_of(starts, jnp.argmax(self.wins))
        # All starts may be nearest to zero.
        is_lost = (best.result == RESULTS.successful) & ~jnp.any(self.wins)
        result = RESULTS.where(is_lost, RESULTS.stagnated, best.result)
        point, is_trivial = best.state.point, cone.is_trivial
        # Brought onto the cone, once, this is exactly zero where the contact holds.
        vector = descended(operator, point.mode, point.product, point.eigenvalue)
        return Minimum(
            vector=jnp.where(is_trivial, 0, vector),
            num_steps=jnp.sum(starts.num_steps),
            num_applications=jnp.sum(starts.state.num_applications),
            result=RESULTS.where(is_trivial, RESULTS.successful, result),
            history=best.history,
        )

    def turned(self) -> "Competition":
        """Return the next round."""
        wins = self._places() < lane_of(jnp.array(_NUM_KEPT), self.number)
        resumed = jax.vmap(self.solver.resumed)(self._starts)
        # After the last round all stay where they are.
        is_last = self.number == len(_LENGTHS) - 1
        loops = jax.tree.map(partial(jnp.where, is_last), self.loops, resumed)
        return replace(self, loops=loops, is_on=wins & ~is_last, wins=wins, number=self.number + 1)

    @property
    def _starts(self) -> Iteration:
        return jax.vmap(self.solver.outcome)(self.loops)

    def _places(self) -> Int[Array, " loops"]:
        """Return the place of each start, from 0 for the lowest; beyond all for those beaten."""
        starts = self._starts
        modes = starts.state.point.mode
        axes = tuple(range(1, modes.ndim))
        # Zero may be the nearest vector of the cone.
        is_out = ~self.wins | jnp.isnan(starts.residual) | (norms(modes) == 0)
        lowest = jnp.where(is_out, jnp.inf, starts.state.point.eigenvalue)
        is_alike = jnp.tensordot(modes, modes, (axes, axes)) > _SAME
        order = _order(lowest)
        is_copy = jnp.any((order[:, None] < order) & is_alike, axis=0)
        is_higher = lowest - self.problem.operator.scale * starts.residual > jnp.min(lowest)
        is_beaten = is_out | is_copy | is_higher
        return jnp.where(is_beaten, _OUT, _order(jnp.where(is_beaten, jnp.inf, lowest)))


def _order(values: Float[Array, " starts"]) -> Int[Array, " starts"]:
    """Return how many values come before each one, ties in the order they have."""
    places = jnp.arange(len(values))
    is_tied_before = (values[:, None] == values) & (places[:, None] < places)
    return jnp.sum((values[:, None] < values) | is_tied_before, axis=0)

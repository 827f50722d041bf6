"""The competition of `ProjectedLOBPCG` between starts on a cone, with pauses, start by start."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Int

from jaxstab.contact.hessian import Block, SymmetricOperator
from jaxstab.core.loop import Loop
from jaxstab.core.types import Flag
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.eigenpair import Minimum
from jaxstab.stability.solvers.base import Eigenproblem
from jaxstab.stability.solvers.cone_lobpcg import ProjectedLOBPCG, entry
from jaxstab.stability.solvers.rounds import ROUNDS, places, winner

_NUM_ROUNDS = len(ROUNDS)


class Competitor(eqx.Module):
    """A start in a round.

    Attributes:
        loop: where it is, counted from the beginning of the round.
        goes_on: whether it takes part.
        round: the number of the round.
    """

    loop: Loop
    goes_on: Flag
    round: Int[Array, ""]

    def is_over(self, solver: ProjectedLOBPCG) -> Flag:
        """Return whether the round is over for this start."""
        is_last = self.round >= _NUM_ROUNDS
        has_run = self.loop.num_steps >= _length(self.round)
        return is_last | ~self.goes_on | has_run | solver.is_over(self.loop)

    def advanced(
        self,
        solver: ProjectedLOBPCG,
        operator: SymmetricOperator,
        cone: AdmissibleCone,
        max_steps: ArrayLike,
    ) -> "Competitor":
        """Return the start after at most so many steps more of its round."""
        left = jnp.minimum(max_steps, _length(self.round) - self.loop.num_steps)
        loop = solver.advance(Eigenproblem(operator, cone), self.loop, left)
        return Competitor(loop, self.goes_on, self.round)


def entered(
    solver: ProjectedLOBPCG, cone: AdmissibleCone, starts: Block, is_needed: Bool[Array, " starts"]
) -> Competitor:
    """Return all starts before the first round."""
    first = jax.vmap(partial(entry, cone))(starts)
    loops = jax.vmap(solver.resumed)(first)
    goes_on = is_needed & ~cone.is_trivial
    return Competitor(loops, goes_on, jnp.zeros(len(starts), int))


def turned(
    solver: ProjectedLOBPCG, operator: SymmetricOperator, cone: AdmissibleCone, all_: Competitor
) -> Competitor:
    """Return all starts, for which a round is over, in the next that has steps, or at the end."""

    def turn(all_: Competitor) -> Competitor:
        found = jax.vmap(solver.outcome)(all_.loop)
        num_kept = jnp.array([kept for _, kept in ROUNDS])[all_.round[0]]
        wins = places(found, all_.goes_on, operator, cone) < num_kept
        resumed = jax.vmap(solver.resumed)(found)
        # After the last round all stay where they are.
        is_last = all_.round[0] == _NUM_ROUNDS - 1
        loops = jax.tree.map(partial(jnp.where, is_last), all_.loop, resumed)
        return Competitor(loops, wins, all_.round + 1)

    def goes_on(all_: Competitor) -> Flag:
        is_over = jax.vmap(lambda one: one.is_over(solver))(all_)
        return jnp.all(is_over) & (all_.round[0] < _NUM_ROUNDS)

    return jax.lax.while_loop(goes_on, turn, all_)


def decided(
    solver: ProjectedLOBPCG, operator: SymmetricOperator, cone: AdmissibleCone, all_: Competitor
) -> Minimum:
    """Return what the competition has come to, after its last round."""
    return winner(jax.vmap(solver.outcome)(all_.loop), all_.goes_on, operator, cone)


def _length(number: Int[Array, ""]) -> Int[Array, ""]:
    return jnp.array([length for length, _ in ROUNDS])[number]

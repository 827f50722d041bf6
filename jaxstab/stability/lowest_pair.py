"""The lowest eigenpair on a linear space, and on a cone from the lowest modes around it."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from jaxstab.contact.hessian import Block, Hessian
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Flag
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import Eigenpair, measured
from jaxstab.stability.ritz import norms
from jaxstab.stability.solvers.base import ConeSolver, SpaceSolver

# Starts on a cone, which of them are needed, and whether the first is the answer.
ConeStarts = tuple[Block, Bool[Array, " starts"], Flag]
# Up to so many points each one that lifts alone is a start too: near full contact others failed.
_FEW = 24


class Lowest(eqx.Module):
    """The lowest pair on a set, its sign beyond doubt, and a block of modes to go on from."""

    pair: Eigenpair
    sign: Int[Array, ""]
    modes: Block

    def known_before(self) -> "Lowest":
        """Return the same pair at no cost."""
        # Put, since JAX would compile a zero.
        none = jax.device_put(np.zeros((), int))
        return replace(self, pair=replace(self.pair, num_steps=none, num_applications=none))

    def costing(self, more: Int[Array, ""]) -> "Lowest":
        """Return the same pair at the cost of some applications more."""
        number = self.pair.num_applications + more
        return replace(self, pair=replace(self.pair, num_applications=number))


def with_cost_of(before: Eigenpair, pair: Eigenpair) -> Eigenpair:
    """Return a pair at the cost of both."""
    return replace(
        pair,
        num_steps=before.num_steps + pair.num_steps,
        num_applications=before.num_applications + pair.num_applications,
    )


def on_space(solver: SpaceSolver, hessian: Hessian, space: Subspace, starts: Block) -> Lowest:
    """Return the lowest pair on a linear space."""
    restricted = hessian.restricted(space.is_moving)
    found = solver.solve(restricted, space, starts)
    pair = measured(restricted, space, found, found.vector[0]).with_proof(True)
    return Lowest(pair, pair.sign, found.vector)


def on_cone(
    solver: ConeSolver, hessian: Hessian, cone: AdmissibleCone, around: Lowest, starts: ConeStarts
) -> Lowest:
    """Return the lowest pair on a cone."""
    vectors, is_needed, is_answer = starts
    restricted = hessian.restricted(cone.is_moving)
    found = solver.solve(restricted, cone, vectors, is_needed)
    pair = measured(restricted, cone, found, found.vector)
    # In any other case a lower minimum may have been missed.
    pair = pair.with_proof(is_answer | cone.is_trivial)
    return Lowest(pair, pair.sign, around.modes)


def cone_starts(
    solver: ConeSolver, cone: AdmissibleCone, around: Lowest, random: Block
) -> ConeStarts:
    """Return starts on a cone, which of them are needed, and whether the first is the answer.

    They are the two lowest modes of the linear space around it with both signs, and random vectors.
    On few points each contact point that lifts is one too. If the lowest mode converged and lies in
    the cone, it is the answer and the only start.
    """
    modes = around.modes
    starts = jnp.concatenate([modes[:2], -modes[:2], random])
    signs = jnp.stack([modes[0], -modes[0]])
    entering = norms(jnp.where(cone.one_sided, jnp.minimum(signs, 0), 0))
    is_admissible = jnp.min(entering) <= solver.tolerance_in(entering.dtype)
    is_answer = (around.pair.result == RESULTS.successful) & is_admissible
    lowest = jnp.where(is_answer, signs[jnp.argmin(entering)], starts[0])
    is_needed = ~is_answer | (jnp.arange(len(starts)) == 0)
    starts = starts.at[0].set(lowest)
    size = cone.one_sided.size
    one_sided = cone.one_sided
    if size <= _FEW:
        lifted = jnp.eye(size, dtype=starts.dtype).reshape(size, *one_sided.shape)
        starts = jnp.concatenate([starts, lifted])
        is_needed = jnp.concatenate([is_needed, ~is_answer & one_sided.ravel()])
    return starts, is_needed, is_answer

"""The lowest pair on a linear space, and from its modes that on a cone in it."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from jaxstab.contact.hessian import Block, Hessian
from jaxstab.core.procedure import Procedure
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Flag
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import Eigenpair, Minimum, measured
from jaxstab.stability.ritz import norms
from jaxstab.stability.solvers.base import ConeSolver, ModesProblem, SpaceSolver

# Up to so many points, each contact point that lifts alone is a start too: near full contact on
# few points others were seen to miss the smallest.
_FEW = 24


class Lowest(eqx.Module):
    """The lowest pair on a set, its sign beyond doubt, and a block of modes to go on from."""

    pair: Eigenpair
    sign: Int[Array, ""]
    modes: Block


def on_space(
    solver: SpaceSolver, hessian: Hessian, space: Subspace, starts: Block
) -> Procedure[Lowest]:
    """Return the procedure that finds the lowest pair on a linear space."""
    problem = ModesProblem(hessian.restricted(space.is_moving), space, starts)
    found = yield from solver.search(problem, starts)
    pair = problem.pair(found)
    return Lowest(pair, pair.sign, found.vector)


def cone_starts(
    solver: ConeSolver,
    cone: AdmissibleCone,
    hull: Lowest,
    random: Block,
    before: Lowest | None = None,
) -> tuple[Block, Bool[Array, " starts"], Flag]:
    """Return vectors to start from on a cone, which are needed, and whether one is the answer.

    They are the two lowest modes of its hull with both signs, and noise. On few points each contact
    point that lifts is one too. If the lowest mode converged and lies in the cone, it is the answer
    and the only start. All compete with earlier results.
    """
    modes = hull.modes
    starts = jnp.concatenate([modes[:2], -modes[:2], random])
    signs = jnp.stack([modes[0], -modes[0]])
    entering = norms(jnp.where(cone.one_sided, jnp.minimum(signs, 0), 0))
    is_admissible = jnp.min(entering) <= solver.tolerance_in(entering.dtype)
    is_answer = (hull.pair.result == RESULTS.successful) & is_admissible
    lowest = jnp.where(is_answer, signs[jnp.argmin(entering)], starts[0])
    is_needed = ~is_answer | (jnp.arange(len(starts)) == 0)
    starts = starts.at[0].set(lowest)
    size, one_sided = cone.one_sided.size, cone.one_sided
    if size <= _FEW:
        lifted = jnp.eye(size, dtype=starts.dtype).reshape(size, *one_sided.shape)
        starts = jnp.concatenate([starts, lifted])
        is_needed = jnp.concatenate([is_needed, ~is_answer & one_sided.ravel()])
    if before is None:
        return starts, is_needed, is_answer
    starts = jnp.concatenate([before.pair.mode[None], starts])
    return starts, jnp.ones(len(starts), bool), is_answer


def on_cone(
    hessian: Hessian,
    cone: AdmissibleCone,
    hull: Lowest,
    found: Minimum,
    is_answer: Flag,
) -> Lowest:
    """Return the lowest pair on a cone, as it was found."""
    restricted = hessian.restricted(cone.is_moving)
    # Or else there is nothing on the cone, or it may have been missed.
    pair = measured(restricted, cone, found, found.vector).with_proof(is_answer | cone.is_trivial)
    return Lowest(pair, pair.sign, hull.modes)


def again(lowest: Lowest) -> Lowest:
    """Return a known pair, at no cost."""
    # Put, since JAX would compile a zero.
    none = jax.device_put(np.zeros((), int))
    return replace(lowest, pair=replace(lowest.pair, num_steps=none, num_applications=none))


def costing(lowest: Lowest, more: Int[Array, ""]) -> Lowest:
    """Return a lowest pair whose cost is higher by some applications."""
    pair = lowest.pair
    return replace(lowest, pair=replace(pair, num_applications=pair.num_applications + more))


def after(first: Lowest, then: Lowest) -> Lowest:
    """Return the second of two, at the cost of both."""
    before, pair = first.pair, then.pair
    pair = replace(
        pair,
        num_steps=before.num_steps + pair.num_steps,
        num_applications=before.num_applications + pair.num_applications,
    )
    return replace(then, pair=pair)

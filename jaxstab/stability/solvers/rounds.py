"""The rounds in which starts on a cone compete: who goes on, and who has won."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxstab.contact.hessian import SymmetricOperator
from jaxstab.core.loop import Iteration
from jaxstab.core.results import RESULTS
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.eigenpair import Minimum, descended
from jaxstab.stability.ritz import norms

# Steps in each round, and how many may go on to the next.
ROUNDS = ((4, 12), (8, 3), (10, 3), (15, 3), (25, 3), (40, 3), (60, 3), (2**31 - 1, 1))
# The place of those that are beaten, which no round lets go on.
_OUT = max(kept for _, kept in ROUNDS)
# The inner product from which two unit vectors are taken to lead to the same minimiser.
_SAME = 0.95


def winner(
    found: Iteration,
    wins: Bool[Array, " starts"],
    operator: SymmetricOperator,
    cone: AdmissibleCone,
) -> Minimum:
    """Return the minimiser of the one start that has won, if any has."""
    best = jax.tree.map(lambda leaf: leaf[jnp.argmax(wins)], found)
    # All starts may be nearest to zero.
    is_lost = (best.result == RESULTS.successful) & ~jnp.any(wins)
    result = RESULTS.where(is_lost, RESULTS.stagnated, best.result)
    point, is_trivial = best.state.point, cone.is_trivial
    # Brought onto the cone, once, this is exactly zero where the contact holds.
    vector = descended(operator, point.mode, point.product, point.eigenvalue)
    return Minimum(
        vector=jnp.where(is_trivial, 0, vector),
        num_steps=jnp.sum(found.num_steps),
        num_applications=jnp.sum(found.state.num_applications),
        result=RESULTS.where(is_trivial, RESULTS.successful, result),
        history=best.history,
    )


def places(
    found: Iteration,
    goes_on: Bool[Array, " starts"],
    operator: SymmetricOperator,
    cone: AdmissibleCone,
) -> Int[Array, " starts"]:
    """Return the place of each start, from 0 for the lowest; beyond all for those beaten."""
    modes = found.state.point.mode
    axes = tuple(range(1, modes.ndim))
    # Zero may be the nearest vector of the cone.
    is_out = ~goes_on | jnp.isnan(found.residual) | (norms(modes) == 0)
    lowest = jnp.where(is_out, jnp.inf, found.state.point.eigenvalue)
    is_alike = jnp.tensordot(modes, modes, (axes, axes)) > _SAME
    order = _order(lowest)
    is_copy = jnp.any((order[:, None] < order) & is_alike, axis=0)
    is_higher = lowest - operator.scale * found.residual > jnp.min(lowest)
    is_beaten = is_out | is_copy | is_higher
    return jnp.where(is_beaten, _OUT, _order(jnp.where(is_beaten, jnp.inf, lowest)))


def _order(values: Float[Array, " starts"]) -> Int[Array, " starts"]:
    """Return how many values come before each one, ties in the order they have."""
    places = jnp.arange(len(values))
    is_tied_before = (values[:, None] == values) & (places[:, None] < places)
    return jnp.sum((values[:, None] < values) | is_tied_before, axis=0)

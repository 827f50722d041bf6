"""The projected conjugate gradient of Polonsky & Keer (1999) on the gap, with adhesion.

V. Rey, G. Anciaux, J.-F. Molinari, Normal adhesive contact on rough surfaces: efficient algorithm
for FFT-based BEM resolution, Computational Mechanics 60 (2017): reference [36] of Rey & Bleyer.
"""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact.residual import Balance
from jaxstab.core.checks import as_array
from jaxstab.core.grid import total
from jaxstab.core.loop import optional_parameter
from jaxstab.core.types import Field, Scalar
from jaxstab.equilibrium.solvers.base import EquilibriumSolver, Problem


class _ActiveSetState(eqx.Module):
    gap: Field
    balance: Balance
    direction: Field
    free_norm: Scalar


class PolonskyKeerRey(EquilibriumSolver):
    """Projected conjugate gradients on the gap at a prescribed mean gap (Rey et al., 2017).

    It differs from the original in two places. The step length along a direction t is
    <q, t> / <t, (K + D) t>, and falls back to the original's <q, t> / <t, K t> where the
    adhesion makes the former's curvature negative. And points pulled out of contact move by
    their pressure over the largest stiffness, plus f'' where that is positive. It is not made for
    potentials with a core.

    Arguments:
        tolerance: relative optimality residual to reach; by default 1e-8 in float64 and 1e-4 in
            float32.
        max_steps: the step limit, 20 000 by default.

    Example:
        >>> found = js.equilibrate(contact, js.MeanGap(0.05), js.solvers.PolonskyKeerRey(1e-8))
        >>> f"{found.mean_pressure:.4f}"
        '-0.1768'
    """

    tolerance: Scalar | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=as_array, default=20_000)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-8, "float32": 1e-4}
    patience: ClassVar[int] = 1_000

    def prepared(self, problem: Problem, start: Field) -> Problem:
        """Return a problem that holds the mean gap.

        Raises:
            ValueError: for a load that does not, and for a contact with a hardness.
        """
        if problem.contact.hardness is not None:
            raise ValueError(
                "PolonskyKeerRey knows no hardness: use PreconditionedConjugateGradient."
            )
        if not problem.control.fixes_mean:
            raise ValueError(
                "PolonskyKeerRey holds the mean gap only: under any other load use "
                "PreconditionedConjugateGradient."
            )
        return problem

    def init(self, problem: Problem, start: Field) -> _ActiveSetState:
        """Return the state of a gap that meets the load."""
        zero = jnp.zeros((), start.dtype)
        return _ActiveSetState(start, problem.balance(start), jnp.zeros_like(start), zero)

    def step(self, problem: Problem, state: _ActiveSetState) -> _ActiveSetState:
        """Return the state after a step along the direction of conjugate gradients."""
        solid = problem.contact.solid.with_uniform_stiffness(0)
        is_free = state.gap > 0
        net = state.balance.net
        curvature = state.balance.curvature
        free_norm = total(jnp.where(is_free, net, 0) ** 2)
        momentum = _ratio(free_norm, state.free_norm)
        # Dividing by a stiffness keeps products within the range of single precision.
        direction = net / solid.max_stiffness + momentum * state.direction
        direction = jnp.where(is_free, direction, 0)

        elastic = total(direction * solid.apply(direction))
        both = elastic + total(curvature * direction**2)
        length = _ratio(total(net * direction), jnp.where(both > 0, both, elastic))

        gap = jnp.maximum(state.gap - length * direction, 0)
        is_pulled = (gap == 0) & (net < 0)
        release = -net / (solid.max_stiffness + jnp.maximum(curvature, 0))
        gap = problem.control.restore(jnp.where(is_pulled, release, gap))
        free_norm = jnp.where(jnp.any(is_pulled), 0, free_norm)
        return _ActiveSetState(gap, problem.balance(gap), direction, free_norm)


def _ratio(above: Scalar, below: Scalar) -> Scalar:
    return jnp.where(below > 0, above / jnp.where(below > 0, below, 1), 0)

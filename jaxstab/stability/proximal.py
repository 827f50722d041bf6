"""Algorithm 1 of Rey & Bleyer: a primal-dual proximal iteration for the cone eigenvalue.

It departs from the text in six places. The eigenvalue is the Rayleigh quotient, not z, which
multiplies the constraint of zero mean. The start is a random admissible vector, since e has no
component in the admissible space. The loop ends on the projected residual, since neither epsilon
nor eta measures optimality. As the problem is not convex, the answer is a local minimiser. And
because the iteration can cycle where few points are free, y and z come from one projection onto
both constraints together, z by one Newton step of it, where (36) and (37) project onto each
apart; and beta grows from the bound on |A| to twice that in full contact. Without contact both
are as in the text.
"""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.elasticity import FieldMap
from jaxstab.grid import total
from jaxstab.iterate import (
    Indicators,
    Iteration,
    IterativeSolver,
    optional_parameter,
)
from jaxstab.stability.cones import AdmissibleCone


class _State(eqx.Module):
    x: Float[Array, " *grid"]
    y: Float[Array, " *grid"]
    z: Float[Array, ""]
    z_change: Float[Array, ""]


class ProximalIteration(IterativeSolver):
    """Algorithm 1 with tau = 1 / beta and sigma = beta / 2 (Rey & Bleyer, eqs. 34 to 39).

    Arguments:
        tolerance: the projected residual |x - P(x - (A x - lambda x) / b)| of a unit vector to
            reach, P the projection onto the cone and b the bound on |A|; by default 1e-7 in
            float64 and 1e-5 in float32.
        max_steps: the step limit, 200 000 by default.
    """

    tolerance: Float[Array, ""] | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=200_000)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-7, "float32": 1e-5}
    patience: ClassVar[int] = 40_000
    steps_per_check: ClassVar[int] = 50

    def solve(
        self,
        operator: FieldMap,
        bound: Float[Array, ""],
        cone: AdmissibleCone,
        start: Float[Array, " *grid"],
    ) -> Iteration[_State]:
        """Iterate from an admissible unit vector.

        Arguments:
            operator: A [pressure/length].
            bound: not below the norm of A [pressure/length].
            cone: where perturbations must lie.
            start: the first x.
        """
        beta = bound * (1 + jnp.mean(cone.in_contact, dtype=bound.dtype))

        def step(state: _State) -> _State:
            # tau sigma = 1/2.
            x = state.x - operator(state.x) / beta - (state.y + state.z) / 2
            x = x / jnp.sqrt(total(x**2))
            pulled = state.y + 2 * x - state.x
            z_change = cone.newton_step(pulled)
            z = state.z + z_change
            y = jnp.where(cone.in_contact, jnp.minimum(pulled - z_change, 0), 0)
            return _State(x, y, z, z_change)

        def measure(state: _State) -> Indicators:
            _, _, residual = admissible_pair(operator, bound, cone, state.x)
            return {
                "residual": residual,
                "epsilon": jnp.abs(jnp.sum(state.x)),
                "eta": jnp.abs(state.z_change) / jnp.maximum(jnp.abs(state.z), _tiny(state.z)),
            }

        zero = jnp.zeros((), start.dtype)
        return self.iterate(step, measure, _State(start, 0 * start, zero, zero))


def admissible_pair(
    operator: FieldMap,
    bound: Float[Array, ""],
    cone: AdmissibleCone,
    vector: Float[Array, " *grid"],
) -> tuple[Float[Array, ""], Float[Array, " *grid"], Float[Array, ""]]:
    """Return eigenvalue, mode and projected residual of the cone's unit vector nearest to this."""
    mode = unit_vector(cone, vector)
    product = operator(mode)
    eigenvalue = jnp.sum(mode * product)
    moved = cone.project(mode - (product - eigenvalue * mode) / bound)
    return eigenvalue, mode, jnp.sqrt(jnp.sum((mode - moved) ** 2))


def unit_vector(cone: AdmissibleCone, vector: Float[Array, " *grid"]) -> Float[Array, " *grid"]:
    """Return the cone's unit vector nearest to this one, or zero where the cone is trivial."""
    projected = jnp.where(cone.is_trivial, 0, cone.project(vector))
    return projected / jnp.maximum(jnp.sqrt(jnp.sum(projected**2)), _tiny(projected))


def _tiny(like: Array) -> float:
    return float(jnp.finfo(like.dtype).tiny)

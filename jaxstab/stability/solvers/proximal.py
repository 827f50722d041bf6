"""Algorithm 1 of Rey & Bleyer: a primal-dual proximal iteration for the cone eigenvalue.

It departs from the text in six places. The eigenvalue is the Rayleigh quotient, not z, which
multiplies the constraint of zero mean. The start is a random admissible vector, since e has no
component in the admissible space. The loop ends on the projected residual, since neither epsilon
nor eta measures optimality. As the problem is not convex, the answer is a local minimiser. The
iteration can cycle where few points are free. So y and z come from one projection onto both
constraints together, z by one Newton step of it; (36) and (37) project onto each apart. And beta
grows from the bound on |A| to twice that in full contact. Without contact both are as in the text.
"""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact.hessian import Block
from jaxstab.core.grid import total
from jaxstab.core.history import Indicators
from jaxstab.core.loop import Iteration, integer_parameter, optional_parameter
from jaxstab.core.types import Field, Scalar
from jaxstab.stability.eigenpair import Minimum, admissible_pair, descended, unit_vector
from jaxstab.stability.solvers.base import ConeSolver, Eigenproblem


class _State(eqx.Module):
    x: Field
    y: Field
    z: Scalar
    z_change: Scalar


class ProximalIteration(ConeSolver):
    """Algorithm 1 with tau = 1 / beta and sigma = beta / 2 (Rey & Bleyer, eqs. 34 to 39).

    Arguments:
        tolerance: the projected residual |x - P(x - (A x - lambda x) / b)| b / s of a unit vector
            to reach. P is the projection onto the cone, b the bound on |A| and s its size on the
            lower modes. By default 1e-7 in float64 and 1e-5 in float32.
        max_steps: the step limit, 200 000 by default.
    """

    tolerance: Scalar | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=integer_parameter, default=200_000)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-7, "float32": 1e-5}
    patience: ClassVar[int] = 40_000
    steps_per_check: ClassVar[int] = 50

    def init(self, problem: Eigenproblem, start: Block) -> _State:
        """Return the last of the starts alone, brought onto the cone."""
        # One of the two signs survives the projection.
        towards, away = (unit_vector(problem.domain, sign * start[-1]) for sign in (1, -1))
        x, zero = jnp.where(jnp.any(towards != 0), towards, away), jnp.zeros((), start.dtype)
        return _State(x, 0 * x, zero, zero)

    def step(self, problem: Eigenproblem, state: _State) -> _State:
        """Return the state after a primal and a dual step."""
        operator, cone = problem.operator, problem.domain
        bound = operator.bound
        beta = bound * (1 + jnp.mean(cone.one_sided, dtype=bound.dtype))
        # tau sigma = 1/2.
        x = state.x - operator(state.x) / beta - (state.y + state.z) / 2
        x = x / jnp.sqrt(total(x**2))
        pulled = state.y + 2 * x - state.x
        z_change = cone.newton_step(pulled)
        z = state.z + z_change
        y = jnp.where(cone.one_sided, jnp.minimum(pulled - z_change, 0), 0)
        return _State(x, y, z, z_change)

    def measure(self, problem: Eigenproblem, state: _State) -> Indicators:
        """Return the projected residual, and the paper's epsilon and eta."""
        _, _, residual = admissible_pair(problem.operator, problem.domain, state.x)
        return {
            "residual": residual,
            "epsilon": jnp.abs(jnp.sum(state.x)),
            "eta": jnp.abs(state.z_change) / jnp.maximum(jnp.abs(state.z), _tiny(state.z)),
        }

    def minimum(self, problem: Eigenproblem, found: Iteration[_State]) -> Minimum:
        """Return a minimiser of the Rayleigh quotient."""
        operator, num_steps = problem.operator, found.num_steps
        # One projected gradient step sets to exactly zero what the contact holds.
        eigenvalue, mode, _ = admissible_pair(operator, problem.domain, found.state.x)
        eigenvalue = jnp.where(eigenvalue == jnp.inf, 0, eigenvalue)
        return Minimum(
            vector=descended(operator, mode, operator(mode), eigenvalue),
            num_steps=num_steps,
            num_applications=num_steps + 1 + num_steps // self.steps_per_check + 2,
            result=found.result,
            history=found.history,
        )


def _tiny(like: Array) -> float:
    return float(jnp.finfo(like.dtype).tiny)

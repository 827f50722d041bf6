"""Algorithm 1 of Rey & Bleyer: a primal-dual proximal iteration for the cone eigenvalue.

The step is equations (34) to (37) as printed. Elsewhere the text cannot be meant:

- The start is a random admissible vector: e has no component in the admissible space.
- The loop goes on while *either* indicator is above the tolerance, where the text says "and"; since
  neither measures optimality, it ends on the projected residual.
- The eigenvalue is the Rayleigh quotient. z, which the text calls so, is the multiplier of the mean
  over sigma.

The problem is not convex, so the result is a local minimiser.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact.hessian import Block
from jaxstab.core.accuracy import EIGENPAIR
from jaxstab.core.checks import as_array, require_positive
from jaxstab.core.grid import mean, total
from jaxstab.core.history import Indicators
from jaxstab.core.loop import Iteration, optional_parameter
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Scalar
from jaxstab.core.units import NUMBER, STIFFNESS, Dimension
from jaxstab.stability.eigenpair import Minimum, admissible_pair, descend, unit_vector
from jaxstab.stability.solvers.base import ConeSolver, Eigenproblem

_COMPLIANCE = Dimension("length/pressure")


class _PrimalDual(eqx.Module):
    x: Field
    y: Field
    z: Scalar
    z_change: Scalar


class ProximalIteration(ConeSolver):
    """Algorithm 1 (Rey & Bleyer, eqs. 34 to 39), as printed.

    Where few points are free it can cycle, and ends as `stagnated`.

    Arguments:
        tolerance: the projected residual |x - P(x - (A x - lambda x) / b)| b / s of a unit vector
            to reach. P is the projection onto the cone, b the bound on |A| and s its size on the
            lower modes. By default 1e-7 in float64 and 1e-5 in float32.
        max_steps: the step limit, 200 000 by default.
        tau: the primal step [length/pressure], by default 1 / beta with beta the bound on |A|.
        sigma: the dual step [pressure/length], by default beta / 2. The paper's condition
            1 / tau - sigma >= beta / 2 is checked: a solve that violates it ends as `long_steps`.

    Raises:
        ValueError: if a tolerance, limit or step is not positive.

    Example:
        >>> stability = js.assess_stability(contact, state, js.ProximalIteration())
        >>> f"{stability.cone.eigenvalue:.3f}"
        '-2.268'
    """

    tolerance: Annotated[Scalar, NUMBER] | None = eqx.field(
        converter=optional_parameter, default=None
    )
    max_steps: Int[Array, ""] = eqx.field(converter=as_array, default=200_000)
    tau: Annotated[Scalar, _COMPLIANCE] | None = eqx.field(
        converter=optional_parameter, default=None
    )
    sigma: Annotated[Scalar, STIFFNESS] | None = eqx.field(
        converter=optional_parameter, default=None
    )

    default_tolerance: ClassVar[Mapping[str, float]] = EIGENPAIR
    patience: ClassVar[int] = 40_000
    steps_per_check: ClassVar[int] = 50

    def __check_init__(self) -> None:
        for name, step in (("tau", self.tau), ("sigma", self.sigma)):
            if step is not None:
                require_positive(name, step)

    def init(self, problem: Eigenproblem, start: Block) -> _PrimalDual:
        """Return the last of the starts alone, brought onto the cone, with y = 0 and z = 1.

        A cone without the constraint of zero mean has no multiplier of it: there z = 0.
        """
        # In the text x = e, which has no component in the space. One of the two signs survives the
        # projection.
        towards, away = (unit_vector(problem.domain, sign * start[-1]) for sign in (1, -1))
        x = jnp.where(jnp.any(towards != 0), towards, away)
        one = jnp.ones((), start.dtype)
        return _PrimalDual(x, jnp.zeros_like(x), one * problem.domain.fixes_mean, one)

    def step(self, problem: Eigenproblem, state: _PrimalDual) -> _PrimalDual:
        """Return the state after equations (34) to (37)."""
        operator = problem.operator
        cone = problem.domain
        tau, sigma = self._steps(operator.bound)
        x = state.x
        y = state.y
        z = state.z
        new = x - tau * operator(x) - tau * sigma * (y + z)  # (34)
        # Points that a cone holds stay zero.
        new = jnp.where(cone.is_moving, new, 0)
        new /= jnp.sqrt(total(new**2))  # (35)
        moved = 2 * new - x
        outward = cone.inward(jnp.minimum(cone.inward(y + moved), 0))
        y = jnp.where(cone.one_sided, outward, 0)  # (36)
        z_change = jnp.zeros_like(z)
        if cone.fixes_mean:
            z_change = mean(moved)  # (37)
        return _PrimalDual(new, y, z + z_change, z_change)

    def measure(self, problem: Eigenproblem, state: _PrimalDual) -> Indicators:
        """Return the projected residual, which ends the loop, and epsilon and eta (38, 39)."""
        _, _, residual = admissible_pair(problem.operator, problem.domain, state.x)
        tiny = jnp.finfo(state.z.dtype).tiny
        return {
            "residual": residual,
            "epsilon": jnp.abs(total(state.x)),  # (38)
            "eta": jnp.abs(state.z_change) / jnp.maximum(jnp.abs(state.z), tiny),  # (39)
        }

    def minimum(self, problem: Eigenproblem, found: Iteration[_PrimalDual]) -> Minimum:
        """Return a minimiser of the Rayleigh quotient."""
        operator = problem.operator
        num_steps = found.num_steps
        # One projected gradient step sets to exactly zero the points that the contact holds.
        # The eigenvalue is the Rayleigh quotient; z is the multiplier of the mean over sigma.
        eigenvalue, mode, _ = admissible_pair(operator, problem.domain, found.state.x)
        eigenvalue = jnp.where(eigenvalue == jnp.inf, 0, eigenvalue)
        tau, sigma = self._steps(operator.bound)
        # The defaults meet it exactly, so rounding is allowed for.
        is_short = (1 / tau - sigma) * (1 + 8 * jnp.finfo(mode.dtype).eps) >= operator.bound / 2
        return Minimum(
            vector=descend(operator, mode, operator(mode), eigenvalue),
            num_steps=num_steps,
            num_applications=num_steps + 1 + num_steps // self.steps_per_check + 2,
            result=RESULTS.where(is_short, found.result, RESULTS.long_steps),
            history=found.history,
        )

    def _steps(self, beta: Scalar) -> tuple[Scalar, Scalar]:
        """Return tau and sigma; the choice of section 4.1 where they are not given."""
        tau = 1 / beta
        if self.tau is not None:
            tau = self.tau.astype(beta.dtype)
        sigma = beta / 2
        if self.sigma is not None:
            sigma = self.sigma.astype(beta.dtype)
        return tau, sigma

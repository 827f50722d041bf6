"""Newton's method for a fold: both of its conditions taken together."""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact
from jaxstab.core.history import Indicators
from jaxstab.core.loop import IterativeSolver
from jaxstab.core.types import Scalar
from jaxstab.paths.branch_end.linearise import Point, linearised, moved_along, newton_step, point_at


class FoldNewton(IterativeSolver):
    """Newton's method for a balance of pressures and an eigenvalue of zero."""

    tolerance: Scalar | None = None
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=30)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-9, "float32": 1e-4}
    patience: ClassVar[int] = 8

    def step(self, problem: Contact, state: Point) -> Point:
        """Return the point after a step of Newton's method."""
        linear = linearised(problem, state.load, state.gap, state.pair)
        conditions = linear.imbalance, state.pair.eigenvalue
        change, move = newton_step(linear, conditions, lambda b: linear.stiffened.solution(b)[0])
        load, gap = moved_along(problem, state.load, state.gap, change, move)
        return point_at(problem, load, gap, state.modes)

    def measure(self, problem: Contact, state: Point) -> Indicators:
        """Return how far both conditions are from being met."""
        balance = problem.balance(problem.control(state.load))(state.gap)
        eigenvalue = jnp.abs(state.pair.eigenvalue) / problem.solid.min_stiffness
        return {"residual": jnp.maximum(balance.residual, eigenvalue)}

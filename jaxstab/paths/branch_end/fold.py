"""Newton's method for a fold: both of its conditions taken together."""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact
from jaxstab.core.history import Indicators
from jaxstab.core.loop import Iteration, IterativeSolver
from jaxstab.core.types import Flag, Scalar
from jaxstab.paths.branch_end.linearise import Point, linearised, moved_along, newton_step, point_at


class FoldNewton(IterativeSolver):
    """Newton's method for a balance of pressures and an eigenvalue of zero."""

    tolerance: Scalar | None = None
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=30)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-9, "float32": 1e-4}
    patience: ClassVar[int] = 8

    def solve(
        self, contact: Contact, point: Point, is_needed: Flag | bool = True
    ) -> Iteration[Point]:
        """Go from a point of the branch to the fold, if there is such a point."""

        def step(point: Point) -> Point:
            linear = linearised(contact, point.load, point.gap, point.pair)
            conditions = linear.imbalance, point.pair.eigenvalue
            change, move = newton_step(
                linear, conditions, lambda b: linear.stiffened.solution(b)[0]
            )
            load, gap = moved_along(contact, point.load, point.gap, change, move)
            return point_at(contact, load, gap, point.modes)

        def measure(point: Point) -> Indicators:
            balance = contact.balance(contact.control(point.load))(point.gap)
            eigenvalue = jnp.abs(point.pair.eigenvalue) / contact.solid.min_stiffness
            return {"residual": jnp.maximum(balance.residual, eigenvalue)}

        return self.iterate(step, measure, point, jnp.where(is_needed, self.max_steps, 0))

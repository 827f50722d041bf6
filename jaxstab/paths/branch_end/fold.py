"""Newton's method for a fold: both of its conditions taken together."""

import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.history import Indicators
from jaxstab.paths.branch_end.linearise import (
    NewtonSolver,
    Point,
    linearised,
    moved_along,
    newton_step,
    point_at,
)


class FoldNewton(NewtonSolver):
    """Newton's method for a balance of pressures and an eigenvalue of zero."""

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

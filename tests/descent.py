"""A solver for equilibria of one's own, which several tests take."""

from jaxtyping import Array

import jaxstab as js


class Descent(js.solvers.EquilibriumSolver):
    """Steps down the net pressure, as long as the stiffest wave allows."""

    tolerance: Array = 1e-8
    max_steps: Array = 20_000
    patience = 5_000

    def step(self, problem, state):
        gap, net = state.gap, state.balance.net
        moves = problem.control.project(net, (gap > 0) | (net < 0))
        return problem.state(gap - moves / problem.contact.solid.max_stiffness)

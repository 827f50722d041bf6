"""A solver for equilibria of one's own, which several tests take."""

import equinox as eqx
from jaxtyping import Array

import jaxstab as js


class Descent(js.EquilibriumSolver):
    """Steps down the net pressure, as long as the stiffest wave allows."""

    tolerance: Array = 1e-8
    max_steps: Array = 20_000
    patience = 5_000

    def solve(self, contact, control, gap):
        balance_of = contact.balance(control)
        length = 1 / contact.solid.max_stiffness

        def step(state):
            moves = control.project(state.balance.net, (state.gap > 0) | (state.balance.net < 0))
            gap = control.admissible(state.gap - length * moves)
            return State(gap, balance_of(gap))

        return self.iterate(
            step, lambda state: {"residual": state.balance.residual}, State(gap, balance_of(gap))
        )


class State(eqx.Module):
    gap: Array
    balance: eqx.Module

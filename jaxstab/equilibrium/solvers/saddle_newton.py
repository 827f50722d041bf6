"""Newton's method for equilibria of any kind, minima of the energy or not."""

from collections.abc import Mapping
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact.hessian import Hessian
from jaxstab.core import model
from jaxstab.core.accuracy import EQUILIBRIUM, NEWTON_STEP
from jaxstab.core.checks import as_array
from jaxstab.core.control_flow import choose, on_platform
from jaxstab.core.grid import total
from jaxstab.core.history import Indicators
from jaxstab.core.linear_system import MAX_STEPS, LinearSystem
from jaxstab.core.loop import optional_parameter
from jaxstab.core.types import Flag, Scalar
from jaxstab.equilibrium.solvers.base import EquilibriumSolver, Problem, SolverState
from jaxstab.equilibrium.solvers.minres import minres

# Halvings of a step before it is taken as it is.
_MAX_CUTS = 8


class _NewtonTrial(eqx.Module):
    state: SolverState
    length: Scalar
    count: Int[Array, ""]


class SaddleNewton(EquilibriumSolver):
    """Newton's method on the balance of pressures, whether the energy falls or not.

    It finds the equilibrium near its start, a minimum or a saddle, for instance beyond a fold.
    A step moves the points out of contact, and points in contact that are in tension. It
    solves (K + D) d = -(K u + p0 + f') among them by MINRES with the preconditioner 1 / (K + c). It
    is cut at zero gap, and halved while it raises the residual.

    Arguments:
        tolerance: relative optimality residual to reach; by default 1e-9 in float64 and 1e-4 in
            float32.
        max_steps: the step limit, 200 by default.

    Example:
        >>> newton = js.solvers.SaddleNewton()
        >>> saddle = js.equilibrate(contact, js.MeanGap(0.05), newton, initial=state)
        >>> f"{saddle.mean_pressure:.4f}"
        '-0.1768'
    """

    tolerance: Scalar | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=as_array, default=200)

    default_tolerance: ClassVar[Mapping[str, float]] = EQUILIBRIUM
    patience: ClassVar[int] = 20

    def step(self, problem: Problem, state: SolverState) -> SolverState:
        """Return the state after a step of Newton's method, or of the part that is no worse."""
        control = problem.control
        solid = problem.contact.solid
        side = control.side(state.gap, state.balance.net)
        force = state.balance.net
        if side is not None:
            force = model.on_side(force, side, control.largest_reaction)
        curvature = state.balance.curvature
        is_moving = control.moving(state.gap, state.balance.net)
        hessian = Hessian(solid, curvature, control.stiffness, is_moving)
        adhesion = total(jnp.abs(curvature)) / curvature.size
        inverse = hessian.inverse(solid.min_stiffness + adhesion)

        system = LinearSystem(hessian, inverse, lambda field: control.project(field, is_moving))
        change = minres(system, -force, NEWTON_STEP, MAX_STEPS)

        def attempt(trial: _NewtonTrial) -> _NewtonTrial:
            new = problem.state(state.gap + trial.length * change, side)
            return _NewtonTrial(new, trial.length / 2, trial.count + 1)

        def is_worse(trial: _NewtonTrial) -> Flag:
            falls = trial.state.balance.residual < state.balance.residual
            return (trial.count == 0) | (~falls & (trial.count <= _MAX_CUTS))

        def unless_found(_: Array, trial: _NewtonTrial) -> _NewtonTrial:
            return choose(is_worse(trial), attempt(trial), trial)

        # The system took many more transforms than all lengths do: elsewhere no host looks on.
        return on_platform(
            partial(jax.lax.while_loop, is_worse, attempt),
            partial(jax.lax.fori_loop, 0, _MAX_CUTS + 1, unless_found),
            _NewtonTrial(state, jnp.ones((), state.gap.dtype), jnp.array(0)),
        ).state

    def measure(self, problem: Problem, state: SolverState) -> Indicators:
        """Return the residual, infinite where the surfaces are apart for good."""
        balance = state.balance
        return {"residual": jnp.where(balance.has_escaped, jnp.inf, balance.residual)}

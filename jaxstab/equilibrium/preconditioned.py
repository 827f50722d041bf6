"""Preconditioned projected conjugate gradients whose energy never rises."""

from collections.abc import Mapping
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxstab.contact import Balance, Contact
from jaxstab.elasticity import FieldMap
from jaxstab.grid import total
from jaxstab.iterate import (
    Indicators,
    Iteration,
    IterativeSolver,
    Report,
    optional_parameter,
)
from jaxstab.loads import Control
from jaxstab.potentials import energy_density, slope

_MAX_CUTS = 40
_ARMIJO = 1e-4


class _State(eqx.Module):
    gap: Float[Array, " *grid"]
    balance: Balance
    energy: Float[Array, ""]
    direction: Float[Array, " *grid"]
    force: Float[Array, " *grid"]
    force_norm: Float[Array, ""]
    reach: Float[Array, ""]


class _Trial(eqx.Module):
    gap: Float[Array, " *grid"]
    balance: Balance
    gain: Float[Array, ""]
    is_accepted: Bool[Array, ""]
    length: Float[Array, ""]
    count: Int[Array, ""]


class PreconditionedConjugateGradient(IterativeSolver):
    """Projected conjugate gradients on the gap, preconditioned in Fourier space.

    A step moves the points out of contact, and those in contact that are pulled off it. Its
    direction is that of Polak and Ribiere, never less than zero, with the preconditioner
    1 / (K + c) masked to those points; its length minimises the energy along the direction to
    second order, and is cut until the energy falls once the gap is cut at zero and brought back
    under the load. Where the curvature is negative, lengths grow for as long as they succeed.

    Arguments:
        tolerance: relative optimality residual to reach; by default 1e-8 in float64 and 1e-4 in
            float32.
        max_steps: the step limit, 5 000 by default.
    """

    tolerance: Float[Array, ""] | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=5_000)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-8, "float32": 1e-4}
    patience: ClassVar[int] = 300

    def solve(
        self,
        contact: Contact,
        control: Control,
        gap: Float[Array, " *grid"],
        report: Report | None = None,
    ) -> Iteration[_State]:
        """Iterate from a gap that meets the load to an equilibrium under it."""
        stiffness = contact.solid.stiffness
        precondition, shift = _preconditioner(contact, gap)
        balance_of = contact.balance(control)

        def search(state: _State, direction: Float[Array, " *grid"], length: Array) -> _Trial:
            density = energy_density(contact.potential, state.gap)
            size = total(jnp.abs(density) + state.gap * jnp.abs(state.balance.elastic))
            noise = 100 * jnp.finfo(gap.dtype).eps * size

            def attempt(length: Float[Array, ""], count: Int[Array, ""]) -> _Trial:
                new_gap = control.restore(jnp.maximum(state.gap - length * direction, 0))
                balance = balance_of(new_gap)
                change = new_gap - state.gap
                # Differences of fields, not of energies, which would lose the last digits.
                elastic = (state.balance.elastic + balance.elastic) * change / 2
                adhesive = energy_density(contact.potential, new_gap) - density
                gain = total(elastic + adhesive + control.work(change))
                first_order = total(state.balance.net * change)
                promised = _ARMIJO * jnp.minimum(first_order, 0)
                # Where rounding hides the gain, the slopes at both ends still show it.
                by_slopes = (first_order + total(balance.net * change)) / 2
                is_hidden = (gain <= noise) & (by_slopes <= promised)
                is_accepted = (gain <= promised) | is_hidden
                return _Trial(new_gap, balance, gain, is_accepted, length, count)

            def shorten(trial: _Trial) -> _Trial:
                return attempt(trial.length / 3, trial.count + 1)

            return jax.lax.while_loop(
                lambda trial: ~trial.is_accepted & (trial.count < _MAX_CUTS),
                shorten,
                attempt(length, jnp.array(0)),
            )

        def step(state: _State) -> _State:
            net = state.balance.net
            is_moving = (state.gap > 0) | (net < 0)
            force = control.project(net, is_moving)
            steepest = control.project(precondition(force), is_moving)
            force_norm = total(force * steepest)
            change = force_norm - total(state.force * steepest)
            momentum = jnp.maximum(change, 0) / _nonzero(state.force_norm)
            direction = control.project(steepest + momentum * state.direction, is_moving)
            descent = total(force * direction)
            direction = jnp.where(descent > 0, direction, steepest)
            descent = jnp.where(descent > 0, descent, force_norm)

            elastic = total(direction * stiffness(direction))
            curvature = elastic + total(contact.curvature(state.gap) * direction**2)
            is_convex = curvature > 0
            bound = elastic + shift * total(direction**2)
            length = descent / _nonzero(jnp.where(is_convex, curvature, bound / state.reach))

            trial = search(state, direction, length)
            stays = ~trial.is_accepted
            grows = trial.is_accepted & ~is_convex & (trial.count == 0)
            return _State(
                jnp.where(stays, state.gap, trial.gap),
                jax.tree.map(partial(jnp.where, stays), state.balance, trial.balance),
                jnp.where(stays, state.energy, state.energy + trial.gain),
                jnp.where(stays, 0, direction),
                force,
                force_norm,
                jnp.where(grows, 2 * state.reach, 1),
            )

        def measure(state: _State) -> Indicators:
            slopes = slope(contact.potential, state.gap), contact.curvature(state.gap)
            has_escaped = control.has_escaped(state.gap, *slopes)
            residual = jnp.where(has_escaped, jnp.inf, state.balance.residual)
            return {"residual": residual, "energy": state.energy}

        one = jnp.ones((), gap.dtype)
        energy = contact.energy(gap) / contact.grid.cell_area + total(control.work(gap))
        nothing = jnp.zeros_like(gap)
        start = _State(gap, balance_of(gap), energy, nothing, nothing, one, one)
        return self.iterate(step, measure, start, report)


def _preconditioner(
    contact: Contact, gap: Float[Array, " *grid"]
) -> tuple[FieldMap, Float[Array, ""]]:
    """Return the map 1 / (K + c), and c: the stiffness of the softest wave and of the adhesion."""
    multiplier = contact.solid.multiplier.astype(gap.dtype)
    softest = jnp.min(jnp.where(multiplier > 0, multiplier, jnp.inf))
    shift = softest + total(jnp.maximum(contact.curvature(gap), 0)) / gap.size
    inverse = 1 / (multiplier + shift)

    def apply(field: Float[Array, " *grid"]) -> Float[Array, " *grid"]:
        return jnp.fft.irfftn(inverse * jnp.fft.rfftn(field), s=field.shape)

    return apply, shift


def _nonzero(value: Float[Array, ""]) -> Float[Array, ""]:
    return jnp.where(value == 0, 1, value)

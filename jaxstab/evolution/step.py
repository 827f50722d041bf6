"""A time step of a viscoelastic contact: an elastic equilibrium, and an estimate of its error.

The solid is springs r_k K in parallel, r_0 = 1 the relaxed one, and each other in series with a
dashpot. The strain of spring k is a displacement v_k, v_k' = w' - v_k / t_k with t_0 infinite, so
that v_0 = w is the displacement relative to the far side, and p = K sum r_k v_k. For w linear in
time within a step dt, with e_k = exp(-dt / t_k) and b_k = (t_k / dt) (1 - e_k),

    v_k(new) = e_k v_k + b_k (w(new) - w),

so that p(new) = K_step (w(new) + m) with K_step = K sum r_k b_k and the memory
m = sum r_k e_k v_k / sum r_k b_k - w. A step is the elastic equilibrium of K_step on the surface
h + m, exact for any dt if w is linear in it, of second order otherwise.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.contact import Contact
from jaxstab.contact.energy import characteristic_energy, rounding_of
from jaxstab.core.compile import program
from jaxstab.core.grid import mean, total
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import solve
from jaxstab.evolution.evolution import (
    Memory,
    Totals,
    mean_displacement_as_gap,
    moved_contact,
    or_nan,
)
from jaxstab.loads import Load, Spring
from jaxstab.potentials import energy_density
from jaxstab.solids.solid import finite_or_zero
from jaxstab.solids.viscoelastic import ramp

# Errors are relative to these parts of the height and energy of the surface before it moves.
_LEAST = 1e-2
# A step exchanges at least this part of the largest energy exchanged so far, as its error counts.
_LEAST_EXCHANGE = 1 / 300


class StepRecord(eqx.Module):
    """What the loop over time steps keeps of a step, for the next one.

    Attributes:
        memory: the gap and the strains of the springs.
        rate: of the deformation, in the last step.
        forms: v_k.K v_k of each spring [energy].
        totals: the scalars that the user gets.
        largest_deformation: of all steps so far [length].
        largest_energy: the largest energy exchanged so far.
        imbalance: the work of the pressures in the last step less the energy gained.
        dt: the length of step that the error allows [time].
        result: how the last equilibrium ended.
    """

    memory: Memory
    rate: Field
    forms: Float[Array, " springs"]
    totals: Totals
    largest_deformation: Scalar
    largest_energy: Scalar
    imbalance: Scalar
    dt: Scalar
    result: RESULTS


@program
def first_record(contact: Contact, load: Load, memory: Memory, dt: Scalar) -> StepRecord:
    """Return the record after a step from a memory, where no work has been done yet."""
    zero = jnp.zeros_like(dt)
    heights = contact.solid.surface(contact.heights)
    extent = jnp.max(jnp.abs(heights - jnp.mean(heights)))
    # A flat surface is not deformed at all, but for rounding.
    extent = jnp.where(extent > 0, extent, contact.profile.range)
    begin = StepRecord(
        memory=memory,
        rate=jnp.zeros_like(contact.heights),
        forms=jnp.concatenate([_forms(contact, [v], v) for v in memory.strains]),
        totals=Totals(*[zero] * 7),
        largest_deformation=_LEAST * extent,
        largest_energy=_LEAST**2 * characteristic_energy(contact),
        imbalance=zero,
        dt=jnp.full_like(zero, jnp.inf),
        result=RESULTS.successful,
    )
    end, _ = take_step(contact, load, begin, dt)
    return replace(
        end,
        memory=or_nan(end.memory, end.result),
        rate=begin.rate,
        totals=replace(end.totals, work=zero, viscous_dissipation=zero, jump_dissipation=zero),
        largest_deformation=begin.largest_deformation,
        largest_energy=begin.largest_energy,
    )


def take_step(
    contact: Contact, load: Load, old: StepRecord, dt: Scalar
) -> tuple[StepRecord, Callable[[Flag], StepRecord]]:
    """Return the record after a time step to a load, and the function that adds a jump's loss.

    Both are differentiable.

    1. Find the equilibrium of K_step on the surface moved by the memory.
    2. Find the deformation w relative to the far side, and from its change the strains v_k.
    3. Add what the dashpots have dissipated: on each branch the work r_k v_k.K w' less the energy
       stored there, that is the integral of r_k v_k.K v_k / t_k, in closed form.
    4. Add up the energy stored: that of the springs, of adhesion, and of the spring of the load.
    5. The work of a smooth step is all that it stores and dissipates. The work of the pressures at
       both ends, by the trapezoidal rule, is only of second order: the difference is an estimate of
       the error. In a jump it is the work, and the rest of the energy is lost.
    """
    solid: Any = contact.solid
    memory = old.memory
    before = old.totals
    moved = moved_contact(contact, memory, dt)
    load = mean_displacement_as_gap(contact, load)
    control = moved.control(load)
    start = memory.gap
    if control.fixes_mean:
        # Full contact opens everywhere at once.
        start = jnp.where(jnp.max(start) > 0, start, 1)
    found = solve(moved, load, PreconditionedConjugateGradient(), start)
    gap = found.gap
    pressure = found.mean_pressure

    # Relative to the far side the mean is mean(p) / K_step(q = 0) - mean(m), or has no memory.
    stiffness = finite_or_zero(moved.solid.uniform_stiffness)
    is_held = stiffness > 0
    level = mean(found.pressure) / jnp.where(is_held, stiffness, 1)
    punch = solid.punch
    level = jnp.where(is_held, level - mean(moved.heights - contact.heights, punch), 0)
    displacement = gap + contact.heights
    deformation = displacement - mean(displacement, punch) + level
    change = deformation - memory.strains[0]
    ratios, times = solid.springs
    x = dt / times
    e = jnp.exp(-x)
    b = ramp(x)
    strains = jax.vmap(lambda e, b, v: e * v + b * change)(e, b, memory.strains)

    *cross, square = _forms(contact, [*memory.strains, change], change)
    cross = jnp.stack(cross)
    forms = e**2 * old.forms + 2 * e * b * cross + b**2 * square
    branches = -jnp.expm1(-2 * x) / 2 * old.forms - jnp.expm1(-x) * b * cross + _gain(x) * square
    dissipated = before.viscous_dissipation + jnp.sum(ratios * branches)

    # Above zero strain and no law.
    stored = total(energy_density(contact.potential, gap)) * contact.grid.cell_area
    stored = stored.astype(gap.dtype) + jnp.sum(ratios * forms) / 2
    # The far side, or the far end of a spring, moves against the pressure.
    far = mean(gap - memory.gap - change, punch)
    if isinstance(load, Spring):
        compliance = 1 / load.stiffness.astype(gap.dtype)
        far -= compliance * (pressure - before.mean_pressure)
        stored += contact.area * compliance * pressure**2 / 2

    gained = stored - before.stored + dissipated - before.viscous_dissipation
    by_pressure = -contact.area * (before.mean_pressure + pressure) / 2 * far
    work = before.work + gained

    new = StepRecord(
        memory=Memory(gap, strains.at[0].set(deformation)),
        rate=change / jnp.where(dt > 0, dt, 1),
        forms=forms,
        totals=Totals(
            mean_gap=jnp.mean(solid.surface(gap)),
            mean_pressure=pressure,
            contact_area=found.contact_area,
            stored=stored,
            work=work,
            viscous_dissipation=dissipated,
            jump_dissipation=before.jump_dissipation,
        ),
        largest_deformation=jnp.maximum(old.largest_deformation, jnp.max(jnp.abs(deformation))),
        largest_energy=jnp.maximum(old.largest_energy, jnp.maximum(jnp.abs(work), dissipated)),
        imbalance=by_pressure - gained,
        dt=old.dt,
        result=found.result,
    )

    def potential(gap: Field) -> Scalar:
        return moved.energy(gap) + moved.grid.area.astype(gap.dtype) * control.energy(
            control.mean_gap_of(gap)
        )

    def fall() -> Scalar:
        # At one load, in one step.
        return jnp.maximum(potential(control.restore(start)) - potential(gap), 0)

    def with_loss(has_jumped: Flag) -> StepRecord:
        lost = jax.lax.cond(has_jumped, fall, lambda: jnp.zeros_like(dt))
        work = jnp.where(has_jumped, before.work + by_pressure, new.totals.work)
        totals = replace(new.totals, work=work, jump_dissipation=before.jump_dissipation + lost)
        # The rate of a jump says nothing of the next step.
        return replace(new, totals=totals, rate=jnp.where(lost > 0, 0, new.rate))

    return new, with_loss


def errors_of_step(
    contact: Contact, old: StepRecord, new: StepRecord, dt: Scalar, rtol: Scalar
) -> tuple[Scalar, Scalar]:
    """Return the estimated errors of a step, of its memory and of its energies, over the tolerance.

    Of the memory: half of how far the deformation is from its extrapolation, as much of it as the
    springs forget, over the largest deformation. Of the energies: the imbalance of the work of the
    pressures, storage and dissipation, over the energy exchanged in the step. So the imbalances of
    many steps add up to a part of all that is exchanged, however short the steps are.
    """
    solid: Any = contact.solid
    forgotten = 1 - 1 / solid.stiffening(dt)
    bend = new.memory.strains[0] - old.memory.strains[0] - dt * old.rate
    bent = forgotten * jnp.max(jnp.abs(bend)) / 2

    totals = new.totals
    change = jax.tree.map(jnp.subtract, totals, old.totals)
    exchanged = (jnp.abs(change.work) + jnp.abs(change.stored) + change.viscous_dissipation) / 2
    pressing = contact.area * totals.mean_pressure * totals.mean_gap
    allowed = rtol * jnp.maximum(exchanged, _LEAST_EXCHANGE * new.largest_energy)
    allowed += rounding_of(totals.stored, pressing)

    def over(tolerance: Scalar, error: Scalar) -> Scalar:
        return error / jnp.where(tolerance == 0, 1, tolerance)

    return over(rtol * new.largest_deformation, bent), over(allowed, jnp.abs(new.imbalance))


def _forms(contact: Contact, fields: Sequence[Field], field: Field) -> Float[Array, " fields"]:
    """Return v.K u of several fields v and one u, both relative to the far side [energy]."""
    uniform = finite_or_zero(contact.solid.uniform_stiffness)
    pressure = contact.solid.with_uniform_stiffness(uniform).apply(field)
    forms = jnp.stack([total(v * pressure) for v in fields])
    return contact.grid.cell_area.astype(forms.dtype) * forms


def _gain(x: Float[Array, " springs"]) -> Float[Array, " springs"]:
    """Return the integral of (1 - exp(-x theta))^2 / x over theta in (0, 1)."""
    near = jnp.minimum(x, 1)
    y = jnp.maximum(x, 1)
    # By quadrature for small x, where the closed form loses its digits.
    nodes, weights = np.polynomial.legendre.leggauss(8)
    theta = jnp.asarray(nodes / 2 + 0.5, x.dtype)
    risen = theta * ramp(near[:, None] * theta)
    closed = (1 - (3 - 4 * jnp.exp(-y) + jnp.exp(-2 * y)) / (2 * y)) / y
    return jnp.where(x < 1, near * (risen**2 @ jnp.asarray(weights / 2, x.dtype)), closed)

"""From one given time to the next, in steps that adapt to an estimate of their error."""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.contact import Contact
from jaxstab.core.grid import mean, total
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load, Spring
from jaxstab.paths.energy import own_energy
from jaxstab.paths.evolution.evolution import Totals, or_nan
from jaxstab.paths.evolution.step import (
    Internal,
    load_on,
    moved_contact,
    next_state,
    spring_forms,
    spring_forms_after,
    springs,
)
from jaxstab.paths.record import Table
from jaxstab.potentials import energy_density

# Errors are relative to these parts of the height and energy of the surface before it moves.
_LEAST = 1e-2
# The shortest step, over the interval and over the shortest relaxation time.
_SHORTEST = 1e-6, 1e-2
# How much longer or shorter than the last a step may be.
_GROWTH, _SHRINKAGE, _CAUTION = 4.0, 0.1, 0.9


class Moment(eqx.Module):
    """A state in time, and all that the next step needs.

    These are the rate of the deformation in the last step, v_k.K v_k of each spring, the largest
    deformation and energy exchanged so far, the length of step that the error allows, and how the
    last equilibrium ended.
    """

    internal: Internal
    rate: Field
    forms: Float[Array, " springs"]
    totals: Totals
    scales: Float[Array, "2"]
    dt: Scalar
    result: RESULTS


class Leg(NamedTuple):
    """The way between two given times, along which the load is linear: its number, and both ends.

    Several legs have a leading axis.
    """

    number: Int[Array, "..."]
    times: Float[Array, "... 2"]
    values: Float[Array, "... 2"]


class Step(eqx.Module):
    """A step that was taken: its leg, its ends in parts of that, and the loss of a jump in it."""

    leg: Int[Array, "..."]
    start: Float[Array, "..."]
    end: Float[Array, "..."]
    lost: Float[Array, "..."]


def between(ends: Float[Array, "... 2"], place: Scalar) -> Scalar:
    """Return the time or the value of the load at a part of a leg."""
    return ends[..., 0] + place * (ends[..., 1] - ends[..., 0])


def first_moment(contact: Contact, load: Load, internal: Internal, found: Equilibrium) -> Moment:
    """Return the state at the first time, where nothing has been done yet."""
    zero, heights = jnp.zeros((), contact.heights.dtype), contact.solid.surface(contact.heights)
    forms = spring_forms(contact, internal)
    extent = jnp.max(jnp.abs(heights - jnp.mean(heights)))
    return Moment(
        internal=or_nan(internal, found.result),
        rate=jnp.zeros_like(internal.gap),
        forms=forms,
        totals=_totals(contact, load, internal, found, forms, zero, zero, zero),
        scales=jnp.stack([_LEAST * extent, _LEAST**2 * own_energy(contact)]),
        dt=jnp.full_like(zero, jnp.inf),
        result=found.result,
    )


def stepped(contact: Contact, load: Load, old: Moment, dt: Scalar) -> Moment:
    """Return the state after a step to a load, with its energies."""
    internal, found = next_state(contact, load, old.internal, dt)
    forms, dissipated = spring_forms_after(contact, old.forms, old.internal, internal, dt)
    before = _handle(contact, load, old.internal, old.totals.mean_pressure)
    after = _handle(contact, load, internal, found.mean_pressure)
    # By the trapezoidal rule.
    pressure = (old.totals.mean_pressure + found.mean_pressure) / 2
    work = old.totals.work - contact.area * pressure * (after - before)
    dissipated += old.totals.dissipated
    totals = _totals(contact, load, internal, found, forms, work, dissipated, old.totals.lost)
    extent, exchanged = jnp.max(jnp.abs(internal.strains[0])), jnp.maximum(abs(work), dissipated)
    scales = jnp.maximum(old.scales, jnp.stack([extent, exchanged]))
    rate = (internal.strains[0] - old.internal.strains[0]) / jnp.where(dt > 0, dt, 1)
    return Moment(internal, rate, forms, totals, scales, old.dt, found.result)


def _totals(
    contact: Contact,
    load: Load,
    internal: Internal,
    found: Equilibrium,
    forms: Float[Array, " springs"],
    work: Scalar,
    dissipated: Scalar,
    lost: Scalar,
) -> Totals:
    """Return the scalars of a state; the energy stored is that above zero strain and no law."""
    gap, pressure = internal.gap, found.mean_pressure
    density = energy_density(contact.potential, gap)
    stored = total(density) * contact.grid.cell_area.astype(gap.dtype)
    stored += jnp.sum(springs(contact)[0] * forms) / 2
    if isinstance(load, Spring):
        stored += contact.area * pressure**2 / (2 * load.stiffness.astype(gap.dtype))
    mean_gap, area = jnp.mean(contact.solid.surface(gap)), found.contact_area
    return Totals(mean_gap, pressure, area, stored, work, dissipated, lost)


def _handle(contact: Contact, load: Load, internal: Internal, pressure: Scalar) -> Scalar:
    """Return the place of the far side, or of the far end of a spring [length]."""
    far = mean(internal.gap + contact.heights - internal.strains[0])
    return far - pressure / load.stiffness if isinstance(load, Spring) else far


def with_loss(
    contact: Contact, load: Load, old: Moment, new: Moment, dt: Scalar, has_jumped: Flag
) -> Moment:
    """Return the state after a step with the energy that is lost if it has jumped.

    That is how far the potential falls at one load in one step.
    """

    def fall() -> Scalar:
        moved = moved_contact(contact, old.internal, dt)
        control = moved.control(load_on(moved, contact, load))

        def potential(gap: Field) -> Scalar:
            return moved.energy(gap) + moved.grid.area.astype(gap.dtype) * control.energy(mean(gap))

        return potential(control.restore(old.internal.gap)) - potential(new.internal.gap)

    lost = jnp.maximum(jax.lax.cond(has_jumped, fall, lambda: jnp.zeros_like(dt)), 0)
    totals = replace(new.totals, lost=new.totals.lost + lost)
    # The rate of such a step says nothing of the next one.
    return replace(new, totals=totals, rate=jnp.where(lost > 0, 0, new.rate))


def march(
    contact: Contact, load: Load, rtol: Scalar, moment: Moment, steps: Table, leg: Leg
) -> tuple[Moment, Table]:
    """Return the state at the end of a leg, and the steps up to there with those that led to it."""
    span = leg.times[1] - leg.times[0]
    # Under JAX transformations nothing has refused times that do not increase.
    span = jnp.where(span > 0, span, jnp.nan)
    fastest = springs(contact)[1][1]
    shortest = jnp.minimum(_SHORTEST[0] * span, _SHORTEST[1] * fastest)
    shortest = jnp.maximum(shortest, 8 * jnp.finfo(span.dtype).eps * span)

    def goes_on(state: tuple[Moment, Table, Scalar]) -> Flag:
        moment, steps, place = state
        return (place < 1) & (moment.result == RESULTS.successful) & ~steps.is_full

    def step(state: tuple[Moment, Table, Scalar]) -> tuple[Moment, Table, Scalar]:
        old, steps, place = state
        left = (1 - place) * span
        dt = jnp.minimum(old.dt, left)
        # Two equal steps rather than a long one and a tiny one.
        dt = jnp.where((dt < left) & (2 * dt > left), left / 2, dt)
        end = jnp.where(dt < left, place + dt / span, 1)
        held = load.at(between(leg.values, end))
        new = stepped(contact, held, old, dt)
        is_solved = new.result == RESULTS.successful
        error = _error(contact, old, new, dt) / rtol
        error = jnp.where(is_solved & ~jnp.isnan(error), error, jnp.inf)
        is_smooth = error <= 1
        is_shortest = ~(dt > shortest)
        is_taken = (is_smooth | is_shortest) & is_solved
        factor = jnp.clip(_CAUTION / jnp.sqrt(jnp.maximum(error, 1e-8)), _SHRINKAGE, _GROWTH)
        # The end of a leg cuts a step short, which says nothing of the next one.
        longer = jnp.where(factor >= 1, jnp.maximum(old.dt, dt * factor), dt * factor)
        next_dt = jnp.where(is_smooth, longer, dt * jnp.minimum(factor, 0.5))
        new = with_loss(contact, held, old, new, dt, is_taken & ~is_smooth)
        taken = Step(leg.number, place, end, new.totals.lost - old.totals.lost)
        moment, place = jax.tree.map(partial(jnp.where, is_taken), (new, end), (old, place))
        result = RESULTS.where(is_shortest, new.result, RESULTS.successful)
        moment = replace(moment, dt=jnp.maximum(next_dt, shortest), result=result)
        return moment, steps.with_entry(taken, is_taken), place

    start = moment, steps, jnp.zeros_like(span)
    moment, steps, place = jax.lax.while_loop(goes_on, step, start)
    is_short = (place < 1) & (moment.result == RESULTS.successful)
    result = RESULTS.where(is_short, RESULTS.store_full, moment.result)
    return replace(moment, result=result), steps


def _error(contact: Contact, old: Moment, new: Moment, dt: Scalar) -> Scalar:
    """Return the estimated error of a step.

    Of the memory: half of how far the deformation is from its extrapolation, as much of it as the
    springs forget, over the largest deformation. Of the energies: the imbalance of work, storage
    and dissipation, over the largest energy exchanged.
    """
    solid: Any = contact.solid
    share = 1 - 1 / solid.stiffening(dt)
    bend = new.internal.strains[0] - old.internal.strains[0] - dt * old.rate
    change = jax.tree.map(jnp.subtract, new.totals, old.totals)
    imbalance = change.work - change.stored - change.dissipated
    errors = jnp.abs(jnp.stack([share * jnp.max(jnp.abs(bend)) / 2, imbalance]))
    return jnp.max(errors / jnp.where(new.scales > 0, new.scales, 1))

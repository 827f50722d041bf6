"""From one given time to the next, in steps that adapt to an estimate of their error."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.core.grid import mean
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load, Spring
from jaxstab.paths.energy import own_energy
from jaxstab.paths.evolution.evolution import Totals
from jaxstab.paths.evolution.step import Forms, Internal, Medium
from jaxstab.solids.viscoelastic import ramp

# Of the surface's height and of its energy: what errors are relative to where nothing has moved.
_LEAST = 1e-2
# The shortest step, over the interval and over the shortest relaxation time.
_SHORTEST = 1e-6, 1e-2
# How much longer or shorter than the last a step may be.
_GROWTH, _SHRINKAGE, _CAUTION = 4.0, 0.1, 0.9


class Moment(eqx.Module):
    """A state in time, and all that the next step needs.

    Attributes:
        internal: the memory.
        rate: how fast the deformation changed in the last step [length/time].
        forms: the elastic energies of the branches.
        totals: the scalars.
        energy: all that is stored [energy].
        handle: the place of the far side, or of the far end of a spring [length].
        extent: the largest deformation so far [length].
        exchanged: the largest energy that was exchanged so far [energy].
        dt: the length of step that the error allows [time].
        result: how the last equilibrium ended.
    """

    internal: Internal
    rate: Field
    forms: Forms
    totals: Totals
    energy: Scalar
    handle: Scalar
    extent: Scalar
    exchanged: Scalar
    dt: Scalar
    result: RESULTS


class Leg(eqx.Module):
    """The way between two given times, along which the load is linear.

    Attributes:
        number: which of them it is, from zero.
        start, end: the times [time].
        before, after: the values of the load.
    """

    number: Int[Array, ""]
    start: Scalar
    end: Scalar
    before: Scalar
    after: Scalar

    def value(self, place: Scalar) -> Scalar:
        """Return the value of the load at a part of the way."""
        return self.before + place * (self.after - self.before)


class Steps(eqx.Module):
    """The accepted steps of an evolution, in order, with room for more.

    Attributes:
        legs: the leg of each step.
        starts, ends: where it begins and ends, in parts of its leg.
        lost: the energy lost in a jump in it, zero where there was none [energy].
        number: how many there are.
    """

    legs: Int[Array, " steps"]
    starts: Float[Array, " steps"]
    ends: Float[Array, " steps"]
    lost: Float[Array, " steps"]
    number: Int[Array, ""]

    @classmethod
    def none(cls, room: int, dtype: jnp.dtype) -> "Steps":
        """Return room for a number of steps."""
        zeros = jnp.zeros(room, dtype)
        return cls(jnp.zeros(room, int), zeros, zeros, zeros, jnp.array(0))

    def with_one(self, leg: Array, start: Scalar, end: Scalar, lost: Scalar) -> "Steps":
        """Return the steps and one more."""
        i = self.number
        return Steps(
            self.legs.at[i].set(leg),
            self.starts.at[i].set(start),
            self.ends.at[i].set(end),
            self.lost.at[i].set(lost),
            i + 1,
        )


def first_moment(medium: Medium, load: Load, internal: Internal, found: Equilibrium) -> Moment:
    """Return the state at the first time, where nothing has been done yet."""
    contact, zero = medium.contact, jnp.zeros((), medium.contact.heights.dtype)
    surface = contact.solid.surface
    heights, forms = surface(contact.heights), Forms.of(medium, internal)
    far = mean(internal.gap + contact.heights - internal.deformation)
    handle, spring = _machine(medium, load, far, found)
    mean_gap = jnp.mean(surface(internal.gap))
    return Moment(
        internal=internal,
        rate=jnp.zeros_like(internal.gap),
        forms=forms,
        totals=Totals(mean_gap, found.mean_pressure, found.contact_area, zero, zero, zero, zero),
        energy=forms.energy(medium) + medium.adhesion(internal.gap) + spring,
        handle=handle,
        extent=_LEAST * jnp.max(jnp.abs(heights - jnp.mean(heights))),
        exchanged=_LEAST**2 * own_energy(contact),
        dt=jnp.full_like(zero, jnp.inf),
        result=found.result,
    )


def stepped(medium: Medium, load: Load, old: Moment, dt: Scalar) -> Moment:
    """Return the state after a step to a load, with its energies."""
    internal, found, far = medium.advance(old.internal, load, dt)
    forms, dissipated = old.forms.after(medium, old.internal, internal, dt)
    handle, spring = _machine(medium, load, far, found)
    energy = forms.energy(medium) + medium.adhesion(internal.gap) + spring
    # By the trapezoidal rule.
    pressure = (old.totals.mean_pressure + found.mean_pressure) / 2
    totals = Totals(
        mean_gap=jnp.mean(medium.contact.solid.surface(internal.gap)),
        mean_pressure=found.mean_pressure,
        contact_area=found.contact_area,
        stored=old.totals.stored + energy - old.energy,
        work=old.totals.work - medium.contact.area * pressure * (handle - old.handle),
        dissipated=old.totals.dissipated + dissipated,
        lost=old.totals.lost,
    )
    change = internal.deformation - old.internal.deformation
    exchanged = jnp.maximum(jnp.abs(totals.stored), jnp.abs(totals.work))
    return Moment(
        internal=internal,
        rate=jnp.where(dt > 0, change / jnp.where(dt > 0, dt, 1), 0),
        forms=forms,
        totals=totals,
        energy=energy,
        handle=handle,
        extent=jnp.maximum(old.extent, jnp.max(jnp.abs(internal.deformation))),
        exchanged=jnp.maximum(old.exchanged, exchanged),
        dt=old.dt,
        result=found.result,
    )


def _machine(medium: Medium, load: Load, far: Scalar, found: Equilibrium) -> tuple[Scalar, Scalar]:
    """Return where the load holds the contact [length], and the energy of its spring [energy]."""
    if not isinstance(load, Spring):
        return far, jnp.zeros_like(far)
    pressure, stiffness = found.mean_pressure, load.stiffness.astype(far.dtype)
    energy = medium.contact.area * pressure**2 / (2 * stiffness)
    return far - pressure / stiffness, energy


def march(
    medium: Medium, load: Load, rtol: Scalar, moment: Moment, steps: Steps, leg: Leg
) -> tuple[Moment, Steps]:
    """Return the state at the end of a leg, and the steps up to there with those that led to it."""
    span = leg.end - leg.start
    shortest = jnp.minimum(_SHORTEST[0] * span, _SHORTEST[1] * medium.times[0])
    shortest = jnp.maximum(shortest, 8 * jnp.finfo(span.dtype).eps * span)

    def goes_on(state: tuple[Moment, Steps, Scalar]) -> Flag:
        moment, steps, place = state
        is_solved = moment.result == RESULTS.successful
        return (place < 1) & is_solved & (steps.number < steps.legs.size)

    def step(state: tuple[Moment, Steps, Scalar]) -> tuple[Moment, Steps, Scalar]:
        old, steps, place = state
        left = (1 - place) * span
        dt = jnp.minimum(old.dt, left)
        # Two equal steps rather than a long one and a tiny one.
        dt = jnp.where((dt < left) & (2 * dt > left), left / 2, dt)
        end = jnp.where(dt < left, place + dt / span, 1)
        new = stepped(medium, load.at(leg.value(end)), old, dt)
        is_solved = new.result == RESULTS.successful
        error = _error(medium, old, new, dt) / rtol
        error = jnp.where(is_solved & ~jnp.isnan(error), error, jnp.inf)
        is_smooth = error <= 1
        is_taken = is_smooth | (dt <= shortest)
        factor = jnp.clip(_CAUTION / jnp.sqrt(jnp.maximum(error, 1e-8)), _SHRINKAGE, _GROWTH)
        # The end of a leg cuts a step short, which says nothing of the next one.
        longer = jnp.where(factor >= 1, jnp.maximum(old.dt, dt * factor), dt * factor)
        next_dt = jnp.where(is_smooth, longer, dt * jnp.minimum(factor, 0.5))
        next_dt = jnp.maximum(next_dt, shortest)
        has_jumped = is_taken & ~is_smooth & is_solved
        loss = partial(loss_of, medium, load.at(leg.value(end)), old, new, dt)
        lost = jax.lax.cond(has_jumped, loss, lambda: jnp.zeros_like(dt))
        taken = after_jump(new, lost), steps.with_one(leg.number, place, end, lost), end
        moment, steps, place = jax.tree.map(partial(jnp.where, is_taken), taken, state)
        return replace(moment, dt=next_dt), steps, place

    start = moment, steps, jnp.zeros_like(span)
    moment, steps, place = jax.lax.while_loop(goes_on, step, start)
    is_short = (place < 1) & (moment.result == RESULTS.successful)
    result = RESULTS.where(is_short, RESULTS.store_full, moment.result)
    return replace(moment, result=result), steps


def after_jump(moment: Moment, lost: Scalar) -> Moment:
    """Return a state with the energy that its step has lost in a jump, if any."""
    totals = replace(moment.totals, lost=moment.totals.lost + lost)
    # The rate of such a step says nothing of the next one.
    return replace(moment, totals=totals, rate=jnp.where(lost > 0, 0, moment.rate))


def _error(medium: Medium, old: Moment, new: Moment, dt: Scalar) -> Scalar:
    """Return the estimated error of a step.

    That of the memory: half of how far the deformation is from its extrapolation, as much of it as
    the branches feel, over the largest deformation. That of the energies: the imbalance of work,
    storage and dissipation, over the largest energy exchanged.
    """
    kept = jnp.sum(medium.ratios * ramp(dt, medium.times))
    bend = new.internal.deformation - old.internal.deformation - dt * old.rate
    bend = kept / (1 + kept) * jnp.max(jnp.abs(bend)) / 2
    here, before = new.totals, old.totals
    imbalance = (here.work - before.work) - (here.stored - before.stored)
    imbalance -= here.dissipated - before.dissipated
    scales = jnp.stack([new.extent, new.exchanged])
    errors = jnp.abs(jnp.stack([bend, imbalance]))
    return jnp.max(errors / jnp.where(scales > 0, scales, 1))


def loss_of(medium: Medium, load: Load, old: Moment, new: Moment, dt: Scalar) -> Scalar:
    """Return the energy lost in a jump: how far the potential falls at one load, in one step."""
    moved = medium.moved(old.internal, dt)
    control = moved.control(medium.load_on(moved, load))

    def potential(gap: Field) -> Scalar:
        return moved.energy(gap) + moved.grid.area.astype(gap.dtype) * control.energy(mean(gap))

    fallen = potential(control.restore(old.internal.gap)) - potential(new.internal.gap)
    return jnp.maximum(fallen, 0)

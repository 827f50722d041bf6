"""Steps in time of a viscoelastic contact, each an elastic equilibrium, from one load to the next.

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
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.branches.energy import characteristic_energy, rounding_of
from jaxstab.contact import Contact
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose
from jaxstab.core.grid import mean, total
from jaxstab.core.results import RESULTS
from jaxstab.core.table import Table
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find_equilibrium, with_derivatives
from jaxstab.evolution.evolution import Internal, Totals, moved_contact, on_gap, or_nan
from jaxstab.loads import Load, Spring
from jaxstab.potentials import energy_density
from jaxstab.solids.solid import finite_or_zero
from jaxstab.solids.viscoelastic import ramp

# The error of a step by default. In float32 less is the rounding of equilibria.
RTOL = {"float64": 1e-3, "float32": 1e-2}
# Errors are relative to these parts of the height and energy of the surface before it moves.
_LEAST = 1e-2
# A step exchanges at least this part of the largest energy exchanged so far, as its error counts.
_LEAST_EXCHANGE = 1 / 300
# The shortest step, over the interval and over the shortest relaxation time.
_SHORTEST = 1e-6, 1e-4
# How much longer or shorter than the last a step may be.
_GROWTH = 4.0
_SHRINKAGE = 0.1
_CAUTION = 0.9
_NODES, _WEIGHTS = (values / 2 for values in np.polynomial.legendre.leggauss(8))


class Moment(eqx.Module):
    """A state in time, and all that the next step needs.

    These are the rate of the deformation in the last step, v_k.K v_k of each spring, the largest
    deformation and energy exchanged so far, the work of the pressures in the last step less the
    energy gained, the length of step that the error allows, and how the last equilibrium ended.
    """

    internal: Internal
    rate: Field
    forms: Float[Array, " springs"]
    totals: Totals
    scales: Float[Array, "2"]
    imbalance: Scalar
    dt: Scalar
    result: RESULTS


# The ways between given times count from zero. A step is on one of them, from one part of it to
# another, with the loss of a jump. Before one with a jump stands one of no length.
Step = tuple[Int[Array, "..."], Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]
State = tuple[Moment, Table[Step]]


class Interval(NamedTuple):
    """The way to a given time: its number, and the loads and the times at both ends.

    Before the first time there is none, and both ends are the same.
    """

    number: Int[Array, "..."]
    loads: Float[Array, "... 2"]
    times: Float[Array, "... 2"]


def along(column: Float[Array, " times"], way: Int[Array, "..."] | int, part: Array) -> Array:
    """Return the time or the value of the load at a part of the way between two given times."""
    return column[way] + part * (column[way + 1] - column[way])


@program
def first_moment(contact: Contact, load: Load, memory: Internal, dt: Scalar) -> Moment:
    """Return the state after a step from a memory, where nothing has been done yet."""
    zero = jnp.zeros_like(dt)
    heights = contact.solid.surface(contact.heights)
    extent = jnp.max(jnp.abs(heights - jnp.mean(heights)))
    # A flat surface is not deformed at all, but for rounding.
    extent = jnp.where(extent > 0, extent, contact.profile.range)
    begin = Moment(
        internal=memory,
        rate=jnp.zeros_like(contact.heights),
        forms=jnp.concatenate([_forms(contact, [v], v) for v in memory.strains]),
        totals=Totals(*[zero] * 7),
        scales=jnp.stack([_LEAST * extent, _LEAST**2 * characteristic_energy(contact)]),
        imbalance=zero,
        dt=jnp.full_like(zero, jnp.inf),
        result=RESULTS.successful,
    )
    end, _ = stepped(contact, load, begin, dt)
    totals = replace(end.totals, work=zero, dissipated=zero, lost=zero)
    internal = or_nan(end.internal, end.result)
    return replace(end, internal=internal, rate=begin.rate, totals=totals, scales=begin.scales)


def stepped(
    contact: Contact, load: Load, old: Moment, dt: Scalar
) -> tuple[Moment, Callable[[Flag], Moment]]:
    """Return the state after a step to a load, and the function that adds the loss of a jump.

    Both are differentiable. A dashpot dissipates the work r_k v_k.K w' on its branch less the
    energy stored there: the integral of r_k v_k.K v_k / t_k, in closed form.
    """
    solid: Any = contact.solid
    memory = old.internal
    before = old.totals
    moved = moved_contact(contact, memory, dt)
    load = on_gap(contact, load)
    control = moved.control(load)
    start = memory.gap
    if control.fixes_mean:
        # Full contact opens everywhere at once.
        start = jnp.where(jnp.max(start) > 0, start, 1)
    given = jax.lax.stop_gradient((moved, load, PreconditionedConjugateGradient(), start))
    found = with_derivatives(moved, load, find_equilibrium(*given))
    gap = found.gap
    pressure = found.mean_pressure
    area = contact.area

    # Relative to the far side the mean is mean(p) / K_step(q = 0) - mean(m), or has no memory.
    stiffness = finite_or_zero(moved.solid.uniform_stiffness)
    is_held = stiffness > 0
    level = mean(found.pressure) / jnp.where(is_held, stiffness, 1)
    level = jnp.where(is_held, level - mean(moved.heights - contact.heights), 0)
    displacement = gap + contact.heights
    deformation = displacement - mean(displacement) + level
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
    dissipated = before.dissipated + jnp.sum(ratios * branches)
    # Above zero strain and no law.
    stored = total(energy_density(contact.potential, gap)) * contact.grid.cell_area
    stored = stored.astype(gap.dtype) + jnp.sum(ratios * forms) / 2
    # The far side, or the far end of a spring, moves against the pressure.
    far = mean(gap - memory.gap - change)
    if isinstance(load, Spring):
        compliance = 1 / load.stiffness.astype(gap.dtype)
        far -= compliance * (pressure - before.mean_pressure)
        stored += area * compliance * pressure**2 / 2
    # The work of a smooth step is all that it stores and dissipates, which is known in closed form.
    # From the pressures at both ends alone, by the trapezoidal rule, it would be of second order.
    gained = stored - before.stored + dissipated - before.dissipated
    by_pressure = -area * (before.mean_pressure + pressure) / 2 * far
    work = before.work + gained

    mean_gap = jnp.mean(solid.surface(gap))
    touching = found.contact_area
    largest = jnp.max(jnp.abs(deformation)), jnp.maximum(jnp.abs(work), dissipated)
    new = Moment(
        internal=Internal(gap, strains.at[0].set(deformation)),
        rate=change / jnp.where(dt > 0, dt, 1),
        forms=forms,
        totals=Totals(mean_gap, pressure, touching, stored, work, dissipated, before.lost),
        scales=jnp.maximum(old.scales, jnp.stack(largest)),
        imbalance=by_pressure - gained,
        dt=old.dt,
        result=found.result,
    )

    def potential(gap: Field) -> Scalar:
        return moved.energy(gap) + moved.grid.area.astype(gap.dtype) * control.energy(mean(gap))

    def fall() -> Scalar:
        # At one load, in one step.
        return jnp.maximum(potential(control.restore(start)) - potential(gap), 0)

    def with_loss(has_jumped: Flag) -> Moment:
        lost = jax.lax.cond(has_jumped, fall, lambda: jnp.zeros_like(dt))
        work = jnp.where(has_jumped, before.work + by_pressure, new.totals.work)
        totals = replace(new.totals, work=work, lost=before.lost + lost)
        # The rate of a jump says nothing of the next step.
        return replace(new, totals=totals, rate=jnp.where(lost > 0, 0, new.rate))

    return new, with_loss


def march(
    contact: Contact,
    load: Load,
    rtol: Scalar,
    keeps: Flag | None,
    state: State,
    interval: Interval,
) -> tuple[State, tuple]:
    """Return the state at a given time, from the time before, with all steps, and its row.

    That is of scalars and memory, NaN without a state, the result, and the number of all steps.
    Of the load, all but its value is used.
    """
    Carry = tuple[Moment, Table[Step], Scalar]
    solid: Any = contact.solid
    way = interval.number - 1
    span = interval.times[1] - interval.times[0]
    shortest = jnp.minimum(_SHORTEST[0] * span, _SHORTEST[1] * solid.times[0])
    shortest = jnp.maximum(shortest, 8 * jnp.finfo(span.dtype).eps * span)
    # A jump takes two entries.
    room = len(state[1].rows[0])

    def goes_on(carry: Carry) -> Flag:
        moment, steps, part = carry
        # Under JAX transformations nothing has refused times that do not increase.
        is_open = (part < 1) & (span > 0) & (steps.count + 1 < room)
        return is_open & (moment.result == RESULTS.successful)

    def step(carry: Carry) -> Carry:
        old, steps, part = carry
        left = (1 - part) * span
        dt = jnp.minimum(old.dt, left)
        # Two equal steps rather than a long one and a tiny one.
        dt = jnp.where((dt < left) & (2 * dt > left), left / 2, dt)
        end = jnp.where(dt < left, part + dt / span, 1)
        new, with_loss = stepped(contact, load.at(along(interval.loads, 0, end)), old, dt)
        is_solved = new.result == RESULTS.successful
        errors = _errors(contact, old, new, dt, rtol)
        error = jnp.max(errors)
        error = jnp.where(is_solved & ~jnp.isnan(error), error, jnp.inf)
        is_smooth = error <= 1
        is_shortest = ~(dt > shortest)
        is_taken = (is_smooth | is_shortest) & is_solved
        factor = jnp.clip(_CAUTION / jnp.sqrt(jnp.maximum(error, 1e-8)), _SHRINKAGE, _GROWTH)
        # A given time cuts a step short, which says nothing of the next one.
        longer = jnp.where(factor >= 1, jnp.maximum(old.dt, dt * factor), dt * factor)
        next_dt = jnp.where(is_smooth, longer, dt * jnp.minimum(factor, 0.5))
        # The shortest step may bend much, behind a turn of the load, and lose nothing.
        new = with_loss(is_taken & (errors[1] > 1))
        loss = new.totals.lost - old.totals.lost
        result = RESULTS.where(is_shortest, new.result, RESULTS.successful)
        # A step of no length before a jump moves with it in derivatives.
        pause = way, part, part, jnp.zeros_like(loss)
        steps = steps.with_entry(pause, loss > 0)
        steps = steps.with_entry((way, part, end, loss), is_taken)
        moment, part = choose(is_taken, (new, end), (old, part))
        return replace(moment, dt=jnp.maximum(next_dt, shortest), result=result), steps, part

    start = *state, jnp.where(interval.number > 0, 0, jnp.ones_like(span))
    moment, steps, part = jax.lax.while_loop(goes_on, step, start)
    why = RESULTS.where(span > 0, RESULTS.store_full, RESULTS.unordered_times)
    is_short = (part < 1) & (moment.result == RESULTS.successful)
    result = RESULTS.where(is_short, why, moment.result)
    kept = or_nan((moment.totals, None if keeps is None else moment.internal), result)
    return (replace(moment, result=result), steps), (*kept, result, steps.count)


def _errors(
    contact: Contact, old: Moment, new: Moment, dt: Scalar, rtol: Scalar
) -> Float[Array, "2"]:
    """Return the estimated errors of a step, over the tolerance.

    Of the memory: half of how far the deformation is from its extrapolation, as much of it as the
    springs forget, over the largest deformation. Of the energies: the imbalance of the work of the
    pressures, storage and dissipation, over the energy exchanged in the step. So the imbalances of
    many steps add up to a part of all that is exchanged, however short the steps are.
    """
    solid: Any = contact.solid
    share = 1 - 1 / solid.stiffening(dt)
    bend = new.internal.strains[0] - old.internal.strains[0] - dt * old.rate
    extent, largest = new.scales
    bent = share * jnp.max(jnp.abs(bend)) / 2

    totals = new.totals
    change = jax.tree.map(jnp.subtract, totals, old.totals)
    exchanged = (jnp.abs(change.work) + jnp.abs(change.stored) + change.dissipated) / 2
    pressing = contact.area * totals.mean_pressure * totals.mean_gap
    allowed = rtol * jnp.maximum(exchanged, _LEAST_EXCHANGE * largest)
    allowed += rounding_of(totals.stored, pressing)
    tolerances = jnp.stack([rtol * extent, allowed])
    errors = jnp.stack([bent, jnp.abs(new.imbalance)])
    return errors / jnp.where(tolerances == 0, 1, tolerances)


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
    theta, weights = (jnp.asarray(values, x.dtype) for values in (_NODES + 0.5, _WEIGHTS))
    risen = theta * ramp(near[:, None] * theta)
    closed = (1 - (3 - 4 * jnp.exp(-y) + jnp.exp(-2 * y)) / (2 * y)) / y
    return jnp.where(x < 1, near * (risen**2 @ weights), closed)

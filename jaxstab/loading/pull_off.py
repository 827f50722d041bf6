"""The pull-off: the largest tension that a contact survives as it is unloaded."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxstab.branches.curve import HARDLY_ANY
from jaxstab.branches.differentiable_limit import CriticalLoad, critical_load_at
from jaxstab.branches.limit import Limit, limit_ahead
from jaxstab.contact import Contact, require_contact
from jaxstab.contact.entry import answer
from jaxstab.contact.resolution import FOR_JUMPS, warned_once
from jaxstab.core.checks import scalar_parameter
from jaxstab.core.compile import in_pieces, program
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field, Scalar
from jaxstab.equilibrium import Equilibrium, equilibrate
from jaxstab.equilibrium.equilibrate import initial_gap
from jaxstab.equilibrium.equilibrium import State, single_start
from jaxstab.equilibrium.window import padded_start
from jaxstab.loading.load_path import DISTURBANCE, LoadPath, load_path_of
from jaxstab.loading.load_stepping import step_to_end
from jaxstab.loading.record import Event, Strongest, no_jump
from jaxstab.loads import Load, MeanPressure, Spring

# Only the jump from the largest tension matters.
_SMALLEST_JUMP = 1e-4
_RESOLUTION = {"float64": 1e-9, "float32": 1e-5}
# The largest attraction is known at some gaps only.
_BEYOND = 1.01


def pull_off(
    contact: Contact,
    *,
    initial: ArrayLike | State | None = None,
    spring: ArrayLike | None = None,
    progress: bool | None = None,
    throw: bool = True,
) -> CriticalLoad:
    """Return the largest tension that a contact survives as it is unloaded, and how it ends.

    The contact is followed as by `jaxstab.follow`: unlike `critical_load`, this finds the last
    jump, whatever jumps come before. Under a dead load no state remains. With a machine of finite
    stiffness the contact may survive a jump: the jump from the largest tension counts. If the
    machine is so stiff that tension passes a maximum without a jump, that maximum is larger. Jumps
    that lose about 1e-4 of the problem's characteristic energy may be passed over (`follow`).

    Arguments:
        contact: the contact problem.
        initial: a state in contact to unload from, on this grid or another, at its own mean
            pressure; or a gap, at zero pressure. By default the equilibrium at zero mean pressure.
        spring: the stiffness of a machine in series [pressure/length]; by default a dead load.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        throw: raise an error if there is no pull-off; otherwise look at `result`.

    Returns:
        The last state before the pull-off, located exactly; its load is a `MeanPressure` or a
        `Spring`. `kind` is a fold or a release, and `after` is the state that remains, NaN if there
        is none. It can be differentiated, as in `critical_load`, with respect to contact and
        spring.

    Raises:
        ValueError: for a stiffness that is not one positive number, or a start that is invalid in
            `equilibrate`.
        SolverError: if `throw`, where there is no state to unload from, or it comes apart without
            a jump.
    """
    require_contact(contact)
    machine = None
    if spring is not None:
        machine = Spring(0.0, scalar_parameter(spring, "The stiffness of the spring"))
    with warned_once(contact, FOR_JUMPS):
        pressure, start = _start(jax.lax.stop_gradient(contact), initial)
    padded, start = padded_start(contact, MeanPressure(pressure), start)
    constant = jax.lax.stop_gradient(padded)
    if machine is None:
        load: Load = dead_load(constant, pressure)
    else:
        load = _retraction(constant, pressure, start, machine)
        load.warn_if_soft(contact.solid)
    return answer(
        _search,
        padded,
        load,
        start,
        bar=(100, "%", progress),
        differentiable=_pull_off,
        describe=lambda _: _describe(load),
        throw=throw,
    )


@in_pieces
def _search(contact: Contact, load: Load, start: Field) -> tuple[Limit, Equilibrium]:
    """Return the limit of the branch before the jump from the largest tension, and what remains."""
    resolution = _RESOLUTION[contact.heights.dtype.name]
    load_path = load_path_of(contact, load, _SMALLEST_JUMP, DISTURBANCE, resolution=resolution)
    ended, strongest = step_to_end(load_path, start, no_jump)
    jump = strongest.event
    before, ahead = _before(load_path, jump)
    limit = limit_ahead(contact, before, jump.before.gap, ahead)
    return jax.block_until_ready(_concluded(contact, before, ended.result, strongest, limit))


def _pull_off(contact: Contact, load: Load, end: tuple[Limit, Equilibrium]) -> CriticalLoad:
    limit, after = end
    return replace(critical_load_at(contact, load, limit), after=after)


@program
def _before(load_path: LoadPath, jump: Event) -> tuple[Load, Scalar]:
    """Return the load before a jump, and how far ahead of it the load of the jump lies."""
    return load_path.at(jump.before.value), jump.ahead


@program
def _concluded(
    contact: Contact, load: Load, ended: RESULTS, strongest: Strongest, limit: Limit
) -> tuple[Limit, Equilibrium]:
    result = RESULTS.where(strongest.is_found, limit.result, RESULTS.no_jump)
    result = RESULTS.where(ended == RESULTS.successful, result, ended)
    attracts = contact.profile.max_attraction > 0
    result = RESULTS.where(attracts, result, RESULTS.no_attraction)
    return replace(limit, result=result), strongest.event.state_after(contact, load)


def _start(contact: Contact, initial: ArrayLike | State | None) -> tuple[Scalar, Field]:
    """Return the mean pressure to unload from, and the gap there."""
    if not isinstance(initial, eqx.Module):
        state = equilibrate(contact, MeanPressure(0.0), initial=initial, throw=False)
        return jnp.zeros_like(state.mean_pressure), state.gap
    pressure = single_start(initial).mean_pressure
    gap = initial_gap(contact, MeanPressure(pressure), initial)
    assert gap is not None
    return pressure, gap


@program
def dead_load(contact: Contact, pressure: Scalar) -> MeanPressure:
    """Return the mean pressures from a state's to one that leaves nothing together.

    Without attraction both are the same.
    """
    strongest = contact.profile.max_attraction
    last = jnp.where(strongest > 0, -_BEYOND * strongest, pressure)
    return MeanPressure(jnp.stack([pressure, last]))


@program
def _retraction(contact: Contact, pressure: Scalar, gap: Field, machine: Spring) -> Spring:
    """Return the positions of a spring from a state's to one that leaves nothing together."""
    mean_displacement = jnp.mean(gap) + jnp.mean(contact.heights) + contact.datum
    deepest = _BEYOND * contact.profile.max_attraction
    reach = contact.profile.outermost_gap(HARDLY_ANY * deepest)
    surface = contact.solid.surface(contact.heights)
    spread = jnp.max(surface) - jnp.min(surface)
    # The far side of the solid, where it has one, gives way too.
    control = machine.control(contact.solid, contact.heights)
    give = contact.solid.area_fraction / control.constant
    first = mean_displacement - give * pressure
    last = jnp.where(deepest > 0, mean_displacement + give * deepest + reach + spread, first)
    return Spring(jax.lax.stop_gradient(jnp.stack([first, last])), machine.stiffness)


def _describe(load: Load) -> str:
    first, last = (float(value) for value in jax.lax.stop_gradient(load.value))
    return f"No pull-off found from {type(load).__name__}({first:.6g}) to ({last:.6g})"

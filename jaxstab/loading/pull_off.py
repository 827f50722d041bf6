"""The pull-off: the largest tension that a contact survives as it is unloaded."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxstab.branches.differentiable_limit import CriticalLoad, critical_load_at
from jaxstab.branches.limit import Limit, limit_ahead
from jaxstab.contact import Contact, require_contact, require_elastic
from jaxstab.contact.resolution import FOR_JUMPS, warned_once
from jaxstab.core.accuracy import EQUILIBRIUM
from jaxstab.core.checks import scalar_parameter
from jaxstab.core.compile import in_pieces, own_conventions, program
from jaxstab.core.control_flow import cond
from jaxstab.core.grid import mean
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import nothing_like
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium, equilibrate
from jaxstab.equilibrium.equilibrium import single_start
from jaxstab.equilibrium.posing import finish, pose, posed_gap
from jaxstab.equilibrium.start import Initial, given_gap
from jaxstab.loading.event import Event
from jaxstab.loading.load_path import DISTURBANCE, load_path_of
from jaxstab.loading.load_stepping import step_to_end
from jaxstab.loads import Load, MeanPressure, Spring
from jaxstab.potentials.profile import HARDLY_ANY
from jaxstab.states.point import PathPoint
from jaxstab.states.record import Record

# Only the jump from the largest tension matters.
_SMALLEST_JUMP = 1e-4
# The largest attraction is known at some gaps only.
_BEYOND = 1.01


def pull_off(
    contact: Contact,
    *,
    initial: Initial = None,
    spring: ArrayLike | None = None,
    progress: bool | None = None,
    throw: bool = True,
) -> CriticalLoad:
    """Return the largest tension that a contact survives as it is unloaded, and how it ends.

    The contact is followed as by `jaxstab.follow`: unlike `critical_load`, this finds the jump from
    the largest tension, whatever jumps come before. Under a dead load no state remains. With a
    machine of finite stiffness the contact may survive that jump. If the machine is so stiff that
    tension passes a maximum without a jump, that maximum is larger. Jumps that lose about 1e-4 of
    the problem's characteristic energy may be passed over (`follow`).

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

    Example:
        >>> pull = js.pull_off(contact)
        >>> f"{pull.load.value:.4f} {pull.kind}"
        '-0.1770 release'
    """
    require_contact(contact)
    require_elastic(contact, "pull_off")
    machine = None
    if spring is not None:
        machine = Spring(0.0, scalar_parameter(spring, "The stiffness of the spring"))
    with warned_once(contact, FOR_JUMPS):
        first, gap = _start(jax.lax.stop_gradient(contact), initial)
    problem = pose(contact, first)
    here, first = jax.lax.stop_gradient((problem.contact, problem.load))
    start = posed_gap(here, first, gap)
    if machine is None:
        load: Load = dead_load(here, first.value)
    else:
        machine.warn_if_soft(contact.solid)
        load = _retraction(here, first.value, start, machine, problem.unit)
    constants = jax.lax.stop_gradient((here, load, start))
    with own_conventions():
        with progress_bar("pull-off", 100, "%", shown=progress, inputs=constants):
            limit, after = _search(*constants)
        end = critical_load_at(problem.contact, load, limit)

    def describe(_: CriticalLoad) -> str:
        loads = load.in_units_of(1 / problem.unit)
        first, last = (float(value) for value in jax.lax.stop_gradient(loads.value))
        return f"No pull-off found from {type(loads).__name__}({first:.6g}) to ({last:.6g})"

    return finish(replace(end, after=after), problem, describe, throw)


class _Strongest(eqx.Module):
    """Of all jumps the first from the largest tension: a store that keeps no states.

    Attributes:
        event: the jump, NaN where there is none.
        tension: the tension before it [pressure], -inf where there is none.
    """

    event: Event
    tension: Scalar

    @property
    def is_found(self) -> Flag:
        """Whether there is one."""
        return self.tension > -jnp.inf

    @property
    def is_full(self) -> bool:
        """Whether there is no room: there always is."""
        return False

    def append(self, _: object, record: Record[PathPoint, Event]) -> _Strongest:
        """Return the stronger one of this and the jump of a step, if there is one."""
        event = record.event

        def stronger() -> _Strongest:
            tension, is_stronger = _compare_tensions(self.tension, event.before.mean_pressure)
            return cond(is_stronger, lambda: _Strongest(event, tension), lambda: self)

        return cond(event.is_jump, stronger, lambda: self)


@program
def _no_jump(like: Record[PathPoint, Event]) -> _Strongest:
    """Return that there is no jump as yet, of records like one, and no state after it."""
    event = jax.tree.map(nothing_like, like.event)
    event = replace(event, is_pulled=jnp.array(True))
    return _Strongest(event, jnp.full_like(like.event.dissipation, -jnp.inf))


@program
def _compare_tensions(largest: Scalar, mean_pressure: Scalar) -> tuple[Scalar, Flag]:
    """Return the tension of a mean pressure, and whether it is larger than another one."""
    return -mean_pressure, -mean_pressure > largest


@in_pieces
def _search(contact: Contact, load: Load, start: Field) -> tuple[Limit, Equilibrium]:
    """Return the limit of the branch before the jump from the largest tension, and what remains."""
    resolution = EQUILIBRIUM[contact.heights.dtype.name]
    load_path = load_path_of(contact, load, _SMALLEST_JUMP, DISTURBANCE, resolution=resolution)
    ended, strongest = step_to_end(load_path, start, _no_jump)
    jump = strongest.event
    before = load_path.at(jump.before.value)
    limit = limit_ahead(contact, before, jump.before.gap, jump.ahead)
    limit = replace(limit, result=_result(contact, ended.result, strongest, limit))
    return jax.block_until_ready((limit, jump.equilibrium_after(contact, before)))


@program
def _result(contact: Contact, ended: RESULTS, strongest: _Strongest, limit: Limit) -> RESULTS:
    """Return how the search ended, given how load stepping did."""
    result = RESULTS.where(strongest.is_found, limit.result, RESULTS.no_jump)
    result = RESULTS.where(ended == RESULTS.successful, result, ended)
    attracts = contact.profile.max_attraction > 0
    return RESULTS.where(attracts, result, RESULTS.no_attraction)


def _start(contact: Contact, initial: Initial) -> tuple[MeanPressure, Field]:
    """Return the mean pressure to unload from, and the gap of the surface there."""
    if isinstance(initial, eqx.Module):
        load = MeanPressure(single_start(initial).mean_pressure)
        return load, given_gap(contact, load, initial)
    state = equilibrate(contact, MeanPressure(0.0), initial=initial, throw=False)
    return MeanPressure(jnp.zeros_like(state.mean_pressure)), state.gap


@program
def dead_load(contact: Contact, pressure: Scalar) -> MeanPressure:
    """Return the mean pressures from a state's to one that leaves nothing together.

    Without attraction both are the same.
    """
    strongest = contact.profile.max_attraction
    last = jnp.where(strongest > 0, -_BEYOND * strongest, pressure)
    return MeanPressure(jnp.stack([pressure, last]))


@program
def _retraction(
    contact: Contact, pressure: Scalar, gap: Field, machine: Spring, unit: Scalar
) -> Spring:
    """Return the positions of a spring from a state's to one that leaves nothing together.

    The stiffness of the machine is given in the unit of the user, all else in this unit.
    """
    machine = machine.in_units_of(unit)
    mean_displacement = mean(gap + contact.heights, contact.solid.punch) + contact.datum
    deepest = _BEYOND * contact.profile.max_attraction
    reach = contact.profile.outermost_gap(HARDLY_ANY * deepest)
    surface = contact.solid.surface(contact.heights)
    spread = jnp.max(surface) - jnp.min(surface)
    # The far side of the solid, where it has one, gives way too.
    control = machine.control(contact.solid, contact.heights)
    give = contact.solid.mean_over_grid(1 / control.constant)
    first = mean_displacement - give * pressure
    last = jnp.where(deepest > 0, mean_displacement + give * deepest + reach + spread, first)
    return Spring(jax.lax.stop_gradient(jnp.stack([first, last])), machine.stiffness)

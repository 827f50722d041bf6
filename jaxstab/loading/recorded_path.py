"""The path that load stepping has recorded, its jumps explained and its work accounted for."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxstab.branches.barrier_law import BarrierLaw, barrier_law
from jaxstab.branches.limit import Limit, limit_ahead
from jaxstab.contact import Contact
from jaxstab.core.accuracy import rounding_of_numbers
from jaxstab.core.compile import in_pieces, program
from jaxstab.core.control_flow import by_entries, cond
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import first_entries
from jaxstab.core.types import Field, Scalar
from jaxstab.loading.event import Event, load_on_indented, no_event
from jaxstab.loading.jump_detection import PathSearch
from jaxstab.loading.load_path import LoadPath
from jaxstab.loading.load_stepping import step_to_end
from jaxstab.loading.path import Jump, Path
from jaxstab.loads import Load
from jaxstab.states.kinds import KINDS
from jaxstab.states.point import PathPoint, states_along
from jaxstab.states.record import Record, RecordList, Room


def with_jump(load_path: LoadPath, record: Record) -> Record:
    """Return the record of a step, its event as a `Jump`; known outside of a trace."""
    if not record.is_event:
        return record
    jump = _jump(load_path.contact, load_path.load, record.event)
    return replace(record, event=jax.block_until_ready(jump))


@program
@by_entries
def path_with_room(room: Room, load_path: LoadPath, start: Field) -> Path:
    """Return the path of a contact along a load path, within a program.

    Only the first entries are of states, and of jumps, as many as it has recorded. The jumps are
    explained at the end: in the loop a batch would do so at each step of each path.
    """
    contact = load_path.contact
    load = load_path.load
    ended, tables = step_to_end(load_path, start, room)
    is_short = ended.goes_on(load)
    result = RESULTS.where(is_short, RESULTS.store_full, ended.result)
    path = _path(load_path, ended.here, tables.last, result, tables.states.rows)
    return replace(path, jumps=jax.lax.map(partial(_jump, contact, load), tables.events.rows))


def path_of(
    load_path: LoadPath, recording: RecordList[PathSearch, PathPoint, Jump], result: RESULTS
) -> Path:
    """Return the path of a recording, and how it ended."""
    search = recording.search

    def no_jump() -> Jump:
        return _jump(load_path.contact, load_path.load, no_event(search.here))

    points, jumps = recording.rows(jax.eval_shape(no_jump))
    number = len(recording.states)
    path = _path(load_path, search.here, recording.last, result, recording.table())
    load, states = (first_entries(part, number) for part in (path.load, path.equilibrium))
    if recording.fields:
        states = replace(states, gap=points.gap, indentation=points.indentation)
    else:
        states = replace(states, gap=None, indentation=None)
    return replace(path, load=load, equilibrium=states, jumps=jumps)


@in_pieces
def _jump(contact: Contact, loads: Load, event: Event) -> Jump:
    """Return a jump with the end of the branch that it leaves."""
    load = loads[0].at(event.before.value)

    def explain() -> tuple[KINDS, Field, BarrierLaw]:
        # The branch of the surface as it is before the jump, which yields no further.
        as_it_is = contact.after(event.before).elastic
        here = load_on_indented(load, event.before)
        return _explanation(as_it_is, limit_ahead(as_it_is, here, event.before.gap, event.ahead))

    kind, mode, law = cond(event.is_jump, explain, lambda: _no_explanation(load, event))
    return Jump(
        load=load,
        kind=kind,
        before=event.equilibrium_before(contact, load),
        after=event.equilibrium_after(contact, load),
        mode=mode,
        dissipation=event.dissipation,
        plastic_work=event.plastic_work,
        state=event.state,
        barrier_law=law,
    )


@program
def _explanation(contact: Contact, limit: Limit) -> tuple[KINDS, Field, BarrierLaw]:
    where = limit.load, limit.gap, limit.kind, limit.mode, limit.point
    return limit.kind, limit.mode, barrier_law(contact, *where)


@program
def _no_explanation(load: Load, event: Event) -> tuple[KINDS, Field, BarrierLaw]:
    gap = event.before.gap
    nan = jnp.full((), jnp.nan, gap.dtype)
    law = BarrierLaw(nan, nan, nan, load.unit)
    return KINDS.where(event.is_touch, KINDS.touch, KINDS.fold), jnp.full_like(gap, nan), law


@program
def _path(
    load_path: LoadPath, here: PathPoint, last: PathPoint, result: RESULTS, points: PathPoint
) -> Path:
    """Return the path through points to its last state, without its jumps."""
    contact = load_path.contact
    is_branch = (jnp.diff(points.dissipation) == 0) & jnp.isfinite(points.value[1:])
    unlocated, error = unlocated_loss(points, is_branch)
    # Steps are taken whose work is no better known. Where F has a kink, as where a soft machine
    # comes into contact, parabolas do not tell.
    tolerance = load_path.smallest_loss(here)
    error = jnp.where(jnp.isnan(tolerance), error, jnp.maximum(error, tolerance))
    # The sum of many terms, each as large as the energies, is rounded.
    rounding = jnp.sum(jnp.where(is_branch, points.rounding(contact.area)[1:], 0))
    gains = (result == RESULTS.successful) & (unlocated < -error - rounding)
    loads, states = states_along(contact, load_path.load[0], points)
    none: Any = None
    work = here.stored - points.stored[0] + here.dissipation
    plastic_work = None
    if here.plastic_work is not None and points.plastic_work is not None:
        plastic_work = here.plastic_work - points.plastic_work[0]
        work = work + plastic_work
    return Path(
        load=loads,
        equilibrium=states,
        jumps=none,
        work=work,
        dissipation=here.dissipation,
        result=RESULTS.where(gains, RESULTS.unbalanced_work, result),
        unlocated=unlocated,
        unlocated_error=error,
        last_gap=last.gap,
        last_indentation=last.indentation,
        plastic_work=plastic_work,
    )


def unlocated_loss(points: PathPoint, is_branch: Bool[Array, " steps"]) -> tuple[Scalar, Scalar]:
    """Return the loss of steps along branches, and the error of the quadrature of their work.

    On each step F is the mean of the two parabolas through its ends and the state before, or the
    one after. Half of the difference of their integrals is the error; where there is only one of
    them, all that it takes from the trapezoid.
    """
    force = points.force
    increments = jnp.diff(points.value)
    rounding = rounding_of_numbers(increments.dtype) * jnp.nanmax(jnp.abs(points.value))
    is_long = jnp.abs(increments) > rounding
    secants = jnp.diff(force) / jnp.where(increments == 0, 1, increments)
    secants = jnp.where(is_long, secants, 0)
    # Parabolas through three states, where these lie on one branch, in the order of their loads,
    # and apart. The integral of c (l - a) (l - b) from a to b is -c (b - a)^3 / 6.
    has_parabola = is_branch[1:] & is_branch[:-1] & (increments[1:] * increments[:-1] > 0)
    has_parabola &= is_long[1:] & is_long[:-1]
    spans = increments[1:] + increments[:-1]
    coefficients = jnp.diff(secants) / jnp.where(spans == 0, 1, spans)
    coefficients = jnp.where(has_parabola, coefficients, 0)
    with_before = jnp.pad(coefficients, (1, 0))
    with_after = jnp.pad(coefficients, (0, 1))
    num_parabolas = jnp.pad(has_parabola, (1, 0)).astype(int) + jnp.pad(has_parabola, (0, 1))
    cubes = increments**3 / 6
    trapezoids = increments * (force[1:] + force[:-1]) / 2
    work = trapezoids - cubes * (with_before + with_after) / jnp.maximum(num_parabolas, 1)
    error = jnp.where(num_parabolas == 2, (with_before - with_after) / 2, with_before + with_after)
    error = jnp.where(num_parabolas == 0, secants * increments**2 / 2, cubes * error)
    lost = jnp.sum(jnp.where(is_branch, work - jnp.diff(points.potential), 0))
    # NaN of a path without a state.
    begun = points.dissipation[0]
    return begun + lost, begun + jnp.sum(jnp.where(is_branch, jnp.abs(error), 0))

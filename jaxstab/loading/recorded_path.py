"""The path that load stepping has recorded, its jumps explained and its work accounted for."""

from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxstab.branches.barrier_law import BarrierLaw, barrier_law
from jaxstab.branches.limit import Limit, limit_ahead
from jaxstab.branches.morse_index import lowest_pair, no_modes
from jaxstab.contact import Contact
from jaxstab.core.accuracy import EQUILIBRIUM, rounding_of_numbers
from jaxstab.core.compile import in_pieces, program
from jaxstab.core.control_flow import by_entries, choose, cond
from jaxstab.core.grid import mean, total
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import first_entries
from jaxstab.core.types import Field, Mask, Scalar
from jaxstab.loading.event import Event, load_on_indented, no_event
from jaxstab.loading.jump_detection import PathSearch
from jaxstab.loading.load_path import LoadPath
from jaxstab.loading.load_stepping import step_to_end
from jaxstab.loading.path import Jump, Path
from jaxstab.loads import Load
from jaxstab.potentials.varying import Scaled, Yielding
from jaxstab.stability.assess import AT_HARDNESS
from jaxstab.stability.eigenpair import Eigenpair
from jaxstab.states.kinds import KINDS
from jaxstab.states.point import PathPoint, states_along
from jaxstab.states.record import Record, RecordList, Room

# A branch of no known end may be that of a point whose pressure is below H by less than this part.
_ABOUT_TO_YIELD = 1e-3


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
        gap = event.before.gap
        if contact.hardness is None:
            return _explanation(contact, limit_ahead(contact, load, gap, event.ahead))
        branch = _yielding_branch(contact, load, event.before, jnp.zeros_like(gap, bool))
        limit = limit_ahead(*branch, event.ahead)
        point = _next_to_yield(contact, branch[0], limit)
        after = _yielding_branch(contact, load, event.before, point)
        pair = lowest_pair(*after, after[2], no_modes(gap), EQUILIBRIUM[gap.dtype.name])
        return _or_yielding(_explanation(branch[0], limit), point, pair)

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
def _yielding_branch(
    contact: Contact, load: Load, before: PathPoint, point: Mask
) -> tuple[Contact, Load, Field]:
    """Return the branch of a surface that yields on where its pressure is H, as a contact.

    There, and at a point about to, it bears H whatever its displacement, as points out of contact
    do by a law that repels by H at every gap: so these lie lower by about the height of the
    surface. The others are those of the surface as it is before a jump.
    """
    left = contact.after(before)
    load = load_on_indented(load, before)
    gap = before.gap
    hardness = left.hardness
    largest = left.largest_reaction
    potential = left.potential
    assert hardness is not None and largest is not None and isinstance(potential, Scaled)
    net = left.control(load).net_pressure(left.gradient(gap), gap)
    yields = (gap == 0) & (net >= (1 - AT_HARDNESS) * largest) | point
    # An infinite hardness, where nothing yields, is no number to be multiplied by zero.
    law = Yielding(potential.law, yields, jnp.where(yields, hardness / potential.factor, 0))
    height = jnp.max(left.heights) - jnp.min(left.heights) + jnp.max(gap)
    depth = jnp.where(yields, height, 0)
    branch = left.elastic.with_indentation(depth)
    branch = eqx.tree_at(lambda contact: contact.potential.law, branch, law)
    return branch, load.after_indentation(mean(depth)), gap + depth


@program
def _next_to_yield(contact: Contact, branch: Contact, limit: Limit) -> Mask:
    """Return the contact point that reaches H first, if one does before the limit of a branch."""
    gap = limit.gap
    largest = contact.largest_reaction
    assert largest is not None
    net = branch.control(limit.load).net_pressure(branch.gradient(gap), gap)
    share = jnp.where(gap == 0, net / largest, 0)
    least = jnp.where(limit.kind == KINDS.uncertain, 1 - _ABOUT_TO_YIELD, 1)
    is_first = jnp.arange(share.size).reshape(share.shape) == jnp.argmax(share)
    return is_first & (jnp.max(share) > least)


@program
def _or_yielding(
    explanation: tuple[KINDS, Field, BarrierLaw], point: Mask, pair: Eigenpair
) -> tuple[KINDS, Field, BarrierLaw]:
    """Return an explanation, or where a point has yielded before, with its lowest eigenpair, that.

    The point then goes down along the mode.
    """
    kind, mode, law = explanation
    is_before = jnp.any(point)
    ends = is_before & (pair.eigenvalue < -pair.error)
    kind = KINDS.where(is_before, KINDS.uncertain, kind)
    downward = -jnp.sign(total(jnp.where(point, pair.mode, 0))) * pair.mode
    unknown = jax.tree.map(lambda number: jnp.full_like(number, jnp.nan), law)
    law = choose(is_before, unknown, law)
    return KINDS.where(ends, KINDS.yielding, kind), jnp.where(ends, downward, mode), law


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
    them, all that it takes from the trapezoid. On a surface that yields F has a kink wherever a
    point begins to: the error is all that both take, which is no less than that of a single kink.
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
    taken = (with_before + with_after) / jnp.maximum(num_parabolas, 1)
    work = trapezoids - cubes * taken
    error = jnp.where(num_parabolas == 2, (with_before - with_after) / 2, with_before + with_after)
    if points.plastic_work is not None:
        error = taken
    error = jnp.where(num_parabolas == 0, secants * increments**2 / 2, cubes * error)
    lost = jnp.sum(jnp.where(is_branch, work - jnp.diff(points.potential), 0))
    # NaN of a path without a state.
    begun = points.dissipation[0]
    return begun + lost, begun + jnp.sum(jnp.where(is_branch, jnp.abs(error), 0))

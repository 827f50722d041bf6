"""The path that load stepping has recorded, its jumps explained and its work accounted for."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxstab.contact import Contact
from jaxstab.core.compile import in_pieces, program
from jaxstab.core.control_flow import by_entries, cond
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import first_entries, stacked
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.loads import Load
from jaxstab.paths.barrier_law import BarrierLaw, barrier_law
from jaxstab.paths.curve.limit import Limit, limit_ahead
from jaxstab.paths.jump_detection import Progress
from jaxstab.paths.kinds import KINDS
from jaxstab.paths.path import Jump, Path
from jaxstab.paths.record import Event, PathPoint, Tables, states_along

# Tables of states have multiples of this size, so that one program serves many lengths.
_ROOM = 1024


class Recording:
    """All states and jumps of load stepping, taken out of its tables from time to time.

    Jumps are looked at one by one: any number of them needs one program, and no more memory than
    they take.

    Attributes:
        contact: the contact, in its characteristic units.
        load: the turning points.
        progress: how far it has come, with empty tables; None before its first state.
        points: the parts of the table of states.
        events: the jumps, as they were detected.
        jumps: the jumps with the ends of their branches, as far as these are located.
    """

    def __init__(self, contact: Contact, load: Load) -> None:
        self.contact, self.load = contact, load
        self.progress: Any = None
        self.points: list[PathPoint] = []
        self.events: list[Event] = []
        self.jumps: list[Jump] = []

    def emptied(self, progress: Progress[Tables]) -> Progress[Tables]:
        """Return the progress with empty tables, whose states and jumps are taken out."""
        events = progress.records.jumps.entries()
        for i in range(len(events.state)):
            self.events.append(jax.tree.map(lambda leaf, i=i: leaf[i], events))
        self.points.append(progress.records.states.entries())
        self.progress = replace(progress, records=progress.records.emptied())
        self.locate_ends()
        return self.progress

    def locate_ends(self) -> None:
        """Locate the ends of the branches at the jumps since the last time."""
        for event in self.events[len(self.jumps) :]:
            jump = _jump_alone(self.contact, self.load[0], event)
            self.jumps.append(jax.block_until_ready(jump))


@program
@by_entries
def path_with_room(progress: Progress[Tables], contact: Contact, load: Load) -> Path:
    """Return the path of a contact along a load path.

    Only the first entries are of states, and of jumps, as many as it has recorded.
    """
    jumps = jax.lax.map(partial(_jump, contact, load[0]), progress.records.jumps.rows)
    return _path(progress, progress.records.states.rows, contact, load[0], jumps)


def path_of(record: Recording) -> Path:
    """Return the path as `path_with_room` does, from the states and jumps taken out on the way."""
    contact, one, progress = record.contact, record.load[0], record.progress
    number = int(progress.num_states)
    none = jax.tree.map(lambda leaf: leaf[0], progress.records.jumps.rows)
    record.locate_ends()
    jumps = record.jumps
    like = jumps[0] if jumps else jax.eval_shape(_jump_alone, contact, one, none)
    room = _ROOM * max(-(-number // _ROOM), 1)

    def padded(*parts: np.ndarray) -> np.ndarray:
        # Fields, if there are any, are not needed.
        rows = np.concatenate(parts) if parts[0].ndim == 1 else np.zeros((room, 0))
        rest = np.full((room - len(rows), *rows.shape[1:]), np.nan, rows.dtype)
        return np.concatenate([rows, rest])

    path = _path_alone(progress, jax.tree.map(padded, *record.points), contact, one)
    load, states = (first_entries(part, number) for part in (path.load, path.equilibrium))
    gaps = np.concatenate([part.gap for part in record.points])
    states = replace(states, gap=jax.device_put(gaps) if gaps.size else None)
    return replace(path, load=load, equilibrium=states, jumps=stacked(jumps, like))


def _jump(contact: Contact, one: Load, event: Event) -> Jump:
    load, is_end = _load_before(one, event)

    def explained() -> tuple[KINDS, Field, BarrierLaw]:
        return _explained(contact, limit_ahead(contact, load, event.before.gap, event.ahead))

    kind, mode, law = cond(is_end, explained, lambda: _unexplained(load, event))
    return _jump_of(contact, load, event, kind, mode, law)


@program
def _load_before(one: Load, event: Event) -> tuple[Load, Flag]:
    """Return the load before a jump, and whether the jump is the end of a branch."""
    value = event.before.value
    return one.at(value), jnp.isfinite(value) & ~event.is_touch


@program
def _explained(contact: Contact, limit: Limit) -> tuple[KINDS, Field, BarrierLaw]:
    where = limit.load, limit.gap, limit.kind, limit.mode, limit.point
    return limit.kind, limit.mode, barrier_law(contact, *where)


@program
def _unexplained(load: Load, event: Event) -> tuple[KINDS, Field, BarrierLaw]:
    gap = event.before.gap
    nan = jnp.full((), jnp.nan, gap.dtype)
    return KINDS.fold, jnp.full_like(gap, nan), BarrierLaw(nan, nan, load.unit)


@program
def _jump_of(
    contact: Contact, load: Load, event: Event, kind: KINDS, mode: Field, law: BarrierLaw
) -> Jump:
    return Jump(
        load=load,
        kind=KINDS.where(event.is_touch, KINDS.touch, kind),
        before=event.state_before(contact, load),
        after=event.state_after(contact, load),
        mode=mode,
        dissipation=event.dissipation,
        state=event.state,
        barrier_law=law,
    )


def _path(
    progress: Progress[Tables], points: PathPoint, contact: Contact, one: Load, jumps: Any = None
) -> Path:
    """Return the path through points, with jumps if they are given."""
    is_branch = (jnp.diff(points.dissipation) == 0) & jnp.isfinite(points.value[1:])
    unlocated, error = _unlocated_loss(points, is_branch)
    # The sum of many terms, each as large as the energies, is rounded.
    rounding = jnp.sum(jnp.where(is_branch, points.rounding(contact.area)[1:], 0))
    gains = (progress.result == RESULTS.successful) & (unlocated < -error - rounding)
    load, states = states_along(contact, one, points)
    return Path(
        load=load,
        equilibrium=states,
        jumps=jumps,
        work=progress.here.stored - points.stored[0] + progress.here.dissipation,
        dissipation=progress.here.dissipation,
        result=RESULTS.where(gains, RESULTS.unbalanced_work, progress.result),
        unlocated=unlocated,
        unlocated_error=error,
        last_gap=progress.gap,
    )


_jump_alone = in_pieces(_jump)
_path_alone = program(_path)


def _unlocated_loss(points: PathPoint, is_branch: Bool[Array, " steps"]) -> tuple[Scalar, Scalar]:
    """Return the loss of steps along branches, and the error of the quadrature of their work.

    On each step F is the mean of the two parabolas through its ends and the state before, or the
    one after. Half of the difference of their integrals is the error; where there is only one of
    them, all that it takes from the trapezoid.
    """
    step, force = jnp.diff(points.value), points.force
    slope = jnp.diff(force) / jnp.where(step == 0, 1, step)
    pair = step[1:] + step[:-1]
    # Through three states, where these lie on one branch and in the order of their loads.
    is_known = is_branch[1:] & is_branch[:-1] & (step[1:] * step[:-1] > 0)
    turn = jnp.where(is_known, jnp.diff(slope) / jnp.where(pair == 0, 1, pair), 0)
    before, after = jnp.pad(turn, (1, 0)), jnp.pad(turn, (0, 1))
    number = jnp.pad(is_known, (1, 0)).astype(int) + jnp.pad(is_known, (0, 1))
    cubes = step**3 / 6
    work = step * (force[1:] + force[:-1]) / 2 - cubes * (before + after) / jnp.maximum(number, 1)
    error = jnp.where(number == 2, (before - after) / 2, before + after)
    error = jnp.where(number == 0, slope * step**2 / 2, cubes * error)
    lost = jnp.sum(jnp.where(is_branch, work - jnp.diff(points.potential), 0))
    return lost, jnp.sum(jnp.where(is_branch, jnp.abs(error), 0))

"""Load stepping along a load path, through jumps."""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, Self, TypeVar

import jax.numpy as jnp
import numpy as np

from jaxstab.core.checks import concrete
from jaxstab.core.compile import program
from jaxstab.core.control_flow import while_loop
from jaxstab.core.progress import advance_to
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag
from jaxstab.equilibrium import Equilibrium
from jaxstab.loading.jump_detection import (
    Bisection,
    Progress,
    apply_step,
    next_step,
)
from jaxstab.loading.load_path import LoadPath, Start
from jaxstab.loading.record import Event, Record
from jaxstab.loads import Load
from jaxstab.states.point import point_of


class _Records(Protocol):
    @property
    def is_full(self) -> Flag | bool: ...
    def append(self, record: Record) -> Self: ...


Records = TypeVar("Records", bound=_Records)


def step_to_end(
    load_path: LoadPath, start: Field, empty: Callable[[Record], Records]
) -> tuple[Progress, Records]:
    """Return the progress at the end of a load path, or where the records are full, and these.

    1. Find the first equilibrium, from a gap if one is given.
    2. Predict the next state, and find the equilibrium at its load.
    3. Judge the step to it, and append what it has recorded.

    Arguments:
        load_path: the load path.
        start: a gap to start from, or None.
        empty: returns empty records for records like one.
    """
    first = _first_start(load_path, start).equilibrium(load_path.contact)
    progress, record = _first_state(load_path, first)
    records = empty(record).append(record)

    def goes_on(state: tuple[Progress, Records]) -> Flag:
        progress, records = state
        return progress.is_open(load_path.load) & ~concrete(records.is_full)

    def step(state: tuple[Progress, Records]) -> tuple[Progress, Records]:
        progress, records = state
        trial = next_step(load_path, progress)
        found = trial.start.equilibrium(load_path.contact)
        progress, record = apply_step(load_path, progress, trial, found)
        advance_to(lambda: int(100 * fraction_done(load_path.load, record)))
        return progress, records.append(record)

    return while_loop(goes_on, step, (progress, records))


@program
def _first_start(load_path: LoadPath, start: Field) -> Start:
    value = load_path.load.value[0]
    return load_path.start_at(value, start)


@program
def _first_state(load_path: LoadPath, found: Equilibrium) -> tuple[Progress, Record]:
    """Return the progress at the first turning point, and its record."""
    turns = load_path.load.value
    none = jnp.array(0)
    here = point_of(load_path.contact, found, turns[0])
    # Of a path without a state no loss is known.
    lost = jnp.where(found.result == RESULTS.successful, here.dissipation, jnp.nan)
    here = replace(here, dissipation=lost)
    span = jnp.max(turns) - jnp.min(turns)
    zero = jnp.zeros_like(span)
    is_passable = jnp.isfinite(span) & (load_path.resolution > 0)
    # Towards a load that is no number, or from zero to zero, no step would ever end.
    is_endless = (found.result == RESULTS.successful) & ~is_passable
    result = RESULTS.where(is_endless, RESULTS.infeasible_load, found.result)
    yes = jnp.array(True)
    no = jnp.array(False)
    progress = Progress(
        here=here,
        last=here,
        next_length=load_path.first_step,
        bisection=Bisection(zero + jnp.inf, zero, load_path.resolution),
        leg=none,
        is_apart=no,
        last_state=none,
        result=result,
    )
    nothing = Event(
        before=here,
        after=here,
        ahead=zero,
        dissipation=zero,
        state=none,
        is_jump=no,
        is_pulled=no,
        is_touch=no,
    )
    return progress, Record(here, yes, nothing, no, none, result)


def fraction_done(load: Load, record: Record) -> float:
    """Return the fraction of the load path that is done, outside of a trace."""
    turns, leg, here = (concrete(x) for x in (load.value, record.leg, record.point.value))
    lengths = np.abs(np.diff(turns))
    done = lengths[:leg].sum() + abs(here - turns[leg])
    return float(done / lengths.sum())

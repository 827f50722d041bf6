"""Load stepping along a load path, through jumps."""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, Self, TypeVar

import jax.numpy as jnp

from jaxstab.core.checks import concrete
from jaxstab.core.compile import program
from jaxstab.core.control_flow import while_loop
from jaxstab.core.progress import advance_to
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag
from jaxstab.equilibrium import Equilibrium
from jaxstab.loading.event import no_event
from jaxstab.loading.jump_detection import (
    JumpBracket,
    PathSearch,
    apply_step,
    next_step,
)
from jaxstab.loading.load_path import LoadPath, Start
from jaxstab.states.point import point_of
from jaxstab.states.record import Record


class _Store(Protocol):
    @property
    def is_full(self) -> Flag | bool: ...
    def append(self, search: PathSearch, record: Record, /) -> Self: ...


Store = TypeVar("Store", bound=_Store)


def step_to_end(
    load_path: LoadPath,
    start: Field,
    empty: Callable[[Record], Store],
    explain: Callable[[Record], Record] = lambda record: record,
) -> tuple[PathSearch, Store]:
    """Return the search at the end of a load path, or where the store is full, and the store.

    1. Find the first equilibrium, from a gap if one is given.
    2. Predict the next state, and find the equilibrium at its load.
    3. Judge the step to it.
    4. Explain its jump, if it has located one, and append what it has recorded.

    Arguments:
        load_path: the load path.
        start: a gap to start from, or None.
        empty: returns an empty store for records like one.
        explain: returns what to append of the record of a step; by default the record.
    """
    first = _first_start(load_path, start).equilibrium(load_path.contact)
    search, record = _first_state(load_path, first)
    store = empty(record).append(search, record)

    def goes_on(state: tuple[PathSearch, Store]) -> Flag:
        search, store = state
        return search.goes_on(load_path.load) & ~concrete(store.is_full)

    def step(state: tuple[PathSearch, Store]) -> tuple[PathSearch, Store]:
        search, store = state
        trial = next_step(load_path, search)
        found = trial.start.equilibrium(load_path.contact)
        search, record = apply_step(load_path, search, trial, found)
        advance_to(lambda: int(100 * search.fraction_done(load_path.load)))
        return search, store.append(search, explain(record))

    return while_loop(goes_on, step, (search, store))


@program
def _first_start(load_path: LoadPath, start: Field) -> Start:
    value = load_path.load.value[0]
    return load_path.start_at(value, start)


@program
def _first_state(load_path: LoadPath, found: Equilibrium) -> tuple[PathSearch, Record]:
    """Return the search at the first turning point, and its record."""
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
    search = PathSearch(
        here=here,
        previous=here,
        next_length=load_path.first_step,
        bracket=JumpBracket(zero + jnp.inf, zero, load_path.resolution),
        leg=none,
        is_apart=no,
        state_number=none,
        result=result,
    )
    return search, Record(here, yes, no_event(here), no)

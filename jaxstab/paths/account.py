"""The path that a walk has recorded, its jumps explained and its work accounted for."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.branches.reason import reason_of
from jaxstab.branches.release import first_releases
from jaxstab.checks import known
from jaxstab.contact import Contact
from jaxstab.equilibrium.state import state_at
from jaxstab.lanes import by_lanes
from jaxstab.loads import Load
from jaxstab.paths.path import Jump, Path, States
from jaxstab.paths.step import Walk
from jaxstab.paths.store import Event, Place, Store
from jaxstab.programs import program
from jaxstab.results import KINDS


@partial(program, static_argnums=0)
def path_of(fields: bool, ended: Walk[Store], contact: Contact, load: Load) -> Path:
    """Return the path of a contact under a programme of loads, with the gap of each state or not.

    Only the first entries are of states, and of jumps, as many as the walk has recorded.
    """
    return by_lanes(partial(_path_of, fields))(ended, contact, load)


def _path_of(fields: bool, ended: Walk[Store], contact: Contact, load: Load) -> Path:
    states, one = ended.states.rows, load[0]
    place = states.place

    def loads(values: Array) -> Load:
        # What else a load has is the same all along.
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, values.shape), one).at(values)

    def work(place: Place, supplied: Array) -> Array:
        # A dead weight is no part of what is worked on.
        start = states.place.stored[0] - states.place.potential[0]
        return supplied + (place.stored - place.potential) - start

    def jump(event: Event) -> Jump:
        before, after = event.before, event.after
        load = one.at(before.value)
        kind, mode = jax.lax.cond(
            jnp.isfinite(before.value),
            lambda: reason_of(
                contact, load, before.gap, first_releases(contact, load, before.gap, event.ahead)
            ),
            lambda: (KINDS.fold, jnp.full_like(before.gap, jnp.nan)),
        )
        return Jump(
            load=load,
            kind=KINDS.where(event.is_touch, KINDS.touch, kind),
            before=state_at(contact, load, before.gap),
            after=state_at(contact, one.at(after.value), after.gap),
            mode=mode,
            dissipation=event.dissipation,
            state=event.state,
        )

    return Path(
        load=loads(place.value),
        equilibrium=States(
            place.mean_gap,
            place.mean_pressure,
            place.contact_area,
            jnp.broadcast_to(contact.area, place.energy.shape),
            place.energy,
            work(place, states.supplied),
            states.dissipation,
            place.gap if fields else None,
        ),
        jumps=jax.lax.map(jump, ended.jumps.rows),
        work=work(ended.here.place, ended.here.supplied),
        dissipation=ended.here.dissipation,
        result=ended.result,
    )


def cut(path: Path, num_states: int, num_jumps: int) -> Path:
    """Return a path with as many entries as there are."""

    def first(tree: Any, number: int) -> Any:
        return jax.tree.map(lambda leaf: jax.device_put(known(leaf)[:number]), tree)

    load, equilibrium = first((path.load, path.equilibrium), num_states)
    return replace(path, load=load, equilibrium=equilibrium, jumps=first(path.jumps, num_jumps))

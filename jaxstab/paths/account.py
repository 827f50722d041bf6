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
from jaxstab.lanes import by_lanes
from jaxstab.loads import Load
from jaxstab.paths.path import Jump, Path, States
from jaxstab.paths.step import Walk
from jaxstab.paths.store import Event, Place, Store
from jaxstab.programs import program
from jaxstab.results import KINDS
from jaxstab.stacks import first_entries, stacked


@partial(program, static_argnums=0)
def path_with_room(fields: bool, ended: Walk[Store], contact: Contact, load: Load) -> Path:
    """Return the path of a contact under a programme of loads, with the gap of each state or not.

    Only the first entries are of states, and of jumps, as many as the walk has recorded.
    """

    def path(ended: Walk[Store], contact: Contact, load: Load) -> Path:
        jumps = jax.lax.map(partial(_jump, contact, load[0]), ended.jumps.rows)
        return Path(jumps=jumps, **_states(fields, ended, contact, load))

    return by_lanes(path)(ended, contact, load)


def path_of(fields: bool, ended: Walk[Store], contact: Contact, load: Load) -> Path:
    """Return the path as `path_with_room` does, its values known, but with no room left.

    Jumps are looked at one by one: any number of them needs one program, and no more memory than
    they take.
    """
    rows, one = jax.tree.map(known, ended.jumps.rows), load[0]

    def event(i: int) -> Event:
        return jax.tree.map(lambda leaf: leaf[i], rows)

    jumps = [_jump_alone(contact, one, event(i)) for i in range(int(ended.jumps.count))]
    like = jumps[0] if jumps else jax.eval_shape(_jump_alone, contact, one, event(0))
    parts = _states_alone(fields, replace(ended, jumps=None), contact, load)
    for name in ("load", "equilibrium"):
        parts[name] = first_entries(parts[name], int(ended.states.count))
    return Path(jumps=stacked(jumps, like), **parts)


def _jump(contact: Contact, one: Load, event: Event) -> Jump:
    here = event.before
    load = one.at(here.value)
    kind, mode = jax.lax.cond(
        jnp.isfinite(here.value) & ~event.is_touch,
        lambda: reason_of(
            contact, load, here.gap, first_releases(contact, load, here.gap, event.ahead)
        ),
        lambda: (KINDS.fold, jnp.full_like(here.gap, jnp.nan)),
    )
    return Jump(
        load=load,
        kind=KINDS.where(event.is_touch, KINDS.touch, kind),
        before=event.state_before(contact, one),
        after=event.state_after(contact, one),
        mode=mode,
        dissipation=event.dissipation,
        state=event.state,
    )


def _states(fields: bool, ended: Walk[Any], contact: Contact, load: Load) -> dict[str, Any]:
    """Return all of a path but its jumps, by name."""
    states, one = ended.states.rows, load[0]
    place = states.place

    def loads(values: Array) -> Load:
        # What else a load has is the same all along.
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, values.shape), one).at(values)

    def work(place: Place, supplied: Array) -> Array:
        # A dead weight is no part of what is worked on.
        start = states.place.stored[0] - states.place.potential[0]
        return supplied + (place.stored - place.potential) - start

    return {
        "load": loads(place.value),
        "equilibrium": States(
            place.mean_gap,
            place.mean_pressure,
            place.contact_area,
            jnp.broadcast_to(contact.area, place.energy.shape),
            place.energy,
            work(place, states.supplied),
            states.dissipation,
            place.gap if fields else None,
        ),
        "work": work(ended.here.place, ended.here.supplied),
        "dissipation": ended.here.dissipation,
        "result": ended.result,
    }


_jump_alone = program(_jump)
_states_alone = program(_states, static_argnums=0)

"""The path that a walk has recorded, its jumps explained and its work accounted for."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.contact import Contact
from jaxstab.core.batching import by_lanes
from jaxstab.core.compile import program
from jaxstab.core.stack import first_entries, stacked
from jaxstab.loads import Load
from jaxstab.paths.branch_end.kind import KINDS, reason_of
from jaxstab.paths.branch_end.release import first_releases
from jaxstab.paths.path import Jump, Path, States
from jaxstab.paths.record import Event, Store
from jaxstab.paths.recording import Recording
from jaxstab.paths.step import Walk
from jaxstab.paths.unlocated import unlocated_loss


@partial(program, static_argnums=0)
def path_with_room(fields: bool, ended: Walk[Store], contact: Contact, load: Load) -> Path:
    """Return the path of a contact under a programme of loads, with the gap of each state or not.

    Only the first entries are of states, and of jumps, as many as the walk has recorded.
    """

    def path(ended: Walk[Store], contact: Contact, load: Load) -> Path:
        jumps = jax.lax.map(partial(_jump, contact, load[0]), ended.jumps.rows)
        return Path(jumps=jumps, **_states(fields, ended, contact, load))

    return by_lanes(path)(ended, contact, load)


def path_of(fields: bool, record: Recording, contact: Contact, load: Load) -> Path:
    """Return the path as `path_with_room` does, from what was recorded on the way.

    Jumps are looked at one by one: any number of them needs one program, and no more memory than
    they take.
    """
    one = load[0]
    jumps = [_jump_alone(contact, one, event) for event in record.events]
    like = jumps[0] if jumps else jax.eval_shape(_jump_alone, contact, one, record.no_event)
    parts = _states_alone(False, record.ended, contact, load)
    for name in ("load", "equilibrium"):
        parts[name] = first_entries(parts[name], record.num_states)
    if fields:
        parts["equilibrium"] = replace(parts["equilibrium"], gap=record.gaps)
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
    assert isinstance(ended.states, Store)
    states, one = ended.states.rows, load[0]
    place = states.place

    def loads(values: Array) -> Load:
        # What else a load has is the same all along.
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, values.shape), one).at(values)

    dissipation = states.dissipation
    is_branch = (jnp.diff(dissipation) == 0) & jnp.isfinite(place.value[1:])
    unlocated, error = unlocated_loss(place.value, place.potential, place.force, is_branch)
    end = ended.here
    return {
        "load": loads(place.value),
        "equilibrium": States(
            place.mean_gap,
            place.mean_pressure,
            place.contact_area,
            jnp.broadcast_to(contact.area, place.energy.shape),
            place.energy,
            place.stored - place.stored[0] + dissipation,
            dissipation,
            place.gap if fields else None,
        ),
        "work": end.place.stored - place.stored[0] + end.dissipation,
        "dissipation": end.dissipation,
        "result": ended.result,
        "unlocated": unlocated,
        "unlocated_error": error,
    }


_jump_alone = program(_jump)
_states_alone = program(_states, static_argnums=0)

"""The way of a contact to its pull-off as a stage of a case: what `pull_off` does, with pauses."""

from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Int

from jaxstab.branches.critical_load import CriticalLoad
from jaxstab.contact import Contact
from jaxstab.equilibrium.stage import EquilibriumStage
from jaxstab.iterate import Loop
from jaxstab.paths.course import Course, solver
from jaxstab.paths.pull_off import ROOM, as_shown, dead_load, end_of, unloading
from jaxstab.paths.step import Aim, Walk, after, aimed, judged
from jaxstab.paths.store import Place, Strongest, place_of
from jaxstab.paths.walk import begin_at
from jaxstab.pause import Pause
from jaxstab.refill import Record, Stage
from jaxstab.results import RESULTS


class _Walking(eqx.Module):
    """A walk, and the equilibrium that it seeks.

    Attributes:
        course: the programme.
        walk: where it is.
        aim: its next step.
        loop: the search for the equilibrium there.
        num_before: the steps of all searches before.
    """

    course: Course
    walk: Walk[Strongest]
    aim: Aim
    loop: Loop[Any]
    num_before: Int[Array, ""]

    def after(self, place: Place, result: RESULTS) -> "_Walking":
        """Return the walk after a step whose equilibrium is found, about to seek the next."""
        course, aim = self.course, self.aim
        walk = after(course, self.walk, aim, judged(course, self.walk, aim, place, result))
        return _aimed(course, walk, self.num_before + self.loop.num_steps)


def _aimed(course: Course, walk: Walk[Strongest], num_before: Int[Array, ""]) -> _Walking:
    """Return a walk that is about to seek its next equilibrium."""
    aim = aimed(course, walk)
    with Pause() as pause:
        course.state(aim.value, walk.part, aim.start)
    return _Walking(course, walk, aim, pause.loop, num_before)


class WalkStage(Stage):
    """The walk of a contact from no load to a tension that leaves nothing together.

    Arguments:
        equilibria: the stage before, of the contact under no load.
    """

    def __init__(self, equilibria: EquilibriumStage):
        self._equilibria = equilibria

    def begin(self, record: Record) -> _Walking:
        """Return the walk before its first step."""
        contact, found = self._equilibria.found(record)
        own, unit = contact.whole.in_own_units()
        load = dead_load(contact.whole, found.mean_pressure).in_units_of(unit)
        course = unloading(own, load)
        first = place_of(own, found.in_units_of(unit), load.value[0])
        walk = begin_at(course, (first, found.result), *ROOM)
        return jax.tree.map(lambda leaf: leaf[None], _aimed(course, walk, jnp.array(0)))

    def advance(self, record: Record, state: _Walking, max_steps: ArrayLike) -> _Walking:
        """Return the walk after at most so many steps more of the search that it is in."""
        aim = state.aim
        with Pause(state.loop, max_steps) as pause:
            found = state.course.state(aim.value, state.walk.part, aim.start)
        state = replace(state, loop=pause.loop)
        is_found = solver().is_over(state.loop)
        return jax.tree.map(partial(jnp.where, is_found), state.after(*found), state)

    def is_over(self, record: Record, state: _Walking) -> Bool[Array, ""]:
        """Return whether the walk has come to its end."""
        return ~state.walk.is_open(state.course)

    def num_steps(self, state: _Walking) -> Int[Array, ""]:
        """Return the number of steps of all searches."""
        return state.num_before + state.loop.num_steps

    def found(self, record: Record) -> tuple[Contact, CriticalLoad]:
        """Return the contact of a case and its pull-off."""
        contact, _ = self._equilibria.build(**record[0])
        whole = contact.whole
        own, unit = whole.in_own_units()
        state: _Walking = jax.tree.map(lambda leaf: leaf[0], record[2])
        end = end_of(state.course, state.walk)
        found = as_shown(end, own, state.course.load[0], throw=False)
        return contact, found.in_units_of(1 / unit).on_surface(whole.solid)

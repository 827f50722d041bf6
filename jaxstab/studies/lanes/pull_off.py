"""The way of a contact to its pull-off as a stage of a case: what `pull_off` does, with pauses."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int

from jaxstab.contact import Contact
from jaxstab.core.loop import Loop
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Flag
from jaxstab.loads import MeanPressure
from jaxstab.paths.branch_end.critical_load import CriticalLoad
from jaxstab.paths.programme import Programme as Course
from jaxstab.paths.pull_off import ROOM, as_shown, dead_load, end_of, unloading
from jaxstab.paths.record import Place, Strongest, place_of
from jaxstab.paths.step import Progress as Walk
from jaxstab.paths.step import TrialStep as Aim
from jaxstab.paths.step import apply_step as after
from jaxstab.paths.step import next_step as aimed
from jaxstab.paths.walk import begin_at
from jaxstab.studies.lanes.equilibrium import EquilibriumStage
from jaxstab.studies.lanes.stage import Record, Stage


class _Walking(eqx.Module):
    """A walk, and the equilibrium that it seeks.

    Attributes:
        course: the programme.
        walk: where it is, once it has begun.
        has_begun: whether the first equilibrium is found.
        aim: the next.
        loop: the search for it.
        num_before: the steps of all searches before.
    """

    course: Course
    walk: Walk[Strongest]
    has_begun: Flag
    aim: Aim
    loop: Loop[Any]
    num_before: Int[Array, ""]

    def after(self, place: Place, result: RESULTS) -> "_Walking":
        """Return the walk after the equilibrium that it sought, about to seek the next."""
        course, walk = self.course, self.walk
        further = after(course, walk, self.aim, place, result)
        begun = begin_at(course, (place, result), *ROOM)
        walk = jax.tree.map(partial(jnp.where, self.has_begun), further, begun)
        num_steps = self.num_before + self.loop.num_steps
        return _seeking(course, walk, jnp.array(True), aimed(course, walk), num_steps)


def _seeking(
    course: Course,
    walk: Walk[Strongest],
    has_begun: Flag,
    aim: Aim,
    num_before: Int[Array, ""],
) -> _Walking:
    """Return a walk that is about to seek an equilibrium."""
    solver, problem = _search(course, walk, aim)
    return _Walking(course, walk, has_begun, aim, solver.begin(problem, aim.start), num_before)


def _search(course: Course, walk: Walk[Strongest], aim: Aim) -> tuple[Any, Any]:
    solver, problem = course.search(aim.value, walk.part, aim.least_potential, aim.is_final)
    return solver, solver.prepared(problem, aim.start)


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
        # As yet not begun, but of the right kind.
        value, no = load.value[0], jnp.array(False)
        place = place_of(own, found.in_units_of(unit), value)
        walk = begin_at(course, (place, found.result), *ROOM)
        start = course.start(value, walk.part, jnp.maximum(place.gap, 0))
        aim = Aim(value, jnp.zeros_like(value), start, jnp.full_like(value, -jnp.inf), no, no)
        state = _seeking(course, walk, no, aim, jnp.array(0))
        return jax.tree.map(lambda leaf: leaf[None], state)

    def advance(self, record: Record, state: _Walking, max_steps: ArrayLike) -> _Walking:
        """Return the walk after at most so many steps more of the search that it is in."""
        course, walk, aim = state.course, state.walk, state.aim
        solver, problem = _search(course, walk, aim)
        state = replace(state, loop=solver.advance(problem, state.loop, max_steps))
        found = course.place(aim.value, walk.part, solver.outcome(state.loop))
        is_found = solver.is_over(state.loop)
        return jax.tree.map(partial(jnp.where, is_found), state.after(*found), state)

    def is_over(self, record: Record, state: _Walking) -> Flag:
        """Return whether the walk has come to its end."""
        return state.has_begun & ~state.walk.is_open(state.course.load)

    def num_steps(self, state: _Walking) -> Int[Array, ""]:
        """Return the number of steps of all searches."""
        return state.num_before + state.loop.num_steps


class PullOffStages:
    """The stages of a pull-off.

    Arguments:
        build: returns a contact, called by names.
    """

    def __init__(self, build: Callable[..., Contact]):
        self._build = build
        equilibria = EquilibriumStage(lambda **values: (build(**values), MeanPressure(0.0)))
        self.walk = WalkStage(equilibria)
        self.all = [equilibria, self.walk]

    def found(self, record: Record) -> tuple[Contact, CriticalLoad]:
        """Return the contact of a case and its pull-off."""
        contact = self._build(**record[0])
        state: _Walking = jax.tree.map(lambda leaf: leaf[0], record[2])
        course, whole = state.course, contact.whole
        found = as_shown(end_of(course, state.walk), course.contact, course.load[0], throw=False)
        return contact, found.in_units_of(1 / whole.own_pressure).on_surface(whole.solid)

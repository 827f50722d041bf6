"""The way of a contact to its pull-off as a procedure, step by step as `pull_off` takes it."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.procedure import Procedure, Rounds, Solve
from jaxstab.equilibrium.equilibrate import whole_equilibrium
from jaxstab.equilibrium.solvers.base import Problem
from jaxstab.loads import MeanPressure
from jaxstab.paths.branch_end.critical_load import CriticalLoad
from jaxstab.paths.jump_detection import Progress, TrialStep, apply_step, next_step
from jaxstab.paths.programme import Programme
from jaxstab.paths.pull_off import ROOM, as_shown, dead_load, end_of, unloading
from jaxstab.paths.record import Strongest
from jaxstab.paths.walk import begin_at


class Walking(Rounds):
    """The steps of a walk, each of which seeks an equilibrium.

    Attributes:
        programme: the programme.
        walk: where it is.
        aim: the next step.
    """

    programme: Programme
    walk: Progress[Strongest]
    aim: TrialStep | None = None

    @property
    def search(self) -> tuple[Any, Any]:
        """The solver of this step, and its problem, prepared."""
        aim = self.aim
        assert aim is not None
        solver, problem = self.programme.search(
            aim.value, self.walk.part, aim.least_potential, aim.is_final
        )
        return solver, solver.prepared(problem, aim.start)

    @property
    def found(self) -> Progress[Strongest]:
        """The walk at its end."""
        return self.walk

    def begun(self) -> "Walking":
        """Return the next step before its search has begun."""
        aiming = replace(self, aim=next_step(self.programme, self.walk))
        solver, problem = aiming.search
        assert aiming.aim is not None
        loop = solver.begin(problem, aiming.aim.start)
        is_open = self.walk.is_open(self.programme.load)
        return replace(
            aiming, loops=jax.tree.map(lambda leaf: leaf[None], loop), is_on=is_open[None]
        )

    def turned(self) -> "Walking":
        """Return the step after this one."""
        aim = self.aim
        assert aim is not None
        loop = jax.tree.map(lambda leaf: leaf[0], self.loops)
        state = self.programme.place(aim.value, self.walk.part, self.search[0].outcome(loop))
        return replace(self, walk=apply_step(self.programme, self.walk, aim, *state)).begun()


def unloaded(contact: Contact) -> Procedure[CriticalLoad]:
    """Return the procedure that unloads a contact to its pull-off."""
    whole = contact.whole
    found = yield from whole_equilibrium(contact, MeanPressure(0.0))
    own, unit = whole.in_own_units()
    programme = unloading(own, dead_load(whole, found.mean_pressure).in_units_of(unit))
    value, part = programme.load.value[0], jnp.array(0)
    start = programme.start(value, part, jnp.maximum(found.gap, 0))
    given = own, programme.at(value, part)
    first = yield Solve(programme.solver, given, start, Problem.under)
    walk = begin_at(programme, programme.place(value, part, first), *ROOM)
    walk = yield Walking(programme, walk)
    found = as_shown(end_of(programme, walk), own, programme.load[0], throw=False)
    return found.in_units_of(1 / unit).on_surface(whole.solid)

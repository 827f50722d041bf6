"""An equilibrium as a stage of a case: what `equilibrate` does by default, with pauses."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, ArrayLike, Int

from jaxstab.contact import Contact
from jaxstab.core.loop import Loop
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium.equilibrate import concluded, in_users_units, started
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.equilibrium.solvers.base import Problem
from jaxstab.equilibrium.solvers.conjugate_gradients import PreconditionedConjugateGradient
from jaxstab.equilibrium.window import whole_start
from jaxstab.loads import Load, require_load
from jaxstab.studies.lanes.stage import Record, Stage

# Returns a contact and its load, given the inputs of a case by name.
Build = Callable[..., tuple[Contact, Load]]


class _Problem(eqx.Module):
    """A contact problem in units of its own.

    Attributes:
        contact: the contact.
        load: its load.
        unit: the unit of pressure.
        start: a gap to start from.
    """

    contact: Contact
    load: Load
    unit: Scalar
    start: Field

    @property
    def prepared(self) -> Any:
        """What the solver is given."""
        problem = Problem.of(self.contact, self.contact.control(self.load))
        return _solver().prepared(problem, self.start)


class _Solve(eqx.Module):
    problem: _Problem
    loop: Loop[Any]


class EquilibriumStage(Stage):
    """The equilibrium of a contact that is built from the inputs of a case.

    Arguments:
        build: returns the contact and its load.
    """

    def __init__(self, build: Build):
        self.build = build

    def begin(self, record: Record) -> _Solve:
        """Return the solve before its first step."""
        contact, load = self.build(**record[0])
        require_load(load)
        whole, start = whole_start(contact, load, None)
        unit = whole.own_pressure
        whole, load = whole.in_units_of(unit), load.in_units_of(unit)
        problem = _Problem(whole, load, unit, started(whole, load, start))
        loop = _solver().begin(problem.prepared, problem.start)
        return jax.tree.map(lambda leaf: leaf[None], _Solve(problem, loop))

    def advance(self, record: Record, state: _Solve, max_steps: ArrayLike) -> _Solve:
        """Return the solve after at most so many steps more."""
        loop = _solver().advance(state.problem.prepared, state.loop, max_steps)
        return replace(state, loop=loop)

    def is_over(self, record: Record, state: _Solve) -> Flag:
        """Return whether the solve has ended."""
        return _solver().is_over(state.loop)

    def num_steps(self, state: _Solve) -> Int[Array, ""]:
        """Return the number of steps taken."""
        return state.loop.num_steps

    def found(self, record: Record) -> tuple[Contact, Equilibrium]:
        """Return the contact of a case and its equilibrium, on the grid that it is solved on."""
        contact, load = self.build(**record[0])
        solve: _Solve = jax.tree.map(lambda leaf: leaf[0], record[1])
        problem = solve.problem
        found = concluded(problem.contact, problem.load, _solver().outcome(solve.loop))
        return contact, in_users_units(found, problem.unit, load)


def _solver() -> PreconditionedConjugateGradient:
    return PreconditionedConjugateGradient()

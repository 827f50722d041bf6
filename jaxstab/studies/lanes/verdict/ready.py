"""What comes before the searches of a verdict, and what their stages share."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int

from jaxstab.core.types import Flag
from jaxstab.equilibrium import Equilibrium
from jaxstab.stability.assess import prepared
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.lowest_pair import Lowest
from jaxstab.stability.search import Search
from jaxstab.stability.solvers.cone_lobpcg import ProjectedLOBPCG
from jaxstab.stability.solvers.davidson import Davidson
from jaxstab.studies.lanes.equilibrium import EquilibriumStage
from jaxstab.studies.lanes.stage import Record, Stage


def cone_solver() -> ProjectedLOBPCG:
    """Return the solver of the cones."""
    return ProjectedLOBPCG()


def space_solver(dtype: Any) -> Davidson:
    """Return the solver of the linear spaces."""
    return Davidson(cone_solver().tolerance_in(dtype))


class Ready(eqx.Module):
    """An equilibrium, and what is known before its eigenvalues are."""

    equilibrium: Equilibrium
    search: Search
    known: Any


def ready_in(record: Record) -> Ready:
    """Return what a case has in the record of its `ReadyStage`."""
    return jax.tree.map(lambda leaf: leaf[0], record[2])


class ReadyStage(Stage):
    """What comes before the searches, without a step.

    Arguments:
        equilibria: the stage before.
    """

    def __init__(self, equilibria: EquilibriumStage):
        self.equilibria = equilibria

    def begin(self, record: Record) -> Ready:
        """Return the search at an equilibrium."""
        contact, found = self.equilibria.found(record)
        search, known = prepared(contact.whole, found, jax.random.key(0), False)
        return jax.tree.map(lambda leaf: leaf[None], Ready(found, search, known))

    def advance(self, record: Record, state: Ready, max_steps: ArrayLike) -> Ready:
        """Return the state as it is."""
        return state

    def is_over(self, record: Record, state: Ready) -> Flag:
        """Return that it is."""
        return jnp.array(True)

    def num_steps(self, state: Ready) -> Int[Array, ""]:
        """Return none."""
        return jnp.array(0)


def chosen(condition: Flag, one: Lowest, other: Lowest) -> Lowest:
    """Return the one of two lowest pairs."""
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), one, other)


def paired(one: Lowest, other: Lowest) -> Lowest:
    """Return two lowest pairs along a leading axis."""
    return jax.tree.map(lambda x, y: jnp.stack([x, y]), one, other)


def cone_of(search: Search, number: Int[Array, ""]) -> AdmissibleCone:
    """Return V0+ or the critical cone, by its number."""
    one, other = search.cone, search.critical_cone
    return jax.tree.map(lambda x, y: jnp.where(number == 0, x, y), one, other)

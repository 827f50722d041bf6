"""A verdict as stages of a case: what `assess_stability` does by default, with pauses."""

import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.equilibrium import Equilibrium
from jaxstab.stability.assess import stability_of
from jaxstab.stability.search import with_bound
from jaxstab.stability.verdict import Stability
from jaxstab.studies.lanes.equilibrium import EquilibriumStage
from jaxstab.studies.lanes.stage import Record
from jaxstab.studies.lanes.verdict.bound import BoundStage
from jaxstab.studies.lanes.verdict.coarser import CoarserStage
from jaxstab.studies.lanes.verdict.cones import ConesStage
from jaxstab.studies.lanes.verdict.ready import ReadyStage, chosen, ready_in
from jaxstab.studies.lanes.verdict.spaces import SpacesStage


class VerdictStages:
    """The stages of a verdict, after that of the equilibrium.

    Arguments:
        equilibria: the stage of the equilibrium.
    """

    def __init__(self, equilibria: EquilibriumStage):
        self._equilibria = equilibria
        self._spaces = SpacesStage()
        coarser = CoarserStage(self._spaces)
        self._cones = ConesStage(self._spaces, coarser)
        self.all = [
            equilibria,
            ReadyStage(equilibria),
            self._spaces,
            coarser,
            self._cones,
            BoundStage(self._spaces, self._cones),
        ]

    def found(self, record: Record) -> tuple[Contact, Equilibrium, Stability]:
        """Return the contact of a case, its equilibrium and its stability."""
        contact, _ = self._equilibria.build(**record[0])
        ready, state = ready_in(record), jax.tree.map(lambda leaf: leaf[0], record[6])
        around, hull = self._spaces.found(record)
        cone, critical = self._cones.found(record)
        # There is a cost where one was needed.
        cone = chosen(state.cost > 0, with_bound(cone, state.best, state.cost), cone)
        no = jnp.array(False)
        found = ready.search.concluded(around, cone, critical, hull, no, no)
        stability = stability_of(ready.equilibrium, ready.known, found)
        surface = contact.whole.solid
        return contact, ready.equilibrium.on_surface(surface), stability.on_surface(surface)

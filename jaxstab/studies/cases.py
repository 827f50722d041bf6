"""Ready-made cases of studies, whose batches do not wait for the slowest case.

Each is a function of one case, as any other that `jaxstab.study` takes. In batches, which are for
accelerators, it advances by steps: a finished case frees its slot for the next.
"""

import inspect
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax

from jaxstab.contact import Contact
from jaxstab.core.procedure import Kept, Procedure
from jaxstab.equilibrium import Equilibrium, equilibrate
from jaxstab.equilibrium.equilibrate import whole_equilibrium
from jaxstab.loads import Load
from jaxstab.paths import pull_off as find_pull_off
from jaxstab.paths.branch_end.critical_load import CriticalLoad
from jaxstab.stability import ProjectedLOBPCG, Stability, assess_stability
from jaxstab.stability.assess import assessment
from jaxstab.studies.lanes.programs import Programs
from jaxstab.studies.lanes.pull_off import unloaded

__all__ = ["equilibrium", "pull_off", "verdict"]

Outputs = Mapping[str, Any]
# Returns a contact and its load, given the inputs of a case by name.
Build = Callable[..., tuple[Contact, Load]]


@dataclass(frozen=True)
class Case:
    """A ready-made case.

    Attributes:
        build: returns the problem, called by names with the values of the axes.
        summary: returns the outputs to keep of the results.
    """

    build: Callable[..., Any]
    summary: Callable[..., Outputs]

    @property
    def __signature__(self) -> inspect.Signature:
        return inspect.signature(self.build)

    @abstractmethod
    def __call__(self, **values: Any) -> Outputs:
        """Return the outputs of one case."""

    @abstractmethod
    def procedure(self, values: Mapping[str, Any]) -> Procedure[Outputs]:
        """Return the procedure that does the same, of which lanes can run many."""

    def programs(self) -> Programs:
        """Return the programs that run many cases in lanes."""
        return Programs(lambda values: self.procedure(values))


class EquilibriumCase(Case):
    """The equilibrium of a contact that a function builds: see `equilibrium`."""

    def __call__(self, **values: Any) -> Outputs:
        """Return the outputs of one equilibrium."""
        contact, load = self.build(**values)
        return self.summary(contact, equilibrate(contact, load, throw=False))

    def procedure(self, values: Mapping[str, Any]) -> Procedure[Outputs]:
        """Return the procedure that does the same, of which lanes can run many."""
        contact, load = yield Kept(self.build(**values))
        found = yield from whole_equilibrium(contact, load)
        return self.summary(contact, found.on_surface(contact.whole.solid))


class VerdictCase(Case):
    """The stability of the equilibrium of a contact: see `verdict`."""

    def __call__(self, **values: Any) -> Outputs:
        """Return the outputs of one verdict."""
        contact, load = self.build(**values)
        found = equilibrate(contact, load, throw=False)
        return self.summary(contact, found, assess_stability(contact, found, throw=False))

    def procedure(self, values: Mapping[str, Any]) -> Procedure[Outputs]:
        """Return the procedure that does the same, of which lanes can run many."""
        contact, load = yield Kept(self.build(**values))
        found = yield from whole_equilibrium(contact, load)
        found = yield Kept(found)
        search = assessment(contact.whole, found, ProjectedLOBPCG(), jax.random.key(0))
        stability = yield from search
        surface = contact.whole.solid
        return self.summary(contact, found.on_surface(surface), stability.on_surface(surface))


class PullOffCase(Case):
    """The pull-off of a contact that a function builds: see `pull_off`."""

    def __call__(self, **values: Any) -> Outputs:
        """Return the outputs of one pull-off."""
        contact = self.build(**values)
        return self.summary(contact, find_pull_off(contact, throw=False))

    def procedure(self, values: Mapping[str, Any]) -> Procedure[Outputs]:
        """Return the procedure that does the same, of which lanes can run many."""
        contact = yield Kept(self.build(**values))
        found = yield from unloaded(contact)
        return self.summary(contact, found)


def equilibrium(build: Build, summary: Callable[..., Outputs] | None = None) -> EquilibriumCase:
    """Return a case that finds the equilibrium of a contact, as `equilibrate` does.

    Arguments:
        build: returns a contact and its load, called by names with the values of the axes. In
            batches it must be one that JAX can trace, as a case of any other kind.
        summary: returns the outputs to keep, a dict of arrays, from the contact and its
            `Equilibrium`. By default mean pressure, contact area, energy, residual, the number of
            steps, and how the solver `ended`.

    Returns:
        A function of the same arguments as `build`, to be given to `jaxstab.study`.
    """
    return EquilibriumCase(build, summary or _of_equilibrium)


def verdict(build: Build, summary: Callable[..., Outputs] | None = None) -> VerdictCase:
    """Return a case that assesses the equilibrium of a contact, as `assess_stability` does.

    Arguments:
        build: as in `equilibrium`.
        summary: returns the outputs to keep, a dict of arrays, from the contact, its `Equilibrium`
            and its `Stability`. By default those of `equilibrium`, the three eigenvalues with their
            errors, complementarity and barrier, the verdict, whether it is `proved`, and how the
            assessment ended, `assessed`.

    Returns:
        A function of the same arguments as `build`, to be given to `jaxstab.study`.
    """
    return VerdictCase(build, summary or _of_verdict)


def pull_off(
    build: Callable[..., Contact], summary: Callable[..., Outputs] | None = None
) -> PullOffCase:
    """Return a case that unloads a contact to its pull-off, as `jaxstab.pull_off` does.

    That is from the equilibrium under no load, by a tension that is a dead load.

    Arguments:
        build: returns a contact, called by names with the values of the axes. In batches it must
            be one that JAX can trace, as a case of any other kind.
        summary: returns the outputs to keep, a dict of arrays, from the contact and its
            `CriticalLoad`. By default mean pressure, contact area and energy of the last state, the
            `kind` of its end, the eigenvalue `critical` there (`CriticalLoad.critical`), and how
            the search `ended`.

    Returns:
        A function of the same arguments as `build`, to be given to `jaxstab.study`.
    """
    return PullOffCase(build, summary or _of_pull_off)


def _of_equilibrium(contact: Contact, equilibrium: Equilibrium) -> Outputs:
    """Return the numbers of an equilibrium, but for its fields."""
    return {
        "mean_pressure": equilibrium.mean_pressure,
        "contact_area": equilibrium.contact_area,
        "energy": equilibrium.energy,
        "residual": equilibrium.residual,
        "num_steps": equilibrium.num_steps,
        "ended": equilibrium.result,
    }


def _of_verdict(contact: Contact, equilibrium: Equilibrium, stability: Stability) -> Outputs:
    """Return the numbers of an equilibrium and its stability, but for fields and modes."""
    pairs = stability.pairs
    return {
        **_of_equilibrium(contact, equilibrium),
        **{name: pair.eigenvalue for name, pair in pairs.items()},
        **{f"{name}_error": pair.error for name, pair in pairs.items()},
        "complementarity": stability.complementarity,
        "barrier": stability.barrier.height,
        "verdict": stability.verdict,
        "proved": stability.proved,
        "assessed": stability.result,
    }


def _of_pull_off(contact: Contact, end: CriticalLoad) -> Outputs:
    """Return the numbers of a pull-off, but for fields and modes."""
    return {
        "mean_pressure": end.equilibrium.mean_pressure,
        "contact_area": end.equilibrium.contact_area,
        "energy": end.equilibrium.energy,
        "kind": end.kind,
        "critical": end.critical.eigenvalue,
        "ended": end.result,
    }

"""The interface of equilibrium solvers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx

from jaxstab.contact.contact import Contact
from jaxstab.contact.residual import Balance
from jaxstab.core.display import inline
from jaxstab.core.history import Indicators
from jaxstab.core.loop import IterativeSolver
from jaxstab.core.types import Field
from jaxstab.loads.load import Control


class SolverState(eqx.Module):
    """A gap that meets the load and is nowhere negative, and how far it is from equilibrium."""

    gap: Field
    balance: Balance


@dataclass(frozen=True)
class Problem:
    """A contact under a load.

    Attributes:
        contact: the contact, in its characteristic units.
        control: the condition that the load sets on the gap.
        balance: maps a gap to how far it is from equilibrium.
    """

    contact: Contact
    control: Control
    balance: Callable[[Field], Balance]

    @classmethod
    def of(cls, contact: Contact, control: Control) -> "Problem":
        """Return the problem of a contact under the condition of a load."""
        return cls(contact, control, contact.balance(control))

    def state(self, gap: Field, side: Field | None = None) -> SolverState:
        """Return the state of the admissible gap that is near to another.

        On a surface that yields a signed gap is cut where it leaves its side.
        """
        gap = self.control.admissible(gap, side)
        return SolverState(gap, self.balance(gap))


class EquilibriumSolver(IterativeSolver):
    """An algorithm for equilibria: a subclass defines a `step` from a state to the next.

    Its states have a `gap` that meets the load and is nowhere negative, and its `balance`, whose
    residual is to fall to the tolerance. It may be given as `solver` wherever an equilibrium is
    sought.

    Example:
        >>> isinstance(js.solvers.SaddleNewton(), js.solvers.EquilibriumSolver)
        True
    """

    __repr__ = inline

    def init(self, problem: Any, start: Field) -> Any:
        """Return the state of a gap that meets the load."""
        return SolverState(start, problem.balance(start))

    def measure(self, problem: Any, state: Any) -> Indicators:
        """Return the residual of a state."""
        return {"residual": state.balance.residual}

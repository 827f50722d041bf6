"""What a solver for equilibria is to all the rest."""

from abc import abstractmethod
from typing import Any

from jaxstab.contact import Contact
from jaxstab.core.loop import Iteration, IterativeSolver
from jaxstab.core.types import Field
from jaxstab.loads import Control


class EquilibriumSolver(IterativeSolver):
    """An algorithm for equilibria: a subclass gives a step and an indicator to `iterate`.

    It may be given as `solver` wherever an equilibrium is sought.
    """

    @abstractmethod
    def solve(self, contact: Contact, control: Control, gap: Field) -> Iteration[Any]:
        """Iterate from a gap that meets the load to an equilibrium under it.

        Arguments:
            contact: the contact problem, in units of its own.
            control: what the load asks of the gap.
            gap: where to start.

        Returns:
            The iteration, its state a `gap` that meets the load and is nowhere negative, and its
            `balance`, by `contact.balance(control)`, whose residual is to fall to the tolerance.
        """

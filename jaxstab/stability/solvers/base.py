"""What solvers for smallest eigenvalues are to all the rest."""

from abc import abstractmethod

from jaxtyping import Array, Bool

from jaxstab.contact.hessian import Block, SymmetricOperator
from jaxstab.core.loop import IterativeSolver
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import Minimum


class ConeSolver(IterativeSolver):
    """An algorithm for the smallest eigenvalue on a cone."""

    @abstractmethod
    def solve(
        self,
        operator: SymmetricOperator,
        cone: AdmissibleCone,
        starts: Block,
        is_needed: Bool[Array, " starts"] | bool = True,
    ) -> Minimum:
        """Return a minimiser of the Rayleigh quotient on a cone.

        Arguments:
            operator: A [pressure/length].
            cone: where perturbations must lie.
            starts: vectors to start from, not brought onto the cone: first the best guesses, last
                random ones.
            is_needed: which of them are of use.
        """


class SpaceSolver(IterativeSolver):
    """An algorithm for the smallest eigenvalues on a linear space."""

    @abstractmethod
    def solve(
        self, operator: SymmetricOperator, space: Subspace, starts: Block, count: int = 1
    ) -> Minimum:
        """Return the modes of a block, the lowest `count` of them to the tolerance.

        Arguments:
            operator: A [pressure/length].
            space: where modes must lie.
            starts: a vector for every mode of the block.
            count: how many modes decide.

        Returns:
            As vectors the whole block, in the order of the eigenvalues; zero where the block is
            larger than the space.
        """

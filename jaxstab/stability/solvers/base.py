"""What solvers for smallest eigenvalues are to all the rest."""

from dataclasses import dataclass
from typing import Any

from jaxtyping import Array, Bool

from jaxstab.contact.hessian import Block, SymmetricOperator
from jaxstab.core.loop import Iteration, IterativeSolver
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import Minimum


@dataclass(frozen=True)
class Eigenproblem:
    """An operator and a set.

    Attributes:
        operator: A [pressure/length].
        domain: where perturbations must lie: a cone, or a linear space.
    """

    operator: SymmetricOperator
    domain: Any


class Eigensolver(IterativeSolver):
    """An algorithm for smallest eigenvalues, on a set of any kind."""

    def minimum(self, problem: Any, found: Iteration[Any]) -> Minimum:
        """Return what was found, and at what cost: one application for each step."""
        return Minimum(found.state, found.num_steps, found.num_steps, found.result, found.history)


class ConeSolver(Eigensolver):
    """An algorithm for the smallest eigenvalue on a cone.

    A subclass gives `init`, from a block of vectors to start from, `step` and `measure`; and
    `minimum`, where its state is not the vector.
    """

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
        problem = Eigenproblem(operator, cone)
        return self.minimum(problem, self.run(problem, starts))


class SpaceSolver(Eigensolver):
    """An algorithm for the smallest eigenvalues on a linear space.

    A subclass gives `init`, from a block of vectors to start from, `step` and `measure`; and
    `minimum`, where its state is not the block.
    """

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
        problem = ModesProblem(operator, space, starts, count)
        return self.minimum(problem, self.run(problem, starts))


@dataclass(frozen=True)
class ModesProblem(Eigenproblem):
    """An operator, a linear space, and what to begin with.

    Attributes:
        starts: a vector for every mode of the block.
        count: how many modes decide.
    """

    starts: Block
    count: int = 1

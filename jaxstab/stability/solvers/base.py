"""The interface of solvers for smallest eigenvalues."""

from typing import Any, Self

import equinox as eqx
import jax
from jaxtyping import Array, Bool, PRNGKeyArray

from jaxstab.contact.hessian import Block, Hessian, SymmetricOperator
from jaxstab.core.display import inline
from jaxstab.core.loop import Iteration, IterativeSolver
from jaxstab.core.types import Field
from jaxstab.core.units import Dimensioned
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import Minimum

# The modes that a search for the lowest carries on.
BLOCK_SIZE = 4
# The random vectors that a search on a cone starts from.
NUM_RANDOM = 8


class Eigenproblem(eqx.Module):
    """An operator and a set.

    Attributes:
        operator: A [pressure/length].
        domain: where perturbations must lie: a cone, or a linear space.
    """

    operator: SymmetricOperator
    domain: Any


class ConeProblem(eqx.Module):
    """The Hessian of an equilibrium on the points that may move, and a cone of perturbations there.

    Attributes:
        operator: A, restricted to those points.
        domain: the cone.
    """

    operator: Hessian
    domain: AdmissibleCone

    @classmethod
    def of(cls, hessian: Hessian, cone: AdmissibleCone) -> Self:
        """Return the problem of a Hessian on a cone."""
        return cls(hessian.restriction(cone.is_moving), cone)


class ModesProblem(Eigenproblem):
    """An operator, a linear space, and the vectors to start from.

    Attributes:
        starts: a vector for every mode of the block.
        count: how many modes decide.
    """

    starts: Block
    count: int = eqx.field(static=True)


class Eigensolver(IterativeSolver):
    """An algorithm for smallest eigenvalues, on a set of any kind."""

    __repr__ = inline

    def minimum(self, problem: Any, found: Iteration[Any]) -> Minimum:
        """Return the result and its cost: one application for each step."""
        return Minimum(found.state, found.num_steps, found.num_steps, found.result, found.history)


class ConeSolver(Eigensolver, Dimensioned):
    """An algorithm for the smallest eigenvalue on a cone.

    A subclass gives `init`, from a block of vectors to start from, `step` and `measure`; and
    `minimum`, where its state is not the vector. Fields that hold pressures declare their
    dimension, since `assess_stability` solves in the contact's characteristic pressure.

    Example:
        >>> isinstance(js.solvers.ProjectedLOBPCG(), js.solvers.ConeSolver)
        True
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

    Example:
        >>> isinstance(js.solvers.Davidson(), js.solvers.SpaceSolver)
        True
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


def noise(key: PRNGKeyArray, count: int, like: Field) -> Block:
    """Return random fields to start from."""
    return jax.random.uniform(key, (count, *like.shape), like.dtype, -1, 1)

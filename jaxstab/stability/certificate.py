"""A proof that the smallest eigenvalue on a cone is positive where that on its hull is not.

For perturbations x that are not negative on the contact C, and any matrix N on C whose entries are
not negative, x.Ax >= x.(A - N)x: the smallest eigenvalue of A - N on the linear space around the
cone is a bound from below. With kappa the kernel in space of an operator that is not negative,
N = kappa(0) - kappa(r) is such a matrix. The operator is what K lacks of a stiffness: A - N is
stiffer than A in the soft waves of C, at the price of kappa(0) times the square of the sum on C,
which for zero mean is that on the free points.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact.hessian import Block, Hessian, SymmetricOperator
from jaxstab.core.grid import total
from jaxstab.core.types import Field, FieldMap, Flag, Mask, Scalar
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.eigenpair import Minimum, measured
from jaxstab.stability.solvers.base import ModesProblem
from jaxstab.stability.solvers.davidson import Davidson

# To what part of the cone's eigenvalue soft waves are stiffened, tried in turn.
SHARES = (0.5, 0.25)


class _Stiffened(SymmetricOperator):
    """A - N, on fields of the space around a cone."""

    hessian: Hessian
    lack: FieldMap
    on_point: Scalar
    one_sided: Mask
    bound: Scalar
    scale: Scalar

    def __call__(self, field: Field) -> Field:
        """Return (A - N) x."""
        on_contact = jnp.where(self.one_sided, field, 0)
        gained = self.lack(on_contact) - self.on_point * total(on_contact)
        return self.hessian(field) + jnp.where(self.one_sided, gained, 0)

    def preconditioner(self, mode: Field, eigenvalue: Scalar) -> FieldMap:
        """Return that of A."""
        return self.hessian.preconditioner(mode, eigenvalue)


def certified_bound(
    solver: Davidson,
    hessian: Hessian,
    cone: AdmissibleCone,
    eigenvalue: Scalar,
    starts: Block,
) -> tuple[Scalar, Int[Array, ""]]:
    """Return a number that the smallest eigenvalue on a cone is not below, and what it cost.

    It is -inf if none is known. The cost is counted in applications, each a pair of transforms.

    Arguments:
        solver: for the linear space around the cone.
        hessian: A.
        cone: the cone.
        eigenvalue: the smallest that was found on it.
        starts: vectors to start from.
    """

    def attempt(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        number, best, cost = state
        problem = bounding_problem(hessian, cone, eigenvalue, starts, number)
        assert problem is not None
        found = solver.solve(problem.operator, problem.domain, problem.starts)
        value, more = bound_by(problem, found)
        return number + 1, jnp.maximum(best, value), cost + more

    def goes_on(state: tuple[Array, Array, Array]) -> Flag:
        number, best, _ = state
        return is_sought(number, best)

    start = jnp.array(0), jnp.full_like(eigenvalue, -jnp.inf), jnp.array(0)
    if bounding_problem(hessian, cone, eigenvalue, starts, start[0]) is None:
        return start[1:]
    _, best, cost = jax.lax.while_loop(goes_on, attempt, start)
    return best, cost


def is_sought(number: Int[Array, ""], best: Scalar) -> Flag:
    """Return whether the share of this number is to be tried, with the best bound so far."""
    return (number < len(SHARES)) & (best <= 0)


def bounding_problem(
    hessian: Hessian,
    cone: AdmissibleCone,
    eigenvalue: Scalar,
    starts: Block,
    number: Int[Array, ""],
) -> ModesProblem | None:
    """Return the problem whose eigenvalue is a bound, by one of the shares, given by its number.

    None where the solid knows of none.
    """
    hull = cone.hull
    restricted = hessian.restricted(hull.is_moving)
    contact = cone.one_sided & hull.is_moving
    size = jnp.maximum(total(contact.astype(eigenvalue.dtype)), 1)
    adhesion = total(jnp.where(contact, hessian.curvature, 0)) / size
    level = jnp.asarray(SHARES, eigenvalue.dtype)[number] * eigenvalue - adhesion
    lacking = restricted.solid.lacking(level)
    if lacking is None:
        return None
    lack, on_point = lacking
    largest = restricted.bound + jnp.maximum(level, 0) + on_point * size
    operator = _Stiffened(
        bound=largest,
        scale=restricted.scale,
        hessian=restricted,
        lack=lack,
        on_point=on_point,
        one_sided=contact,
    )
    return ModesProblem(operator, hull, starts)


def bound_by(problem: ModesProblem, found: Minimum) -> tuple[Scalar, Int[Array, ""]]:
    """Return the bound that was found, and what it cost."""
    pair = measured(problem.operator, problem.domain, found, found.vector[0])
    # A and N are one application here, but two pairs of transforms.
    cost = found.num_applications + (found.num_applications + len(problem.starts)) // 2
    return pair.with_proof(True).bound, cost

"""A proof that the smallest eigenvalue on a cone is positive where that on its hull is not.

Let the perturbations x be >= 0 on the contact C, and N a matrix on C whose entries are >= 0. Then
x.Ax >= x.(A - N)x, and the smallest eigenvalue of A - N on the linear space around the cone is a
lower bound. Points with x <= 0, at which a surface yields, do not count as contact here. With kappa
the kernel in space of an operator that is not negative, N = kappa(0) - kappa(r) is such a matrix.
The operator is max(0, s - K) for a stiffness s. So A - N is stiffer than A in the soft waves of C,
at the price of kappa(0) times the square of the sum on C. For zero mean that is the sum on the free
points.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.contact.hessian import Hessian, SymmetricOperator
from jaxstab.core.compile import program
from jaxstab.core.grid import total
from jaxstab.core.types import Field, FieldMap, Mask, Scalar
from jaxstab.stability.eigenpair import eigenpair_of
from jaxstab.stability.lowest_pair import Lowest
from jaxstab.stability.solvers.base import ConeProblem, SpaceSolver

# Soft waves are stiffened to these parts of the cone's eigenvalue, tried in turn.
_SHARES = (0.5, 0.25)


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
        """Return the preconditioner of A."""
        return self.hessian.preconditioner(mode, eigenvalue)


@program
def certify(solver: SpaceSolver, problem: ConeProblem, found: Lowest, hull: Lowest) -> Lowest:
    """Return the lowest pair found on a cone with a bound that no eigenvalue on it is below.

    The bound rests on the solver, which must not miss the lowest mode of a linear space; it is -inf
    if none is known. Each application of A - N costs two pairs of transforms.
    """
    eigenvalue = found.pair.eigenvalue
    starts = hull.modes
    space = problem.domain.hull
    if _stiffer_hessian(problem, eigenvalue) is None:
        return found
    shares = jnp.array(_SHARES, eigenvalue.dtype)

    def seek(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        number, best, cost = state
        operator = _stiffer_hessian(problem, shares[number] * eigenvalue)
        assert operator is not None
        minimum = solver.solve(operator, space, starts)
        pair = eigenpair_of(operator, space, minimum, minimum.vector[0]).with_proof(True)
        more = minimum.num_applications
        more += (more + len(starts)) // 2
        return number + 1, jnp.maximum(best, pair.bound), cost + more

    # One share after another, until a bound is positive.
    start = jnp.array(0), jnp.full_like(eigenvalue, -jnp.inf), jnp.array(0)
    _, bound, cost = jax.lax.while_loop(
        lambda state: (state[0] < len(_SHARES)) & (state[1] <= 0), seek, start
    )
    return replace(found, pair=found.pair.with_proof(False, bound)).costing(cost)


def _stiffer_hessian(problem: ConeProblem, aim: Scalar) -> _Stiffened | None:
    """Return A - N, of which soft waves are as stiff as is aimed at; None if no N is known."""
    hessian = problem.operator
    cone = problem.domain
    contact = cone.one_sided & cone.is_moving
    if cone.sign is not None:
        contact &= cone.sign > 0
    size = jnp.maximum(total(contact.astype(aim.dtype)), 1)
    adhesion = total(jnp.where(contact, hessian.curvature, 0)) / size
    level = aim - adhesion
    deficit = hessian.solid.stiffness_deficit(level)
    if deficit is None:
        return None
    lack, on_point = deficit
    largest = hessian.bound + jnp.maximum(level, 0) + on_point * size
    return _Stiffened(
        bound=largest,
        scale=hessian.scale,
        hessian=hessian,
        lack=lack,
        on_point=on_point,
        one_sided=contact,
    )

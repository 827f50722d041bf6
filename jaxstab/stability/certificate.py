"""A proof that the smallest eigenvalue on a cone is positive where that on its hull is not.

Let the perturbations x be >= 0 on the contact C, and N a matrix on C whose entries are >= 0. Then
x.Ax >= x.(A - N)x, and the smallest eigenvalue of A - N on the linear space around the cone is a
lower bound. With kappa the kernel in space of an operator that is not negative,
N = kappa(0) - kappa(r) is such a matrix. The operator is max(0, s - K) for a stiffness s. So A - N
is stiffer than A in the soft waves of C, at the price of kappa(0) times the square of the sum on C.
For zero mean that is the sum on the free points.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact.hessian import Block, Hessian, SymmetricOperator
from jaxstab.core.grid import total
from jaxstab.core.procedure import Procedure, Rounds
from jaxstab.core.types import Field, FieldMap, Mask, Scalar
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.solvers.base import ModesProblem
from jaxstab.stability.solvers.davidson import Davidson

# To what part of the cone's eigenvalue soft waves are stiffened, tried in turn.
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
        """Return that of A."""
        return self.hessian.preconditioner(mode, eigenvalue)


class Bounds(Rounds):
    """Bounds that are sought one after another, until one is positive.

    Attributes:
        solver: for the linear space around the cone.
        hessian, cone, eigenvalue, starts: as in `certified_bound`.
        best, cost: the best bound so far, and its cost.
        number: that of the share.
    """

    solver: Davidson
    hessian: Hessian
    cone: AdmissibleCone
    eigenvalue: Scalar
    starts: Block
    best: Scalar
    cost: Int[Array, ""]
    number: Int[Array, ""]

    @property
    def search(self) -> tuple[Davidson, ModesProblem]:
        """The solver, and the problem with this share."""
        share = jnp.asarray(_SHARES, self.eigenvalue.dtype)[self.number]
        operator = _stiffened(self.hessian, self.cone, share * self.eigenvalue)
        assert operator is not None
        return self.solver, ModesProblem(operator, self.cone.hull, self.starts)

    @property
    def found(self) -> tuple[Scalar, Int[Array, ""]]:
        """The best bound, and the cost of all."""
        return self.best, self.cost

    def begun(self) -> "Bounds":
        """Return the search for the bound of this share before its first step."""
        solver, problem = self.search
        loop = solver.begin(problem, self.starts)
        is_sought = (self.number < len(_SHARES)) & (self.best <= 0)
        return replace(self, loops=jax.tree.map(lambda x: x[None], loop), is_on=is_sought[None])

    def turned(self) -> "Bounds":
        """Return the search for the bound of the next share."""
        solver, problem = self.search
        loop = jax.tree.map(lambda leaf: leaf[0], self.loops)
        found = solver.minimum(problem, solver.outcome(loop))
        best = jnp.maximum(self.best, problem.pair(found).bound)
        # A and N are one application here, but two pairs of transforms.
        cost = found.num_applications
        cost += (cost + len(self.starts)) // 2
        return replace(self, best=best, cost=self.cost + cost, number=self.number + 1).begun()


def certified_bound(
    solver: Davidson, hessian: Hessian, cone: AdmissibleCone, eigenvalue: Scalar, starts: Block
) -> Procedure[tuple[Scalar, Int[Array, ""]]]:
    """Return the procedure that finds a number that no eigenvalue on a cone is below.

    It rests on the solver, which must not miss the lowest mode of a linear space.

    Arguments:
        solver: for the linear space around the cone.
        hessian: A.
        cone: the cone.
        eigenvalue: the smallest that was found on it.
        starts: vectors to start from.

    Returns:
        The number, -inf if none is known, and its cost in applications of A, each a pair of
        transforms.
    """
    none, nothing = jnp.full_like(eigenvalue, -jnp.inf), jnp.array(0)
    if _stiffened(hessian, cone, eigenvalue) is None:
        return none, nothing
    return (yield Bounds(solver, hessian, cone, eigenvalue, starts, none, nothing, nothing))


def _stiffened(hessian: Hessian, cone: AdmissibleCone, aim: Scalar) -> _Stiffened | None:
    """Return A - N, of which soft waves are as stiff as is aimed at; None if no N is known."""
    restricted = hessian.restricted(cone.is_moving)
    contact = cone.one_sided & cone.is_moving
    size = jnp.maximum(total(contact.astype(aim.dtype)), 1)
    adhesion = total(jnp.where(contact, hessian.curvature, 0)) / size
    level = aim - adhesion
    lacking = restricted.solid.lacking(level)
    if lacking is None:
        return None
    lack, on_point = lacking
    largest = restricted.bound + jnp.maximum(level, 0) + on_point * size
    return _Stiffened(
        bound=largest,
        scale=restricted.scale,
        hessian=restricted,
        lack=lack,
        on_point=on_point,
        one_sided=contact,
    )

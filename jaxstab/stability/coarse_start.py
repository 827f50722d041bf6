"""Starts on a large grid: the modes of the same problem on one coarser grid.

On a fine grid, modes of rough contacts are smooth except at the edges of contact. A search among
many local minimisers costs least where there are few points. There a point touches where at least
half of the points around it do, and adheres as the mean of those that are like it.
"""

from dataclasses import replace
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxstab.contact.hessian import Block, Hessian
from jaxstab.core import model
from jaxstab.core.accuracy import ROUGH
from jaxstab.core.checks import array, concrete, is_transformed
from jaxstab.core.compile import program
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.eigenpair import Minimum, admissible_pair
from jaxstab.stability.lowest_pair import Cost, Lowest, cone_starts
from jaxstab.stability.solvers.base import ConeProblem, Eigensolver, noise
from jaxstab.stability.solvers.cone_lobpcg import ProjectedLOBPCG

Solver = TypeVar("Solver", bound=Eigensolver)

# The points from which a grid is large: on fewer, the coarser problem does not pay.
LARGE = 2**18
# A coarser problem has at most so many points, but for grids that cannot be halved so often.
COARSE = LARGE // 4
# How far the eigenvalue may lie from the coarser problem's, as a part of it: no other
# minimiser is taken to be lower by more.
_TRUST = 1e-2


def has_coarser(hessian: Hessian) -> bool:
    """Return whether the searches of a problem start from a coarser one; never within a trace."""
    if hessian.solid.grid.size < LARGE or is_transformed(hessian):
        return False
    return jax.eval_shape(lambda: hessian.solid.coarser()) is not None


@program
def coarser(problem: ConeProblem) -> ConeProblem:
    """Return the problem on every other point, of those again, until few points are left."""
    hessian = problem.operator
    cone = problem.domain
    while hessian.solid.grid.size > COARSE and (solid := hessian.solid.coarser()) is not None:
        is_moving = ~_majority(~cone.is_moving)
        curvature = _mean_of_like(hessian.curvature, cone)
        one_sided = _majority(cone.one_sided) & is_moving
        sign = _sign_of_most(cone)
        cone = AdmissibleCone(one_sided, ~is_moving, cone.fixes_mean, sign)
        hessian = Hessian(solid, curvature, hessian.stiffness)
    return ConeProblem.of(hessian, cone)


def roughly(solver: Solver, like: Field) -> Solver:
    """Return a solver with the tolerance for a coarser problem."""
    tolerance = max(float(concrete(solver.tolerance_in(like.dtype))), ROUGH)
    return replace(solver, tolerance=array(tolerance, like.dtype))


@program
def starts_on_space(
    coarse: Minimum, modes: Block, key: PRNGKeyArray, fine: Field
) -> tuple[Block, Cost]:
    """Return a block to start from on a linear space, and its cost.

    The last of its vectors is a random one, in which no mode is missing.
    """
    refined = [_refine(mode, fine) for mode in modes[:-1]]
    return jnp.stack([*refined, *noise(key, 1, fine)]), _cost_of(fine, coarse)


class ConeStart(eqx.Module):
    """The one vector from which a cone is searched.

    Attributes:
        vector: the vector.
        is_needed: whether it is one.
        is_known: whether it is the answer, or there is none; then no coarser problem is solved.
        expected: the eigenvalue of the coarser problem, with which the one found has to agree.
        cost: of the vector.
    """

    vector: Field
    is_needed: Flag
    is_known: Flag
    expected: Scalar
    cost: Cost


@program
def start_from_hull(solver: ProjectedLOBPCG, cone: AdmissibleCone, hull: Lowest) -> ConeStart:
    """Return the lowest mode around a cone as the start on it, and whether it is the answer."""
    starts, _, is_proved_lowest = cone_starts(
        solver, cone, hull.pair.result, hull.modes, hull.modes[:0]
    )
    is_known = is_proved_lowest | cone.is_trivial
    unknown = jnp.full_like(hull.pair.eigenvalue, jnp.nan)
    none = jnp.array(0)
    return ConeStart(starts[0], jnp.array(True), is_known, unknown, (none, none))


@program
def start_from_coarse(
    problem: ConeProblem, coarse_hull: Minimum, coarse: Minimum, fine: Field
) -> ConeStart:
    """Return the mode of a coarser problem as the start on a cone, at the cost of two searches."""
    eigenvalue, mode, _ = admissible_pair(problem.operator, problem.domain, coarse.vector)
    no = jnp.array(False)
    cost = _cost_of(fine, coarse_hull, coarse)
    return ConeStart(_refine(mode, fine), jnp.any(mode != 0), no, eigenvalue, cost)


@program
def mode_from(
    solver: ProjectedLOBPCG, problem: ConeProblem, start: ConeStart
) -> tuple[Minimum, Flag]:
    """Return the mode on a cone that one start leads to, and whether that was the answer."""
    starts = start.vector[None]
    found = solver.solve(problem.operator, problem.domain, starts, start.is_needed[None])
    return found, start.is_known


def is_trusted(start: ConeStart, found: Lowest) -> bool:
    """Return whether the pair that one start has led to is the lowest, outside of a trace."""
    eigenvalue = float(found.pair.eigenvalue)
    agrees = abs(eigenvalue - float(start.expected)) <= _TRUST * abs(eigenvalue)
    return bool(start.is_known) or (bool(start.is_needed) and agrees)


def _cost_of(fine: Field, *searches: Minimum) -> Cost:
    """Return the number of applications on all points that cost as much as those of searches."""
    none = jnp.array(0)
    shares = (-(-found.num_applications // (fine.size // found.vector.size)) for found in searches)
    return none, sum(shares, none)


def _majority(mask: Mask) -> Bool[Array, " *coarse"]:
    """Return where at least half of the points of a cell of the coarser grid are in a mask."""
    cells = _cells(mask)
    return 2 * jnp.sum(cells, axis=0) >= len(cells)


def _sign_of_most(cone: AdmissibleCone) -> Float[Array, " *coarse"] | None:
    """Return the sign of most of the one-sided points of a cell, None where all are positive."""
    if cone.sign is None:
        return None
    signs = jnp.where(cone.one_sided, cone.sign, 0)
    return jnp.where(jnp.sum(_cells(signs), axis=0) < 0, -1, 1).astype(signs.dtype)


def _mean_of_like(field: Field, cone: AdmissibleCone) -> Float[Array, " *coarse"]:
    """Return the mean over the points of a cell that move, and touch or do not touch as most do."""
    touches = cone.one_sided | ~cone.is_moving
    like = (_cells(touches) == _majority(touches)) & _cells(cone.is_moving)
    count = jnp.maximum(jnp.sum(like, axis=0), 1)
    return jnp.sum(jnp.where(like, _cells(field), 0), axis=0) / count


def _refine(field: Float[Array, " *coarse"], fine: Field) -> Field:
    """Return a mode of the coarser grid at all points, a unit vector again."""
    for axis, number in enumerate(fine.shape):
        field = jnp.repeat(field, number // field.shape[axis], axis=axis)
    return model.onto_sphere(field)


def _cells(field: Array) -> Array:
    """Return a field as one of cells of the coarser grid, whose points are along a first axis."""
    pairs = field.reshape([n for side in field.shape for n in (side // 2, 2)])
    cells = jnp.moveaxis(pairs, range(1, pairs.ndim, 2), range(field.ndim))
    return cells.reshape(-1, *(n // 2 for n in field.shape))

"""Starts on a large grid: the modes of the same problem on every other point.

On a fine grid, modes of rough contacts are smooth except at the edges of contact. A search among
many local minimisers costs least where there are few points. There a point touches where at least
half of the points around it do, and adheres as the mean of those that are like it.
"""

from dataclasses import replace
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxstab.contact.hessian import Block, Hessian
from jaxstab.core import model
from jaxstab.core.compile import program
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import admissible_pair
from jaxstab.stability.lowest_pair import Lowest, cone_starts, on_cone, on_space
from jaxstab.stability.solvers.base import BLOCK_SIZE, NUM_RANDOM, Eigensolver, SpaceSolver, noise
from jaxstab.stability.solvers.cone_lobpcg import ProjectedLOBPCG

Solver = TypeVar("Solver", bound=Eigensolver)

# The points from which a grid is large: on fewer, compiling the coarser problems does not pay.
_LARGE = 2**18
# The points below which there is no coarser problem: contacts would be missed.
_FEWEST = 2**14
# The residual to which a coarser problem is solved at most.
_TOLERANCE = 1e-4
# How far the eigenvalue may lie from the coarser problem's, as a part of it: no other
# minimiser is taken to be lower by more.
_TRUST = 1e-2


def is_large(hessian: Hessian) -> bool:
    """Return whether the searches of a problem start from a coarser one."""
    return hessian.solid.grid.size >= _LARGE and _has_coarser(hessian)


def modes_by_coarser(
    solver: SpaceSolver, hessian: Hessian, space: Subspace, key: PRNGKeyArray
) -> tuple[Block, Int[Array, ""]]:
    """Return a block to start from on a linear space, and its cost in applications of A.

    The last of its vectors is a random one, in which no mode is missing.
    """
    fine, nowhere = hessian.curvature, jnp.zeros_like(space.is_moving)
    cone = AdmissibleCone(nowhere, ~space.is_moving, space.fixes_mean)
    hessian, cone = _coarser(hessian, cone)
    rough = _roughly(solver, fine)
    if _has_coarser(hessian):
        starts, cost = modes_by_coarser(rough, hessian, cone.hull, key)
    else:
        starts, cost = noise(key, BLOCK_SIZE, hessian.curvature), jnp.array(0)
    found = on_space(rough, hessian, cone.hull, starts)
    modes = jnp.stack([*map(_refined, found.modes[:-1]), *noise(key, 1, fine)])
    return modes, _share_of(cost + found.pair.num_applications, space)


@program
def lowest_by_coarser(
    spaces: SpaceSolver,
    solver: ProjectedLOBPCG,
    hessian: Hessian,
    cone: AdmissibleCone,
    hull: Lowest,
    key: PRNGKeyArray,
) -> tuple[Lowest, Flag]:
    """Return the pair on a cone that the coarser problem's mode leads to, and whether to trust it.

    It agrees with the coarser problem, or the lowest mode around the cone is the answer. This is a
    program of its own, as the search from all starts takes the memory of them all.
    """
    starts, _, is_answer = cone_starts(solver, cone, hull, hull.modes[:0])
    is_known = is_answer | cone.is_trivial
    guess, coarser, cost = jax.lax.cond(
        is_known,
        lambda: (starts[0], jnp.zeros_like(hull.pair.eigenvalue), jnp.array(0)),
        lambda: mode_by_coarser(spaces, solver, hessian, cone, key),
    )
    is_start = jnp.any(guess != 0)
    starts = guess[None], is_start[None], is_answer
    lowest = on_cone(solver, hessian, cone, hull, starts).costing(cost)
    eigenvalue = lowest.pair.eigenvalue
    agrees = is_start & (jnp.abs(eigenvalue - coarser) <= _TRUST * jnp.abs(eigenvalue))
    return lowest, is_known | agrees


def mode_by_coarser(
    spaces: SpaceSolver,
    solver: ProjectedLOBPCG,
    hessian: Hessian,
    cone: AdmissibleCone,
    key: PRNGKeyArray,
) -> tuple[Field, Scalar, Int[Array, ""]]:
    """Return a vector to start from on a cone, its eigenvalue on the coarser grid, and its cost.

    It is zero where the coarser problem has no mode. The cost is in applications of A.
    """
    hull = cone.hull
    hessian, cone = _coarser(hessian, cone)
    like = hessian.curvature
    spaces, rough = _roughly(spaces, like), _roughly(solver, like)
    if _has_coarser(hessian):
        start, _, cost = mode_by_coarser(spaces, rough, hessian, cone, key)
        starts, is_needed = start[None], jnp.array([True])
    else:
        random = noise(key, NUM_RANDOM, like)
        around = on_space(spaces, hessian, cone.hull, random[:BLOCK_SIZE])
        starts, is_needed, _ = cone_starts(rough, cone, around, random)
        cost = around.pair.num_applications
    restricted = hessian.restricted(cone.is_moving)
    found = rough.solve(restricted, cone, starts, is_needed)
    eigenvalue, mode, _ = admissible_pair(restricted, cone, found.vector)
    return _refined(mode), eigenvalue, _share_of(cost + found.num_applications + 1, hull)


def _has_coarser(hessian: Hessian) -> bool:
    solid = hessian.solid
    if solid.grid.size < 4 * _FEWEST:
        return False
    return jax.eval_shape(lambda: solid.coarser()) is not None


def _roughly(solver: Solver, like: Field) -> Solver:
    """Return a solver with the tolerance for a coarser problem."""
    return replace(solver, tolerance=jnp.maximum(solver.tolerance_in(like.dtype), _TOLERANCE))


def _share_of(cost: Int[Array, ""], fine: Subspace) -> Int[Array, ""]:
    """Return the number of applications on all points that cost as much as some on the coarser."""
    return -(-cost // 2**fine.is_moving.ndim)


def _coarser(hessian: Hessian, cone: AdmissibleCone) -> tuple[Hessian, AdmissibleCone]:
    solid = hessian.solid.coarser()
    assert solid is not None
    is_moving = ~_majority(~cone.is_moving)
    curvature = _mean_of_like(hessian.curvature, cone.one_sided | ~cone.is_moving)
    coarser = AdmissibleCone(_majority(cone.one_sided) & is_moving, ~is_moving, cone.fixes_mean)
    return Hessian(solid, curvature, hessian.stiffness), coarser


def _majority(mask: Mask) -> Bool[Array, " *coarse"]:
    """Return where at least half of the points of a cell of the coarser grid are in a mask."""
    cells = _cells(mask)
    return 2 * jnp.sum(cells, axis=0) >= len(cells)


def _mean_of_like(field: Field, mask: Mask) -> Float[Array, " *coarse"]:
    """Return the mean over the points of a cell that are in a mask, or out of it, as most are."""
    like = _cells(mask) == _majority(mask)
    return jnp.sum(jnp.where(like, _cells(field), 0), axis=0) / jnp.sum(like, axis=0)


def _refined(field: Float[Array, " *coarse"]) -> Field:
    """Return a mode of the coarser grid at all points, a unit vector again."""
    for axis in range(field.ndim):
        field = jnp.repeat(field, 2, axis=axis)
    return model.onto_sphere(field)


def _cells(field: Array) -> Array:
    """Return a field as one of cells of the coarser grid, whose points are along a first axis."""
    pairs = field.reshape([n for side in field.shape for n in (side // 2, 2)])
    cells = jnp.moveaxis(pairs, range(1, pairs.ndim, 2), range(field.ndim))
    return cells.reshape(-1, *(n // 2 for n in field.shape))

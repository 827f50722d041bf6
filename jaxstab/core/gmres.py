"""Solutions of linear equations whose operator is neither symmetric nor positive: GMRES.

Y. Saad and M. H. Schultz, SIAM J. Sci. Stat. Comput. 7, 856 (1986). JAX's implementation takes 1.7
to 2.5 times as long here: it orthogonalizes against its whole buffer, twice.
"""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from jaxstab.core.types import Scalar

Tree = TypeVar("Tree")
Vector = Float[Array, " unknowns"]

_NUM_VECTORS = 30


class _Space(eqx.Module):
    """A Krylov space: orthonormal vectors, one more than columns of the Hessenberg matrix.

    `null` is orthogonal to these columns, and begins with 1. The least residual is the start's
    over its norm.
    """

    vectors: Float[Array, "room+1 unknowns"]
    hessenberg: Float[Array, "room+1 room"]
    null: Float[Array, " room+1"]
    count: Int[Array, ""]


def gmres(
    operator: Callable[[Tree], Tree], right: Tree, residual: Scalar, max_restarts: int
) -> Tree:
    """Solve A x = b by restarted GMRES, or return the last iterate.

    Arguments:
        operator: A, a linear function of a pytree of fields.
        right: b.
        residual: |b - A x| to reach.
        max_restarts: the limit on cycles of 30 vectors.
    """
    b, unravel = ravel_pytree(right)

    def product(vector: Vector) -> Vector:
        return ravel_pytree(operator(unravel(vector)))[0]

    def goes_on(state: tuple[Vector, Vector, Array]) -> Array:
        _, left, count = state
        return (jnp.linalg.norm(left) > residual) & (count < max_restarts)

    def cycle(state: tuple[Vector, Vector, Array]) -> tuple[Vector, Vector, Array]:
        solution, left, count = state
        change, left = _cycle(product, left, residual)
        return solution + change, left, count + 1

    start = jnp.zeros_like(b), b, jnp.array(0)
    return unravel(jax.lax.while_loop(goes_on, cycle, start)[0])


def _cycle(
    operator: Callable[[Vector], Vector], left: Vector, wanted: Scalar
) -> Float[Array, "two unknowns"]:
    """Return the vector of the Krylov space that minimizes the residual, and the residual then."""
    norm = jnp.linalg.norm(left)
    vectors = jnp.zeros((_NUM_VECTORS + 1, left.size), left.dtype)
    vectors = vectors.at[0].set(left / norm)
    hessenberg = jnp.zeros((_NUM_VECTORS + 1, _NUM_VECTORS), left.dtype)
    first = jnp.zeros(_NUM_VECTORS + 1, left.dtype).at[0].set(1)

    def goes_on(space: _Space) -> Array:
        reached = norm / jnp.linalg.norm(space.null)
        return (reached > wanted) & (space.count < _NUM_VECTORS)

    start = _Space(vectors, hessenberg, first, jnp.array(0))
    space = jax.lax.while_loop(goes_on, partial(_arnoldi_step, operator), start)
    # Columns that are not used are zero, and so are their parts.
    parts = jnp.linalg.lstsq(space.hessenberg, norm * first)[0]
    # The residual lies in the space too: no other product with A is needed.
    residual = norm * first - space.hessenberg @ parts
    both = jnp.stack([jnp.append(parts, 0), residual])
    return jnp.matmul(both, space.vectors, precision="highest")


def _arnoldi_step(operator: Callable[[Vector], Vector], space: _Space) -> _Space:
    """Extend a Krylov space by one Arnoldi step."""
    last = space.count

    def part(index: Array, state: tuple[Vector, Array]) -> tuple[Vector, Array]:
        vector, column = state
        other = space.vectors[index]
        overlap = jnp.vdot(other, vector)
        return vector - overlap * other, column.at[index].set(overlap)

    start = operator(space.vectors[last]), jnp.zeros_like(space.null)
    vector, column = jax.lax.fori_loop(0, last + 1, part, start)
    norm = jnp.linalg.norm(vector)
    unit = jnp.where(norm > 0, norm, 1)
    # Without a new vector the solution is in the space.
    null = jnp.where(norm > 0, -jnp.vdot(space.null, column) / unit, jnp.inf)
    return _Space(
        space.vectors.at[last + 1].set(vector / unit),
        space.hessenberg.at[:, last].set(column.at[last + 1].set(norm)),
        space.null.at[last + 1].set(null),
        last + 1,
    )

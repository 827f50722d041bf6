"""Several fields at once: their inner products, combinations, and lowest Ritz vectors.

An eigensolver spends its time moving fields through memory, so each is read as seldom as
can be.
"""

from collections.abc import Sequence
from functools import reduce

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.contact.hessian import Block
from jaxstab.core.control_flow import on_platform
from jaxstab.core.grid import totals
from jaxstab.core.types import Field


def inner_products(block: Block, *fields: Field) -> Float[Array, "fields block"]:
    """Return the inner products of every vector of a block with each of some fields."""
    sums = totals([vector * field for field in fields for vector in block])
    return sums.reshape(len(fields), len(block))


def combination(parts: Float[Array, " block"], block: Block | Sequence[Field]) -> Field:
    """Return a linear combination of the vectors of a block, or of a few fields."""
    if isinstance(block, Sequence):
        return reduce(jnp.add, (part * field for part, field in zip(parts, block, strict=True)))
    return jnp.tensordot(parts, block, 1, precision="highest")


def combinations(parts: Float[Array, "block count"], *blocks: Block) -> tuple[Block, ...]:
    """Return linear combinations of the vectors of each block, zero beyond their number."""
    room = parts.shape[0] - parts.shape[1]
    combined = (jnp.tensordot(parts.T, block, 1, precision="highest") for block in blocks)
    return tuple(jnp.pad(block, [(0, room)] + [(0, 0)] * (block.ndim - 1)) for block in combined)


def norms(block: Block | Sequence[Field]) -> Float[Array, " block"]:
    """Return the Euclidean norms of the vectors of a block."""
    return jnp.sqrt(totals([vector**2 for vector in block]))


def rayleigh_ritz(
    axes: Float[Array, "block block"], energies: Float[Array, "block block"], count: int
) -> tuple[Float[Array, " count"], Float[Array, "block count"]]:
    """Return the lowest Ritz values of A on a basis, and their vectors in terms of it.

    Given are orthonormal vectors in terms of the basis, a column each or zero, and the inner
    products of the basis vectors with A times each. Where too few columns are not zero, Ritz values
    lie above all others, and their vectors are zero.
    """
    matrix = axes.T @ ((energies + energies.T) / 2) @ axes
    far = 2 * jnp.sum(jnp.abs(matrix)) + jnp.finfo(matrix.dtype).tiny
    is_zero = jnp.all(axes == 0, axis=0)
    eigenvalues, vectors = _eigh(matrix + jnp.diag(jnp.where(is_zero, far, 0)))
    return eigenvalues[:count], (axes @ vectors)[:, :count]


def orthonormal(
    part: Float[Array, " block"],
    axes: Float[Array, "block columns"],
    gram: Float[Array, "block block"],
    least: float,
) -> Float[Array, " block"]:
    """Return a vector made orthogonal to others, and of unit norm, all in terms of a basis.

    It is zero where less than a part of its norm is left.

    Arguments:
        part: the vector.
        axes: the others, orthonormal columns.
        gram: the inner products of the basis vectors.
        least: that part.
    """
    square = part @ gram @ part
    for _ in range(2):
        part -= axes @ (axes.T @ (gram @ part))
    rest = part @ gram @ part
    is_new = rest > least**2 * square
    return jnp.where(is_new, part / jnp.sqrt(jnp.where(is_new, rest, 1)), 0)


def least_new(dtype: jnp.dtype) -> float:
    """Return the least part of a basis vector apart from the others: below, products are noise."""
    return float(jnp.finfo(dtype).eps) ** (3 / 8)


def _eigh(matrix: Float[Array, "block block"]) -> tuple[Array, Array]:
    """Return the eigenvalues and eigenvectors of a small symmetric matrix."""
    return on_platform(lambda matrix: tuple(jnp.linalg.eigh(matrix)), _eigh_of_two, matrix)


def _eigh_of_two(matrix: Float[Array, "block block"]) -> tuple[Array, Array]:
    # CUDA decomposes several small matrices in one kernel, but one alone in hundreds.
    eigenvalues, vectors = jnp.linalg.eigh(jnp.stack([matrix, matrix]))
    return eigenvalues[0], vectors[0]

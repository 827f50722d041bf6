"""Several fields at once: their inner products, combinations, and lowest Ritz vectors.

An eigensolver spends its time moving fields through memory, so each is read as seldom as
can be.
"""

from collections.abc import Sequence
from functools import reduce

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.contact.hessian import Block
from jaxstab.core.batching import on_platform
from jaxstab.core.grid import totals
from jaxstab.core.types import Field


def inner_products(block: Block, *fields: Field) -> Float[Array, "fields block"]:
    """Return the inner products of every vector of a block with each of some fields."""
    sums = totals([vector * field for field in fields for vector in block])
    return sums.reshape(len(fields), len(block))


def combination(parts: Float[Array, " block"], block: Block | Sequence[Field]) -> Field:
    """Return a linear combination of the vectors of a block."""
    return reduce(jnp.add, (part * vector for part, vector in zip(parts, block, strict=True)))


def combinations(parts: Float[Array, "block count"], *blocks: Block) -> tuple[Block, ...]:
    """Return linear combinations of the vectors of each block, zero beyond their number."""
    room = parts.shape[0] - parts.shape[1]
    combined = (jnp.tensordot(parts.T, block, 1, precision="highest") for block in blocks)
    return tuple(jnp.pad(block, [(0, room)] + [(0, 0)] * (block.ndim - 1)) for block in combined)


def norms(block: Block | Sequence[Field]) -> Float[Array, " block"]:
    """Return the Euclidean norms of the vectors of a block."""
    return jnp.sqrt(totals([vector**2 for vector in block]))


def rayleigh_ritz(
    gram: Float[Array, "block block"], energies: Float[Array, "block block"], count: int
) -> tuple[Float[Array, " count"], Float[Array, "block count"]]:
    """Return the lowest Ritz values of A on a basis, and their vectors in terms of it.

    Vectors of the basis may be zero or depend on each other. Where too few are left, Ritz values
    lie above all others, and their vectors are zero. Given are the inner products of the basis
    vectors with each other, and with A times each.
    """
    norms = jnp.sqrt(jnp.diagonal(gram))
    scale = jnp.where(norms > 0, 1 / jnp.where(norms > 0, norms, 1), 0)
    weights, axes = _eigh(scale[:, None] * gram * scale)
    independent = weights > jnp.finfo(gram.dtype).eps ** 0.75 * jnp.max(weights)
    roots = jnp.sqrt(jnp.where(independent, weights, 1))
    to_basis = scale[:, None] * axes * jnp.where(independent, 1 / roots, 0)
    matrix = to_basis.T @ ((energies + energies.T) / 2) @ to_basis
    far = 2 * jnp.sum(jnp.abs(matrix)) + jnp.finfo(matrix.dtype).tiny
    eigenvalues, vectors = _eigh(matrix + jnp.diag(jnp.where(independent, 0, far)))
    return eigenvalues[:count], (to_basis @ vectors)[:, :count]


def _eigh(matrix: Float[Array, "block block"]) -> tuple[Array, Array]:
    """Return the eigenvalues and eigenvectors of a small symmetric matrix."""
    return on_platform(lambda matrix: tuple(jnp.linalg.eigh(matrix)), _eigh_of_two, matrix)


def _eigh_of_two(matrix: Float[Array, "block block"]) -> tuple[Array, Array]:
    # CUDA decomposes several small matrices in one kernel, but one alone in hundreds.
    eigenvalues, vectors = jnp.linalg.eigh(jnp.stack([matrix, matrix]))
    return eigenvalues[0], vectors[0]

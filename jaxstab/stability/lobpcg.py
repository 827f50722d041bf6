"""The lowest modes on a linear space: locally optimal block preconditioned conjugate gradients.

After A. V. Knyazev, SIAM J. Sci. Comput. 23 (2001) 517. A step takes the block of modes, their
preconditioned residuals and their last moves, and keeps the lowest Ritz vectors of the three.
"""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.grid import total
from jaxstab.hessian import Block, SymmetricOperator
from jaxstab.iterate import Indicators, optional_parameter
from jaxstab.stability.cones import Subspace
from jaxstab.stability.solver import Minimum, SpaceSolver


class _State(eqx.Module):
    eigenvalues: Float[Array, " block"]
    modes: Block
    products: Block
    moves: Block
    move_products: Block
    residuals: Block


class LOBPCG(SpaceSolver):
    """Locally optimal block preconditioned conjugate gradients, on a linear space.

    Arguments:
        tolerance: the residual |P(A x - lambda x)| / s of a unit vector to reach, P the projection
            onto the space and s the size of A on its lower modes; by default 1e-7 in float64 and
            1e-5 in float32.
        max_steps: the step limit, 5000 by default.
    """

    tolerance: Float[Array, ""] | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=5000)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-7, "float32": 1e-5}

    def solve(
        self, operator: SymmetricOperator, space: Subspace, starts: Block, count: int = 1
    ) -> Minimum:
        """Return the modes of a block, as `SpaceSolver` says."""
        size = len(starts)
        scale = operator.scale
        apply, precondition = jax.vmap(operator), jax.vmap(operator.precondition)
        project = jax.vmap(space.project)

        def ritz(basis: Block, products: Block) -> _State:
            gram, energies = inner_products(basis, basis), inner_products(basis, products)
            eigenvalues, parts = rayleigh_ritz(gram, energies, size)
            modes, products_ = combine(parts, basis), combine(parts, products)
            moves = parts.at[:size].set(0)
            return _State(
                eigenvalues,
                modes,
                products_,
                combine(moves, basis),
                combine(moves, products),
                project(products_ - _column(eigenvalues, modes) * modes),
            )

        def step(state: _State) -> _State:
            steepest = project(precondition(state.residuals, state.modes, state.eigenvalues))
            for _ in range(2):
                # Once is not enough where they are nearly parallel to the modes.
                steepest = normalised(steepest)
                steepest -= combine(inner_products(state.modes, steepest), state.modes)
            steepest = normalised(project(steepest))
            lengths = _column(_inverse_norms(state.moves), state.moves)
            return ritz(
                jnp.concatenate([state.modes, steepest, lengths * state.moves]),
                jnp.concatenate([state.products, apply(steepest), lengths * state.move_products]),
            )

        def measure(state: _State) -> Indicators:
            squares = jax.vmap(total)((state.residuals[:count] / scale) ** 2)
            return {"residual": jnp.sqrt(jnp.max(squares))}

        starts = normalised(project(starts))
        iteration = self.iterate(step, measure, ritz(starts, apply(starts)))
        return Minimum(
            vector=iteration.state.modes,
            num_steps=iteration.num_steps,
            num_applications=size * (1 + 2 * iteration.num_steps),
            result=iteration.result,
            history=iteration.history,
        )


def rayleigh_ritz(
    gram: Float[Array, "block block"], energies: Float[Array, "block block"], count: int
) -> tuple[Float[Array, " count"], Float[Array, "block count"]]:
    """Return the lowest Ritz values of A on a basis, and their vectors in terms of it.

    Vectors of the basis may be zero or depend on each other. Where too few are left, Ritz values
    lie above all others, and their vectors are zero.

    Arguments:
        gram: the inner products of the basis vectors.
        energies: those with A times each of them.
        count: how many to return.
    """
    norms = jnp.sqrt(jnp.diagonal(gram))
    scale = jnp.where(norms > 0, 1 / jnp.where(norms > 0, norms, 1), 0)
    weights, axes = jnp.linalg.eigh(scale[:, None] * gram * scale)
    independent = weights > jnp.finfo(gram.dtype).eps ** 0.75 * jnp.max(weights)
    roots = jnp.sqrt(jnp.where(independent, weights, 1))
    to_basis = scale[:, None] * axes * jnp.where(independent, 1 / roots, 0)
    matrix = to_basis.T @ ((energies + energies.T) / 2) @ to_basis
    far = 2 * jnp.sum(jnp.abs(matrix)) + jnp.finfo(matrix.dtype).tiny
    eigenvalues, vectors = jnp.linalg.eigh(matrix + jnp.diag(jnp.where(independent, 0, far)))
    return eigenvalues[:count], (to_basis @ vectors)[:, :count]


def inner_products(left: Block, right: Block) -> Float[Array, "left right"]:
    """Return the inner product of every vector of one block with every one of another."""
    return jnp.matmul(_rows(left), _rows(right).T, precision="highest")


def combine(parts: Float[Array, "block count"], basis: Block) -> Block:
    """Return linear combinations of the vectors of a basis."""
    combined = jnp.matmul(parts.T, _rows(basis), precision="highest")
    return combined.reshape(-1, *basis.shape[1:])


def normalised(block: Block) -> Block:
    """Return the vectors of a block scaled to unit length, zero where they are zero."""
    return _column(_inverse_norms(block), block) * block


def norms(block: Block) -> Float[Array, " block"]:
    """Return the Euclidean norms of the vectors of a block."""
    return jnp.sqrt(jax.vmap(total)(block**2))


def _inverse_norms(block: Block) -> Float[Array, " block"]:
    lengths = norms(block)
    return jnp.where(lengths == 0, 0, 1 / jnp.where(lengths == 0, 1, lengths))


def _rows(block: Block) -> Float[Array, "block points"]:
    return block.reshape(len(block), -1)


def _column(values: Float[Array, " block"], like: Block) -> Block:
    return values.reshape(-1, *(1,) * (like.ndim - 1))

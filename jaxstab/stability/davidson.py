"""The lowest modes on a linear space: Davidson's method, restarted with the last move.

The generalised method of R. B. Morgan and D. S. Scott, SIAM J. Sci. Stat. Comput. 7 (1986) 817,
with the locally optimal restart of A. Stathopoulos, SIAM J. Sci. Comput. 29 (2007) 481: a step
widens the space of the lowest Ritz vectors and the last move by preconditioned residuals, one
after another, and keeps the lowest Ritz vectors of it all.
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
from jaxstab.stability.blocks import (
    combination,
    combinations,
    inner_products,
    norms,
    rayleigh_ritz,
    scaled_to_unit,
)
from jaxstab.stability.cones import Subspace
from jaxstab.stability.solver import Minimum, SpaceSolver

# Residuals by which a step widens its space.
_NUM_RESIDUALS = 3


class _Span(eqx.Module):
    """A space by vectors and P A times each, zero where unused, and their inner products."""

    basis: Block
    products: Block
    gram: Float[Array, "room room"]
    energies: Float[Array, "room room"]

    @classmethod
    def empty(cls, room: int, like: Float[Array, " *grid"]) -> "_Span":
        """Return a space with room for a number of vectors."""
        block = jnp.zeros((room, *like.shape), like.dtype)
        matrix = jnp.zeros((room, room), like.dtype)
        return cls(block, block, matrix, matrix)

    def with_vector(
        self,
        slot: Int[Array, ""] | int,
        vector: Float[Array, " *grid"],
        operator: SymmetricOperator,
        space: Subspace,
    ) -> "_Span":
        """Return the space with another vector, made a unit one orthogonal to the rest."""
        *overlaps, square = inner_products([*self.basis, vector], vector)
        rest = space.project(vector - combination(overlaps, self.basis))
        # None, where what is left is little more than rounding.
        is_new = total(rest**2) > _rounding(square.dtype) ** 2 * square
        vector = jnp.where(is_new, scaled_to_unit(rest), 0)
        product = space.project(operator(vector))
        basis, products = self.basis.at[slot].set(vector), self.products.at[slot].set(product)
        # Orthogonal only to rounding.
        overlaps, energies = jnp.split(inner_products([*basis, *products], vector), 2)
        return _Span(
            basis,
            products,
            self.gram.at[slot].set(overlaps).at[:, slot].set(overlaps),
            self.energies.at[slot].set(energies).at[:, slot].set(energies),
        )

    def spanned_by(self, parts: Float[Array, "room kept"]) -> "_Span":
        """Return the space of some combinations of its vectors, with the same room."""
        room, kept = parts.shape
        basis, products = combinations(parts, self.basis, self.products)
        parts = jnp.pad(parts, ((0, 0), (0, room - kept)))
        return _Span(basis, products, parts.T @ self.gram @ parts, parts.T @ self.energies @ parts)


# A space, the Ritz vectors in it of the last two, and the eigenvalue of the last.
_Widening = tuple[_Span, Array, Array, Array]


class _State(eqx.Module):
    span: _Span
    eigenvalues: Float[Array, " count"]
    residuals: Float[Array, " count"]


class Davidson(SpaceSolver):
    """Davidson's method with a locally optimal restart, on a linear space.

    Arguments:
        tolerance: the residual |P(A x - lambda x)| / s of a unit vector to reach, P the projection
            onto the space and s the size of A on its lower modes; by default 1e-7 in float64 and
            1e-5 in float32.
        max_steps: the step limit, 5000 by default; a step takes three residuals.
    """

    tolerance: Float[Array, ""] | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=5000)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-7, "float32": 1e-5}

    def solve(
        self, operator: SymmetricOperator, space: Subspace, starts: Block, count: int = 1
    ) -> Minimum:
        """Return the modes of a block, as `SpaceSolver` says."""
        size = len(starts)
        tolerance = self.tolerance_in(starts.dtype)

        def restarted(span: _Span, last: Array) -> _State:
            """Keep the lowest Ritz vectors, and the part of another vector apart from them."""
            eigenvalues, parts = rayleigh_ritz(span.gram, span.energies, size)
            square = last @ span.gram @ last
            for _ in range(2):
                last -= parts @ (parts.T @ (span.gram @ last))
            rest = last @ span.gram @ last
            is_new = rest > _rounding(square.dtype) ** 2 * square
            last = jnp.where(is_new, last / jnp.sqrt(jnp.where(is_new, rest, 1)), 0)
            span = span.spanned_by(jnp.column_stack([parts, last]))
            residuals = [span.products[i] - eigenvalues[i] * span.basis[i] for i in range(count)]
            return _State(span, eigenvalues[:count], norms(residuals) / operator.scale)

        def step(state: _State) -> _State:
            target = jnp.argmax(state.residuals > tolerance)
            eigenvalue = state.eigenvalues[target]
            precondition = operator.preconditioner(state.span.basis[target], eigenvalue)

            def widen(index: Array, carry: _Widening) -> _Widening:
                span, _, parts, eigenvalue = carry
                mode, product = combination(parts, span.basis), combination(parts, span.products)
                steepest = precondition(product - eigenvalue * mode)
                span = span.with_vector(size + 1 + index, steepest, operator, space)
                eigenvalues, ritz = rayleigh_ritz(span.gram, span.energies, size)
                return span, parts, ritz[:, target], eigenvalues[target]

            parts = jnp.zeros(len(state.span.basis), starts.dtype).at[target].set(1)
            start = state.span, parts, parts, eigenvalue
            span, last, *_ = jax.lax.fori_loop(0, _NUM_RESIDUALS, widen, start)
            return restarted(span, last)

        def measure(state: _State) -> Indicators:
            return {"residual": jnp.max(state.residuals)}

        span = jax.lax.fori_loop(
            0,
            size,
            lambda slot, span: span.with_vector(slot, starts[slot], operator, space),
            _Span.empty(size + 1 + _NUM_RESIDUALS, starts[0]),
        )
        start = restarted(span, jnp.zeros(len(span.basis), starts.dtype))
        iteration = self.iterate(step, measure, start)
        return Minimum(
            vector=iteration.state.span.basis[:size],
            num_steps=iteration.num_steps,
            num_applications=size + 2 * _NUM_RESIDUALS * iteration.num_steps,
            result=iteration.result,
            history=iteration.history,
        )


def _rounding(dtype: jnp.dtype) -> float:
    """Return what part of a vector, orthogonal to all others, may be rounding."""
    return float(jnp.finfo(dtype).eps) ** (2 / 3)

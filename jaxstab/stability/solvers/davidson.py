"""The lowest modes on a linear space: Davidson's method, restarted with the last move.

The generalised method of R. B. Morgan and D. S. Scott, SIAM J. Sci. Stat. Comput. 7 (1986) 817,
with the locally optimal restart of A. Stathopoulos, SIAM J. Sci. Comput. 29 (2007) 481: a step
widens the space of the lowest Ritz vectors and the last move by preconditioned residuals, one
after another, and keeps the lowest Ritz vectors of it all.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.contact.hessian import Block, SymmetricOperator
from jaxstab.core.accuracy import EIGENPAIR
from jaxstab.core.checks import as_array
from jaxstab.core.control_flow import either, on_platform, with_entry
from jaxstab.core.grid import total
from jaxstab.core.history import Indicators
from jaxstab.core.loop import Iteration, optional_parameter
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.stability.cones import Subspace
from jaxstab.stability.eigenpair import Minimum
from jaxstab.stability.ritz import (
    combination,
    combinations,
    inner_products,
    least_new,
    norms,
    orthonormal,
    rayleigh_ritz,
)
from jaxstab.stability.solvers.base import ModesProblem, SpaceSolver

# Residuals by which a step widens its space.
_NUM_RESIDUALS = 3
# Below this multiple of the rounding of A x a residual has no reliable direction.
_NOISE = 100


class Span(eqx.Module):
    """A space by vectors and P A times each, zero where unused, their inner products, and an
    orthonormal basis in terms of the vectors.
    """

    basis: Block
    products: Block
    gram: Float[Array, "room room"]
    energies: Float[Array, "room room"]
    axes: Float[Array, "room room"]

    def with_vector(
        self,
        slot: Int[Array, ""],
        vector: Field,
        operator: SymmetricOperator,
        space: Subspace,
        is_noise: Flag,
    ) -> "Span":
        """Return the space with another vector, made orthogonal to the rest if it may be noise.

        That reads them all twice. A larger residual holds enough that is new; inner products
        measure it.
        """
        vector = either(is_noise, lambda: self.apart_from(vector), lambda: vector)
        vector = space.project(vector)
        product = space.project(operator(vector))
        basis, products = with_entry((self.basis, self.products), slot, (vector, product))
        overlaps, energies = inner_products(basis, vector, product)
        gram = _with_row(self.gram, slot, overlaps)
        energies = _with_row(self.energies, slot, energies)
        part = (jnp.arange(len(gram)) == slot).astype(gram.dtype)
        axis = orthonormal(part, self.axes, gram, least_new(part.dtype))
        axes = with_entry(self.axes, slot, axis, axis=1)
        return Span(basis, products, gram, energies, axes)

    def apart_from(self, vector: Field) -> Field:
        """Return the part of a vector orthogonal to the space, zero where it is but rounding."""
        overlaps = jnp.tensordot(self.basis, vector, vector.ndim, precision="highest")
        square = total(vector**2)
        rest = vector - combination(overlaps, self.basis)
        # None, where the rest is little more than rounding.
        is_new = total(rest**2) > _rounding(square.dtype) ** 2 * square
        return jnp.where(is_new, rest, 0)

    def span_of(self, parts: Float[Array, "room kept"]) -> "Span":
        """Return the space of some combinations of its vectors, with the same room."""
        room, kept = parts.shape
        basis, products = combinations(parts, self.basis, self.products)
        parts = jnp.pad(parts, ((0, 0), (0, room - kept)))
        gram, energies = (parts.T @ matrix @ parts for matrix in (self.gram, self.energies))
        # They are unit vectors, or zero but for rounding.
        axes = jnp.diag(jnp.round(jnp.diagonal(gram)))
        return Span(basis, products, gram, energies, axes)


# A space, its lowest Ritz values and vectors, and those vectors one step before.
_Widening = tuple[Span, Array, Array, Array]


class _RitzState(eqx.Module):
    """A space, its lowest Ritz pairs, and whether it has no vectors yet.

    On a CPU the first step takes the starts: so the code that adds vectors, most of the program, is
    traced once. Elsewhere they are taken before, and each step has the same number of turns.
    """

    span: Span
    eigenvalues: Float[Array, " size"]
    residuals: Float[Array, " count"]
    is_empty: Flag


class Davidson(SpaceSolver):
    """Davidson's method with a locally optimal restart, on a linear space.

    Arguments:
        tolerance: the residual |P(A x - lambda x)| / s of a unit vector to reach. P is the
            projection onto the space and s the size of A on its lower modes. By default 1e-7 in
            float64 and 1e-5 in float32.
        max_steps: the step limit, 5000 by default; the first takes the starts, each other one three
            residuals.

    Example:
        >>> modes = js.lowest_modes(contact, state, 2, solver=js.solvers.Davidson(1e-6))
        >>> f"{modes.eigenvalue[0]:.3f}"
        '-3.712'
    """

    tolerance: Scalar | None = eqx.field(converter=optional_parameter, default=None)
    max_steps: Int[Array, ""] = eqx.field(converter=as_array, default=5000)

    default_tolerance: ClassVar[Mapping[str, float]] = EIGENPAIR

    def init(self, problem: ModesProblem, start: Block) -> _RitzState:
        """Return a space that has no vectors yet, or on an accelerator the span of the starts."""
        room = len(start) + 1 + _NUM_RESIDUALS
        # XLA takes the axes of a cube for each other in JAX 0.12, and fails: leave a slot unused.
        room += start.shape[1:] == (room, room)
        block = jnp.zeros((room, *start.shape[1:]), start.dtype)
        matrix = jnp.zeros((room, room), start.dtype)
        span = Span(block, block, matrix, matrix, matrix)
        # No residual is known yet: one above any tolerance, from which every fall is progress.
        none = jnp.full(problem.count, jnp.finfo(start.dtype).max ** 0.5, start.dtype)
        empty = _RitzState(span, jnp.zeros(len(start), start.dtype), none, jnp.array(True))

        def elsewhere(state: _RitzState) -> _RitzState:
            return self._widen_span(problem, state, len(start), is_empty=True)

        return on_platform(lambda state: state, elsewhere, empty)

    def step(self, problem: ModesProblem, state: _RitzState) -> _RitzState:
        """Return the lowest Ritz vectors of a space widened by preconditioned residuals."""

        def on_cpu(state: _RitzState) -> _RitzState:
            number = jnp.where(state.is_empty, len(problem.starts), _NUM_RESIDUALS)
            return self._widen_span(problem, state, number, state.is_empty)

        def elsewhere(state: _RitzState) -> _RitzState:
            return self._widen_span(problem, state, _NUM_RESIDUALS, is_empty=False)

        return on_platform(on_cpu, elsewhere, state)

    def _widen_span(
        self,
        problem: ModesProblem,
        state: _RitzState,
        number: int | Int[Array, ""],
        is_empty: bool | Flag,
    ) -> _RitzState:
        operator = problem.operator
        starts = problem.starts
        size = len(problem.starts)
        target = jnp.argmax(self.doubts(problem, state) > self.tolerance_in(starts.dtype))
        mode = state.span.basis[target]
        eigenvalue = state.eigenvalues[target]
        rounding = jnp.finfo(mode.dtype).eps * operator.bound / operator.scale
        is_noise = state.residuals[target] < _NOISE * rounding
        precondition = operator.preconditioner(mode, eigenvalue)

        def widen(index: Array, carry: _Widening) -> _Widening:
            span, eigenvalues, parts, _ = carry

            def of_kept() -> Array:
                return span.products[target] - eigenvalue * mode

            def of_combined() -> Array:
                lowest = parts[:, target]
                product = combination(lowest, span.products)
                return product - eigenvalues[target] * combination(lowest, span.basis)

            def steepest() -> Array:
                # The first is of a vector that the space has.
                return precondition(either(index == 0, of_kept, of_combined))

            vector = either(is_empty, lambda: starts[index], steepest)
            slot = index + jnp.where(is_empty, 0, size + 1)
            span = span.with_vector(slot, vector, operator, problem.domain, is_noise)
            return span, *rayleigh_ritz(span.axes, span.energies, size), parts

        parts = jnp.eye(len(state.span.basis), size, dtype=starts.dtype)
        start = state.span, state.eigenvalues, parts, parts
        span, eigenvalues, parts, before = jax.lax.fori_loop(0, number, widen, start)
        return _restart(problem, span, eigenvalues, parts, before[:, target])

    def measure(self, problem: ModesProblem, state: _RitzState) -> Indicators:
        """Return the largest residual of the modes that decide."""
        return {"residual": jnp.max(self.doubts(problem, state))}

    def doubts(self, problem: ModesProblem, state: _RitzState) -> Float[Array, " count"]:
        """Return the residual of each mode; the first above the tolerance leads."""
        return state.residuals

    def minimum(self, problem: ModesProblem, found: Iteration[_RitzState]) -> Minimum:
        """Return the block of modes and its cost."""
        size = len(problem.starts)
        table = found.history.table
        is_unknown = np.zeros(table.shape, bool)
        is_unknown[0, 1:] = True
        num_widened = on_platform(lambda n: jnp.maximum(n - 1, 0), lambda n: n, found.num_steps)
        return Minimum(
            vector=found.state.span.basis[:size],
            num_steps=found.num_steps,
            num_applications=size + 2 * _NUM_RESIDUALS * num_widened,
            result=found.result,
            history=replace(found.history, table=jnp.where(is_unknown, jnp.nan, table)),
        )


def _restart(
    problem: ModesProblem, span: Span, eigenvalues: Array, parts: Array, last: Array
) -> _RitzState:
    """Keep the lowest Ritz vectors, and the part of another vector apart from them."""
    last = orthonormal(last, parts, span.gram, _rounding(last.dtype))
    span = span.span_of(jnp.column_stack([parts, last]))
    residuals = [span.products[i] - eigenvalues[i] * span.basis[i] for i in range(problem.count)]
    residual = norms(residuals) / problem.operator.scale
    return _RitzState(span, eigenvalues, residual, jnp.array(False))


def _with_row(matrix: Array, slot: Int[Array, ""], row: Array) -> Array:
    """Return a symmetric matrix with another row, and column."""
    return with_entry(with_entry(matrix, slot, row), slot, row, axis=1)


def _rounding(dtype: jnp.dtype) -> float:
    """Return the part of a vector, orthogonal to all others, that may be rounding."""
    return float(jnp.finfo(dtype).eps) ** (2 / 3)

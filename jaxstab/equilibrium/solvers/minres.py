"""Symmetric linear systems that need not be positive: MINRES.

C. C. Paige and M. A. Saunders, SIAM Journal on Numerical Analysis 12, 617 (1975); with a
preconditioner as in H. Elman, D. Silvester and A. Wathen, Finite Elements and Fast Iterative
Solvers (2014), algorithm 4.1.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.core.grid import total
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.types import Field, Flag, Scalar


class _Lanczos(NamedTuple):
    solution: Field
    # The last two Lanczos vectors, and the preconditioner applied to the last.
    vectors: tuple[Field, Field]
    preconditioned: Field
    directions: tuple[Field, Field]
    # Norms of the last two vectors, and cosines and sines of the last two rotations.
    norms: tuple[Scalar, Scalar]
    cosines: tuple[Scalar, Scalar]
    sines: tuple[Scalar, Scalar]
    residual: Scalar
    num_steps: Int[Array, ""]


def minres(system: LinearSystem, right_side: Field, accuracy: float, max_steps: int) -> Field:
    """Solve P A x = P b, or return the last iterate at the step limit.

    Arguments:
        system: A, which need not be positive; its preconditioner must be.
        right_side: b.
        accuracy: the norm of b - A x over the norm of b, in the metric of the preconditioner.
        max_steps: the step limit.
    """

    def precondition(vector: Field) -> tuple[Field, Scalar]:
        image = system.project(system.precondition(vector))
        return image, jnp.sqrt(jnp.maximum(total(image * vector), 0))

    b = system.project(right_side)
    image, size = precondition(b)

    def goes_on(state: _Lanczos) -> Flag:
        return (jnp.abs(state.residual) > accuracy * size) & (state.num_steps < max_steps)

    def step(state: _Lanczos) -> _Lanczos:
        before, last = state.vectors
        norm_before, norm = state.norms
        cosine_before, cosine = state.cosines
        sine_before, sine = state.sines
        unit = state.preconditioned / norm
        product = system.project(system.operator(unit))
        diagonal = total(product * unit)
        vector = product - diagonal / norm * last - norm / norm_before * before
        image, new_norm = precondition(vector)
        # The new column of the tridiagonal matrix, rotated into a triangle.
        pivot = cosine * diagonal - cosine_before * sine * norm
        above = sine * diagonal + cosine_before * cosine * norm
        length = jnp.hypot(pivot, new_norm)
        length = jnp.where(length > 0, length, 1)
        cosines = (cosine, pivot / length)
        sines = (sine, new_norm / length)
        older, old = state.directions
        direction = (unit - sine_before * norm * older - above * old) / length
        return _Lanczos(
            state.solution + cosines[1] * state.residual * direction,
            (last, vector),
            image,
            (old, direction),
            (norm, new_norm),
            cosines,
            sines,
            -sines[1] * state.residual,
            state.num_steps + 1,
        )

    nothing = jnp.zeros_like(b)
    zero = jnp.zeros_like(size)
    one = jnp.ones_like(size)
    start = _Lanczos(
        nothing,
        (nothing, b),
        image,
        (nothing, nothing),
        (one, size),
        (one, one),
        (zero, zero),
        size,
        jnp.array(0),
    )
    return jax.lax.while_loop(goes_on, step, start).solution

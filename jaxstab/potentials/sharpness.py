"""The largest curvature of a law, also at edges narrower than the steps of its profile."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core.compile import program
from jaxstab.core.types import Scalar
from jaxstab.potentials.evaluation import derivatives
from jaxstab.potentials.profile import at_some_points, gaps_of
from jaxstab.potentials.varying import Potential

# Tables of gaps, each of one step of the one before. The last has steps of 1e-9 of a gap.
_NUM_TABLES = 3


@program
def sharpest_curvature(potential: Potential, lengths: Float[Array, "..."]) -> Scalar:
    """Return the largest |f''| where f attracts [pressure/length].

    An edge of the attraction may lie between two gaps of a profile, with its curvature. It is
    looked for where the trapezoidal rule of f'' misses the change of f' most.
    """
    law = at_some_points(potential)
    first = jax.lax.stop_gradient(gaps_of(lengths))
    shares = jnp.asarray(np.linspace(0, 1, first.size), first.dtype)

    def refine(_: int, found: tuple[Array, Scalar]) -> tuple[Array, Scalar]:
        gaps, largest = found
        slopes, curvatures = derivatives(law, gaps)[1:]
        # A law may be undefined at gaps larger than the grid, and is so inside of a core.
        counts = (slopes >= 0) & jnp.isfinite(curvatures)
        largest = jnp.maximum(largest, jnp.max(jnp.where(counts, jnp.abs(curvatures), 0)))
        predicted = (curvatures[..., 1:] + curvatures[..., :-1]) / 2 * jnp.diff(gaps)
        missed = jnp.abs(jnp.diff(slopes) - predicted)
        attracts = counts[..., 1:] | counts[..., :-1]
        missed = jnp.atleast_2d(jnp.where(attracts & jnp.isfinite(missed), missed, 0))
        worst = jnp.argmax(jnp.max(missed, 0))
        return gaps[worst] + (gaps[worst + 1] - gaps[worst]) * shares, largest

    start = first, jnp.zeros((), first.dtype)
    return jax.lax.fori_loop(0, _NUM_TABLES, refine, start)[1]

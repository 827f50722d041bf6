"""A surface of finite extent, continued on the padded grid that its contact is solved on."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxstab.core.compile import program
from jaxstab.core.types import Field
from jaxstab.potentials.varying import Potential, Within, varying_fields, with_fields
from jaxstab.solids.free_half_space import mirrored, padded, where_window
from jaxstab.solids.solid import Solid

# The edges of a window may carry this part of the largest pressure.
MOST_AT_EDGES = 1e-2
# How far below a surface that ends the solid may sink beyond it, over the surface's depth.
_DEPTH = 2


@program
def continued_surface(solid: Solid, heights: Field, law: Potential) -> tuple[Field, Potential]:
    """Return heights and law on the grid of a solid, on which there is no surface elsewhere."""
    lowest = jnp.min(heights)
    spread = jnp.max(heights) - jnp.min(heights)
    # Not deeper than need be, as digits are lost to it.
    depth = _DEPTH * spread + jnp.max(solid.grid.spacing).astype(heights.dtype)
    fields = [mirrored(field) for field in varying_fields(law)]
    is_there = solid.grid.device_put(where_window(heights))
    return padded(heights, lowest - depth), Within(with_fields(law, fields), is_there)


def continued_hardness(hardness: Array | None, heights: Field) -> Array | None:
    """Return the hardness on the padded grid: beyond the surface nothing yields [pressure]."""
    if hardness is None:
        return None
    return _continued_hardness(hardness, heights)


@program
def _continued_hardness(hardness: Array, heights: Field) -> Array:
    return padded(jnp.broadcast_to(hardness, heights.shape), jnp.inf)


def depth_of_edges(heights: np.ndarray) -> float:
    """Return how far the edges of a window lie below its summit [length]."""
    ends = [heights.take([0, n - 1], axis).max() for axis, n in enumerate(heights.shape)]
    return float(heights.max() - max(ends))

"""The heights, the unit and the law that a contact is made of, checked."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxstab.core.checks import is_spread, is_traced, known
from jaxstab.core.grid import Grid
from jaxstab.core.unit_system import unit_of
from jaxstab.potentials import Potential, as_module, varying_fields, with_fields
from jaxstab.solids import Solid
from jaxstab.surfaces import Topography, faults

# Over the range of the heights: a constant in them that costs digits.
_LARGE = 16.0


def relative_heights(heights: Array | np.ndarray) -> tuple[Array | np.ndarray, Array | np.ndarray]:
    """Return heights less a constant that would cost them digits, and this constant."""
    values = known(heights)
    xp = np if isinstance(values, np.ndarray) else jnp
    constant = jax.lax.stop_gradient(values) if xp is jnp else values
    first = constant[(0,) * values.ndim]
    is_large = xp.abs(first) / _LARGE > xp.max(xp.abs(constant - first))
    datum = xp.where(is_large, first, 0).astype(values.dtype)
    return (heights if xp is np and datum == 0 else values - datum), datum


def unit_of_lengths(topography: Topography | None, given: str | None) -> str | None:
    """Return the unit of lengths: that of a topography if it has one, else that given."""
    own = topography.unit if topography else None
    unit = own if given is None else unit_of(given)
    if own not in (None, unit):
        raise ValueError(
            f"The unit is {unit}, the topography is in {own}: leave out `unit`, or convert the "
            f'topography by `.in_unit("{unit}")` and give lengths in {unit}.'
        )
    return unit


def suspicions(
    solid: Solid, heights: Array | np.ndarray, topography: Topography | None
) -> list[str]:
    """Return what looks wrong with heights on a solid: on a window edges need not meet."""
    if topography and solid.is_window:
        return [*topography.wrong_scale, *topography.edge_faults]
    if topography:
        return topography.suspicions
    if is_traced((heights, solid.grid.lengths)) or is_spread(heights):
        return []
    values = np.asarray(heights)
    marks = faults.marks_missing(values, known(solid.grid.lengths))
    return marks if marks or solid.is_window else faults.looks_wrong(values)


def law_on(grid: Grid, potential: Any, dtype: Any) -> Potential:
    """Return a law as a module in a precision, its varying parameters placed on a grid."""
    law = as_module(potential, dtype)
    fields = varying_fields(law)
    for field in fields:
        if field.shape != grid.shape:
            raise ValueError(
                f"A parameter of the law varies over points of shape {field.shape}, the "
                f"heights have shape {grid.shape}: give one for each point."
            )
    return with_fields(law, list(map(grid.placed, fields)))

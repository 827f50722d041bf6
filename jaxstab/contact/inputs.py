"""The heights, the unit and the law that a contact is made of, checked."""

from types import ModuleType
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array

from jaxstab.core.checks import (
    cast,
    concrete,
    is_readable,
    is_traced,
    numbers,
    parameter,
    possible,
    require,
    require_finite,
    require_shape,
)
from jaxstab.core.compile import program
from jaxstab.core.display import text
from jaxstab.core.grid import Grid
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.core.units import unit_of
from jaxstab.potentials.evaluation import as_module, slope
from jaxstab.potentials.varying import Potential, varying_fields, with_fields
from jaxstab.solids import Viscoelastic
from jaxstab.solids.solid import Solid

if TYPE_CHECKING:
    from jaxstab.surfaces import Topography

# A constant in the heights costs digits if it exceeds their range by this factor.
_LARGE = 16.0


def relative_heights(heights: Array | np.ndarray) -> tuple[Array | np.ndarray, Any]:
    """Return heights less a constant that would cost them digits, and this constant."""
    if not is_readable(heights):
        datum = _datum(jax.lax.stop_gradient(heights), jnp)
        return heights - datum, datum
    values = np.asarray(heights)
    datum = _datum(values, np)
    if datum == 0:
        return heights, datum
    return values - datum, datum


def _datum(heights: Any, xp: ModuleType) -> Any:
    """Return the first height if it is large, zero otherwise."""
    first = heights[(0,) * heights.ndim]
    is_large = xp.abs(first) / _LARGE > xp.max(xp.abs(heights - first))
    return xp.where(is_large, first, 0).astype(heights.dtype)


def as_heights(
    heights: "ArrayLike | Topography", grid: Grid
) -> "tuple[Array | np.ndarray, Topography | None]":
    """Return heights as an array on a grid, and the surface that they are of if it is one."""
    # A contact needs the surfaces only where it is made.
    from jaxstab.surfaces.topography import as_topography

    topography = as_topography(heights, grid)
    values = heights
    if topography:
        values = topography.on(grid)
    given = numbers(values, "The array of heights")
    if getattr(heights, "dtype", None) == np.float32:
        given = given.astype(np.float32)
    cure = "build heights and solid on the same grid."
    require_shape("The array of heights", given.shape, grid.shape, cure)
    return given, topography


def unit_of_lengths(topography: "Topography | None", given: str | None) -> str | None:
    """Return the unit of lengths: the topography's if it has one, else the given one."""
    own = None
    if topography:
        own = topography.unit
    if given is None:
        return own
    unit = unit_of(given)
    if own not in (None, unit):
        raise ValueError(
            f"The unit is {unit}, the topography is in {own}: leave out `unit`, or convert the "
            f'topography by `.in_unit("{unit}")` and give lengths in {unit}.'
        )
    return unit


def require_sound(
    solid: Solid, heights: Array | np.ndarray, topography: "Topography | None"
) -> None:
    """Raise for heights that are not finite, and warn of those that look wrong on a solid."""
    from jaxstab.surfaces.topography import FILL, warn_of_faults

    require_finite("A height", jnp.asarray(heights), FILL)
    warn_of_faults(heights, topography, solid.grid.lengths, solid.is_window)


def hardness_on(
    solid: Solid, heights: Field, potential: Potential, hardness: ArrayLike | None
) -> Array | None:
    """Return the hardness of a surface as an array, checked; None if it is infinite everywhere.

    Where it is traced and impossible it is NaN.
    """
    if hardness is None:
        return None
    grid = solid.grid
    if isinstance(solid, Viscoelastic):
        raise ValueError(
            "The solid is Viscoelastic and has a hardness: no indentation is computed in time. "
            "Leave out `hardness`, or give the elastic solid `solid.relaxed`."
        )
    given = cast(parameter(hardness, "The hardness"), heights.dtype)
    if given.ndim:
        require_shape("The hardness", given.shape, grid.shape, "give one number for each point.")
        given = grid.device_put(given)
    known = concrete(given)
    require("The hardness", known, known > 0, "it must be positive.")
    if not is_traced(given) and np.all(known == np.inf):
        return None
    largest, is_enough = _repulsion(potential, heights, given)
    if not is_traced(is_enough) and not concrete(is_enough):
        largest = float(largest)
        how_much = f"by {largest:.3g}" if np.isfinite(largest) else "without bound"
        raise ValueError(
            f"The hardness is {text(given)}, but at zero gap the law repels {how_much}, so that it "
            "allows no contact: give a larger hardness, a law that does not repel at zero gap, as "
            "Exponential, or the same law from a gap z0 on, at which it repels by less than the "
            "hardness: lambda gap: law(z0 + gap)."
        )
    return possible(given, is_enough)


@program
def _repulsion(potential: Potential, heights: Field, hardness: Array) -> tuple[Scalar, Flag]:
    """Return the largest -f'(0) [pressure], and whether the hardness is positive and above it."""
    repulsion = -slope(potential, jnp.zeros_like(heights))
    return jnp.max(repulsion), jnp.all((hardness > 0) & (hardness > repulsion))


def law_on(grid: Grid, potential: Potential, dtype: DTypeLike) -> Potential:
    """Return a law as a module in a precision, its varying parameters on the devices of a grid."""
    law = as_module(potential, dtype)
    fields = varying_fields(law)
    for field in fields:
        cure = "give one number for each point."
        require_shape("A parameter of the law that varies", field.shape, grid.shape, cure)
    return with_fields(law, list(map(grid.device_put, fields)))

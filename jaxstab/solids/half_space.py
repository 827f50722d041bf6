"""The isotropic elastic half space."""

from typing import Annotated

from jaxtyping import Array, Float

from jaxstab.core.grid import Grid
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import NUMBER, PRESSURE
from jaxstab.solids.moduli import contact_modulus, elastic_constants
from jaxstab.solids.spectral import SpectralSolid


class HalfSpace(SpectralSolid):
    """An isotropic elastic half space: K = E* |q| / 2, E* = E / (1 - nu^2) (Westergaard).

    Arguments:
        grid: the grid of its surface.
        youngs_modulus: E [pressure].
        poisson_ratio: nu.

    Raises:
        ValueError: if E is not positive, or nu outside (-1, 0.5].
        TypeError: if one of them is complex.

    Example:
        >>> f"{js.HalfSpace(grid, youngs_modulus=2.0, poisson_ratio=0.5).contact_modulus:.4f}"
        '2.6667'
    """

    grid: Grid
    youngs_modulus: Annotated[Scalar, PRESSURE]
    poisson_ratio: Annotated[Scalar, NUMBER]

    def __init__(self, grid: Grid, youngs_modulus: ArrayLike, poisson_ratio: ArrayLike = 0.0):
        self.grid = grid
        self.youngs_modulus, self.poisson_ratio = elastic_constants(youngs_modulus, poisson_ratio)

    @property
    def contact_modulus(self) -> Scalar:
        """E* = E / (1 - nu^2) [pressure]; NaN where nu is traced and outside (-1, 0.5]."""
        return contact_modulus(self.youngs_modulus, self.poisson_ratio)

    def stiffness_at(self, waves: Float[Array, " *modes"]) -> Float[Array, " *modes"]:
        """Return E* |q| / 2 [pressure/length]."""
        return self.contact_modulus * waves / 2

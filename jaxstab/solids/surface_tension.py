"""Spectral solids that resist curvature: gels with surface tension, and sheets."""

from typing import Annotated

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.core.checks import nonnegative_parameter, positive_scalar, scalar_parameter
from jaxstab.core.grid import Grid, require_grid
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import Dimension
from jaxstab.solids.spectral import SpectralSolid

_TENSION = Dimension("pressure length")


class SurfaceTension(SpectralSolid):
    """A solid with surface tension, for instance a gel: K + s q^2.

    Style et al., Nature Communications 4, 2728 (2013). The tension outweighs elasticity for waves
    shorter than the elastocapillary length s / E*.

    Arguments:
        solid: the elastic solid below, with a stiffness for every wavenumber.
        tension: s >= 0 [pressure length].

    Raises:
        TypeError: for a solid without a stiffness for every wavenumber, such as a `FreeHalfSpace`.
        ValueError: if the tension is negative.

    Example:
        >>> gel = js.SurfaceTension(solid, tension=0.1)
        >>> [f"{k:.1f}" for k in gel.stiffness_at(np.array([1.0, 10.0]))]
        ['0.6', '15.0']
    """

    solid: SpectralSolid
    tension: Annotated[Scalar, _TENSION]

    def __init__(self, solid: SpectralSolid, tension: ArrayLike):
        if not isinstance(solid, SpectralSolid):
            raise TypeError(
                f"The solid is a {type(solid).__name__}: surface tension needs a stiffness for "
                "every wavenumber, as HalfSpace, Layer and CoatedHalfSpace have."
            )
        self.solid = solid
        name = "The surface tension"
        self.tension = nonnegative_parameter(scalar_parameter(tension, name), name)

    @property
    def grid(self) -> Grid:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The grid of its surface."""
        return self.solid.grid

    @property
    def is_isotropic(self) -> bool:
        """Whether K of the solid below depends on |q| alone."""
        return self.solid.is_isotropic

    @property
    def uniform_stiffness(self) -> Scalar:
        """The uniform stiffness of the solid below [pressure/length]."""
        return self.solid.uniform_stiffness

    def stiffness_at(self, waves: Float[Array, "..."]) -> Float[Array, " *modes"]:
        """Return K + s q^2 [pressure/length]."""
        squares = waves**2
        if not self.is_isotropic:
            squares = jnp.sum(squares, axis=0)
        return self.solid.stiffness_at(waves) + self.tension * squares


class Sheet(SpectralSolid):
    """A thin elastic sheet: K = B q^4 + T q^2 (Landau & Lifshitz, Theory of Elasticity, sec. 14).

    Arguments:
        grid: the grid of its surface.
        bending_stiffness: B = E h^3 / (12 (1 - nu^2)) for a plate of thickness h
            [pressure length^3].
        tension: T >= 0, the force per length that stretches it [pressure length].

    Raises:
        ValueError: if the bending stiffness is not positive, or the tension negative.

    Example:
        >>> sheet = js.Sheet(grid, bending_stiffness=1e-3)
        >>> f"{sheet.stiffness_at(np.array(2.0)):.3f}"
        '0.016'
    """

    grid: Grid
    bending_stiffness: Annotated[Scalar, Dimension("pressure length^3")]
    tension: Annotated[Scalar, _TENSION]

    def __init__(self, grid: Grid, bending_stiffness: ArrayLike, tension: ArrayLike = 0.0):
        require_grid(grid)
        self.grid = grid
        self.bending_stiffness = positive_scalar(bending_stiffness, "The bending stiffness")
        name = "The tension of the sheet"
        self.tension = nonnegative_parameter(scalar_parameter(tension, name), name)

    def stiffness_at(self, waves: Float[Array, " *modes"]) -> Float[Array, " *modes"]:
        """Return B q^4 + T q^2 [pressure/length]."""
        square = waves**2
        return (self.bending_stiffness * square + self.tension) * square

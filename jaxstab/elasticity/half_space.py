"""The isotropic elastic half space."""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxstab.checks import known, parameter, require, require_positive
from jaxstab.elasticity.spectral import SpectralSolid
from jaxstab.grid import Grid


class HalfSpace(SpectralSolid):
    """An isotropic elastic half space: K = E* |q| / 2, E* = E / (1 - nu^2) (Westergaard).

    Arguments:
        grid: the grid of its surface.
        youngs_modulus: E [pressure].
        poisson_ratio: nu.

    Raises:
        ValueError: if E is not positive, or nu outside (-1, 0.5].
        TypeError: if one of them is complex.
    """

    grid: Grid
    youngs_modulus: Float[Array, ""]
    poisson_ratio: Float[Array, ""]

    def __init__(self, grid: Grid, youngs_modulus: ArrayLike, poisson_ratio: ArrayLike = 0.0):
        self.grid = grid
        self.youngs_modulus = parameter(youngs_modulus, "Young's modulus")
        self.poisson_ratio = parameter(poisson_ratio, "Poisson's ratio")
        for value in (self.youngs_modulus, self.poisson_ratio):
            if value.shape != ():
                raise ValueError(f"An elastic constant has shape {value.shape}: use jax.vmap.")
        require_positive("Young's modulus", self.youngs_modulus)
        nu = known(self.poisson_ratio)
        require("Poisson's ratio", nu, (nu > -1) & (nu <= 0.5), "it must lie in (-1, 0.5].")

    @property
    def contact_modulus(self) -> Float[Array, ""]:
        """E* = E / (1 - nu^2) [pressure]; NaN where nu is traced and outside (-1, 0.5]."""
        nu = self.poisson_ratio
        return jnp.where((nu > -1) & (nu <= 0.5), self.youngs_modulus / (1 - nu**2), jnp.nan)

    def stiffness_at(self, wavenumbers: Float[Array, " *modes"]) -> Float[Array, " *modes"]:
        """Return E* |q| / 2 [pressure/length]."""
        return self.contact_modulus * wavenumbers / 2

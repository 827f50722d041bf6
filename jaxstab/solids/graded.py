"""The half space whose modulus is a power of the depth."""

from typing import Annotated

import jax.numpy as jnp
from jax.scipy.special import gammaln
from jaxtyping import Array, Float

from jaxstab.core.checks import concrete, positive_scalar, possible, require, scalar_parameter
from jaxstab.core.grid import Grid, require_grid
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import LENGTH, NUMBER, PRESSURE
from jaxstab.solids.moduli import contact_modulus, elastic_constants, possible_ratio
from jaxstab.solids.spectral import SpectralSolid


class Graded(SpectralSolid):
    """An isotropic half space whose modulus grows or falls with the depth: E(z) = E (z / h)^k.

    K = c |q|^(1 - k), with b = sqrt((1 + k) (1 - k nu / (1 - nu))) and E* = E / (1 - nu^2),

        c = E* h^-k cos(k pi / 2) G(2 + k)^2
            / (2^(1 + k) b sin(b pi / 2) G((3 + k + b) / 2) G((3 + k - b) / 2)),

    the Fourier transform of the displacement under a point force (M. Hess, Int. J. Eng. Sci. 104,
    20 (2016)), G the gamma function. k = 0 is a `HalfSpace`. Another grading is a `solids.Layered`
    of many layers, whose error falls as the square of their thickness.

    Arguments:
        grid: the grid of its surface.
        youngs_modulus: E at the depth h [pressure].
        poisson_ratio: nu.
        depth: h [length].
        exponent: k, in (-1, 1): positive if the solid is soft at its surface.

    Raises:
        ValueError: if E or the depth is not positive, nu outside (-1, 0.5], or k outside (-1, 1).
        TypeError: if one of them is complex.

    Example:
        >>> tissue = js.solids.Graded(grid, 1.0, 0.3, depth=0.1, exponent=0.5)
        >>> f"{tissue.stiffness_at(np.array(10.0)):.3f}"
        '4.239'
    """

    grid: Grid
    youngs_modulus: Annotated[Scalar, PRESSURE]
    poisson_ratio: Annotated[Scalar, NUMBER]
    depth: Annotated[Scalar, LENGTH]
    exponent: Annotated[Scalar, NUMBER]

    def __init__(
        self,
        grid: Grid,
        youngs_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        depth: ArrayLike,
        exponent: ArrayLike,
    ):
        require_grid(grid)
        self.grid = grid
        self.youngs_modulus, self.poisson_ratio = elastic_constants(youngs_modulus, poisson_ratio)
        self.depth = positive_scalar(depth, "The depth")
        self.exponent = scalar_parameter(exponent, "The exponent")
        k = concrete(self.exponent)
        cure = "it must lie in (-1, 1); at 1 the solid is a bed of springs, a Spectral of a number."
        require("The exponent", k, (k > -1) & (k < 1), cure)

    def stiffness_at(self, waves: Float[Array, " *modes"]) -> Float[Array, " *modes"]:
        """Return c |q|^(1 - k) [pressure/length]."""
        nu = possible_ratio(self.poisson_ratio)
        k = possible(self.exponent, (self.exponent > -1) & (self.exponent < 1))
        depth = possible(self.depth, self.depth > 0)
        b = jnp.sqrt((1 + k) * (1 - k * nu / (1 - nu)))
        gammas = 2 * gammaln(2 + k) - gammaln((3 + k + b) / 2) - gammaln((3 + k - b) / 2)
        shape = jnp.cos(k * jnp.pi / 2) / (b * jnp.sin(b * jnp.pi / 2)) * jnp.exp(gammas)
        modulus = contact_modulus(self.youngs_modulus, nu)
        return modulus * shape / 2 * waves * (2 * waves * depth) ** -k

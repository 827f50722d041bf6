"""The anisotropic elastic half space, and its contact with a sphere."""

from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core.compile import program
from jaxstab.core.display import inline
from jaxstab.core.grid import Grid, require_grid
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import NUMBER, PRESSURE
from jaxstab.solids.materials import Crystal, unit_vectors
from jaxstab.solids.spectral import SpectralSolid
from jaxstab.solids.stroh import half_space_compliance

# Directions over half a turn at which K is computed; in between it is their Fourier series. Of
# copper and quartz its terms fall by a factor of ten or more from each to the next; of random
# constants half as many directions left errors of 1e-9.
_NUM_DIRECTIONS = 256
_NUM_STEPS = 12


class Indentation(eqx.Module):
    """The contact of an anisotropic half space with a sphere, without adhesion.

    Attributes:
        modulus: the indentation modulus M in Hertz' F = (4/3) M sqrt(R) d^(3/2), d the depth
            [pressure].
        aspect_ratio: the longer axis of the ellipse of contact over the shorter one.
        angle: from the side x of the surface to the longer axis, in radians; zero for a circle.

    Example:
        >>> axes = (0, 0, 1), (1, -1, 0), (1, 1, 0)
        >>> found = js.solids.Anisotropic(grid, (168.4, 121.4, 75.4), axes).indentation
        >>> f"{found.modulus:.1f}, {found.aspect_ratio:.3f}"
        '147.5, 1.077'
    """

    modulus: Annotated[Scalar, PRESSURE]
    aspect_ratio: Annotated[Scalar, NUMBER]
    angle: Annotated[Scalar, NUMBER]

    __repr__ = inline


class Anisotropic(SpectralSolid):
    """A half space of any elastic constants, such as a crystal, cut along any plane.

    K = |q| k(direction), where 1 / k is the normal entry of the surface compliance that Stroh's
    formalism gives (Ting, Anisotropic Elasticity, 1996; L^-1 of Barnett and Lothe).

    Arguments:
        grid: the grid of its surface.
        stiffness: its elastic constants in Voigt's notation (xx, yy, zz, yz, xz, xy), 6 x 6 and
            symmetric, or the three numbers (c11, c12, c44) of a cubic crystal [pressure]. Sets
            with their sources are in `jaxstab.references.materials`.
        axes: the directions of the sides x and y of the surface, and of its normal z, in the
            coordinates of the constants: three rows at right angles of any lengths, as
            ((1, -1, 0), (0, 0, 1), (1, 1, 0)); by default the axes of the crystal.

    Raises:
        ValueError: for constants of another shape, not symmetric or not positive definite, and axes
            that are not three directions at right angles.
        TypeError: if one of them is complex.

    Example:
        >>> silicon = js.solids.Anisotropic(grid, (165.64, 63.94, 79.51))  # GPa
        >>> f"{silicon.indentation.modulus:.1f}"
        '164.7'
    """

    grid: Grid
    material: Crystal

    def __init__(
        self,
        grid: Grid,
        stiffness: ArrayLike,
        axes: ArrayLike | None = None,
    ):
        require_grid(grid)
        self.grid = grid
        self.material = Crystal(stiffness, axes)

    @property
    def is_isotropic(self) -> bool:
        """False: K depends on the direction of a wave."""
        return False

    def stiffness_at(self, waves: Float[Array, " components *modes"]) -> Float[Array, " *modes"]:
        """Return K at wave vectors [pressure/length]."""
        wavenumbers, (x, y) = unit_vectors(waves)
        # exp(2 i theta)
        turn = jax.lax.complex(x * x - y * y, 2 * x * y)
        terms = jnp.fft.fft(self._stiffnesses)[: _NUM_DIRECTIONS // 2] / _NUM_DIRECTIONS
        total = jnp.zeros_like(turn)
        for term in terms[:0:-1]:
            total = (total + term) * turn
        return wavenumbers * (terms[0] + 2 * total).real

    @property
    def _stiffnesses(self) -> Float[Array, " directions"]:
        """K / |q| at directions over half a turn [pressure]."""
        return _stiffnesses(self.material)

    @property
    @program
    def indentation(self) -> Indentation:
        """The contact with a sphere, without adhesion: its modulus, and the ellipse of contact.

        The pressure is p0 sqrt(1 - rho^2) on an ellipse (J. R. Willis, J. Mech. Phys. Solids 14,
        163 (1966)), whose semi-axes are the eigenvalues of a matrix A. With s^2 = m.A^2 m of the
        directions m of waves, the surface moves down by

            (a b p0 / 8) int (1 / k) (1 - (m.x)^2 / s^2) / s dtheta.

        That is a sphere if int m m / (k s^3) is a multiple of the unit matrix: the ellipse makes
        int 1 / (k s), which is convex in A^2, least at a fixed trace. A circle is the approximation
        of J. J. Vlassak and W. D. Nix, Phil. Mag. A 67, 1045 (1993), M = 2 / mean(1 / k), exact on
        planes with an axis of three- or fourfold symmetry.
        """
        softness = 1 / self._stiffnesses
        angles = 2 * np.pi / _NUM_DIRECTIONS * np.arange(_NUM_DIRECTIONS)
        waves = jnp.asarray(np.stack([np.cos(angles), np.sin(angles)]), softness.dtype)

        # A^2 = ((1 + u, v), (v, 1 - u)), so that s^2 = 1 + u cos(2 theta) + v sin(2 theta).
        def newton(_: int, shape: Float[Array, "2"]) -> Float[Array, "2"]:
            squares = 1 + shape @ waves
            slope = -jnp.mean(softness * squares**-1.5 * waves, axis=1) / 2
            curvature = 3 / 4 * (softness * squares**-2.5 * waves) @ waves.T / _NUM_DIRECTIONS
            (a, b), (_, c) = curvature
            adjugate = jnp.array([[c, -b], [-b, a]])
            shape = shape - adjugate @ slope / (a * c - b * b)
            # Inside of the ellipses that there are.
            size = jnp.sqrt(jnp.maximum(shape @ shape, _LARGEST**2))
            return shape * _LARGEST / size

        shape = jax.lax.fori_loop(0, _NUM_STEPS, newton, jnp.zeros_like(softness, shape=2))
        squares = 1 + shape @ waves
        # With int = 2 pi mean, a^3 = 2 R P c and d = P b / a, P = a b p0 / 8, F = 16 pi P / 3.
        depth = 2 * jnp.pi * jnp.mean(softness / jnp.sqrt(squares))
        curvature = jnp.pi * jnp.mean(softness * squares**-1.5)
        modulus = 4 * jnp.pi * jnp.sqrt(2 * curvature) / depth**1.5
        is_circle = shape @ shape < _CIRCLE**2
        u, v = jnp.where(is_circle, jnp.array([1.0, 0.0], shape.dtype), shape)
        eccentric = jnp.where(is_circle, 0, jnp.sqrt(u * u + v * v))
        angle = jnp.where(is_circle, 0, jnp.arctan2(v, u) / 2)
        return Indentation(modulus, jnp.sqrt((1 + eccentric) / (1 - eccentric)), angle)

    @property
    def contact_modulus(self) -> Scalar:
        """The indentation modulus M, which takes the place of E* under a sphere [pressure]."""
        return self.indentation.modulus


# The eccentricity |(u, v)| of the ellipse is kept below, and is zero but for rounding below.
_LARGEST = 0.95
_CIRCLE = 1e-5


def _stiffnesses(material: Crystal) -> Float[Array, " directions"]:
    """Return K / |q| of a half space at directions over half a turn [pressure]."""
    angles = np.pi / _NUM_DIRECTIONS * np.arange(_NUM_DIRECTIONS)
    directions = np.stack([np.cos(angles), np.sin(angles)])
    matrices = material.stroh_matrices(jnp.asarray(directions, material.stiffness.dtype))
    return 1 / half_space_compliance(matrices)[2, 2].real

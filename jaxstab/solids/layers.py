"""Elastic layers: bonded to a rigid base, or to an elastic half space as its coating.

Both follow from one formula, 1/K = (1 - nu) / (G q) times a ratio of sums. All terms of the sums
are positive or zero, so that no digits are lost from thin to thick. They are written by exp(-2x),
x = q h, so that nothing overflows.
"""

import math
from typing import Annotated

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.core.checks import positive_scalar, possible
from jaxstab.core.grid import Grid
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import LENGTH, NUMBER, PRESSURE
from jaxstab.solids.moduli import elastic_constants, possible_ratio, shear_modulus
from jaxstab.solids.spectral import SpectralSolid

Waves = Float[Array, " *modes"]
# Young's modulus and Poisson's ratio of one material.
Moduli = tuple[Annotated[Scalar, PRESSURE], Annotated[Scalar, NUMBER]]

# Differences are summed as series below this argument, by as many terms as double precision needs.
_SMALL = 2.0
_NUM_TERMS = 12


class Layer(SpectralSolid):
    """An isotropic elastic layer, bonded to a rigid base.

    K = (E* q / 2) ((3 - 4 nu) cosh 2x + 2x^2 + 5 - 12 nu + 8 nu^2) / ((3 - 4 nu) sinh 2x - 2x) with
    x = q h (Johnson, Contact Mechanics, 1985, sec. 5.8). At q = 0, where the base stays,
    K = E (1 - nu) / ((1 + nu) (1 - 2 nu) h). `FarDisplacement` prescribes the displacement of the
    base, and a `Spring` pulls at it. An incompressible layer, nu = 0.5, keeps its volume, so its
    base moves by the mean displacement, which `MeanDisplacement` prescribes. Its derivative with
    respect to nu under a `Spring` leaves out the change of the volume.

    Arguments:
        grid: the grid of its surface.
        youngs_modulus: E [pressure].
        poisson_ratio: nu.
        thickness: h [length].

    Raises:
        ValueError: if E or the thickness is not positive, or nu outside (-1, 0.5].
        TypeError: if one of them is complex.

    Example:
        >>> layer = js.Layer(grid, youngs_modulus=1.0, poisson_ratio=0.3, thickness=0.1)
        >>> f"{layer.uniform_stiffness:.3f}"
        '13.462'
    """

    grid: Grid
    youngs_modulus: Annotated[Scalar, PRESSURE]
    poisson_ratio: Annotated[Scalar, NUMBER]
    thickness: Annotated[Scalar, LENGTH]

    def __init__(
        self,
        grid: Grid,
        youngs_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        thickness: ArrayLike,
    ):
        self.grid = grid
        self.youngs_modulus, self.poisson_ratio = elastic_constants(youngs_modulus, poisson_ratio)
        self.thickness = positive_scalar(thickness, "The thickness")

    @property
    def uniform_stiffness(self) -> Scalar:
        """E (1 - nu) / ((1 + nu) (1 - 2 nu) h), infinite at nu = 0.5 [pressure/length]."""
        nu = possible_ratio(self.poisson_ratio)
        softness = (1 + nu) * (1 - 2 * nu) / (1 - nu)
        keeps_volume = softness == 0
        softness = jnp.where(keeps_volume, 1, softness)
        stiffness = self.youngs_modulus / (softness * _possible_thickness(self.thickness))
        return jnp.where(keeps_volume, jnp.inf, stiffness)

    def stiffness_at(self, wavenumbers: Waves) -> Waves:
        """Return K [pressure/length]."""
        zero = jnp.zeros_like(self.poisson_ratio)
        return _coated_stiffness(
            wavenumbers,
            (self.youngs_modulus, self.poisson_ratio),
            self.thickness,
            shear_ratio=zero,
            base_ratio=zero,
        )


class CoatedHalfSpace(SpectralSolid):
    """An isotropic elastic layer, bonded to an isotropic elastic half space.

    Arguments:
        grid: the grid of its surface.
        layer: E and nu of the coating [pressure, 1].
        thickness: h, of the coating [length].
        base: E and nu of the half space [pressure, 1].

    Raises:
        ValueError: if a modulus or the thickness is not positive, a Poisson's ratio is outside
            (-1, 0.5], or layer or base are not two numbers.
        TypeError: if one of them is complex.

    Example:
        >>> coated = js.CoatedHalfSpace(grid, layer=(10.0, 0.3), thickness=0.01, base=(1.0, 0.3))
        >>> [f"{k:.3g}" for k in coated.stiffness_at(np.array([1.0, 1000.0]))]
        ['0.558', '5.49e+03']
    """

    grid: Grid
    layer: Moduli
    thickness: Annotated[Scalar, LENGTH]
    base: Moduli

    def __init__(
        self,
        grid: Grid,
        layer: tuple[ArrayLike, ArrayLike],
        thickness: ArrayLike,
        base: tuple[ArrayLike, ArrayLike],
    ):
        self.grid = grid
        self.layer = _pair(layer, "layer")
        self.thickness = positive_scalar(thickness, "The thickness")
        self.base = _pair(base, "base")

    def stiffness_at(self, wavenumbers: Waves) -> Waves:
        """Return K [pressure/length]."""
        return _coated_stiffness(
            wavenumbers,
            self.layer,
            self.thickness,
            shear_ratio=shear_modulus(*self.layer) / shear_modulus(*self.base),
            base_ratio=possible_ratio(self.base[1]),
        )


def _pair(constants: tuple[ArrayLike, ArrayLike], name: str) -> tuple[Scalar, Scalar]:
    if not isinstance(constants, tuple | list) or len(constants) != 2:
        raise ValueError(
            f"The {name} is {constants!r}: give its Young's modulus and its Poisson's ratio, as in "
            f"{name}=(1.0, 0.3)."
        )
    return elastic_constants(*constants, where=f" of the {name}")


def _possible_thickness(thickness: Scalar) -> Scalar:
    """Return the thickness; NaN where it is traced and not positive."""
    return possible(thickness, thickness > 0)


def _coated_stiffness(
    wavenumbers: Waves,
    layer: tuple[Scalar, Scalar],
    thickness: Scalar,
    *,
    shear_ratio: Scalar,
    base_ratio: Scalar,
) -> Waves:
    """Return K of a coated half space [pressure/length].

    With m = G1/G2, A = 1 + m (3 - 4 nu2), B = m + 3 - 4 nu1, c_i = 4 (1 - nu_i), t = exp(-2x):

        K = G1 q / (1 - nu1) D / N
        D = A (2B (cosh 2x - 1 - 2x^2) + 4 c1 x^2) t + c1 t (c2 m (1 - t) + c1)
        N = A (2B (sinh 2x - 2x) + 8x (m + 1 - 2 nu1)) t + c1 c2 m t^2

    Burmister's solution (1945) for a bonded layer; a rigid base is m = 0.
    """
    m = shear_ratio
    nu = possible_ratio(layer[1])
    g = shear_modulus(*layer)
    x = wavenumbers * _possible_thickness(thickness)
    t = jnp.exp(-2 * x)
    rest = -jnp.expm1(-2 * x)
    a = 1 + m * (3 - 4 * base_ratio)
    b = m + 3 - 4 * nu
    c = 4 * (1 - nu)
    c_base = 4 * (1 - base_ratio)
    sinh_tail, cosh_tail = _damped_tails(x)
    stiff = a * (2 * b * cosh_tail + 4 * c * x * (x * t)) + c * t * (c_base * m * rest + c)
    soft = a * (2 * b * sinh_tail + 8 * (m + (1 - 2 * nu)) * x * t) + c * c_base * m * t**2
    return g * wavenumbers / (1 - nu) * stiff / soft


def _damped_tails(x: Waves) -> tuple[Waves, Waves]:
    """Return exp(-y) times sinh y - y and cosh y - 1 - y^2/2, y = 2x, to all digits."""
    y = 2 * x
    is_small = y < _SMALL
    small = jnp.where(is_small, y, 0)
    large = jnp.where(is_small, _SMALL, y)
    powers = [small**k / float(math.factorial(k)) for k in range(3, 2 * _NUM_TERMS + 3)]
    decay = jnp.exp(-large)
    sinh = (1 - decay**2) / 2 - large * decay
    # The square and the exponential apart would overflow before they vanish.
    cosh = (1 - decay) ** 2 / 2 - large * (large * decay) / 2
    sinh_series, cosh_series = (jnp.exp(-small) * sum(powers[i::2][::-1]) for i in (0, 1))
    return jnp.where(is_small, sinh_series, sinh), jnp.where(is_small, cosh_series, cosh)

"""Elastic solids with a flat periodic surface, given by their multiplier in Fourier space.

The elastic pressure is p = K u, with K diagonal in Fourier space (Rey & Bleyer, eq. 12). Its
multiplier is zero at q = 0: the mean of the displacement is a rigid motion set by the load, and
the mean of the pressure follows from equilibrium.
"""

from abc import abstractmethod
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxstab.checks import known, parameter, require, require_positive
from jaxstab.display import inline
from jaxstab.functions import as_pytree
from jaxstab.grid import Grid
from jaxstab.programs import program

FieldMap = Callable[[Float[Array, " *grid"]], Float[Array, " *grid"]]


def apply_multiplier(
    multiplier: Float[Array, " *modes"], field: Float[Array, " *grid"]
) -> Float[Array, " *grid"]:
    """Return a field with the modes of its half spectrum multiplied."""
    return jnp.fft.irfftn(multiplier * jnp.fft.rfftn(field), s=field.shape)


def softest_wave(multiplier: Float[Array, " *modes"]) -> Float[Array, ""]:
    """Return the smallest stiffness of a wave, that of q = 0 aside."""
    return jnp.min(jnp.where(multiplier > 0, multiplier, jnp.inf))


class Solid(eqx.Module):
    """An elastic solid: anything with a Fourier multiplier from displacement to pressure."""

    grid: eqx.AbstractVar[Grid]

    __repr__ = inline

    @abstractmethod
    def stiffness_at(self, wavenumbers: Float[Array, " *modes"]) -> Float[Array, " *modes"]:
        """Return the multiplier K(|q|) at wavenumbers |q| > 0 [pressure/length]."""

    @property
    @program
    def multiplier(self) -> Float[Array, " *modes"]:
        """K(|q|) on the half spectrum of the grid [pressure/length], zero at q = 0."""
        q = self.grid.wavenumbers
        # The second `where` keeps a formula that is singular at q = 0 out of the derivatives.
        return jnp.where(q > 0, self.stiffness_at(jnp.where(q > 0, q, jnp.max(q))), 0)

    @property
    def is_valid(self) -> Bool[Array, ""]:
        """Whether every wave's stiffness is positive, and a number of full precision."""
        waves = self.multiplier.ravel()[1:]
        return jnp.all((waves >= jnp.finfo(waves.dtype).tiny) & jnp.isfinite(waves))

    @property
    @program
    def max_stiffness(self) -> Float[Array, ""]:
        """Largest eigenvalue of K: the stiffness of the grid's stiffest wave [pressure/length]."""
        return jnp.max(self.multiplier)

    @property
    def stiffness(self) -> FieldMap:
        """The operator K, its multiplier computed once, here."""
        return self._apply(self.multiplier)

    def pressure(self, displacement: Float[Array, " *grid"]) -> Float[Array, " *grid"]:
        """Return the elastic pressure p = K u of zero mean (Rey & Bleyer, eq. 12) [pressure]."""
        return self.stiffness(displacement)

    def displacement(self, pressure: Float[Array, " *grid"]) -> Float[Array, " *grid"]:
        """Return the displacement of zero mean under a pressure (Rey & Bleyer, eq. 11) [length]."""
        multiplier = self.multiplier
        moves = multiplier > 0
        return self._apply(jnp.where(moves, 1 / jnp.where(moves, multiplier, 1), 0))(pressure)

    def energy(self, displacement: Float[Array, " *grid"]) -> Float[Array, ""]:
        """Return the elastic energy u.Ku / 2 over the surface [energy]."""
        density = displacement * self.pressure(displacement) / 2
        return jnp.sum(density) * self.grid.cell_area.astype(density.dtype)

    def _apply(self, multiplier: Float[Array, " *modes"]) -> FieldMap:
        return lambda field: apply_multiplier(multiplier.astype(field.dtype), field)


class HalfSpace(Solid):
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
        """E* = E / (1 - nu^2) [pressure]."""
        return self.youngs_modulus / (1 - self.poisson_ratio**2)

    @property
    def is_valid(self) -> Bool[Array, ""]:
        """Whether nu is in (-1, 0.5] and every wave's stiffness positive, a number in range."""
        nu = self.poisson_ratio
        return super().is_valid & (nu > -1) & (nu <= 0.5)

    def stiffness_at(self, wavenumbers: Float[Array, " *modes"]) -> Float[Array, " *modes"]:
        """Return E* |q| / 2 [pressure/length]."""
        return self.contact_modulus * wavenumbers / 2


class Spectral(Solid):
    """A solid of any stiffness: K = function(|q|), for instance a layer on a rigid base.

    Arguments:
        grid: the grid of its surface.
        function: maps |q| > 0 [1/length] to the stiffness [pressure/length], array to array; a
            function or an `equinox.Module`. Its value at q = 0 is never used.

    Raises:
        ValueError: if the stiffness is not one real number for each wave, positive and finite.
        TypeError: if the function cannot be traced by JAX.
    """

    grid: Grid
    function: Callable[[Array], Array]

    def __init__(self, grid: Grid, function: Callable[[Array], Array]):
        self.grid = grid
        wavenumbers = jax.eval_shape(lambda grid: grid.wavenumbers, grid)
        cure = "it must return one real stiffness for each wavenumber."
        self.function = as_pytree("The function of the solid", function, wavenumbers, cure)
        require_positive("The stiffness of a wave", known(self.multiplier).ravel()[1:])

    def stiffness_at(self, wavenumbers: Float[Array, " *modes"]) -> Float[Array, " *modes"]:
        """Return function(|q|) [pressure/length]."""
        return self.function(wavenumbers)


class Scaled(Solid):
    """A solid whose stiffness is that of another one times a factor."""

    grid: Grid
    solid: Solid
    factor: Float[Array, ""]

    def __init__(self, solid: Solid, factor: Float[Array, ""]):
        self.grid = solid.grid
        self.solid = solid
        self.factor = factor

    @property
    def is_valid(self) -> Bool[Array, ""]:
        """Whether the other solid is a possible one."""
        return self.solid.is_valid

    def stiffness_at(self, wavenumbers: Float[Array, " *modes"]) -> Float[Array, " *modes"]:
        """Return the other stiffness times the factor."""
        return self.factor * self.solid.stiffness_at(wavenumbers)

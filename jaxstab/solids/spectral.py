"""Translation-invariant solids: K multiplies each Fourier mode by its stiffness."""

import inspect
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core import model
from jaxstab.core.checks import require_positive
from jaxstab.core.closures import as_pytree
from jaxstab.core.compile import program
from jaxstab.core.grid import Grid, require_grid
from jaxstab.core.types import ArrayLike, Field, FieldMap, Flag, Scalar
from jaxstab.solids.solid import Solid, finite_or_zero


class Waves(Solid):
    """A translation-invariant solid, by its multiplier in Fourier space.

    Attributes:
        multiplier: K on the half spectrum of the grid [pressure/length].
        has_range: whether all stiffnesses are positive, finite and no subnormal numbers.
    """

    grid: Grid
    multiplier: Float[Array, " *modes"]
    max_stiffness: Scalar
    min_stiffness: Scalar
    has_range: Flag

    @classmethod
    def of(cls, grid: Grid, multiplier: Float[Array, " *modes"]) -> Self:
        """Return the solid of a multiplier."""
        waves = multiplier.ravel()[1:]
        most = jnp.max(waves)
        least = jnp.min(waves)
        has_range = (least >= jnp.finfo(waves.dtype).tiny) & jnp.isfinite(most)
        return cls(grid, multiplier, most, least, has_range)

    @property
    def uniform_stiffness(self) -> Scalar:
        """The multiplier at q = 0 [pressure/length]."""
        return self.multiplier.ravel()[0]

    @property
    def is_valid(self) -> Flag:
        """Whether every wave's stiffness is positive, finite and no subnormal number."""
        return self.has_range

    def apply(self, displacement: Field) -> Field:
        """Return K u [pressure], by one pair of Fourier transforms."""
        return model.apply_multiplier(self.grid, self.multiplier, displacement)

    def displacement(self, pressure: Field) -> Field:
        """Return the displacement under a pressure (Rey & Bleyer, eq. 11) [length]."""
        return model.apply_multiplier(self.grid, model.compliance(self.multiplier), pressure)

    def precondition(self, shift: Scalar) -> FieldMap:
        """Return the inverse of K + shift."""
        inverse = 1 / (self.multiplier + shift)
        return lambda field: model.apply_multiplier(self.grid, inverse, field)

    def with_uniform_stiffness(self, stiffness: ArrayLike) -> "Waves":
        """Return this solid with another multiplier at q = 0."""
        first = (0,) * self.multiplier.ndim
        return replace(self, multiplier=self.multiplier.at[first].set(stiffness))

    def stiffness_deficit(self, level: Scalar) -> tuple[FieldMap, Scalar]:
        """Return max(0, level - K) without its mean, and its diagonal entry."""
        first = (0,) * self.multiplier.ndim
        lack = jnp.maximum(level - self.multiplier, 0).at[first].set(0)
        on_point = self.grid.inverse_transform(lack).ravel()[0]
        return lambda field: model.apply_multiplier(self.grid, lack, field), on_point

    def coarser(self) -> "Waves | None":
        """Return the solid with the waves of the grid of every other point, if there is one."""
        grid = self.grid.coarser
        if grid is None:
            return None
        kept = tuple(k.astype(int) for k in grid.waves)
        return Waves.of(grid, self.multiplier[kept])

    def scaled(self, factor: Scalar) -> "Waves":
        """Return the solid with its multiplier times a factor."""
        stiffnesses = self.multiplier, self.max_stiffness, self.min_stiffness
        multiplier, most, least = (factor * stiffness for stiffness in stiffnesses)
        return replace(self, multiplier=multiplier, max_stiffness=most, min_stiffness=least)


class SpectralSolid(Solid):
    """A translation-invariant solid, by its stiffness for every wavenumber, or every wave vector.

    K of an isotropic solid, or of one like a fibre that stands upright, depends on |q| alone. A
    subclass whose K depends on the direction of q too overrides `is_isotropic` by False, and its
    `stiffness_at` takes wave vectors.

    Example:
        >>> isinstance(solid, js.solids.SpectralSolid)
        True
    """

    grid: eqx.AbstractVar[Grid]

    def __check_init__(self) -> None:
        require_grid(self.grid)

    @property
    def is_isotropic(self) -> bool:
        """Whether K depends on |q| alone."""
        return True

    @abstractmethod
    def stiffness_at(self, waves: Float[Array, "..."]) -> Float[Array, " *modes"]:
        """Return the multiplier K at waves, none of them zero [pressure/length].

        Arguments:
            waves: wavenumbers |q| of any shape; unless K `is_isotropic`, the components (q_x, q_y)
                of wave vectors along the first axis [1/length]. K(-q) is K(q).
        """

    @property
    @program
    def waves(self) -> Waves:
        """This solid by its multiplier."""
        q = self.grid.wavenumbers
        if self.is_isotropic:
            # The second `where` keeps a formula that is singular at q = 0 out of the derivatives.
            stiffness = self.stiffness_at(jnp.where(q > 0, q, q.ravel()[1]))
        else:
            stiffness = self._stiffness_of_wavevectors()
        return Waves.of(self.grid, jnp.where(q > 0, stiffness, self.uniform_stiffness))

    def _stiffness_of_wavevectors(self) -> Float[Array, " *modes"]:
        grid = self.grid
        vectors = grid.wavevectors
        first = vectors.reshape(2, -1)[:, 1].reshape(2, *(1,) * (vectors.ndim - 1))
        stiffness = self.stiffness_at(jnp.where(grid.wavenumbers > 0, vectors, first))
        if grid.num_dimensions == 1:
            return stiffness
        # A wave of two points along a side is half one vector, half its mirror image.
        sides = zip(grid.waves, grid.shape, strict=True)
        is_alias = np.logical_or(*(2 * abs(k) == n for k, n in sides))
        aliases = np.nonzero(is_alias)
        mirrored = vectors[:, *aliases] * jnp.array([[1], [-1]])
        both = (stiffness[aliases] + self.stiffness_at(mirrored)) / 2
        return stiffness.at[aliases].set(both)

    @property
    def contact_modulus(self) -> Scalar:
        """The modulus that closed forms for spheres take: of half spaces alone [pressure].

        Raises:
            AttributeError: for a solid whose modulus depends on the size of the contact.
        """
        raise AttributeError(
            f"{type(self).__name__} has no contact modulus: that under a sphere depends on the "
            "size of the contact. That of a wave is 2 K / |q|, with K = solid.stiffness_at(q)."
        )

    @property
    def prepared(self) -> Waves:
        """This solid by its multiplier."""
        return self.waves

    @property
    def max_stiffness(self) -> Scalar:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The stiffness of the grid's stiffest wave [pressure/length]."""
        return self.waves.max_stiffness

    @property
    def min_stiffness(self) -> Scalar:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The stiffness of its softest wave [pressure/length]."""
        return self.waves.min_stiffness

    @property
    def uniform_stiffness(self) -> Scalar:
        """The multiplier at q = 0: zero where the far side moves along [pressure/length]."""
        return jnp.zeros((), self.grid.lengths.dtype)

    @property
    def is_valid(self) -> Flag:
        """Whether every wave's stiffness is positive, finite and no subnormal number."""
        return self.waves.is_valid

    def apply(self, displacement: Field) -> Field:
        """Return K u (Rey & Bleyer, eq. 12) [pressure].

        A solid that keeps its volume moves in the mean with its far side, at no pressure.
        """
        return self.with_uniform_stiffness(finite_or_zero(self.uniform_stiffness)).apply(
            displacement
        )

    def precondition(self, shift: Scalar) -> FieldMap:
        """Return the inverse of K + shift."""
        return self.waves.precondition(shift)

    def with_uniform_stiffness(self, stiffness: ArrayLike) -> Waves:
        """Return this solid by its multiplier, with another one at q = 0."""
        return self.waves.with_uniform_stiffness(stiffness)

    def scaled(self, factor: Scalar) -> Waves:
        """Return this solid by its multiplier, times a factor."""
        return self.waves.scaled(factor)

    def stiffness_deficit(self, level: Scalar) -> tuple[FieldMap, Scalar]:
        """Return max(0, level - K) without its mean, and its diagonal entry."""
        return self.waves.stiffness_deficit(level)

    def displacement(self, pressure: Field) -> Field:
        """Return the displacement under a pressure (Rey & Bleyer, eq. 11) [length].

        It has zero mean if the far side moves along.
        """
        return self.waves.displacement(pressure)


class Spectral(SpectralSolid):
    """A solid of any stiffness: K = function(|q|) or function(q_x, q_y).

    Arguments:
        grid: the grid of its surface.
        function: maps a wave's |q| > 0 [1/length], or the two components of its wave vector, to its
            stiffness [pressure/length]; a function or an `equinox.Module`. Its value at q = 0 is
            never used; that of (-q_x, -q_y) must be the same. On a line q_y is zero.

    Raises:
        ValueError: if the stiffness is not one real number for each wave, positive and finite.
        TypeError: for something that is no function, or one that JAX cannot trace.

    Example:
        >>> stretched = js.solids.Spectral(grid, lambda q: 0.5 * q + 0.01 * q**2)
        >>> f"{stretched.stiffness_at(np.array(10.0)):.1f}"
        '6.0'
    """

    grid: Grid
    function: Callable[..., Array]
    num_arguments: int = eqx.field(static=True, default=1)

    def __init__(self, grid: Grid, function: Callable[..., Array]):
        require_grid(grid)
        if not callable(function):
            raise TypeError(f"The function of the solid is {function!r}: give one of |q|.")
        self.grid = grid
        self.num_arguments = max(_num_arguments(function), 1)
        if self.num_arguments > 2:
            raise TypeError(
                f"The function of the solid takes {self.num_arguments} arguments: give one of |q|, "
                "or of q_x and q_y."
            )
        wave = jax.ShapeDtypeStruct((), grid.lengths.dtype)
        arguments = [wave] * self.num_arguments
        cure = "it must return one real stiffness for each wave."
        self.function = as_pytree("The function of the solid", function, cure, *arguments)
        waves = self.waves
        for stiffness in (waves.min_stiffness, waves.max_stiffness):
            require_positive("The stiffness of a wave", stiffness)

    @property
    def is_isotropic(self) -> bool:
        """Whether the function is one of |q|."""
        return self.num_arguments == 1

    def stiffness_at(self, waves: Float[Array, "..."]) -> Float[Array, " *modes"]:
        """Return function(|q|) or function(q_x, q_y) [pressure/length]."""
        components = (waves,) if self.is_isotropic else waves
        return jnp.vectorize(self.function)(*components)


def _num_arguments(function: Callable[..., Array]) -> int:
    """Return the number of arguments that a function needs."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:
        # Some functions written in C have none.
        return 1
    named = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    return sum(one.kind in named and one.default is inspect.Parameter.empty for one in parameters)

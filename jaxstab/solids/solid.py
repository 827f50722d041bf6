"""The interface of elastic solids: an operator K from displacement to pressure.

A uniform displacement takes no pressure if the far side moves along, as for a half space (Rey &
Bleyer, eq. 12). The load holds the far side and sets this `uniform_stiffness`. Its pressure is
uniform, or that under a flat punch.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.core import model
from jaxstab.core.compile import own_conventions
from jaxstab.core.display import inline
from jaxstab.core.grid import Mesh, mean, mean_over, require_mesh
from jaxstab.core.types import ArrayLike, Field, FieldMap, Flag, Mask, Scalar


class Solid(eqx.Module):
    """An elastic solid: a symmetric positive operator K on the displacement of its surface.

    A subclass gives the attributes, `apply` and `precondition`; it may override the other methods
    by faster ones. A uniform displacement must take a uniform pressure, or one in proportion to
    `punch`.

    Attributes:
        grid: the grid of its surface.
        max_stiffness: a number not below the largest eigenvalue of K on fields of zero mean
            [pressure/length].
        min_stiffness: about the smallest one there [pressure/length].

    Example:
        >>> f"{solid.max_stiffness:.2f}, {solid.min_stiffness:.2f}"
        '35.54, 3.14'
    """

    # A `Grid` or `Rings`: a type checker takes no narrower attribute in a subclass.
    grid: eqx.AbstractVar[Any]
    max_stiffness: eqx.AbstractVar[Scalar]
    min_stiffness: eqx.AbstractVar[Scalar]

    # A window's solid extends beyond the grid, and no load holds its mean displacement.
    is_window: ClassVar[bool] = False
    # Whether the grid has points beyond the surface.
    is_padded: ClassVar[bool] = False

    @property
    def punch(self) -> Field | None:
        """The pressure of a uniform displacement over its mean; None where it is uniform.

        A load acts by such pressures, and its work is on the mean of the displacement with these
        weights: elsewhere K takes no uniform displacement, and its pressures have no mean.
        """
        return None

    __repr__ = inline

    def __check_init__(self) -> None:
        require_mesh(self.grid)

    @property
    def padded(self) -> "Solid":
        """The solid on the grid of the computation, which is larger than a window's grid."""
        return self

    @property
    def prepared(self) -> "Solid":
        """The solid with all stiffnesses computed that do not change while a contact is solved."""
        return self

    @property
    def area(self) -> Scalar:
        """The area of the surface [length^2]; on a line its length [length]."""
        return self.grid.area

    def mean_over_grid(self, value: Array) -> Array:
        """Return the mean over the grid of a field: a value at the surface, zero elsewhere."""
        return value

    def surface(self, field: Array) -> Array:
        """Return the part of one field or several that has a surface opposite to it."""
        return field

    def displacement(self, pressure: Field) -> Field:
        """Return the displacement under a pressure, where it is known (Rey & Bleyer, eq. 11)."""
        raise NotImplementedError(f"A {type(self).__name__} maps no pressure to a displacement.")

    def conforming(self, heights: Field) -> Field:
        """Return the displacement that full contact takes."""
        return heights

    def conforming_energy(self, heights: Field) -> Scalar:
        """Return the elastic energy of full contact over the surface [energy]."""
        return self.with_uniform_stiffness(0).energy(self.conforming(heights))

    @abstractmethod
    def apply(self, displacement: Field) -> Field:
        """Return the pressure K u of a displacement relative to the far side [pressure]."""

    @abstractmethod
    def precondition(self, shift: Scalar) -> FieldMap:
        """Return an approximate inverse of K + shift, symmetric and positive, for shift > 0."""

    @property
    def uniform_stiffness(self) -> Scalar:
        """The pressure per uniform displacement [pressure/length]."""
        return self.apply(jnp.ones(self.grid.shape, self.max_stiffness.dtype)).ravel()[0]

    @property
    def is_valid(self) -> Flag:
        """Whether stiffnesses are positive, and numbers of full precision."""
        least = self.min_stiffness
        most = self.max_stiffness
        return (least >= jnp.finfo(least.dtype).tiny) & jnp.isfinite(most)

    def with_uniform_stiffness(self, stiffness: ArrayLike) -> "Solid":
        """Return this solid with another uniform stiffness, prepared to be applied often."""
        return Altered(self, jnp.ones_like(self.max_stiffness), stiffness)

    def scaled(self, factor: Scalar) -> "Solid":
        """Return this solid with its stiffness times a factor."""
        return Altered(self, factor, factor * self.uniform_stiffness)

    def coarser(self) -> "Solid | None":
        """Return this solid on every other point, or None if that is not known."""
        return None

    def stiffness_deficit(self, level: Scalar) -> tuple[FieldMap, Scalar] | None:
        """Return the operator that K lacks to reach a stiffness, and its diagonal entry.

        For a `SpectralSolid` it is max(0, level - K) for each wave; for other solids None.
        """
        return None

    @own_conventions()
    def pressure(self, displacement: Field) -> Field:
        """Return K u (Rey & Bleyer, eq. 12) [pressure]."""
        return self.apply(displacement)

    @own_conventions()
    def energy(self, displacement: Field) -> Scalar:
        """Return the elastic energy u.Ku / 2 over the surface [energy]."""
        energy = model.elastic_energy(displacement, self.apply(displacement))
        return energy * self.grid.cell_area.astype(energy.dtype)


def finite_or_zero(stiffness: Scalar) -> Scalar:
    """Return a uniform stiffness; zero where it is infinite, as the solid keeps its volume."""
    return jnp.where(stiffness == jnp.inf, 0, stiffness)


def apart_from_mean(
    inverse: FieldMap,
    field: Field,
    mask: Mask,
    stiffness: Scalar,
    softest: Scalar,
) -> Field:
    """Apply an approximate inverse of K to a field on the points of a mask that a spring holds.

    Under a spring stiffer than the softest wave, the mean is inverted apart from the rest of the
    field, which otherwise would stretch the spring.
    """
    is_stiff = stiffness > softest
    level = mean_over(mask, field)
    share = mean(mask.astype(field.dtype))
    moved = inverse(jnp.where(mask & is_stiff, field - level, field))
    apart = model.onto_space(moved, mask) + jnp.where(
        mask, level / (stiffness * share + softest), 0
    )
    return jnp.where(is_stiff, apart, moved)


class Altered(Solid):
    """A multiple of a solid's stiffness, with a uniform stiffness of its own."""

    grid: Mesh
    max_stiffness: Scalar
    min_stiffness: Scalar
    solid: Solid
    factor: Scalar
    uniform: Scalar

    def __init__(self, solid: Solid, factor: Scalar, uniform: ArrayLike):
        self.grid = solid.grid
        self.max_stiffness = factor * solid.max_stiffness
        self.min_stiffness = factor * solid.min_stiffness
        self.solid = solid
        self.factor = factor
        self.uniform = jnp.asarray(uniform, factor.dtype)

    @property
    def uniform_stiffness(self) -> Scalar:
        """The given uniform stiffness [pressure/length]."""
        return self.uniform

    def apply(self, displacement: Field) -> Field:
        """Apply the scaled K of the solid to a field; the mean has the uniform stiffness."""
        rigid = mean(displacement)
        level = finite_or_zero(self.uniform) * rigid
        pressure = self.solid.apply(displacement - rigid)
        dtype = jnp.result_type(pressure, displacement)
        if (pressure.shape, pressure.dtype) != (displacement.shape, dtype):
            given, found = map(eqx.tree_pformat, (displacement, pressure))
            raise TypeError(
                f"`apply` of {type(self.solid).__name__} maps {given} to {found}: return a "
                "pressure of the same shape and precision."
            )
        return self.factor * pressure + level

    def precondition(self, shift: Scalar) -> FieldMap:
        """Return the solid's scaled preconditioner, exact for the mean."""
        inverse = self.solid.precondition(shift / self.factor)

        def apply(field: Field) -> Field:
            level = mean(field)
            return inverse(field - level) / self.factor + level / (self.uniform + shift)

        return apply

"""The interface of elastic solids: an operator K from displacement to pressure.

A displacement that is the same everywhere takes no pressure where the far side moves along, as that
of a half space does (Rey & Bleyer, eq. 12). The load holds the far side and determines its
stiffness (`Solid.held_by`).
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.core import model
from jaxstab.core.display import inline
from jaxstab.core.grid import Grid, mean, mean_over, require_grid
from jaxstab.core.switches import own_conventions
from jaxstab.core.types import ArrayLike, Field, FieldMap, Flag, Mask, Scalar


class Solid(eqx.Module):
    """An elastic solid: a symmetric positive operator K on the displacement of its surface.

    A subclass gives the attributes, `apply` and `precondition`; the rest follows from these, and
    may be replaced by something faster. A displacement that is the same everywhere must take a
    pressure that is.

    Attributes:
        grid: the grid of its surface.
        max_stiffness: a number not below the largest eigenvalue of K on fields of zero mean
            [pressure/length].
        min_stiffness: about the smallest one there [pressure/length].
    """

    grid: eqx.AbstractVar[Grid]
    max_stiffness: eqx.AbstractVar[Scalar]
    min_stiffness: eqx.AbstractVar[Scalar]

    # Whether there is solid beyond the grid too, which no load can hold in the mean.
    is_window: ClassVar[bool] = False

    __repr__ = inline

    def __check_init__(self) -> None:
        require_grid(self.grid)

    @property
    def whole(self) -> "Solid":
        """The solid on the grid that it is solved on: that of a window is larger than this."""
        return self

    @property
    def share(self) -> float:
        """The part of the grid with a surface opposite to it."""
        return 1.0

    def surface(self, field: Array) -> Array:
        """Return the part of one field or several that has a surface opposite to it."""
        return field

    def flush(self, heights: Field) -> Field:
        """Return the displacement that full contact takes."""
        return heights

    @abstractmethod
    def apply(self, displacement: Field) -> Field:
        """Return the pressure K u of a displacement relative to the far side [pressure]."""

    @abstractmethod
    def precondition(self, shift: Scalar) -> FieldMap:
        """Return roughly the inverse of K + shift, for a positive shift: symmetric and positive."""

    @property
    def uniform_stiffness(self) -> Scalar:
        """The pressure over a displacement that is the same everywhere [pressure/length]."""
        return self.apply(jnp.ones(self.grid.shape, self.max_stiffness.dtype)).ravel()[0]

    @property
    def is_valid(self) -> Flag:
        """Whether stiffnesses are positive, and numbers of full precision."""
        least, most = self.min_stiffness, self.max_stiffness
        return (least >= jnp.finfo(least.dtype).tiny) & jnp.isfinite(most)

    def held_by(self, stiffness: ArrayLike) -> "Solid":
        """Return the same solid with another uniform stiffness, prepared to be applied often."""
        return Altered(self, jnp.ones_like(self.max_stiffness), stiffness)

    def scaled(self, factor: Scalar) -> "Solid":
        """Return a solid whose stiffness is this one's times a factor."""
        return Altered(self, factor, factor * self.uniform_stiffness)

    def coarser(self) -> "Solid | None":
        """Return the same solid on every other point, where the coarser grid's waves are known."""
        return None

    def lacking(self, level: Scalar) -> tuple[FieldMap, Scalar] | None:
        """Return the operator that K lacks to reach a stiffness, and its diagonal entry.

        For each wave that is max(0, level - K), where the solid is one that has waves, as a
        `SpectralSolid`; of others it is not known.
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
    """Return roughly the inverse of K on the points of a mask, which a spring holds, times a field.

    If that is stiffer than the softest wave, the mean and the rest of the field are taken apart.
    Otherwise any move of the rest would stretch the spring.
    """
    is_stiff = stiffness > softest
    level, share = mean_over(mask, field), mean(mask.astype(field.dtype))
    moved = inverse(jnp.where(mask & is_stiff, field - level, field))
    apart = model.onto_space(moved, mask) + jnp.where(
        mask, level / (stiffness * share + softest), 0
    )
    return jnp.where(is_stiff, apart, moved)


class Altered(Solid):
    """A solid whose stiffness is that of another one times a factor, but for the uniform one."""

    grid: Grid
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
        """That which was given [pressure/length]."""
        return self.uniform

    def apply(self, displacement: Field) -> Field:
        """Return K of the other solid times a field; the mean has a stiffness of its own."""
        rigid = mean(displacement)
        level = finite_or_zero(self.uniform) * rigid
        return self.factor * self.solid.apply(displacement - rigid) + level

    def precondition(self, shift: Scalar) -> FieldMap:
        """Return that of the other solid, exact for the mean."""
        inverse = self.solid.precondition(shift / self.factor)

        def apply(field: Field) -> Field:
            level = mean(field)
            return inverse(field - level) / self.factor + level / (self.uniform + shift)

        return apply

"""Loads, and what each of them asks of a gap.

A load holds either the mean gap, and then the mean pressure p0 follows from equilibrium, or the
mean pressure, and then the mean gap does. Solvers see it as a `Control`, prepared for one surface.
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxstab.checks import parameter
from jaxstab.display import inline
from jaxstab.grid import centred, total
from jaxstab.scan import Scan
from jaxstab.stacks import Stackable

Field = Float[Array, " *grid"]
Mask = Bool[Array, " *grid"]


class Control(eqx.Module):
    """What a load asks of the gap of one surface.

    Attributes:
        fixes_mean: whether perturbations under the load have zero mean.
    """

    fixes_mean: ClassVar[bool]

    @property
    @abstractmethod
    def is_feasible(self) -> Bool[Array, ""]:
        """Whether any gap meets the load."""

    @abstractmethod
    def starting_gap(self, heights: Field) -> Field:
        """Return the gap of the undeformed solid, negative where it would enter the surface."""

    @abstractmethod
    def restore(self, gap: Field) -> Field:
        """Return a gap that meets the load, near to one that is nowhere negative."""

    @abstractmethod
    def missed(self, gap: Field) -> Float[Array, ""]:
        """Return by what part of itself a gap misses the load."""

    @abstractmethod
    def resisting(self, attraction: Field, is_free: Mask) -> Field:
        """Return the part of the attraction that neither load nor contact takes [pressure]."""

    @abstractmethod
    def mean_imbalance(self, missed: Field, attraction: Field) -> Float[Array, ""]:
        """Return the mean of the pressures out of balance, over that of those that balance."""

    @abstractmethod
    def net_pressure(self, gradient: Field, is_free: Mask) -> Field:
        """Return K u + p0 + f'(g) from K u + f'(g) [pressure]."""

    @abstractmethod
    def project(self, field: Field, is_moving: Mask) -> Field:
        """Return the nearest perturbation of the moving points that the load allows."""

    @abstractmethod
    def work(self, change: Array) -> Array:
        """Return the work done against the load by a change of the gap, or of gaps in all."""

    @abstractmethod
    def escape_gap(self, scan: Scan) -> Float[Array, ""]:
        """Return the gap beyond which nothing holds the surfaces against the load [length]."""

    @abstractmethod
    def has_escaped(self, gap: Field, escape_gap: Float[Array, ""]) -> Bool[Array, ""]:
        """Whether the load has pulled the surfaces apart for good."""


class GapControl(Control):
    """The mean gap is held at a value [length]."""

    fixes_mean: ClassVar[bool] = True

    mean_gap: Float[Array, ""]

    @property
    def is_feasible(self) -> Bool[Array, ""]:
        """Whether the mean gap is positive and finite."""
        return (self.mean_gap > 0) & jnp.isfinite(self.mean_gap)

    def starting_gap(self, heights: Field) -> Field:
        """Return g0 + mean(h) - h."""
        return self.mean_gap + jnp.mean(heights) - heights

    def restore(self, gap: Field) -> Field:
        """Return the gap scaled to its mean."""
        return gap * (self.mean_gap * gap.size / total(gap))

    def missed(self, gap: Field) -> Float[Array, ""]:
        """Return how far the mean gap is off, over what it should be."""
        unit = jnp.where(self.mean_gap == 0, 1, self.mean_gap)
        return jnp.abs((total(gap) / gap.size - self.mean_gap) / unit)

    def resisting(self, attraction: Field, is_free: Mask) -> Field:
        """Return the attraction of the free points less its mean, which p0 balances."""
        return centred(attraction, is_free)

    def mean_imbalance(self, missed: Field, attraction: Field) -> Float[Array, ""]:
        """Return zero: p0 is whatever balances the mean."""
        return jnp.zeros((), missed.dtype)

    def net_pressure(self, gradient: Field, is_free: Mask) -> Field:
        """Return the gradient less its mean over the free points, which is -p0."""
        return gradient - total(jnp.where(is_free, gradient, 0)) / _count(is_free, gradient)

    def project(self, field: Field, is_moving: Mask) -> Field:
        """Return the field less its mean over the moving points, zero elsewhere."""
        return centred(field, is_moving)

    def work(self, change: Array) -> Array:
        """Return zero: the mean gap does not move."""
        return jnp.zeros_like(change)

    def escape_gap(self, scan: Scan) -> Float[Array, ""]:
        """Return infinity: the mean gap is held."""
        return jnp.array(jnp.inf)

    def has_escaped(self, gap: Field, escape_gap: Float[Array, ""]) -> Bool[Array, ""]:
        """Return False: the mean gap is held."""
        return jnp.array(False)


class PressureControl(Control):
    """The mean pressure is held at p0, positive in compression [pressure]."""

    fixes_mean: ClassVar[bool] = False

    mean_pressure: Float[Array, ""]

    @property
    def is_feasible(self) -> Bool[Array, ""]:
        """Whether the pressure is finite."""
        return jnp.isfinite(self.mean_pressure)

    def starting_gap(self, heights: Field) -> Field:
        """Return the gap at which half of the surface would be in contact."""
        return jnp.mean(heights) - heights

    def restore(self, gap: Field) -> Field:
        """Return the gap itself: any that is not negative will do."""
        return gap

    def missed(self, gap: Field) -> Float[Array, ""]:
        """Return zero: any gap will do."""
        return jnp.zeros((), gap.dtype)

    def resisting(self, attraction: Field, is_free: Mask) -> Field:
        """Return the attraction of the free points plus p0, which balances it if a tension."""
        return jnp.where(is_free, attraction + self.mean_pressure, 0)

    def mean_imbalance(self, missed: Field, attraction: Field) -> Float[Array, ""]:
        """Return what is missed over p0 and the attraction, in the mean."""
        balancing = jnp.abs(self.mean_pressure) + jnp.abs(total(attraction) / attraction.size)
        mean = jnp.abs(total(missed) / missed.size)
        return jnp.where(balancing > 0, mean / jnp.where(balancing > 0, balancing, 1), 0)

    def net_pressure(self, gradient: Field, is_free: Mask) -> Field:
        """Return the gradient plus p0."""
        return gradient + self.mean_pressure

    def project(self, field: Field, is_moving: Mask) -> Field:
        """Return the field at the moving points, zero elsewhere."""
        return jnp.where(is_moving, field, 0)

    def work(self, change: Array) -> Array:
        """Return p0 times the change of the gap."""
        return self.mean_pressure * change

    def escape_gap(self, scan: Scan) -> Float[Array, ""]:
        """Return the outermost gap with a thousandth of the attraction that would balance p0."""
        outermost = scan.outermost_gap(-1e-3 * self.mean_pressure)
        return jnp.where(self.mean_pressure < 0, outermost, jnp.inf)

    def has_escaped(self, gap: Field, escape_gap: Float[Array, ""]) -> Bool[Array, ""]:
        """Whether all points are beyond that gap."""
        return jnp.all((gap > 0) & (gap > escape_gap))


def _prescribed(value: ArrayLike) -> Float[Array, "..."]:
    # JAX compiles apart for a Python number and for an entry of an array.
    return parameter(np.float64(value) if isinstance(value, float | int) else value)


class Load(Stackable, eqx.Module):
    """What holds the surfaces together: one value, or an array of values for a sweep."""

    value: eqx.AbstractVar[Float[Array, "..."]]

    __repr__ = inline

    @abstractmethod
    def control(self, heights: Field) -> Control:
        """Return what the load asks of the gap over this surface."""

    def in_units_of(self, pressure: Float[Array, ""]) -> "Load":
        """Return the same load with pressures in another unit; lengths stay."""
        return self


class MeanDisplacement(Load):
    """A prescribed mean(u) [length]: one value, or an array of them for a sweep."""

    value: Float[Array, "..."] = eqx.field(converter=_prescribed)

    def control(self, heights: Field) -> GapControl:
        """Hold the mean gap at mean(u) - mean(h)."""
        return GapControl(self.value.astype(heights.dtype) - jnp.mean(heights))


class MeanGap(Load):
    """A prescribed mean(g) [length] (Rey & Bleyer, eq. 4): one value, or an array for a sweep."""

    value: Float[Array, "..."] = eqx.field(converter=_prescribed)

    def control(self, heights: Field) -> GapControl:
        """Hold the mean gap at the value."""
        return GapControl(self.value.astype(heights.dtype))


class MeanPressure(Load):
    """A prescribed p0 [pressure], positive in compression: one value, or an array for a sweep."""

    value: Float[Array, "..."] = eqx.field(converter=_prescribed)

    def control(self, heights: Field) -> PressureControl:
        """Hold the mean pressure at the value."""
        return PressureControl(self.value.astype(heights.dtype))

    def in_units_of(self, pressure: Float[Array, ""]) -> "MeanPressure":
        """Return the same load with pressures in another unit; lengths stay."""
        return MeanPressure(self.value / pressure)


def require_load(load: Load) -> None:
    """Raise `TypeError` if `load` is not one."""
    if not isinstance(load, Load):
        raise TypeError(
            f"The load is {load!r}: say what it prescribes, with MeanDisplacement, MeanGap or "
            "MeanPressure."
        )


def _count(mask: Mask, like: Field) -> Float[Array, ""]:
    return jnp.maximum(total(mask.astype(like.dtype)), 1)

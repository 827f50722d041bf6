"""Loads that press: with a pressure of their own, whatever the gap."""

from abc import abstractmethod
from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.core import model
from jaxstab.core.grid import mean
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.core.units import PRESSURE
from jaxstab.loads.load import Control, Load, prescribed_value
from jaxstab.potentials.profile import Profile
from jaxstab.solids.solid import Solid


class PressingControl(Control):
    """A mean pressure p0 presses, which may depend on the mean gap.

    Attributes:
        punch: the pressures of p0 over p0, and the weights of the mean gap; None where uniform.
    """

    fixes_mean: ClassVar[bool] = False

    punch: Field | None = eqx.field(default=None, kw_only=True)

    def mean_gap_of(self, gap: Field) -> Scalar:
        """Return the mean of the gap with the weights of the load [length]."""
        return mean(gap, self.punch)

    @abstractmethod
    def pressure(self, gap: Field) -> Scalar:
        """Return p0 at a gap, positive in compression [pressure]."""

    def restore(self, gap: Field) -> Field:
        """Return the gap itself: any that is not negative will do."""
        return gap

    def admissible(self, gap: Field, side: Field | None = None) -> Field:
        """Return the gap cut at zero."""
        return self.cut(gap, side)

    def error(self, gap: Field) -> Scalar:
        """Return zero: any gap will do."""
        return jnp.zeros((), gap.dtype)

    def net_pressure(self, gradient: Field, gap: Field) -> Field:
        """Return the gradient plus p0."""
        return gradient + model.load_pressure(self.pressure(gap), self.punch)

    def resisting(self, attraction: Field, gap: Field) -> Field:
        """Return f' + p0 on the free points: a tension p0 balances a part of the attraction."""
        pressed = model.load_pressure(self.pressure(gap), self.punch)
        return jnp.where(gap > 0, attraction + pressed, 0)

    def mean_imbalance(self, imbalance: Field, attraction: Field, gap: Field) -> Scalar:
        """Return the mean imbalance over p0 and the attraction."""
        balancing = jnp.abs(self.pressure(gap)) + mean(jnp.abs(attraction))
        if self.stiffness is not None:
            # A relaxed spring is balanced to a part of its length.
            balancing = balancing + self.stiffness * self.mean_gap_of(gap)
        left = jnp.abs(mean(imbalance))
        return jnp.where(balancing > 0, left / jnp.where(balancing > 0, balancing, 1), 0)

    def project(self, field: Field, is_moving: Mask) -> Field:
        """Return the field at the moving points, zero elsewhere."""
        return jnp.where(is_moving, field, 0)


class PressureControl(PressingControl):
    """The mean pressure is held at p0, positive in compression [pressure]."""

    stores_energy: ClassVar[bool] = False

    mean_pressure: Scalar

    @property
    def stiffness(self) -> None:
        """None: the pressure does not change with the gap."""

    @property
    def is_feasible(self) -> Flag:
        """Whether the pressure is finite, and no larger than a surface that yields bears."""
        is_finite = jnp.isfinite(self.mean_pressure)
        if self.largest_pressure is None:
            return is_finite
        return is_finite & (self.mean_pressure <= self.largest_pressure)

    def pressure(self, gap: Field) -> Scalar:
        """Return p0."""
        return self.mean_pressure

    def starting_gap(self, heights: Field) -> Field:
        """Return the gap at which half of the surface would be in contact."""
        return jnp.mean(heights) - heights

    def energy(self, mean_gap: Array) -> Array:
        """Return p0 times the mean gap."""
        return self.mean_pressure * mean_gap

    def escape_gap(self, profile: Profile) -> Scalar:
        """Return the outermost gap with a thousandth of the attraction that would balance p0.

        At zero pressure a law that repels at large gaps pushes the surfaces apart without end. If
        it attracts there, only surfaces beyond all gaps that are looked at are apart.
        """
        pressure = self.mean_pressure
        attracting = jnp.where(profile.repels_far, profile.outermost_attraction, profile.gaps[0])
        outermost = jnp.where(pressure < 0, profile.outermost_gap(-1e-3 * pressure), attracting)
        return jnp.where(pressure <= 0, outermost, jnp.inf)

    def has_escaped(self, gap: Field, escape_gap: Scalar) -> Flag:
        """Whether all points are beyond that gap."""
        return jnp.all((gap > 0) & (gap > escape_gap))


class MeanPressure(Load):
    """A prescribed p0 [pressure], positive in compression: one value, or an array for a sweep.

    Example:
        >>> f"{js.equilibrate(contact, js.MeanPressure(0.1)).contact_area:.3f}"
        '0.867'
    """

    quantity: ClassVar[str] = "mean pressure $p_0$"

    value: Annotated[Float[Array, "..."], PRESSURE] = eqx.field(converter=prescribed_value)

    def control(self, solid: Solid, heights: Field) -> PressureControl:
        """Hold the mean pressure at the value."""
        mean_pressure = solid.mean_over_grid(self.value.astype(heights.dtype))
        return PressureControl(mean_pressure=mean_pressure, punch=solid.punch)

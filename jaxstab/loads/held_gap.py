"""Loads that hold the mean of the gap."""

from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.core import model
from jaxstab.core.grid import mean
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.core.units import LENGTH
from jaxstab.loads.load import Control, Load, prescribed_value
from jaxstab.solids.solid import Solid


class GapControl(Control):
    """The mean gap is held at a value [length]."""

    fixes_mean: ClassVar[bool] = True

    mean_gap: Scalar

    @property
    def stiffness(self) -> None:
        """None: perturbations have no mean for it to act on."""

    @property
    def is_feasible(self) -> Flag:
        """Whether the mean gap is finite, and positive unless the surface yields."""
        is_finite = jnp.isfinite(self.mean_gap)
        if self.largest_reaction is None:
            return (self.mean_gap > 0) & is_finite
        return is_finite

    def starting_gap(self, heights: Field) -> Field:
        """Return g0 + mean(h) - h."""
        return self.mean_gap + jnp.mean(heights) - heights

    def restore(self, gap: Field) -> Field:
        """Return the gap scaled to its mean."""
        if self.largest_reaction is None:
            return model.scaled_to_mean(gap, self.mean_gap)
        return model.signed_to_mean(gap, self.mean_gap)

    def admissible(self, gap: Field, side: Field | None = None) -> Field:
        """Return the gap cut at zero, and scaled to its mean."""
        return self.restore(self.cut(gap, side))

    def error(self, gap: Field) -> Scalar:
        """Return the error of the mean gap, over its prescribed value.

        On a surface that yields it is over the mean size of the signed gap.
        """
        unit = self.mean_gap
        if self.largest_reaction is not None:
            unit = mean(jnp.abs(gap))
        unit = jnp.where(unit == 0, 1, unit)
        return jnp.abs((mean(gap) - self.mean_gap) / unit)

    def energy(self, mean_gap: Array) -> Array:
        """Return zero: the mean gap does not move."""
        return jnp.zeros_like(mean_gap)

    def net_pressure(self, gradient: Field, gap: Field) -> Field:
        """Return the gradient less its mean over the free points, which is -p0."""
        return gradient + model.held_mean_pressure(gradient, gap, None, self.largest_reaction)

    def resisting(self, attraction: Field, gap: Field) -> Field:
        """Return the attraction of the free points less its mean, which p0 balances."""
        return model.onto_space(attraction, gap > 0)

    def mean_imbalance(self, imbalance: Field, attraction: Field, gap: Field) -> Scalar:
        """Return zero: p0 is whatever balances the mean."""
        return jnp.zeros((), imbalance.dtype)

    def project(self, field: Field, is_moving: Mask) -> Field:
        """Return the field less its mean over the moving points, zero elsewhere."""
        return model.onto_space(field, is_moving)


class MeanDisplacement(Load):
    """A prescribed mean(u) [length]: one value, or an array for a sweep.

    Example:
        >>> f"{js.equilibrate(contact, js.MeanDisplacement(0.1)).mean_pressure:.4f}"
        '-0.1244'
    """

    quantity: ClassVar[str] = "mean displacement $u_0$"
    is_position: ClassVar[bool] = True

    value: Annotated[Float[Array, "..."], LENGTH] = eqx.field(converter=prescribed_value)

    def control(self, solid: Solid, heights: Field) -> GapControl:
        """Hold the mean gap at mean(u) - mean(h)."""
        _refuse_window("MeanDisplacement", solid)
        return GapControl(self.value.astype(heights.dtype) - jnp.mean(heights))


class MeanGap(Load):
    """A prescribed mean(g) [length] (Rey & Bleyer, eq. 4): one value, or an array for a sweep.

    On a surface that yields it is the mean of u - h, the gap over the surface as the contact has
    it: mean(g) less the mean indentation. A path counts it from the surface that it began with.

    Example:
        >>> f"{js.equilibrate(contact, js.MeanGap(0.1)).mean_pressure:.4f}"
        '-0.1244'
    """

    quantity: ClassVar[str] = "mean gap $g_0$"

    value: Annotated[Float[Array, "..."], LENGTH] = eqx.field(converter=prescribed_value)

    def control(self, solid: Solid, heights: Field) -> GapControl:
        """Hold the mean gap at the value."""
        _refuse_window("MeanGap", solid)
        return GapControl(self.value.astype(heights.dtype))

    def after_indentation(self, depth: Scalar) -> "MeanGap":
        """Return the mean gap over a surface that lies lower by a mean depth."""
        return MeanGap(self.value + depth)


def _refuse_window(load: str, solid: Solid) -> None:
    if solid.is_window:
        raise ValueError(
            f"{load} cannot be held on the window of a FreeHalfSpace or on rings, which does not "
            "hold the solid outside: prescribe a FarDisplacement, a MeanPressure or a Spring."
        )

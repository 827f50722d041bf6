"""Loads that press like a spring: a machine in series, or the solid itself."""

from typing import Annotated, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core import model
from jaxstab.core.checks import (
    concrete,
    parameter,
    require_kind,
    require_positive,
    where_known,
)
from jaxstab.core.grid import Mesh, mean, mean_over, total
from jaxstab.core.types import ArrayLike, Field, FieldMap, Flag, Mask, Scalar
from jaxstab.core.units import LENGTH, STIFFNESS
from jaxstab.core.warn import warn
from jaxstab.loads.load import Load, prescribed_value
from jaxstab.loads.pressure import PressingControl
from jaxstab.potentials.profile import Profile
from jaxstab.solids.solid import Solid, apart_from_mean

# The least stiffness of a real cantilever, over the stiffness of the solid's softest wave.
_SOFT = 1e-8


class MachineWarning(UserWarning):
    """The machine is softer than the contact by orders of magnitude.

    Example:
        >>> import warnings
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     found = js.equilibrate(contact, js.Spring(0.1, 1e-9), throw=False)
        >>> caught[0].category.__name__
        'MachineWarning'
    """


class SpringControl(PressingControl):
    """A spring holds the mean gap: p0 = k (mean(g) - g0).

    Attributes:
        relaxed_gap: g0, the mean gap at which the spring is relaxed [length].
        constant: k [pressure/length].
        softest: the stiffness of the softest wave of the solid [pressure/length].
    """

    relaxed_gap: Scalar
    constant: Scalar
    softest: Scalar

    @property
    def is_stiff(self) -> Flag:
        """Whether it is stiffer than the softest wave, and so holds the gap rather than presses."""
        return self.constant > self.softest

    @property
    def stiffness(self) -> Scalar:
        """The constant k of the spring."""
        return self.constant

    @property
    def is_feasible(self) -> Flag:
        """Whether the spring has a position and a stiffness."""
        is_finite = jnp.isfinite(self.relaxed_gap) & jnp.isfinite(self.constant)
        return is_finite & (self.constant > 0)

    def pressure(self, gap: Field) -> Scalar:
        """Return k (mean(g) - g0)."""
        return self.constant * (self.mean_gap_of(gap) - self.relaxed_gap)

    def net_pressure(self, gradient: Field, gap: Field) -> Field:
        """Return the gradient plus p0, less the imbalance that rounding of the gap explains."""
        pressure = self.pressure(gap)
        lengths = jnp.abs(self.relaxed_gap) + self.mean_gap_of(gap)
        if self.largest_reaction is not None:
            lengths = jnp.abs(lengths)
        # A mean is rounded by some four units. If more were left to it, states along a path would
        # be out of balance by as much, and its steps be halved in float32.
        rounding = 4 * float(jnp.finfo(gap.dtype).eps) * self.constant * lengths
        held = model.held_mean_pressure(gradient, gap, self.punch, self.largest_reaction)
        imbalance = pressure - held
        open_part = jax.lax.stop_gradient(jnp.clip(imbalance, -rounding, rounding))
        return gradient + model.load_pressure(pressure - open_part, self.punch)

    def starting_gap(self, heights: Field) -> Field:
        """Return the start under a held mean gap for a stiff spring, else under a held pressure."""
        mean_gap = jnp.where(self.is_stiff, jnp.maximum(self.relaxed_gap, 0), 0)
        return mean_gap + mean(heights, self.punch) - heights

    def separated_gap(self, heights: Field, profile: Profile) -> Field:
        """Return the gap of the relaxed spring if a separated state exists, else `starting_gap`.

        It exists if at half of the smallest gap, and further out, the spring pulls harder than the
        law: a uniform move of the surface then meets an equilibrium before.
        """
        start = self.starting_gap(heights)
        apart = jnp.maximum(self.relaxed_gap, 0) + mean(heights, self.punch) - heights
        half = jnp.min(apart) / 2
        attraction = jnp.max(jnp.where(profile.gaps >= half, profile.slopes, 0))
        return jnp.where((half > 0) & (attraction < self.constant * half), apart, start)

    def admissible(self, gap: Field, side: Field | None = None) -> Field:
        """Return the gap cut at zero; for a stiff spring, scaled to the mean it had before."""
        cut = self.cut(gap, side)
        if self.largest_reaction is not None:
            scaled = model.signed_to_mean(cut, mean(gap))
            return jnp.where(self.is_stiff, scaled, cut)
        before = total(gap)
        after = total(cut)
        is_scaled = self.is_stiff & (before > 0)
        return cut * jnp.where(is_scaled, before / jnp.where(is_scaled, after, 1), 1)

    def release_level(self, gap: Field, net: Field) -> Scalar:
        """Return the mean over the free points under a stiff spring, which relaxes first."""
        largest = self.largest_reaction
        level = mean_over(model.free_points(gap, largest), model.on_side(net, gap, largest))
        return jnp.where(self.is_stiff, level, 0)

    def precondition(self, inverse: FieldMap, force: Field, is_moving: Mask) -> Field:
        """Apply the preconditioner; a stiff spring takes the mean apart."""
        return apart_from_mean(inverse, force, is_moving, self.constant, self.softest)

    def energy(self, mean_gap: Array) -> Array:
        """Return k (mean(g) - g0)^2 / 2."""
        return self.constant * (mean_gap - self.relaxed_gap) ** 2 / 2


class Spring(Load):
    """A machine in series: p0 = k (far - position), a spring of stiffness k behind the solid.

    The displacement `far` of the far side is mean(u) for a half space. For a solid with a uniform
    stiffness k_s, such as a layer or a `FreeHalfSpace`, it is mean(u) - p0 / k_s; then p0 = k_e
    (mean(u) - position) with 1 / k_e = 1 / k + 1 / k_s.

    The limit of a large stiffness is `MeanDisplacement`, or `FarDisplacement` for a solid with a
    far side. The limit of a small one is `MeanPressure`, with a position of -p0 / k. Use the limit
    for a spring more than a million times stiffer than the waves, with which the search on
    the cone would stagnate.

    This k is per area of the cell; `Spring.cantilever` takes a force per length, such as N/m.

    Arguments:
        position: the position of the spring's far end [length]: one, or an array for a sweep.
        stiffness: k [pressure/length]; one, or one for each position.

    Raises:
        ValueError: if a stiffness is not positive, or the numbers of positions and of stiffnesses
            do not agree.

    Warns:
        MachineWarning: for a contact whose softest wave is 1e8 times as stiff.

    Example:
        >>> machine = js.Spring(position=0.2, stiffness=2.0)
        >>> f"{js.equilibrate(contact, machine).mean_pressure:.4f}"
        '-0.0354'
    """

    quantity: ClassVar[str] = "position of the spring"
    is_position: ClassVar[bool] = True

    value: Annotated[Float[Array, "..."], LENGTH]
    stiffness: Annotated[Float[Array, "..."], STIFFNESS]

    def __init__(self, position: ArrayLike, stiffness: ArrayLike):
        self.value, self.stiffness = _alike(prescribed_value(position), prescribed_value(stiffness))
        require_positive("The stiffness of the spring", self.stiffness)

    @classmethod
    def cantilever(cls, position: ArrayLike, constant: ArrayLike, grid: Mesh) -> "Spring":
        """Return the spring of a cantilever with a constant c in force per length: k = c / area.

        A cantilever of 1 N/m over a cell of 1 µm by 1 µm has a stiffness of 1e12 Pa/m.

        Arguments:
            position: the position of its far end [length].
            constant: c, in N/m for pressures in Pa and lengths in m, and also for MPa and µm
                [force/length]; on a line, the constant for a strip of unit width [pressure].
            grid: the grid of the contact, or its rings, `contact.grid`, whose area the force acts
                on.

        Raises:
            ValueError: if a constant is not positive.
            TypeError: for something that is not a grid.
        """
        require_kind(grid, Mesh, "no grid: give the grid of the contact, contact.grid.")
        given = parameter(constant)
        require_positive("The constant of the cantilever", given)
        return cls(position, given / grid.area)

    @property
    def position(self) -> Float[Array, "..."]:
        """The position of the far end [length]: the value of this load."""
        return self.value

    def far_displacement(self, mean_pressure: Array) -> Array:
        """Return position + p0 / k [length]."""
        return self.value + mean_pressure / self.stiffness

    def warn_if_soft(self, solid: Solid) -> None:
        """Warn once of a spring that is softer than any real cantilever against a solid.

        Inside of `jax.jit` and `jax.vmap` values are not known, and nothing is warned of.
        """
        _warn_if_soft(self.stiffness, solid)

    def control(self, solid: Solid, heights: Field) -> SpringControl:
        """Press with the stiffness of the spring and the solid's far side in series."""
        stiffness = solid.mean_over_grid(self.stiffness.astype(heights.dtype))
        far = solid.uniform_stiffness
        # A half space has no uniform stiffness; others act in series with the spring.
        held = stiffness / (1 + stiffness / jnp.where(far > 0, far, jnp.inf))
        return _spring(self.value, held, solid, heights)


class FarDisplacement(Load):
    """A prescribed displacement of the far side of a solid that has one [length].

    A half space is infinitely deep, and an incompressible layer keeps its volume: the load of both
    is `MeanDisplacement`.

    Example:
        >>> layer = js.Layer(grid, youngs_modulus=1.0, poisson_ratio=0.3, thickness=0.1)
        >>> pressed = js.equilibrate(js.Contact(layer, heights, law), js.FarDisplacement(-0.02))
        >>> f"{pressed.mean_pressure:.4f}"
        '0.3454'
    """

    quantity: ClassVar[str] = "displacement of the far side"
    is_position: ClassVar[bool] = True

    value: Annotated[Float[Array, "..."], LENGTH] = eqx.field(converter=prescribed_value)

    def far_displacement(self, mean_pressure: Array) -> Array:
        """Return the prescribed value [length]."""
        return self.value

    def control(self, solid: Solid, heights: Field) -> SpringControl:
        """Press with the stiffness of the solid itself."""
        return _spring(self.value, solid.uniform_stiffness, solid, heights)


@where_known
def _warn_if_soft(stiffnesses: Array, solid: Solid) -> None:
    stiffness = concrete(stiffnesses).min()
    softest = concrete(solid.min_stiffness)
    if stiffness >= _SOFT * softest:
        return
    warn(
        f"the stiffness of the spring is {stiffness:.3g} [pressure/length], the stiffness of the "
        f"solid's softest wave {softest:.3g}: the machine is so soft that it hardly presses. If "
        "the number is a force per length, write Spring.cantilever(position, "
        f"{stiffness:.3g}, contact.grid): that divides it by the cell's area of "
        f"{concrete(solid.grid.area):.3g}. For a dead load give a MeanPressure.",
        MachineWarning,
    )


def _spring(position: Scalar, stiffness: Scalar, solid: Solid, heights: Field) -> SpringControl:
    punch = solid.punch
    relaxed_gap = position.astype(heights.dtype) - mean(heights, punch)
    return SpringControl(
        relaxed_gap=relaxed_gap,
        constant=stiffness,
        softest=solid.min_stiffness,
        punch=punch,
    )


def _alike(positions: Array, stiffnesses: Array) -> list[Array]:
    """Broadcast arrays to their common shape, without compiling anything where they have it."""
    try:
        shape = np.broadcast_shapes(positions.shape, stiffnesses.shape)
    except ValueError:
        raise ValueError(
            f"The positions have shape {positions.shape}, the stiffnesses {stiffnesses.shape}: "
            "give one stiffness, or one for each position."
        ) from None
    values = [positions, stiffnesses]
    for place, value in enumerate(values):
        if value.shape != shape:
            values[place] = jnp.broadcast_to(value, shape)
    return values

"""Rings of equal area on a disc: the points of an axisymmetric contact."""

import math
from collections.abc import Callable
from typing import Annotated, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding
from jaxtyping import Array, Float

from jaxstab.core.checks import (
    in_words,
    integer,
    parameter,
    positive_scalar,
    require,
    require_positive,
)
from jaxstab.core.display import inline
from jaxstab.core.grid import Mesh
from jaxstab.core.types import ArrayLike, Field, Scalar
from jaxstab.core.units import LENGTH

# Contact radii that are tried: tips of all sizes, in any unit of length, in steps of 4 %.
_CONTACT_RADII = np.geomspace(1e-15, 1e6, 1200)
# Points of the integral over the contact, whose error is then below 1e-4.
_NUM_ANGLES = 100
# The radius of the disc over the largest contact radius, and the depth of a tip, in ranges of the
# law, beyond which there is hardly any attraction.
_BEYOND = 1.5
_RANGES = 8
# The stiffness of two rings that move against each other, times their width over E*, and how much
# stiffer than the law they are to be, as jumps need.
_STIFFNESS = 1.8
_STIFFER = 4
# The force of a contact without adhesion is exact to 1e-4 on so many rings, of which so many lie
# within the smallest contact.
_LEAST_RINGS = 200
_IN_CONTACT = 30
# A dense matrix of this size takes 128 MB.
_MOST_RINGS = 4000


class Rings(Mesh):
    """A disc, divided into concentric rings of equal area.

    A field is a function of the distance r from the axis, by one number for each ring; h or g there
    is the value at the mean of r^2 over the ring. Sums over the rings are integrals with one
    weight, as on a grid. Ring i = 0, ..., N - 1 lies between r = R sqrt(i / N) and
    R sqrt((i + 1) / N): rings are narrow where r is large.

    Arguments:
        num_points: N, the number of rings.
        radius: R, of the disc [length].

    Raises:
        ValueError: for fewer than 2 rings, or a radius that is not positive.
        TypeError: for a number of rings that is not an integer.

    Example:
        >>> f"{js.Rings(100, radius=0.5).area:.4f}"
        '0.7854'
    """

    sides: ClassVar[tuple[str, ...]] = ("r",)

    num_points: int = eqx.field(static=True)
    radius: Annotated[Scalar, LENGTH]

    sharding: NamedSharding | None = eqx.field(static=True, repr=False, init=False, default=None)

    __repr__ = inline

    def __init__(self, num_points: int, radius: ArrayLike):
        self.num_points = integer("The number of rings", num_points)
        if self.num_points < 2:
            raise ValueError(f"The number of rings is {self.num_points}: give 2 or more.")
        self.radius = positive_scalar(radius, "The radius of the disc")

    @classmethod
    def for_contact(
        cls,
        profile: Callable[[np.ndarray], ArrayLike],
        contact_modulus: float,
        *,
        force: float,
        work_of_adhesion: float = 0.0,
        length: float = 0.0,
    ) -> "Rings":
        """Return a disc and a number of rings that resolve a tip's contact up to a force.

        The contact radius a at the force is that of Sneddon's solution (I. N. Sneddon, Int. J.
        Eng. Sci. 3, 47 (1965)) with the adhesion of JKR (D. Maugis and M. Barquins, J. Phys. D:
        Appl. Phys. 11, 1989 (1978)),

            F = 2 E* int_0^a r^2 (-h'(r)) / sqrt(a^2 - r^2) dr - sqrt(8 pi w E* a^3).

        The disc is half as large again, and larger if the tip is within eight ranges of the law
        there. At the edge of the contact that a dead load pulls off the shortest wave is four times
        as stiff as the law, and thirty rings lie within it. A held far side leaves about half of
        that radius: give twice the rings for its jump.

        Arguments:
            profile: h(r), the height of the tip at an array of radii [length].
            contact_modulus: E* = E / (1 - nu^2) of the solid [pressure].
            force: the largest compressive force, not negative [force].
            work_of_adhesion: w [energy/area].
            length: the range of the law, whose largest |f''| is w / length^2 [length]; not needed
                without adhesion.

        Raises:
            TypeError: for a profile that is not a function.
            ValueError: for a modulus that is not positive, a negative force or work, adhesion
                without a range, neither force nor adhesion, and a tip that no contact radius brings
                to the force. For a range that takes more than 4,000 rings; the message has the
                range that they resolve. For a force whose contact is so much wider than the one at
                pull-off that thirty rings within this take more than 4,000.
        """
        if not callable(profile):
            raise TypeError(
                f"The profile is {in_words(profile)}: give a function that returns the height at "
                "an array of radii, as lambda r: -(r**2) / 2."
            )
        require_positive("The contact modulus", parameter(contact_modulus))
        for name, value in (("The force", force), ("The work of adhesion", work_of_adhesion)):
            require(name, value, 0 <= value < np.inf, "it must be finite and not negative.")
        if work_of_adhesion > 0:
            require_positive("The range of the law", parameter(length))
        a = _CONTACT_RADII
        forces = contact_modulus * _force_without_adhesion(profile, a)
        forces -= np.sqrt(8 * np.pi * work_of_adhesion * contact_modulus * a**3)
        largest = int(np.argmax(forces > force))
        if largest == 0:
            raise ValueError(
                f"The force is {force}, the work of adhesion {work_of_adhesion}: no contact radius "
                "of this tip balances them. Give a positive force or work, and a tip that falls "
                "away from its summit at r = 0."
            )
        contact = a[largest]
        # Pull-off happens at the least force.
        smallest = a[np.argmin(forces[: largest + 1])] if work_of_adhesion > 0 else contact
        radius = _BEYOND * contact
        number = _LEAST_RINGS
        if work_of_adhesion > 0:
            depths = profile(contact) - np.asarray(profile(a))
            is_beyond = (a > radius) & (depths >= _RANGES * length)
            is_near = profile(contact) - np.asarray(profile(radius)) < _RANGES * length
            if is_near and is_beyond.any():
                radius = a[np.argmax(is_beyond)]
            sharpest = work_of_adhesion / length**2
            width = _STIFFNESS * contact_modulus / (_STIFFER * sharpest)
            number = max(number, radius**2 / (2 * width * smallest))
        if number > _MOST_RINGS:
            raise ValueError(
                f"The range of the law is {length}: that takes {number:.0f} rings. A range of "
                f"{length * (number / _MOST_RINGS) ** 0.5:.3g} takes {_MOST_RINGS}."
            )
        in_contact = _IN_CONTACT * (radius / smallest) ** 2
        if in_contact > _MOST_RINGS:
            raise ValueError(
                f"The force is {force}: its contact needs a disc {radius / smallest:.3g} times as "
                f"wide as the contact at pull-off, and {in_contact:.0f} rings for {_IN_CONTACT} "
                "within that. Give a smaller force, or no adhesion if the pull-off does not matter."
            )
        return cls(math.ceil(max(number, in_contact)), radius)

    @property
    def shape(self) -> tuple[int]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The number of rings, in a tuple."""
        return (self.num_points,)

    @property
    def num_dimensions(self) -> int:
        """Dimensions of the disc: 2, though fields have one axis."""
        return 2

    @property
    @jax.jit
    def lengths(self) -> Float[Array, " sides"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Diameter of the disc [length]."""
        return 2 * self.radius[None]

    @property
    @jax.jit
    def spacing(self) -> Float[Array, " sides"]:
        """Mean width of the rings, R / N [length]."""
        return self.radius[None] / self.num_points

    @property
    @jax.jit
    def area(self) -> Scalar:
        """Area of the disc [length^2]."""
        return jnp.pi * self.radius**2

    @property
    @jax.jit
    def cell_area(self) -> Scalar:
        """Area of a ring [length^2]."""
        return jnp.pi * self.radius**2 / self.num_points

    def shrunk(self, factor: float) -> "Rings":
        """Return as many rings on a disc whose radius is smaller by a factor."""
        return Rings(self.num_points, self.radius / factor)

    @property
    @jax.jit
    def edges(self) -> Float[Array, " edges"]:
        """Radii of the edges of the rings, from zero to R [length]."""
        return self.radius * jnp.asarray(
            np.sqrt(np.linspace(0, 1, self.num_points + 1)), self.radius.dtype
        )

    @property
    @jax.jit
    def squared_distances(self) -> Field:
        """Mean of r^2 over each ring [length^2]."""
        shares = (np.arange(self.num_points) + 0.5) / self.num_points
        return self.radius**2 * jnp.asarray(shares, self.radius.dtype)

    @property
    def radii(self) -> Field:
        """Root of the mean of r^2 over each ring [length]."""
        return jnp.sqrt(self.squared_distances)

    @property
    def coordinates(self) -> tuple[Field]:
        """The radii, in a tuple [length]."""
        return (self.radii,)


def _force_without_adhesion(profile: Callable, a: np.ndarray) -> np.ndarray:
    """Return the force over E* at contact radii, by Sneddon's integral over r = a sin(phi)."""
    angles = np.pi / 2 * np.arange(2 * _NUM_ANGLES + 1) / (2 * _NUM_ANGLES)
    edges = a[:, None] * np.sin(angles[::2])
    falls = -np.diff(np.asarray(profile(edges), float), axis=1)
    return 2 * a * np.sum(np.sin(angles[1::2]) ** 2 / np.cos(angles[1::2]) * falls, axis=1)

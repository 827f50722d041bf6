"""Rings of equal area on a disc: the points of an axisymmetric contact."""

from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding
from jaxtyping import Array, Float

from jaxstab.core.checks import integer, positive_scalar
from jaxstab.core.display import inline
from jaxstab.core.grid import Mesh
from jaxstab.core.types import ArrayLike, Field, Scalar
from jaxstab.core.units import LENGTH


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
    """

    num_points: int = eqx.field(static=True)
    radius: Annotated[Scalar, LENGTH]

    sharding: NamedSharding | None = eqx.field(static=True, repr=False, init=False, default=None)

    __repr__ = inline

    def __init__(self, num_points: int, radius: ArrayLike):
        self.num_points = integer("The number of rings", num_points)
        if self.num_points < 2:
            raise ValueError(f"The number of rings is {self.num_points}: give 2 or more.")
        self.radius = positive_scalar(radius, "The radius of the disc")

    @property
    def shape(self) -> tuple[int]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The number of rings, in a tuple."""
        return (self.num_points,)

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

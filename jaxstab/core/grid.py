"""Points of equal area on a surface: periodic grids in one and two dimensions.

Points of a grid lie at x_i = i L / n, wave vectors at q = 2 pi k / L. Fields are real, so only the
half spectrum of `rfftn` is stored. Fields may be sharded over several devices.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Complex, Float, Shaped

from jaxstab.core import fft
from jaxstab.core.checks import (
    as_array,
    concrete,
    integer,
    is_traced,
    parameter,
    require_no_explicit_mesh,
    require_positive,
)
from jaxstab.core.control_flow import on_platform
from jaxstab.core.display import inline
from jaxstab.core.types import ArrayLike, Field, Mask, Scalar
from jaxstab.core.units import LENGTH

# Fewer sums are faster one by one on a CPU, where each addition in a pass waits for the last. The
# code that `program` asks of older versions waits less.
_LEAST_IN_A_PASS = 2 if jax.__version_info__ < (0, 11) else 5


class Mesh(eqx.Module):
    """Points of a surface that stand for equal areas: sums over them are integrals.

    Attributes:
        sides: the names of the sides.
        shape: number of points along each side.
        lengths: the extent of the surface along each side [length].
        sharding: how fields are distributed over several devices; None for one.
    """

    sides: ClassVar[tuple[str, ...]]
    shape: eqx.AbstractVar[tuple[int, ...]]
    lengths: eqx.AbstractVar[Float[Array, " sides"]]
    sharding: eqx.AbstractVar[NamedSharding | None]

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    @property
    def num_dimensions(self) -> int:
        """Dimensions of the surface: 1 on a line, where forces and areas are per width, else 2."""
        return len(self.shape)

    @property
    @abstractmethod
    def spacing(self) -> Float[Array, " sides"]:
        """Distance between neighbouring points along each side [length]."""

    @property
    @abstractmethod
    def cell_area(self) -> Scalar:
        """Area that one point stands for [length^2]; on a line, its length [length]."""

    @property
    @abstractmethod
    def area(self) -> Scalar:
        """Area of all points [length^2]; on a line, its length [length]."""

    @property
    @abstractmethod
    def coordinates(self) -> tuple[Field, ...]:
        """Coordinates of every point [length], one array for each side."""

    @property
    @abstractmethod
    def squared_distances(self) -> Field:
        """Square of the distance of every point from the middle of the surface [length^2]."""

    @abstractmethod
    def shrunk(self, factor: float) -> "Mesh":
        """Return as many points on a surface whose sides are shorter by a factor."""

    def device_put(self, field: Shaped[Array | np.ndarray, "..."]) -> Shaped[Array, "..."]:
        """Put a field, or a stack of fields, on the devices of the surface."""
        return as_array(field)

    @property
    def coarser(self) -> "Mesh | None":
        """The mesh of every other point; None where there is none."""
        return None


def require_mesh(mesh: object) -> None:
    """Raise `TypeError` for anything but points on a surface."""
    if not isinstance(mesh, Mesh):
        raise TypeError(
            f"The grid is a {type(mesh).__name__}: give the grid first, as in "
            "jaxstab.Grid(128), or the `grid` of a topography."
        )


def require_grid(grid: object) -> None:
    """Raise `TypeError` for anything but a periodic grid."""
    require_mesh(grid)
    if not isinstance(grid, Grid):
        raise TypeError(
            f"The grid is {grid!r}, which is not periodic: give a jaxstab.Grid. On rings a solid "
            "is an AxisymmetricHalfSpace(rings, ...), or Axisymmetric(rings, solid)."
        )


class Grid(Mesh):
    """A periodic grid of points on a line or a rectangle.

    Arguments:
        shape: number of points along each side; one integer n means an n x n square.
        lengths: side lengths [length], all 1 by default.
        sharding: how fields are distributed over several devices: a `NamedSharding` with one axis
            of its mesh over the first side, `PartitionSpec("x")`; one device by default. Files do
            not keep it.

    Raises:
        ValueError: unless there are one or two sides, 2 points or more along each, and positive
            lengths. For a length that is the integer number of points, as in Grid(32, 32). For
            another spec of the sharding, a line on several devices, and a first side that they do
            not divide.
        TypeError: for a number of points that is not an integer, or another kind of sharding.

    Example:
        >>> f"{js.Grid((64, 32), lengths=(2.0, 1.0)).cell_area:.6f}"
        '0.000977'
    """

    sides: ClassVar[tuple[str, ...]] = ("x", "y")

    shape: tuple[int, ...] = eqx.field(static=True)
    lengths: Annotated[Float[Array, " sides"], LENGTH]
    sharding: NamedSharding | None = eqx.field(static=True, repr=False, default=None)

    __repr__ = inline

    def __init__(
        self,
        shape: int | Sequence[int],
        lengths: Sequence[float] | ArrayLike = 1.0,
        *,
        sharding: NamedSharding | None = None,
    ):
        require_no_explicit_mesh()
        numbers: Any = shape
        if not (isinstance(shape, Sequence) or np.ndim(shape) > 0):
            numbers = (shape, shape)
        self.shape = tuple(integer("A number of grid points", n) for n in numbers)
        if len(self.shape) not in (1, 2) or min(self.shape, default=0) < 2:
            raise ValueError(
                f"Grid shape is {self.shape}: give one side (a line) or two, of 2 points or more."
            )
        if np.ndim(shape) == 0 and isinstance(lengths, int) and lengths == self.shape[0]:
            raise ValueError(
                f"Grid({lengths}, {lengths}) would have sides of length {lengths}: for {lengths} x "
                f"{lengths} points write Grid(({lengths}, {lengths})), for a length {lengths}.0."
            )
        given = concrete(parameter(lengths, "A grid length"))
        if given.shape not in ((), (len(self.shape),)):
            raise ValueError(f"Grid lengths are {given}: give one for each side of {self.shape}.")
        require_positive("A grid length", given)
        sides = given * np.ones(len(self.shape), given.dtype)
        self.lengths = as_array(sides)
        self.sharding = None
        if sharding is not None:
            self.sharding = fft.automatic_sharding(sharding, self.shape)

    @property
    @jax.jit
    def spacing(self) -> Float[Array, " sides"]:
        """Distance between neighbouring points along each side [length]."""
        return self.lengths / jnp.array(self.shape, self.lengths.dtype)

    @property
    @jax.jit
    def cell_area(self) -> Scalar:
        """Area that one point stands for [length^2]; on a line, its length [length]."""
        return jnp.prod(self.spacing)

    @property
    @jax.jit
    def area(self) -> Scalar:
        """Area of the cell [length^2]; on a line, its length [length]."""
        return jnp.prod(self.lengths)

    @property
    @jax.jit
    def coordinates(self) -> tuple[Field, ...]:
        """Coordinates of every point [length], one array for each side."""
        sides = [
            jnp.arange(n, dtype=dx.dtype) * dx
            for n, dx in zip(self.shape, self.spacing, strict=True)
        ]
        return tuple(map(self.device_put, jnp.meshgrid(*sides, indexing="ij")))

    @property
    def squared_distances(self) -> Field:
        """Square of the distance of every point from the middle of the cell [length^2]."""
        sides = zip(self.coordinates, self.lengths, strict=True)
        return jnp.sum(jnp.stack([(x - length / 2) ** 2 for x, length in sides]), axis=0)

    def shrunk(self, factor: float) -> "Grid":
        """Return as many points on a cell whose sides are shorter by a factor."""
        return eqx.tree_at(lambda grid: grid.lengths, self, self.lengths / factor)

    def device_put(self, field: Shaped[Array | np.ndarray, "..."]) -> Shaped[Array, "..."]:
        """Put a field, a stack of fields or a spectrum on the grid's devices."""
        require_no_explicit_mesh()
        if self.sharding is None:
            return as_array(field)
        leading = (None,) * (field.ndim - len(self.shape))
        spec = PartitionSpec(*leading, *self.sharding.spec)
        sharding = NamedSharding(self.sharding.mesh, spec)
        if isinstance(field, np.ndarray):
            # Each process fills its own devices, without communication.
            return jax.make_array_from_callback(
                field.shape, sharding, lambda part: field[part].copy()
            )
        if is_traced(field):
            return jax.lax.with_sharding_constraint(field, sharding)
        return jax.device_put(field, sharding)

    def transform(self, field: Field) -> Complex[Array, " *modes"]:
        """Return the half spectrum of a field, as `rfftn` does.

        On several devices its axes are swapped and extended by modes of multiplicity zero.
        """
        return fft.transform(field, self.sharding)

    def inverse_transform(self, modes: Complex[Array, " *modes"]) -> Field:
        """Return the field of a half spectrum."""
        return fft.inverse_transform(modes, self.shape, self.sharding)

    @property
    def coarser(self) -> "Grid | None":
        """The grid of every other point; None where there is none, or several devices hold it."""
        if self.sharding is not None or any(n % 2 or n < 4 for n in self.shape):
            return None
        return Grid(tuple(n // 2 for n in self.shape), self.lengths)

    @property
    @jax.jit
    def wavenumbers(self) -> Float[Array, " *modes"]:
        """Norm |q| = 2 pi |k / L| of every wave vector of `transform` [1/length]."""
        # Squares of waves per longest side stay in range in any unit.
        longest = jax.lax.stop_gradient(jnp.max(self.lengths))
        sides = zip(self.waves, longest / self.lengths, strict=True)
        squared = sum((k.astype(ratio.dtype) * ratio) ** 2 for k, ratio in sides)
        # Two `where`s keep the infinite derivative of the root at zero out of the gradient.
        norm = jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1)), 0)
        return self.device_put(2 * jnp.pi / longest * norm)

    @property
    @jax.jit
    def wavevectors(self) -> Float[Array, " components *modes"]:
        """Components q_x and q_y of every wave vector of `transform` [1/length]; q_y = 0 on a line.

        A wave of two points along a side, which is also the one with the opposite component, has
        one sign.
        """
        sides = zip(self.waves, self.lengths, strict=True)
        components = [2 * jnp.pi / length * k.astype(length.dtype) for k, length in sides]
        modes = list(jnp.broadcast_arrays(*components))
        if len(modes) == 1:
            modes.append(jnp.zeros_like(modes[0]))
        return self.device_put(jnp.stack(modes))

    @property
    def waves(self) -> tuple[Float[np.ndarray, "..."], ...]:
        """Number of waves k along each side of the modes of `transform`, to be broadcast."""
        *full, half = self.shape
        # Modes that pad the half spectrum repeat the last one.
        along = np.minimum(np.arange(fft.num_waves(half, self.sharding)), half // 2)
        axes = [*(np.fft.fftfreq(n, 1 / n) for n in full), along.astype(float)]
        waves = np.meshgrid(*axes, indexing="ij", sparse=True)
        return tuple(map(self._in_order, waves))

    @property
    @jax.jit
    def mode_multiplicity(self) -> Float[Array, " *modes"]:
        """The number of modes of the full spectrum that each mode stands for: 1, 2, or 0."""
        *full, half = self.shape
        k = np.arange(fft.num_waves(half, self.sharding))
        along = np.where((k == 0) | (2 * k == half), 1.0, 2.0) * (k <= half // 2)
        modes = jnp.broadcast_to(along, (*full, k.size))
        return self.device_put(self._in_order(modes))

    def _in_order(self, modes: Any) -> Any:
        """Return modes with their axes in the order of `transform`, swapped on several devices."""
        if self.sharding is None:
            return modes
        return modes.T


def resample(field: Field, shape: tuple[int, ...]) -> Float[Array, " *finer"]:
    """Return a periodic field on another number of points, through its Fourier series.

    Its waves are those that both numbers of points resolve, a wave of two points as a cosine.
    """
    scale = math.prod(shape) / field.size
    for axis, n in enumerate(shape):
        before = field.shape[axis]
        modes = jnp.fft.rfft(field, axis=axis)
        modes = jax.lax.slice_in_dim(modes, 0, min(n, before) // 2 + 1, axis=axis)
        if n != before and min(n, before) % 2 == 0:
            # On the finer grid half of it is the wave -k; on the coarser the two waves are one.
            weight = 2.0
            if n > before:
                weight = 0.5
            modes = modes.at[(slice(None),) * axis + (-1,)].multiply(weight)
        field = jnp.fft.irfft(modes, n, axis=axis)
    return scale * field


@partial(jax.jit, inline=True)
def total(field: Field) -> Scalar:
    """Return the sum of a field, by products with ones, the fastest way on a CPU."""
    for length in field.shape[::-1]:
        field = jnp.matmul(field, jnp.ones(length, field.dtype), precision="highest")
    return field


def totals(fields: Sequence[Field]) -> Float[Array, " fields"]:
    """Return the sums of several fields, which may be products, in one pass over all."""

    def one_by_one(*fields: Field) -> Float[Array, " fields"]:
        return jnp.stack([total(field) for field in fields])

    if len(fields) < _LEAST_IN_A_PASS:
        return on_platform(one_by_one, _totals_in_a_pass, *fields)
    return _totals_in_a_pass(*fields)


# A function of its own: JAX compiles a reduction anew for each new one.
def _add(left: tuple[Array, ...], right: tuple[Array, ...]) -> tuple[Array, ...]:
    return tuple(map(jnp.add, left, right))


@jax.custom_jvp
def _totals_in_a_pass(*fields: Field) -> Float[Array, " fields"]:
    zeros = tuple(jnp.zeros((), field.dtype) for field in fields)
    rows = jnp.stack(jax.lax.reduce(fields, zeros, _add, (fields[0].ndim - 1,)))
    if rows.ndim == 1:
        return rows
    return jax.vmap(total)(rows)


@_totals_in_a_pass.defjvp
def _change_of_totals(
    fields: tuple[Field, ...], changes: tuple[Field, ...]
) -> tuple[Float[Array, " fields"], Float[Array, " fields"]]:
    # That of the reduction takes no field that is constant among others.
    return _totals_in_a_pass(*fields), jnp.stack([total(change) for change in changes])


def mean(field: Field, weights: Field | None = None) -> Scalar:
    """Return the mean of a field, or of its product with weights."""
    if weights is not None:
        field = weights * field
    return total(field) / field.size


def mean_over(mask: Mask, field: Field) -> Scalar:
    """Return the mean of a field over a mask, zero over none."""
    # Not in one pass: derivatives transpose the sum, in which the count is a constant.
    count = jnp.maximum(total(mask.astype(field.dtype)), 1)
    return total(jnp.where(mask, field, 0)) / count

"""The elastic half space under a single contact, which is not repeated.

Pressures on a window act by real-space coefficients, wrapped on a grid of twice the points a side,
where K is their inverse. Outside of the surface the pressure is zero by equilibrium.
"""

from typing import Annotated, ClassVar, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxstab.core.compile import program
from jaxstab.core.grid import Grid, require_grid
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.types import ArrayLike, Field, FieldMap, Mask, Scalar
from jaxstab.core.units import NUMBER, PRESSURE
from jaxstab.solids.moduli import contact_modulus, elastic_constants
from jaxstab.solids.solid import Solid
from jaxstab.solids.spectral import Waves


class Padded(Waves):
    """A solid on a grid of twice the points a side, whose first half is the window."""

    is_window: ClassVar[bool] = True
    is_padded: ClassVar[bool] = True

    @property
    def window(self) -> tuple[int, ...]:
        """The number of points of the window along each side."""
        return tuple(n // 2 for n in self.grid.shape)

    @property
    def area(self) -> Scalar:
        """The area of the window [length^2]; on a line its length [length]."""
        return self.mean_over_grid(self.grid.area)

    def mean_over_grid(self, value: Array) -> Array:
        """Return the mean over the grid of a field: a value on the window, zero elsewhere."""
        return 0.5 ** len(self.grid.shape) * value

    def surface(self, field: Array) -> Array:
        """Return the window of one field or several."""
        return _first(self, field)

    def conforming(self, heights: Field) -> Field:
        """Return the surface continued by its mirror images, without a step at its edges."""
        return mirrored(self.surface(heights))

    def conforming_energy(self, heights: Field) -> Scalar:
        """Return the elastic energy of full contact over the window, one of its images [energy]."""
        return self.mean_over_grid(super().conforming_energy(heights))


class FreeHalfSpace(Solid):
    """An isotropic elastic half space that is free of pressure outside a window.

    The displacement of the window is u = d + G p, with the displacement d of the far side
    (`FarDisplacement`) and Love's coefficients G of a uniform pressure on each cell (Johnson,
    Contact Mechanics, 1985, eq. 3.25; Liu, Wang & Liu, Wear 243, 2000). On a line nothing is at
    rest far away: d is the displacement at a distance L, the window's length, from a line of
    force, and G is the integral of -2 / pi ln(r / L).

    Computations run on twice the points per side (`Contact.padded`, which also has the energy and
    the Hessian of a gap); results show only the window. Eigenvalues and the unit norm of modes
    include displacements outside of the window. The energy of equilibria leaves out the energy of a
    uniform pressure on twice the window.

    Arguments:
        grid: the window. It is not periodic.
        youngs_modulus: E [pressure].
        poisson_ratio: nu.

    Raises:
        ValueError: if E is not positive, or nu outside (-1, 0.5].
        TypeError: if one of them is complex, and for rings.

    Example:
        >>> free = js.FreeHalfSpace(grid, youngs_modulus=1.0)
        >>> f"{free.uniform_stiffness:.4f}"
        '0.4457'
    """

    grid: Grid
    youngs_modulus: Annotated[Scalar, PRESSURE]
    poisson_ratio: Annotated[Scalar, NUMBER]

    is_window: ClassVar[bool] = True

    def __check_init__(self) -> None:
        require_grid(self.grid)

    def __init__(self, grid: Grid, youngs_modulus: ArrayLike, poisson_ratio: ArrayLike = 0.0):
        self.grid = grid
        self.youngs_modulus, self.poisson_ratio = elastic_constants(youngs_modulus, poisson_ratio)

    @property
    def contact_modulus(self) -> Scalar:
        """E* = E / (1 - nu^2) [pressure]; NaN where nu is traced and outside (-1, 0.5]."""
        return contact_modulus(self.youngs_modulus, self.poisson_ratio)

    @property
    def padded(self) -> Padded:
        """This solid on the padded grid."""
        return _whole(self.grid, self.contact_modulus)

    @property
    def max_stiffness(self) -> Scalar:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The stiffness of the padded grid's stiffest wave [pressure/length]."""
        return self.padded.max_stiffness

    @property
    def min_stiffness(self) -> Scalar:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The stiffness of its softest wave except q = 0 [pressure/length]."""
        return self.padded.min_stiffness

    @property
    def uniform_stiffness(self) -> Scalar:
        """A uniform pressure on the padded grid over its displacement [pressure/length]."""
        return self.padded.uniform_stiffness

    @property
    def is_valid(self) -> Array:
        """Whether every wave's stiffness is positive, and a number of full precision."""
        return self.padded.is_valid

    def scaled(self, factor: Scalar) -> "FreeHalfSpace":
        """Return the half space with its modulus times a factor."""
        modulus = self.youngs_modulus
        return eqx.tree_at(lambda solid: solid.youngs_modulus, self, factor * modulus)

    def with_uniform_stiffness(self, stiffness: ArrayLike) -> NoReturn:
        """Raise `TypeError`: here a uniform displacement takes a pressure that is not uniform."""
        raise TypeError(
            "Energies, gradients, Hessians and balances of a contact on a FreeHalfSpace live on "
            "twice its points a side: use `contact.padded`."
        )

    @program
    def displacement(self, pressure: Field) -> Field:
        """Return G p, the displacement under a pressure on the window [length]."""
        larger = self.padded
        return larger.surface(larger.displacement(padded(pressure, 0)))

    @program
    def apply(self, displacement: Field) -> Field:
        """Return the pressure of a displacement of the window; NaN if it is not found."""
        larger = self.padded

        def precondition(field: Field) -> Field:
            return larger.surface(larger.apply(padded(field, 0)))

        system = LinearSystem(self.displacement, precondition, lambda field: field)
        return system.differentiable_solution(displacement)

    def precondition(self, shift: Scalar) -> FieldMap:
        """Return the window of the inverse of K + shift on the padded grid."""
        larger = self.padded
        inverse = larger.precondition(shift)
        return lambda field: larger.surface(inverse(padded(field, 0)))


@jax.jit
def _first(padded: Padded, field: Array) -> Array:
    return padded.grid.device_put(field[(..., *(slice(n) for n in padded.window))])


def padded(field: Field, value: ArrayLike) -> Field:
    """Pad a field on the window to twice the points a side by a value."""
    # Not `jnp.pad`: its value has a derivative too, which reverse mode cannot take without one of
    # the field.
    whole = jnp.full([2 * n for n in field.shape], value, field.dtype)
    return whole.at[tuple(slice(n) for n in field.shape)].set(field)


def where_window(field: Field) -> Mask:
    """Return the mask of a field's window on twice the points a side."""
    return padded(jnp.ones_like(field, bool), False)


def mirrored(field: Field) -> Field:
    """Pad a field on the window to twice the points a side by its mirror images."""
    return jnp.pad(field, [(0, n) for n in field.shape], mode="symmetric")


@program
def _whole(grid: Grid, modulus: Scalar) -> Padded:
    doubled = tuple(2 * n for n in grid.shape)
    larger = Grid(doubled, 2 * grid.lengths, sharding=grid.sharding)
    compliance = larger.transform(larger.device_put(_coefficients(grid, doubled))).real
    # Padding modes get the compliance of a wave.
    compliance = jnp.where(larger.mode_multiplicity > 0, compliance, compliance.ravel()[1])
    return Padded.of(larger, modulus / compliance)


def _coefficients(grid: Grid, doubled: tuple[int, ...]) -> Field:
    """Return the displacements under unit pressure on the first cell, for E* = 1 [length]."""
    halves = grid.spacing / 2
    steps = [np.minimum(np.arange(n), n - np.arange(n)) for n in doubled]
    sides = [2 * half * step for half, step in zip(halves, steps, strict=True)]
    if len(sides) == 1:
        return _on_a_line(sides[0], halves[0], grid.lengths[0])
    x, y = jnp.meshgrid(*sides, indexing="ij")
    a, b = halves
    along = _strip(x + a, y, b) - _strip(x - a, y, b)
    return (along + _strip(y + b, x, a) - _strip(y - b, x, a)) / jnp.pi


def _strip(s: Field, t: Field, half: Scalar) -> Field:
    """Return s (asinh((t + half) / |s|) - asinh((t - half) / |s|)), to all digits."""
    upper = t + half
    lower = t - half
    far = jnp.hypot(s, upper)
    near = jnp.hypot(s, lower)
    rise = 2 * half + 4 * t * half / (far + near)
    return s * jnp.log1p(rise / (lower + near))


def _on_a_line(x: Field, half: Scalar, length: Scalar) -> Field:
    """Return -2 / pi times the integral of ln(r / L) over a cell (Johnson, eq. 2.19)."""

    def integral(r: Field) -> Field:
        return r * (jnp.log(jnp.abs(r) / length) - 1)

    return -2 / jnp.pi * (integral(x + half) - integral(x - half))

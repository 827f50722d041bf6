"""Axisymmetric contacts of an elastic half space, free of pressure outside of a disc.

The unknown pressures are uniform on rings of equal area, displacements are means over rings. Their
compliance C is a dense symmetric matrix, and its inverse is K. Displacements relative to the far
side take the pressures K u: a uniform displacement takes those under a flat punch, whose mean is
the `uniform_stiffness` times the displacement.
"""

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from types import ModuleType
from typing import Annotated, Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import ellipe, ellipkm1, j1, jv

from jaxstab.core.checks import require_kind
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.grid import mean
from jaxstab.core.rings import Rings
from jaxstab.core.types import ArrayLike, Field, FieldMap, Flag, Scalar
from jaxstab.core.units import NUMBER, PRESSURE
from jaxstab.solids.moduli import contact_modulus, elastic_constants
from jaxstab.solids.solid import Solid
from jaxstab.solids.spectral import SpectralSolid

Matrix = Float[np.ndarray | Array, "rings rings"]

# Points of Gauss in r^2, at which the displacement is averaged over a ring: with as many the error
# is below the error of uniform pressures on rings.
_POINTS_OF_A_RING = 4
# Waves of the difference of two solids: panels of so many points of Gauss. Bessel functions of two
# rings at the rim have a wavelength of pi / R, which a panel is. Below 1 / R panels grow by this
# factor, from waves that are that much longer than R, and above they end at waves that much shorter
# than the widest ring's share of R.
_POINTS_OF_A_PANEL = 6
_GROWTH = 4.0
_LONGEST = 1e7
_SHORTEST = 4.0
# Legendre's functions follow from their recurrence up to this argument, where it loses few digits,
# and beyond from so many intervals of half a turn, to rounding.
_NEAR = 1.25
_INTERVALS = 28
# The difference of kernels is smooth: fewer points do, and none of two rings coincide.
_POINTS_OF_A_DIFFERENCE = (2, 3)


class Modes(Solid):
    """A solid on rings by the eigenvectors of its stiffness at no force.

    K = V diag(k) V^T + k_0 e e^T / N. The first part is the stiffness where the far side follows at
    no force, K - K 1 1^T K / (1^T K 1). It takes no uniform displacement, and its pressures have no
    mean. The second part is that of a displacement of the far side: e is the pressure under a flat
    punch over its mean, k_0 the uniform stiffness.

    Attributes:
        grid: the rings.
        vectors: the eigenvectors V in columns, the first one uniform.
        stiffnesses: the eigenvalues k, ascending from zero [pressure/length].
        profile: e.
        uniform: k_0 [pressure/length].
    """

    grid: Rings
    vectors: Float[Array, "rings rings"]
    stiffnesses: Float[Array, " rings"]
    profile: Field
    uniform: Scalar

    is_window: ClassVar[bool] = True

    @property
    def punch(self) -> Field:
        """The pressure e under a flat punch over its mean."""
        return self.profile

    @property
    def uniform_stiffness(self) -> Scalar:
        """The mean pressure under a flat punch over its displacement, k_0 [pressure/length]."""
        return self.uniform

    @property
    def max_stiffness(self) -> Scalar:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The largest eigenvalue, of a mode at the rim [pressure/length]."""
        return self.stiffnesses[-1]

    @property
    def min_stiffness(self) -> Scalar:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The smallest one but zero [pressure/length]."""
        return self.stiffnesses[1]

    def apply(self, displacement: Field) -> Field:
        """Return K u, of a displacement relative to the far side [pressure]."""
        level = self.uniform * mean(displacement, self.profile)
        return self._weigh_modes(self.stiffnesses, displacement) + level * self.profile

    def displacement(self, pressure: Field) -> Field:
        """Return the displacement under a pressure, relative to the far side [length]."""
        level = mean(pressure)
        compliances = jnp.where(self.stiffnesses > 0, 1 / _nonzero(self.stiffnesses), 0)
        shape = self._weigh_modes(compliances, pressure - level * self.profile)
        return shape + (level / self.uniform - mean(shape, self.profile))

    def precondition(self, shift: Scalar) -> FieldMap:
        """Return the inverse of K + shift, of its second part by Sherman and Morrison's formula."""
        inverse = 1 / (self.stiffnesses + shift)
        response = self._weigh_modes(inverse, self.profile)
        softening = self.uniform / (1 + self.uniform * mean(response, self.profile))

        def apply(field: Field) -> Field:
            moved = self._weigh_modes(inverse, field)
            return moved - softening * mean(field, response) * response

        return apply

    def with_uniform_stiffness(self, stiffness: ArrayLike) -> "Modes":
        """Return this solid with another uniform stiffness."""
        return replace(self, uniform=jnp.asarray(stiffness, self.stiffnesses.dtype))

    def scaled(self, factor: Scalar) -> "Modes":
        """Return this solid with its stiffness times a factor."""
        return replace(
            self,
            stiffnesses=factor * self.stiffnesses,
            uniform=factor * self.uniform,
        )

    @own_conventions()
    def _weigh_modes(self, weights: Float[Array, " rings"], field: Field) -> Field:
        return self.vectors @ (weights.astype(field.dtype) * (field @ self.vectors))


class AxisymmetricSolid(Solid):
    """A solid on rings; a subclass gives its `modes`.

    Example:
        >>> ringed = js.solids.AxisymmetricHalfSpace(js.Rings(50, radius=0.5), 1.0)
        >>> isinstance(ringed, js.solids.AxisymmetricSolid)
        True
    """

    grid: eqx.AbstractVar[Rings]

    is_window: ClassVar[bool] = True

    def __check_init__(self) -> None:
        cure = "no rings: give jaxstab.Rings(num_points, radius) first."
        require_kind(self.grid, Rings, cure)

    @property
    @abstractmethod
    def modes(self) -> Modes:
        """This solid by the eigenvectors of its stiffness."""

    @abstractmethod
    def stiffness_of_order(self, order: int) -> Matrix:
        """Return the stiffness matrix of displacements cos(m theta) [pressure/length].

        Arguments:
            order: m, not negative; m = 0 is K itself.
        """

    @property
    def prepared(self) -> Modes:
        """This solid by the eigenvectors of its stiffness."""
        return self.modes

    @property
    def punch(self) -> Field:
        """The pressure under a flat punch over its mean."""
        return self.modes.punch

    @property
    def max_stiffness(self) -> Scalar:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The largest eigenvalue of K, of a mode at the rim [pressure/length]."""
        return self.modes.max_stiffness

    @property
    def min_stiffness(self) -> Scalar:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The smallest eigenvalue where the far side follows [pressure/length]."""
        return self.modes.min_stiffness

    @property
    def uniform_stiffness(self) -> Scalar:
        """The mean pressure under a flat punch over its displacement [pressure/length]."""
        return self.modes.uniform_stiffness

    @program
    def apply(self, displacement: Field) -> Field:
        """Return K u, of a displacement relative to the far side [pressure]."""
        return self.modes.apply(displacement)

    @program
    def displacement(self, pressure: Field) -> Field:
        """Return the displacement under a pressure, relative to the far side [length]."""
        return self.modes.displacement(pressure)

    def precondition(self, shift: Scalar) -> FieldMap:
        """Return the inverse of K + shift."""
        return self.modes.precondition(shift)

    def with_uniform_stiffness(self, stiffness: ArrayLike) -> Modes:
        """Return this solid by its modes, with another uniform stiffness."""
        return self.modes.with_uniform_stiffness(stiffness)

    def scaled(self, factor: Scalar) -> Modes:
        """Return this solid by its modes, times a factor."""
        return self.modes.scaled(factor)


class AxisymmetricHalfSpace(AxisymmetricSolid):
    """An isotropic elastic half space that is free of pressure outside of a disc of rings.

    The displacement under a uniform pressure p on a disc of radius a is, with E* = E / (1 - nu^2)
    and complete elliptic integrals (Johnson, Contact Mechanics, 1985, sec. 3.4),

        u = (4 p a / (pi E*)) E(r^2/a^2) for r <= a,
        u = (4 p r / (pi E*)) (E(k^2) - (1 - k^2) K(k^2)) with k = a / r beyond.

    A ring is the difference of two discs. Displacements are relative to the far side, as on a
    `FreeHalfSpace`: loads are a `FarDisplacement`, a `MeanPressure` over the disc, or a `Spring`.
    The energy of an equilibrium leaves out that of a flat punch of the disc's radius at the same
    force, F^2 / (4 R E*).

    Arguments:
        rings: the disc.
        youngs_modulus: E [pressure].
        poisson_ratio: nu.

    Raises:
        ValueError: if E is not positive, or nu outside (-1, 0.5].
        TypeError: for something that is not `Rings`, or a complex modulus or ratio.

    Example:
        >>> rings = js.Rings(50, radius=0.5)
        >>> ringed = js.solids.AxisymmetricHalfSpace(rings, youngs_modulus=1.0)
        >>> tip = js.surfaces.paraboloid(rings, radius=2.0)
        >>> pressed = js.equilibrate(js.Contact(ringed, tip, law), js.FarDisplacement(0.0))
        >>> bool(pressed.in_contact[0])
        True
    """

    grid: Rings
    youngs_modulus: Annotated[Scalar, PRESSURE]
    poisson_ratio: Annotated[Scalar, NUMBER]

    def __init__(self, rings: Rings, youngs_modulus: ArrayLike, poisson_ratio: ArrayLike = 0.0):
        self.grid = rings
        self.youngs_modulus, self.poisson_ratio = elastic_constants(youngs_modulus, poisson_ratio)

    @property
    def contact_modulus(self) -> Scalar:
        """E* = E / (1 - nu^2) [pressure]; NaN where nu is traced and outside (-1, 0.5]."""
        return contact_modulus(self.youngs_modulus, self.poisson_ratio)

    @property
    def is_valid(self) -> Flag:
        """Whether the modulus over the radius is positive, and a number of full precision."""
        stiffness = self.contact_modulus / self.grid.radius
        return (stiffness >= jnp.finfo(stiffness.dtype).tiny) & jnp.isfinite(stiffness)

    @property
    def modes(self) -> Modes:
        """This solid by the eigenvectors of its stiffness, which depend on the number of rings."""
        unit = _modes_of_unit_disc(self.grid.num_points)
        return _scaled_modes(self.grid, self.contact_modulus, unit)

    def stiffness_of_order(self, order: int) -> Matrix:
        """Return the stiffness matrix of displacements cos(m theta) [pressure/length]."""
        unit = np.linalg.inv(_compliance_of_unit_disc(self.grid.num_points, order))
        factor = self.contact_modulus / self.grid.radius
        return factor * jnp.asarray(unit, factor.dtype)


class Axisymmetric(AxisymmetricSolid):
    """Any solid with a stiffness for every wavenumber, under an axisymmetric contact on a disc.

    Its compliance on rings is that of a half space as stiff as its shortest waves, and the Hankel
    transform of the rest: with A_i(q) the mean of J_0(q r) over ring i,

        C_ij = C_ij(half space) + R^2 / (2 N) int (1 / K(q) - 2 / (E* q)) A_i A_j q dq.

    Displacements are relative to the far side or the base, whose displacement a `FarDisplacement`
    prescribes.

    Arguments:
        rings: the disc.
        solid: a `Layer`, `CoatedHalfSpace`, `Layered`, `Graded`, `SurfaceTension`, `Spectral` or
            another solid with a stiffness for every wavenumber, on any grid: only its K(q) counts.

    Raises:
        TypeError: for something that is not `Rings`, or a solid without such a stiffness.
        ValueError: for a solid whose stiffness depends on the direction of a wave, such as a
            crystal.

    Example:
        >>> layer = js.Layer(grid, youngs_modulus=1.0, poisson_ratio=0.3, thickness=0.1)
        >>> js.solids.Axisymmetric(js.Rings(50, radius=0.5), layer).grid.num_points
        50
    """

    grid: Rings
    solid: SpectralSolid

    def __init__(self, rings: Rings, solid: SpectralSolid):
        self.grid = rings
        if not isinstance(solid, SpectralSolid):
            raise TypeError(
                f"The solid is a {type(solid).__name__}: rings need a stiffness for every "
                "wavenumber, as Layer, Layered, Graded, SurfaceTension and Spectral have. A half "
                "space on rings is an AxisymmetricHalfSpace."
            )
        if not solid.is_isotropic:
            raise ValueError(
                f"The solid is {solid!r}, whose stiffness depends on the direction of a wave, so "
                "that its contact with an axisymmetric tip is not axisymmetric: take a grid, or "
                "a half space of the same indentation modulus, as in "
                "AxisymmetricHalfSpace(rings, Anisotropic(...).indentation.modulus)."
            )
        self.solid = solid

    @property
    @program
    def modes(self) -> Modes:
        """This solid by the eigenvectors of its stiffness."""
        return Modes(grid=self.grid, **_mode_parts(self.stiffness_of_order(0), jnp))

    def stiffness_of_order(self, order: int) -> Matrix:
        """Return the stiffness matrix of displacements cos(m theta) [pressure/length]."""
        number = self.grid.num_points
        radius = self.grid.radius
        unit, waves, weights, means = (
            jnp.asarray(part, radius.dtype)
            for part in (_compliance_of_unit_disc(number, order), *_hankel_transform(number, order))
        )
        q = waves / radius
        stiffness = self.solid.stiffness_at(q)
        shortest = 2 * stiffness[-1] / q[-1]
        rest = (1 / stiffness - 2 / (shortest * q)) * q * weights
        # One factor R is that of dq.
        compliance = radius / shortest * unit + radius / (2 * number) * (means * rest) @ means.T
        return jnp.linalg.inv(compliance)


def _nonzero(stiffnesses: Float[Array, " rings"]) -> Float[Array, " rings"]:
    return jnp.where(stiffnesses > 0, stiffnesses, 1)


@program
def _scaled_modes(rings: Rings, modulus: Scalar, of_unit_disc: dict[str, Any]) -> Modes:
    """Return the `Modes` on rings from the parts of those on the unit disc for E* = 1."""
    factor = modulus / rings.radius
    parts = {name: jnp.asarray(part, factor.dtype) for name, part in of_unit_disc.items()}
    return Modes(grid=rings, **parts).scaled(factor)


def _mode_parts(stiffness: Matrix, xp: ModuleType) -> dict[str, Any]:
    """Return the parts of the `Modes` of a stiffness matrix."""
    number = len(stiffness)
    under_punch = xp.sum(stiffness, axis=0)
    uniform = xp.mean(under_punch)
    profile = under_punch / uniform
    held = stiffness - uniform / number * xp.outer(profile, profile)
    stiffnesses, vectors = xp.linalg.eigh((held + held.T) / 2)
    # The first is uniform, with no stiffness, but for rounding.
    flat = xp.full((number, 1), number**-0.5, vectors.dtype)
    return {
        "vectors": xp.concatenate([flat, vectors[:, 1:]], axis=1),
        "stiffnesses": xp.concatenate([xp.zeros(1, stiffnesses.dtype), stiffnesses[1:]]),
        "profile": profile,
        "uniform": uniform,
    }


@lru_cache(maxsize=8)
def _modes_of_unit_disc(number: int) -> dict[str, Any]:
    """Return the parts of the modes of a half space with E* = 1 on a disc of unit radius."""
    return _mode_parts(np.linalg.inv(_compliance_of_unit_disc(number)), np)


@lru_cache(maxsize=16)
def _compliance_of_unit_disc(number: int, order: int = 0) -> Float[np.ndarray, "rings rings"]:
    """Return the mean displacement of each ring under pressure on each, for E* = R = 1.

    Pressure is cos(m theta) on a ring, and so is the displacement. Their difference to order zero
    is that of the kernels, which has no singularity.
    """
    edges = np.sqrt(np.arange(number + 1) / number)
    compliance = np.zeros((number, number))
    for r, weight in _points_of_rings(number, _POINTS_OF_A_RING):
        compliance += weight * np.diff(_under_discs(r[:, None], edges), axis=1)
    if order > 0:
        few, more = _POINTS_OF_A_DIFFERENCE
        for r, weight in _points_of_rings(number, few):
            for s, share in _points_of_rings(number, more):
                kernel = _kernel_less_that_of_order_zero(r[:, None], s, order)
                compliance += weight * share / (2 * number) * kernel
    # Reciprocity holds to the error of the mean over a ring.
    return (compliance + compliance.T) / 2


def _points_of_rings(number: int, count: int) -> Iterator[tuple[np.ndarray, float]]:
    """Yield the radii of Gauss points in r^2, one for each ring of a unit disc, and weights."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    for node, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
        yield np.sqrt((np.arange(number) + node) / number), weight


def _under_discs(r: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return the displacement at r under a unit pressure on a disc of radius a (Johnson, 3.29)."""
    is_inside = r <= a
    outer = np.where(is_inside, a, r)
    m = (np.where(is_inside, r, a) / outer) ** 2
    first = ellipe(m)
    beyond = first - (1 - m) * ellipkm1(1 - m)
    return 4 / np.pi * outer * np.where(is_inside, first, beyond)


def _kernel_less_that_of_order_zero(r: np.ndarray, s: np.ndarray, order: int) -> np.ndarray:
    """Return 1 / pi times the integral of (cos(m theta) - 1) / |x - x'| over theta, for r != s.

    The integral of cos(m theta) / |x - x'| is 2 / sqrt(r s) Q_(m-1/2)((r^2 + s^2) / (2 r s)), with
    Legendre's functions of the second kind. They follow from elliptic integrals by their recurrence
    where the argument is near one, and from the trapezoidal rule elsewhere (Gradshteyn & Ryzhik,
    8.83).
    """
    argument = (r**2 + s**2) / (2 * r * s)
    is_near = argument < _NEAR
    x = np.where(is_near, argument, _NEAR)
    beyond = np.where(is_near, (r - s) ** 2 / (2 * r * s), _NEAR - 1)
    k = np.sqrt(2 / (x + 1))
    # 1 - k^2 to all digits.
    first, second = ellipkm1(beyond / (x + 1)), ellipe(k**2)
    before = k * first
    found = x * before - 2 / k * second
    lowest = before
    for m in range(1, order):
        before, found = found, (2 * m * x * found - (m - 0.5) * before) / (m + 0.5)
    near = 2 / np.sqrt(r * s) * (found - lowest)
    far = np.zeros_like(argument)
    for i in range(1, _INTERVALS + 1):
        angle = np.pi * i / _INTERVALS
        # At half a turn the interval ends.
        share = 1 + (i < _INTERVALS)
        distance = np.sqrt(np.where(is_near, 1, r**2 + s**2 - 2 * r * s * np.cos(angle)))
        far += share * (np.cos(order * angle) - 1) / distance
    return np.where(is_near, near / np.pi, far / _INTERVALS)


@lru_cache(maxsize=8)
def _hankel_transform(number: int, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return waves q R and weights of a quadrature, and the mean of J_m(q r) over each ring."""
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS_OF_A_PANEL)
    count = int(np.ceil(np.log(_LONGEST) / np.log(_GROWTH)))
    shortest = 2 * number * _SHORTEST
    edges = np.concatenate(
        [[0.0], _GROWTH ** -np.arange(count, 0, -1.0), np.arange(1, shortest, np.pi)]
    )
    widths = np.diff(edges)
    waves = (edges[:-1, None] + widths[:, None] * (nodes + 1) / 2).ravel()
    weights = (widths[:, None] * weights / 2).ravel()
    if order == 0:
        # int_0^r J_0(q s) s ds = r J_1(q r) / q
        rings = np.sqrt(np.arange(number + 1) / number)[:, None]
        means = 2 * number * np.diff(rings * j1(rings * waves) / waves, axis=0)
    else:
        means = np.zeros((number, waves.size))
        for r, weight in _points_of_rings(number, _POINTS_OF_A_RING):
            means += weight * jv(order, r[:, None] * waves)
    return waves, weights, means

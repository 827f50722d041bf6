"""Stacks of elastic layers on a half space or a rigid base.

Isotropic layers take Dunkin's compound matrix (Bull. Seismol. Soc. Am. 55, 335 (1965)): what lies
below allows two independent states (v, w, r, p) of displacements along and normal to the surface
and tractions over G q, of which only the 2 x 2 minors matter,

    y = (R, X, Y, Z, D) = ([r p], [v p], [w p], -[w r], [v w]),

so that the surface compliance is [X Y; Y Z] / R, its determinant D / R, and K = G q R / Z. With
s = q z and m = (1 - 2 nu) / (2 (1 - nu)), k = nu / (1 - nu), e = 2 / (1 - nu)

    y' = M y = (e X, R + 2 Y, Z - k X, m R + e D - 2 k Y, Z + m X).

M has the eigenvalues 2, -2 and thrice 0, hence M^3 (M^2 - 4) = 0, and exactly

    exp(s M) = 1 + s M + s^2/2 M^2 + (sinh 2s - 2s)/8 M^3 + (cosh 2s - 1 - 2s^2)/16 M^4.

Times exp(-2 s) nothing overflows. R, X, Z and D are not negative, so that no digits are lost from
thin to thick, nor in layers that keep their volume. A stack with a crystal takes `stroh`.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.core.checks import positive_scalar, possible, require_kind
from jaxstab.core.grid import Grid, require_grid
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import LENGTH, NUMBER, PRESSURE
from jaxstab.solids.materials import Film, Isotropic, Material, material_of, unit_vectors
from jaxstab.solids.moduli import elastic_constants, possible_ratio, shear_modulus
from jaxstab.solids.spectral import SpectralSolid
from jaxstab.solids.stroh import (
    StrohMatrices,
    bonded,
    half_space_compliance,
    layer_compliance,
    layer_faces,
    slipping,
)

Waves = Float[Array, " *modes"]


class Minors(NamedTuple):
    """R, X, Y, Z and D."""

    r: Waves
    x: Waves
    y: Waves
    z: Waves
    d: Waves


# Differences are summed as series below this argument, by as many terms as double precision needs.
_SMALL = 2.0
_NUM_TERMS = 12


class Layered(SpectralSolid):
    """A stack of elastic layers, isotropic or crystals, on a half space or on a rigid base.

    Each layer is bonded to what lies below it, or slips on it. K follows from the base up, by the
    compliance of what lies below, without exponentials that grow: at any thickness and wavelength.
    It depends on the direction of a wave if one of the materials is a `Crystal`. At q = 0, on a
    rigid base, K = 1 / sum(h / M) with the uniaxial moduli M; there a layer that keeps its volume
    is rigid, and a stack of such layers moves with its base, as an incompressible `Layer`.

    Arguments:
        grid: the grid of its surface.
        layers: the layers from the surface down, each a `Film`.
        base: the material of the half space below, as E and nu, an `Isotropic` or a `Crystal`; or
            "rigid", which is kept as None.

    Raises:
        ValueError: for a stack without layers or without a base.
        TypeError: for a layer that is no `Film`, or a base that is no material.

    Example:
        >>> hard = js.solids.Film((10.0, 0.3), 0.01)
        >>> films = [hard, js.solids.Film((0.1, 0.5), 0.05, slips=True)]
        >>> stack = js.solids.Layered(grid, films, base=(1.0, 0.3))
        >>> [f"{k:.3g}" for k in stack.stiffness_at(np.array([1.0, 1000.0]))]
        ['0.54', '5.49e+03']
    """

    grid: Grid
    layers: tuple[Film, ...]
    base: Material | None

    def __init__(
        self,
        grid: Grid,
        layers: Sequence[Film],
        base: Material | tuple[ArrayLike, ArrayLike] | Literal["rigid"],
    ):
        require_grid(grid)
        self.grid = grid
        if not (isinstance(layers, Sequence) and layers):
            raise ValueError(
                f"The layers are {layers!r}: give one or more, from the surface down, as in "
                "[Film((1.0, 0.3), 0.1)]. Without layers the solid is a HalfSpace, or Anisotropic."
            )
        for layer in layers:
            require_kind(layer, Film, "no layer: give a jaxstab.solids.Film(material, thickness).")
        self.layers = tuple(layers)
        if base is None:
            raise ValueError(
                "The base is None, and a stack on nothing bends as a sheet: give the material of "
                'the half space below, as in base=(1.0, 0.3), or base="rigid".'
            )
        self.base = None
        if not (isinstance(base, str) and base == "rigid"):
            self.base = material_of(base, "base")

    @property
    def is_isotropic(self) -> bool:
        """Whether K depends on |q| alone, as no material is a `Crystal`."""
        materials = [layer.material for layer in self.layers]
        return all(isinstance(one, Isotropic | None) for one in (*materials, self.base))

    @property
    def uniform_stiffness(self) -> Scalar:
        """K at q = 0: 1 / sum(h / M) on a rigid base, infinite if no layer yields; else zero."""
        if self.base is not None:
            return jnp.zeros((), self.grid.lengths.dtype)
        softness = sum(
            layer.material.uniaxial_compliance * _possible_thickness(layer.thickness)
            for layer in self.layers
        )
        keeps_volume = softness == 0
        return jnp.where(keeps_volume, jnp.inf, 1 / jnp.where(keeps_volume, 1, softness))

    def stiffness_at(self, waves: Float[Array, "..."]) -> Waves:
        """Return K at wavenumbers, or at wave vectors if there is a crystal [pressure/length]."""
        if self.is_isotropic:
            return _isotropic_stiffness(waves, self.layers, self.base)
        return _crystal_stiffness(waves, self.layers, self.base)


class Layer(SpectralSolid):
    """An isotropic elastic layer, bonded to a rigid base: the shortest `solids.Layered`.

    K = (E* q / 2) ((3 - 4 nu) cosh 2x + 2x^2 + 5 - 12 nu + 8 nu^2) / ((3 - 4 nu) sinh 2x - 2x) with
    x = q h (Johnson, Contact Mechanics, 1985, sec. 5.8). At q = 0, where the base stays,
    K = E (1 - nu) / ((1 + nu) (1 - 2 nu) h). `FarDisplacement` prescribes the displacement of the
    base, and a `Spring` pulls at it. An incompressible layer, nu = 0.5, keeps its volume, so its
    base moves by the mean displacement, which `MeanDisplacement` prescribes. Its derivative with
    respect to nu under a `Spring` leaves out the change of the volume.

    Arguments:
        grid: the grid of its surface.
        youngs_modulus: E [pressure].
        poisson_ratio: nu.
        thickness: h [length].

    Raises:
        ValueError: if E or the thickness is not positive, or nu outside (-1, 0.5].
        TypeError: if one of them is complex.

    Example:
        >>> layer = js.Layer(grid, youngs_modulus=1.0, poisson_ratio=0.3, thickness=0.1)
        >>> f"{layer.uniform_stiffness:.3f}"
        '13.462'
    """

    grid: Grid
    youngs_modulus: Annotated[Scalar, PRESSURE]
    poisson_ratio: Annotated[Scalar, NUMBER]
    thickness: Annotated[Scalar, LENGTH]

    def __init__(
        self,
        grid: Grid,
        youngs_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        thickness: ArrayLike,
    ):
        self.grid = grid
        self.youngs_modulus, self.poisson_ratio = elastic_constants(youngs_modulus, poisson_ratio)
        self.thickness = positive_scalar(thickness, "The thickness")

    @property
    def stack(self) -> Layered:
        """This layer as a stack."""
        film = Film(Isotropic(self.youngs_modulus, self.poisson_ratio), self.thickness)
        return Layered(self.grid, (film,), "rigid")

    @property
    def uniform_stiffness(self) -> Scalar:
        """E (1 - nu) / ((1 + nu) (1 - 2 nu) h), infinite at nu = 0.5 [pressure/length]."""
        return self.stack.uniform_stiffness

    def stiffness_at(self, waves: Waves) -> Waves:
        """Return K [pressure/length]."""
        return self.stack.stiffness_at(waves)


class CoatedHalfSpace(SpectralSolid):
    """An isotropic elastic layer, bonded to an isotropic elastic half space.

    Burmister's solution (1945); any other coating is a `solids.Layered`.

    Arguments:
        grid: the grid of its surface.
        layer: E and nu of the coating [pressure, 1].
        thickness: h, of the coating [length].
        base: E and nu of the half space [pressure, 1].

    Raises:
        ValueError: if a modulus or the thickness is not positive, a Poisson's ratio is outside
            (-1, 0.5], or layer or base are not two numbers.
        TypeError: if one of them is complex.

    Example:
        >>> coated = js.CoatedHalfSpace(grid, layer=(10.0, 0.3), thickness=0.01, base=(1.0, 0.3))
        >>> [f"{k:.3g}" for k in coated.stiffness_at(np.array([1.0, 1000.0]))]
        ['0.558', '5.49e+03']
    """

    grid: Grid
    layer: tuple[Annotated[Scalar, PRESSURE], Annotated[Scalar, NUMBER]]
    thickness: Annotated[Scalar, LENGTH]
    base: tuple[Annotated[Scalar, PRESSURE], Annotated[Scalar, NUMBER]]

    def __init__(
        self,
        grid: Grid,
        layer: tuple[ArrayLike, ArrayLike],
        thickness: ArrayLike,
        base: tuple[ArrayLike, ArrayLike],
    ):
        self.grid = grid
        self.layer = _pair(layer, "layer")
        self.thickness = positive_scalar(thickness, "The thickness")
        self.base = _pair(base, "base")

    @property
    def stack(self) -> Layered:
        """This coating as a stack."""
        return Layered(self.grid, (Film(Isotropic(*self.layer), self.thickness),), self.base)

    def stiffness_at(self, waves: Waves) -> Waves:
        """Return K [pressure/length]."""
        return self.stack.stiffness_at(waves)


def _pair(constants: tuple[ArrayLike, ArrayLike], name: str) -> tuple[Scalar, Scalar]:
    if not isinstance(constants, tuple | list) or len(constants) != 2:
        raise ValueError(
            f"The {name} is {constants!r}: give its Young's modulus and its Poisson's ratio, as in "
            f"{name}=(1.0, 0.3)."
        )
    return elastic_constants(*constants, where=f" of the {name}")


def _possible_thickness(thickness: Scalar) -> Scalar:
    """Return the thickness; NaN where it is traced and not positive."""
    return possible(thickness, thickness > 0)


def _isotropic_stiffness(
    wavenumbers: Waves, layers: Sequence[Film], base: Material | None
) -> Waves:
    """Return K of isotropic layers on an isotropic base, None for a rigid one."""
    one, zero = jnp.ones_like(wavenumbers), jnp.zeros_like(wavenumbers)
    minors = Minors(one, zero, zero, zero, zero)
    shear = None
    if base is not None:
        assert isinstance(base, Isotropic)
        nu = possible_ratio(base.poisson_ratio)
        shear = shear_modulus(base.youngs_modulus, nu)
        # The eigenvector of M to 2, of what decays downwards.
        parts = 1 - nu, (1 - 2 * nu) / 2, 1 - nu, (3 - 4 * nu) / 4
        minors = Minors(one, *(part * one for part in parts))
    for layer in reversed(layers):
        material = layer.material
        assert isinstance(material, Isotropic)
        nu = possible_ratio(material.poisson_ratio)
        above = shear_modulus(material.youngs_modulus, nu)
        # Compliances are in units of 1 / G of the layer above.
        ratio = 1.0 if shear is None else above / shear
        r, x, y, z, d = minors
        minors = Minors(r, ratio * x, ratio * y, ratio * z, ratio**2 * d)
        if layer.slips:
            # Nothing holds v, and r is zero: states are (v, w, r, p) = (1, 0, 0, 0), (0, Z, 0, R).
            minors = Minors(zero, r, zero, zero, ratio * z)
        shear = above
        s = wavenumbers * _possible_thickness(layer.thickness)
        minors = _through_layer(minors, nu, s)
    assert shear is not None
    return shear * wavenumbers * minors.r / minors.z


def _through_layer(minors: Minors, nu: Scalar, s: Waves) -> Minors:
    """Return exp(-2 s) exp(s M) y, and divide it by the sum of what is not negative."""
    m = (1 - 2 * nu) / (2 * (1 - nu))
    k = nu / (1 - nu)
    e = 2 / (1 - nu)

    def times_matrix(minors: Minors) -> Minors:
        r, x, y, z, d = minors
        return Minors(e * x, r + 2 * y, z - k * x, m * r + e * d - 2 * k * y, z + m * x)

    decay = jnp.exp(-2 * s)
    sinh_tail, cosh_tail = _damped_tails(s)
    # The square and the exponential apart would overflow before they vanish.
    weights = decay, s * decay, s * (s * decay) / 2, sinh_tail / 8, cosh_tail / 16
    powers = [minors]
    for _ in weights[1:]:
        powers.append(times_matrix(powers[-1]))
    # The sum over powers of M of each minor.
    factors = jnp.stack(weights)
    sums = [jnp.sum(factors * jnp.stack(parts), axis=0) for parts in zip(*powers, strict=True)]
    above = Minors(*sums)
    unit = jax.lax.stop_gradient(above.r + above.x + above.z + above.d)
    return Minors(*(part / unit for part in above))


def _damped_tails(s: Waves) -> tuple[Waves, Waves]:
    """Return exp(-y) times sinh y - y and cosh y - 1 - y^2/2, y = 2s, to all digits."""
    y = 2 * s
    is_small = y < _SMALL
    small = jnp.where(is_small, y, 0)
    large = jnp.where(is_small, _SMALL, y)
    powers = [small**k / float(math.factorial(k)) for k in range(3, 2 * _NUM_TERMS + 3)]
    decay = jnp.exp(-large)
    sinh = (1 - decay**2) / 2 - large * decay
    # The square and the exponential apart would overflow before they vanish.
    cosh = (1 - decay) ** 2 / 2 - large * (large * decay) / 2
    sinh_series, cosh_series = (jnp.exp(-small) * sum(powers[i::2][::-1]) for i in (0, 1))
    return jnp.where(is_small, sinh_series, sinh), jnp.where(is_small, cosh_series, cosh)


def _crystal_stiffness(
    wavevectors: Float[Array, " components *modes"], layers: Sequence[Film], base: Material | None
) -> Waves:
    """Return K of a stack with a crystal."""
    wavenumbers, directions = unit_vectors(wavevectors)
    matrices = [layer.material.stroh_matrices(directions) for layer in layers]
    # In a unit of the top layer's products of moduli stay in range.
    unit = jax.lax.stop_gradient(jnp.max(abs(matrices[0].n3)))

    def in_unit(material: StrohMatrices) -> StrohMatrices:
        return StrohMatrices(material.n1, material.n2 * unit, material.n3 / unit)

    if base is None:
        compliance = jnp.zeros_like(jax.lax.complex(matrices[0].n1, matrices[0].n1))
    else:
        compliance = half_space_compliance(in_unit(base.stroh_matrices(directions)))
    for layer, material in zip(reversed(layers), reversed(matrices), strict=True):
        faces = layer_faces(in_unit(material), wavenumbers * _possible_thickness(layer.thickness))
        support = (slipping if layer.slips else bonded)(compliance)
        compliance = layer_compliance(faces, support)
    return unit * wavenumbers / compliance[2, 2].real

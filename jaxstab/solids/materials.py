"""Elastic materials, isotropic or crystals, and films of them: what stacks are made of."""

from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core.checks import (
    concrete,
    parameter,
    positive_scalar,
    possible,
    require,
    require_kind,
)
from jaxstab.core.display import inline
from jaxstab.core.types import ArrayLike, Flag, Scalar
from jaxstab.core.units import LENGTH, NUMBER, PRESSURE
from jaxstab.solids.moduli import contact_modulus, elastic_constants, possible_ratio, shear_modulus
from jaxstab.solids.stroh import StrohMatrices

Directions = Float[Array, " components *modes"]

# The pairs of axes of Voigt's six.
_VOIGT = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
# Cosines of angles between axes that are rounded right angles.
_ORTHOGONAL = 1e-4


class Isotropic(eqx.Module):
    """An isotropic elastic material.

    Arguments:
        youngs_modulus: E [pressure].
        poisson_ratio: nu.

    Raises:
        ValueError: if E is not positive, or nu outside (-1, 0.5].
        TypeError: if one of them is complex.

    Example:
        >>> js.solids.Isotropic(1.0, 0.3)
        Isotropic(youngs_modulus=1, poisson_ratio=0.3)
    """

    youngs_modulus: Annotated[Scalar, PRESSURE]
    poisson_ratio: Annotated[Scalar, NUMBER]

    __repr__ = inline

    def __init__(self, youngs_modulus: ArrayLike, poisson_ratio: ArrayLike = 0.0):
        self.youngs_modulus, self.poisson_ratio = elastic_constants(youngs_modulus, poisson_ratio)

    @property
    def uniaxial_compliance(self) -> Scalar:
        """The strain over the pressure that makes it, if nothing moves sideways [1/pressure]."""
        nu = possible_ratio(self.poisson_ratio)
        return (1 + nu) * (1 - 2 * nu) / ((1 - nu) * self.youngs_modulus)

    def stroh_matrices(self, directions: Directions) -> StrohMatrices:
        """Return N1, N2 [1/pressure] and N3 [pressure] for waves of unit vectors m."""
        constants = self.youngs_modulus, self.poisson_ratio
        shear = shear_modulus(*constants)
        along = contact_modulus(*constants)
        nu = possible_ratio(self.poisson_ratio)
        mx, my = directions
        zero = jnp.zeros_like(mx)
        one = zero + 1
        sideways = nu / (1 - nu)
        n1 = [[zero, zero, -mx], [zero, zero, -my], [-sideways * mx, -sideways * my, zero]]
        n2 = [
            [one / shear, zero, zero],
            [zero, one / shear, zero],
            [zero, zero, one * self.uniaxial_compliance],
        ]
        xx, xy, yy = (shear * (i == j) for i, j in ((0, 0), (0, 1), (1, 1)))
        rest = along - shear
        n3 = [
            [xx + rest * mx * mx, xy + rest * mx * my, zero],
            [xy + rest * mx * my, yy + rest * my * my, zero],
            [zero, zero, zero],
        ]
        return StrohMatrices(*(jnp.stack([jnp.stack(row) for row in n]) for n in (n1, n2, n3)))


class Crystal(eqx.Module):
    """An anisotropic elastic material, cut along any plane.

    Arguments:
        stiffness: its elastic constants in Voigt's notation (xx, yy, zz, yz, xz, xy), 6 x 6 and
            symmetric, or the three numbers (c11, c12, c44) of a cubic crystal [pressure]. Sets
            with their sources are in `jaxstab.references.materials`.
        axes: the directions of the sides x and y of the surface, and of its normal z, in the
            coordinates of the constants: three rows at right angles of any lengths, as
            ((1, -1, 0), (0, 0, 1), (1, 1, 0)); by default the axes of the crystal.

    Raises:
        ValueError: for constants of another shape, not symmetric or not positive definite, and axes
            that are not three directions at right angles.
        TypeError: if one of them is complex.

    Example:
        >>> silicon = js.solids.Crystal((165.64, 63.94, 79.51))  # GPa
        >>> js.solids.Layered(grid, [js.solids.Film((70.0, 0.17), 0.01)], silicon).is_isotropic
        False
    """

    stiffness: Annotated[Float[Array, "6 6"], PRESSURE]
    axes: Annotated[Float[Array, "3 3"], NUMBER]

    __repr__ = inline

    def __init__(
        self,
        stiffness: ArrayLike,
        axes: ArrayLike | None = None,
    ):
        self.stiffness = _voigt_matrix(stiffness)
        if axes is None:
            axes = np.eye(3, dtype=self.stiffness.dtype)
        self.axes = _axes(axes)

    @property
    def uniaxial_compliance(self) -> Scalar:
        """The strain over the pressure that makes it, if nothing moves sideways [1/pressure]."""
        tensor = self._tensor
        return jnp.linalg.inv(tensor[:, 2, :, 2])[2, 2]

    @property
    def _tensor(self) -> Float[Array, "3 3 3 3"]:
        """The elastic constants in the axes of the surface [pressure]."""
        a = self.axes
        a = a / jnp.linalg.norm(a, axis=1, keepdims=True)
        own = self.stiffness[_VOIGT[:, :, None, None], _VOIGT]
        return jnp.einsum("ip,jq,kr,ls,pqrs->ijkl", a, a, a, a, own, precision="highest")

    def stroh_matrices(self, directions: Directions) -> StrohMatrices:
        """Return N1, N2 [1/pressure] and N3 [pressure] for waves of unit vectors m."""
        tensor = self._tensor
        # Q = C m m, R = C m n and T = C n n, with the two axes of the vectors m, and so of N first.
        inverse = jnp.linalg.inv(tensor[:, 2, :, 2])
        r = jnp.moveaxis(tensor[:, :2, :, 2], 1, 0)
        turned = _product(inverse, jnp.swapaxes(r, 1, 2))
        rest = _product(r[:, None], turned)
        q = jnp.moveaxis(tensor[:, :2, :, :2], (1, 3), (0, 1)) - rest
        mx, my = directions
        along, across = (n[..., *(None,) * mx.ndim] for n in turned)
        n1 = -(along * mx + across * my)
        xx, mixed, yy = (n[..., *(None,) * mx.ndim] for n in (q[0, 0], q[0, 1] + q[1, 0], q[1, 1]))
        n3 = xx * mx**2 + mixed * mx * my + yy * my**2
        n2 = jnp.broadcast_to(inverse[..., *(None,) * mx.ndim], n1.shape)
        return StrohMatrices(n1, n2, (n3 + jnp.swapaxes(n3, 0, 1)) / 2)


Material = Isotropic | Crystal


def _product(left: Array, right: Array) -> Array:
    return jnp.matmul(left, right, precision="highest")


class Film(eqx.Module):
    """A layer of a stack.

    Arguments:
        material: an `Isotropic` material, or its E and nu [pressure, 1], or a `Crystal`.
        thickness: h [length].
        slips: whether it slips on what lies below, without friction and without lifting off; by
            default it is bonded.

    Raises:
        ValueError: if the thickness is not positive.
        TypeError: for another material.

    Example:
        >>> js.solids.Film((1.0, 0.3), 0.1).slips
        False
    """

    material: Material
    thickness: Annotated[Scalar, LENGTH]
    slips: bool = eqx.field(static=True)

    __repr__ = inline

    def __init__(
        self,
        material: Material | tuple[ArrayLike, ArrayLike],
        thickness: ArrayLike,
        *,
        slips: bool = False,
    ):
        self.material = material_of(material, "film")
        self.thickness = positive_scalar(thickness, "The thickness")
        self.slips = bool(slips)


def material_of(given: Material | tuple[ArrayLike, ArrayLike], name: str) -> Material:
    """Return a material; one of E and nu is isotropic."""
    if isinstance(given, tuple | list):
        if len(given) != 2:
            raise ValueError(
                f"The {name} is {given!r}: give its Young's modulus and its Poisson's ratio, as in "
                "(1.0, 0.3), or a jaxstab.solids.Crystal of its constants."
            )
        return Isotropic(*elastic_constants(*given, where=f" of the {name}"))
    rigid = ', or "rigid"' if name == "base" else ""
    cure = (
        f"no material of the {name}: give its Young's modulus and Poisson's ratio, as in (1.0, "
        f"0.3), or a jaxstab.solids.Crystal(stiffness){rigid}. A stack relaxes in time as a whole, "
        "as a jaxstab.Viscoelastic(jaxstab.solids.Layered(...), ratios, times): layers that relax "
        "differently have no one series for all waves."
    )
    require_kind(given, Material, cure)
    return given


def _voigt_matrix(stiffness: ArrayLike) -> Float[Array, "6 6"]:
    given = parameter(stiffness, "The elastic constants")
    if given.shape == (3,):
        given = _cubic(given)
    if given.shape != (6, 6):
        raise ValueError(
            f"The elastic constants have shape {given.shape}: give 6 x 6 in Voigt's notation (xx, "
            "yy, zz, yz, xz, xy), or (c11, c12, c44) of a cubic crystal."
        )
    known = concrete(given)
    is_symmetric = abs(known - known.T) <= 1e-6 * abs(known).max()
    cure = "give the same constant on both sides of the diagonal."
    require("An elastic constant", known, is_symmetric, cure)
    is_stable = _is_positive_definite(known)
    cure = (
        "the constants are not positive definite, so that some strain would lower the energy: "
        "check their order (xx, yy, zz, yz, xz, xy) and signs; of a cubic crystal c11 > |c12|, "
        "c11 + 2 c12 > 0 and c44 > 0."
    )
    shown = f"\n{known}\n" if isinstance(known, np.ndarray) else known
    require("The matrix of elastic constants", shown, is_stable, cure)
    return possible(given, is_symmetric.all() & is_stable)


def _cubic(constants: Float[Array, "3"]) -> Float[Array, "6 6"]:
    places = np.zeros((3, 6, 6))
    places[0, range(3), range(3)] = 1
    places[1, :3, :3] = 1 - np.eye(3)
    places[2, range(3, 6), range(3, 6)] = 1
    known = concrete(constants)
    xp = np if isinstance(known, np.ndarray) else jnp
    return parameter(xp.tensordot(known, places.astype(known.dtype), 1))


def _is_positive_definite(matrix: Float[Array | np.ndarray, "6 6"]) -> Flag | bool:
    xp = np if isinstance(matrix, np.ndarray) else jnp
    scale = xp.sqrt(abs(xp.diagonal(matrix)))
    # Of a matrix of unit diagonal eigenvalues have all digits, whatever the constants' sizes.
    alike = matrix / xp.where(scale > 0, scale, 1) / xp.where(scale > 0, scale, 1)[:, None]
    least = xp.linalg.eigvalsh((alike + alike.T) / 2)[0]
    return (xp.diagonal(matrix) > 0).all() & (least > 8 * xp.finfo(matrix.dtype).eps)


def _axes(axes: ArrayLike) -> Float[Array, "3 3"]:
    given = parameter(axes, "The axes")
    if given.shape != (3, 3):
        raise ValueError(
            f"The axes have shape {given.shape}: give the directions of x, y and the normal z of "
            "the surface, three rows of three numbers."
        )
    known = concrete(given)
    xp = np if isinstance(known, np.ndarray) else jnp
    lengths = xp.linalg.norm(known, axis=1)
    # Zero lengths make NaN, which is not below.
    with np.errstate(divide="ignore", invalid="ignore"):
        cosines = abs(known @ known.T / (lengths * lengths[:, None]) - np.eye(3))
    cure = (
        "rows must be three directions at right angles; the third is the normal of the surface, "
        "as in ((1, -1, 0), (0, 0, 1), (1, 1, 0))."
    )
    is_orthogonal = (cosines < _ORTHOGONAL).all()
    shown = known.tolist() if isinstance(known, np.ndarray) else known
    require("The matrix of axes", shown, is_orthogonal, cure)
    return possible(given, is_orthogonal)


def unit_vectors(wavevectors: Directions) -> tuple[Float[Array, " *modes"], Directions]:
    """Return |q| and q / |q| of wave vectors that are not zero."""
    # Squares of waves relative to the longest component stay in range in any unit.
    largest = jax.lax.stop_gradient(jnp.max(abs(wavevectors), axis=0))
    norm = largest * jnp.sqrt(jnp.sum((wavevectors / largest) ** 2, axis=0))
    return norm, wavevectors / norm

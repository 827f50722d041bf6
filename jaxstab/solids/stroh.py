"""Waves on a stack of anisotropic elastic layers, by Stroh's formalism and by doubling.

In a layer U(z) exp(i q m.x) is the displacement, q T(z) exp(i q m.x) the traction on planes of
normal n, z = n.x points to the surface. With Q = C m m, R = C m n, T = C n n of the stiffness
tensor C, and s = q z (Ting, Anisotropic Elasticity, 1996, sec. 5.5; his N_3 is -N3 here),

    dU/ds = i N1 U + N2 T,  dT/ds = N3 U + i N1^T T,
    N1 = -T^-1 R^T,  N2 = T^-1,  N3 = Q - R T^-1 R^T.

N2 and N3 are symmetric and not negative. A layer relates its two faces by three matrices,

    U_top = F U_bottom + G T_top,  T_bottom = F^H T_top - H U_bottom.

G the compliance of its top on a rigid base, H the stiffness of its bottom under a free top. Both
are Hermitian and not negative, and so is all that is added to them: no exponential grows, and no
digits cancel. Two equal layers on each other are a layer twice as thick, so that n doublings reach
2^n times the thickness; a half space is where that ends. This is the structured doubling of
Riccati's equation (Chu, Fan, Lin and Wang, Int. J. Control 77, 767 (2004)). Of thin layers, whose F
is nearly one, F - 1 is known to all digits.

Matrices have their two axes first, then the ones of the waves.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

Matrix = Float[Array, "rows columns *modes"]
Compliance = Complex[Array, "3 3 *modes"]

# A layer is doubled so often from one that is so thin, for the wave that decays fastest, that the
# series has all digits in so many terms. What decays a thousand times more slowly is a half space
# of its own before the doublings end.
_NUM_DOUBLINGS = 14
_THIN = 0.25
_NUM_TERMS = 6


class StrohMatrices(NamedTuple):
    """N1, N2 and N3 of a material, for waves of some directions."""

    n1: Matrix
    n2: Matrix
    n3: Matrix


class Faces(NamedTuple):
    """F - 1, G and H, which relate the two faces of a layer."""

    change: Compliance
    top_compliance: Compliance
    bottom_stiffness: Compliance


class Support(NamedTuple):
    """The displacements and tractions that what lies below allows: U = X c, T = Y c for any c."""

    displacements: Compliance
    tractions: Compliance


def product(left: Array, right: Array) -> Array:
    """Return the product of matrices with their axes first."""
    return jnp.sum(left[:, :, None] * right, axis=1)


def adjoint(matrix: Compliance) -> Compliance:
    """Return the conjugate transpose."""
    return jnp.conj(jnp.swapaxes(matrix, 0, 1))


def inverse(matrix: Array) -> Array:
    """Return the inverse of 3 x 3 matrices, by cofactors."""

    def roll(rows: int, columns: int) -> Array:
        return jnp.roll(matrix, (-rows, -columns), (0, 1))

    cofactors = roll(1, 1) * roll(2, 2) - roll(1, 2) * roll(2, 1)
    determinant = jnp.sum(matrix[0] * cofactors[0], axis=0)
    return jnp.swapaxes(cofactors, 0, 1) / determinant


def _identity(like: Array) -> Array:
    size = like.shape[0]
    return jnp.eye(size, dtype=like.dtype).reshape(size, size, *(1,) * (like.ndim - 2))


def layer_faces(material: StrohMatrices, thickness: Float[Array, "*modes"]) -> Faces:
    """Return the faces of a layer of q times its thickness; infinity is a half space."""
    n1, n2, n3 = material
    # About the largest eigenvalue of Stroh's matrix, of the wave that decays fastest.
    fastest = jnp.sqrt(jnp.max(abs(n2)) * jnp.max(abs(n3))) + jnp.max(abs(n1))
    reach = _THIN * 2**_NUM_DOUBLINGS / jax.lax.stop_gradient(fastest)
    s = jnp.minimum(thickness, reach) / 2**_NUM_DOUBLINGS
    # exp(i s N) - 1 = cos(s N) - 1 + i sin(s N) of a real N, on U and -i T.
    upper = jnp.concatenate([n1, n2], axis=1)
    lower = jnp.concatenate([-n3, jnp.swapaxes(n1, 0, 1)], axis=1)
    whole = s * jnp.concatenate([upper, lower], axis=0)
    square = product(whole, whole)
    one = jnp.broadcast_to(_identity(square), square.shape)

    # (1 - cos x) / (x^2 / 2) and sin x / x
    def horner(first: int) -> Array:
        def step(i: Array, series: Array) -> Array:
            n = 2 * (_NUM_TERMS - i) + first
            return one - product(square, series) / (n * (n + 1))

        return jax.lax.fori_loop(0, _NUM_TERMS, step, one)

    real = -product(square, horner(1)) / 2
    imaginary = product(whole, horner(0))
    across = jax.lax.complex(imaginary[:3, 3:], -real[:3, 3:])
    stiffness = jax.lax.complex(-imaginary[3:, :3], real[3:, :3])
    change = jax.lax.complex(real[3:, 3:], imaginary[3:, 3:])
    backward = inverse(_identity(change) + change)
    thin = Faces(
        -adjoint(product(backward, change)),
        _hermitian(product(across, backward)),
        _hermitian(product(backward, stiffness)),
    )
    return jax.lax.fori_loop(0, _NUM_DOUBLINGS, lambda _, layer: _double_layer(layer), thin)


def _double_layer(layer: Faces) -> Faces:
    """Return the faces of a layer twice as thick."""
    change, g, h = layer
    one = _identity(change)
    f = one + change
    back = adjoint(f)
    # W = (1 + G H)^-1
    between = product(g, h)
    turned = inverse(one + between)
    onward = product(turned, f)
    return Faces(
        2 * change + product(change, change) - product(f, product(between, onward)),
        _hermitian(g + product(f, product(turned, product(g, back)))),
        _hermitian(h + product(back, product(h, onward))),
    )


def _hermitian(matrix: Compliance) -> Compliance:
    return (matrix + adjoint(matrix)) / 2


def half_space_compliance(material: StrohMatrices) -> Compliance:
    """Return G of a half space: U = G T at its surface."""
    thickness = jnp.full(material.n1.shape[2:], jnp.inf, material.n1.dtype)
    return layer_faces(material, thickness).top_compliance


def bonded(compliance: Compliance) -> Support:
    """Return the support of a surface of a compliance, to which a layer is bonded."""
    return Support(compliance, jnp.broadcast_to(_identity(compliance), compliance.shape))


def slipping(compliance: Compliance) -> Support:
    """Return the support of a surface of a compliance on which a layer slips.

    The displacement along it is free and without traction.
    """
    normal = jnp.zeros_like(compliance).at[2, 2].set(1)
    along = _identity(compliance) - normal
    return Support(along + compliance[2, 2] * normal, normal)


def layer_compliance(layer: Faces, support: Support) -> Compliance:
    """Return the compliance of the top of a layer on a support: G + F X (Y + H X)^-1 F^H."""
    change, g, h = layer
    f = _identity(change) + change
    x, y = support
    below = product(x, inverse(y + product(h, x)))
    return _hermitian(g + product(f, product(below, adjoint(f))))

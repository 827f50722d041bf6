"""The model of Rey & Bleyer on a page: each equation a function of fields, with its number.

The rest of the package computes with these. Units and the terms that a load adds wrap them, where
they are called. In the notation of the paper h are the heights, g the gap, u the displacement, K
the elastic operator, f the adhesive energy per area, and mu the reaction. Sums run over the points,
as in (15): times the area of a point they are the integrals of (5).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.core.compile import own_conventions
from jaxstab.core.control_flow import choose, on_platform
from jaxstab.core.grid import Grid, mean_over, total, totals
from jaxstab.core.types import ArrayLike, Field, FieldMap, Mask, Scalar

# Evaluations in a projection onto the cone before an accelerator's host looks whether more are
# needed. Of six hundred projections of modes of rough contacts all but one took three steps of
# Newton's method.
_BLIND_CLIMBS = 4


def gap_of(displacement: Field, heights: Field) -> Field:
    """Return g = u - h (2), which is nowhere negative (3) [length]."""
    return displacement - heights


def displacement_of(gap: Field, heights: Field) -> Field:
    """Return u = g + h (2) [length]."""
    return gap + heights


@own_conventions()
def apply_multiplier(grid: Grid, multiplier: Float[Array, " *modes"], field: Field) -> Field:
    """Return FFT^-1(W FFT(p)), the displacement under a pressure (11); with 1/W, p = K u (12)."""
    return grid.inverse_transform(multiplier.astype(field.dtype) * grid.transform(field))


def compliance(stiffness: Float[Array, " *modes"]) -> Float[Array, " *modes"]:
    """Return W (11), the inverse of the stiffness of each wave; zero where that is zero."""
    moves = stiffness != 0
    return jnp.where(moves, 1 / jnp.where(moves, stiffness, 1), 0)


def elastic_energy(displacement: Field, pressure: Field) -> Scalar:
    """Return u.Ku / 2, the first term of (5) and (15), from u and p = K u [energy/area]."""
    return total(displacement * pressure) / 2


def energy(displacement: Field, pressure: Field, density: Field) -> Scalar:
    """Return E_p = u.Ku / 2 + sum f(g) (15), from u, p = K u and f(g) [energy/area]."""
    return elastic_energy(displacement, pressure) + total(density)


def gradient(pressure: Field, slope: Field) -> Field:
    """Return p + f'(g), the derivative of E_p by u (9), from p = K u and f'(g) [pressure]."""
    return pressure + slope


def hessian(K: FieldMap, curvature: Field, field: Field) -> Field:
    """Return A x = (K + D) x, D the diagonal f''(g) (24) [pressure/length times unit of x]."""
    return K(field) + curvature * field


def reaction(net: Field, gap: Field) -> Field:
    """Return mu, the net pressure K u + p0 + f'(g) in contact, zero elsewhere (9) [pressure]."""
    return jnp.where(gap > 0, 0, net)


def imbalance(net: Field, gap: Field) -> Field:
    """Return the violation of (10): the net pressure out of contact, tension in it [pressure]."""
    return jnp.where(gap > 0, net, jnp.minimum(net, 0))


def load_pressure(mean_pressure: ArrayLike, punch: Field | None) -> ArrayLike:
    """Return p0 as a field: uniform, or in proportion to the pressure under a flat punch."""
    if punch is None:
        return mean_pressure
    return mean_pressure * punch


def held_mean_pressure(gradient: Field, gap: Field, punch: Field | None = None) -> Scalar:
    """Return p0, the multiplier of the mean gap: (10) in the mean over the free points."""
    mean_pressure = -mean_over(gap > 0, gradient)
    if punch is None:
        return mean_pressure
    share = mean_over(gap > 0, punch)
    return mean_pressure / jnp.where(share > 0, share, 1)


def onto_load(gap: Field, mean_gap: ArrayLike) -> Field:
    """Return a gap that is nowhere negative, scaled to the mean that is prescribed (4, 13)."""
    return gap * (mean_gap * gap.size / total(gap))


def onto_space(field: Field, is_moving: Mask) -> Field:
    """Return the nearest perturbation of V0 (16): of zero mean, on the points that may move."""
    return jnp.where(is_moving, field - mean_over(is_moving, field), 0)


def onto_one_sided(field: Field, one_sided: Mask, is_moving: Mask) -> Field:
    """Return the nearest field of C (25, 26): x >= 0 in contact, whatever its mean."""
    return jnp.where(is_moving, jnp.where(one_sided, jnp.maximum(field, 0), field), 0)


def onto_cone(field: Field, one_sided: Mask, is_moving: Mask) -> Field:
    """Return the nearest perturbation of V0+ (18, 26): x >= 0 in contact and of zero mean.

    It is x - s, cut at zero in contact, with the shift s that makes its mean zero: the root of a
    convex, decreasing, piecewise linear function. The first step of Newton's method, from no shift,
    leads to the left of it. The others climb to it without passing it, and reach it when no more
    points are cut.
    """

    def uncut(shift: Scalar) -> Mask:
        return is_moving & ((field - shift > 0) | ~one_sided)

    def left_over(shift: Scalar) -> Float[Array, " two"]:
        """Return the sum over the points that are not cut, and their number."""
        mask = uncut(shift)
        return totals([jnp.where(mask, field - shift, 0), mask.astype(field.dtype)])

    def climb(state: tuple[Array, ...]) -> tuple[Array, ...]:
        shift, before, count, _ = state
        left, number = left_over(shift)
        # Each set after the first step holds the next: as many points are the same ones.
        goes_on = (number < before) | ((count == 1) & (number > before))
        return shift + left / jnp.maximum(number, 1), number, count + 1, goes_on

    def climb_blindly(state: tuple[Array, ...]) -> tuple[Array, ...]:
        for _ in range(_BLIND_CLIMBS):
            state = choose(state[3], climb(state), state)
        return state

    zero = jnp.zeros((), field.dtype)
    start = zero, jnp.full_like(zero, jnp.inf), jnp.array(0), jnp.array(True)
    start = on_platform(lambda state: state, climb_blindly, start)
    shift, *_ = jax.lax.while_loop(lambda state: state[3], climb, start)
    return onto_one_sided(field - shift, one_sided, is_moving)


def onto_sphere(field: Field) -> Field:
    """Return the perturbation scaled to unit length (31, 35), zero if it is zero."""
    norm = jnp.sqrt(total(field**2))
    return field / jnp.where(norm == 0, 1, norm)


def rayleigh_quotient(field: Field, product: Field) -> Scalar:
    """Return x.Ax of a unit vector, from x and A x: the value of (26) without its factor 1/2."""
    return total(field * product)

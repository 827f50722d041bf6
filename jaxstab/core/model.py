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


def open_part(gap: Field) -> Field:
    """Return g, the part of a signed gap above zero, whose derivative at zero is one [length]."""
    return jnp.where(gap < 0, 0, gap)


def closed_part(gap: Field) -> Field:
    """Return the depth of the indentation, the part of a signed gap below zero [length]."""
    # NaN stays NaN.
    return jnp.where(gap >= 0, 0, -gap)


def reaction(net: Field, gap: Field) -> Field:
    """Return mu, the net pressure K u + p0 + f'(g) in contact, zero elsewhere (9) [pressure]."""
    return jnp.where(gap > 0, 0, net)


def free_points(gap: Field, largest: Field | None) -> Mask:
    """Return where a gap is open, or a signed one is not zero: the points that may move freely."""
    if largest is None:
        return gap > 0
    return gap != 0


def on_side(net: Field, side: Field, largest: Field | None) -> Field:
    """Return the force on points that leave zero to a side, or have done so [pressure].

    It is the net pressure, less the largest reaction where the side is negative, as there the
    surface yields.
    """
    if largest is None:
        return net
    return jnp.where(side < 0, net - largest, net)


def imbalance(net: Field, gap: Field, largest: Field | None = None) -> Field:
    """Return the violation of (10): the net pressure out of contact, tension in it [pressure].

    Where a reaction has an upper bound, so that the surface yields, also the pressure beyond it;
    and where the surface has yielded the difference of the two.
    """
    tension = jnp.minimum(net, 0)
    if largest is None:
        return jnp.where(gap > 0, net, tension)
    excess = net - largest
    held = tension + jnp.maximum(excess, 0)
    return jnp.where(gap > 0, net, jnp.where(gap < 0, excess, held))


def load_pressure(mean_pressure: ArrayLike, punch: Field | None) -> ArrayLike:
    """Return p0 as a field: uniform, or in proportion to the pressure under a flat punch."""
    if punch is None:
        return mean_pressure
    return mean_pressure * punch


def held_mean_pressure(
    gradient: Field, gap: Field, punch: Field | None = None, largest: Field | None = None
) -> Scalar:
    """Return p0, the multiplier of the mean gap: (10) in the mean over the free points."""
    is_free = free_points(gap, largest)
    mean_pressure = -mean_over(is_free, on_side(gradient, gap, largest))
    if punch is None:
        return mean_pressure
    share = mean_over(is_free, punch)
    return mean_pressure / jnp.where(share > 0, share, 1)


def scaled_to_mean(gap: Field, mean_gap: ArrayLike) -> Field:
    """Return a gap that is nowhere negative, scaled to the mean that is prescribed (4, 13)."""
    return gap * (mean_gap * gap.size / total(gap))


def signed_to_mean(gap: Field, mean_gap: ArrayLike) -> Field:
    """Return a signed gap of the mean that is prescribed, of which one part is scaled.

    It is the open part, or if no scale of that has the mean, as where hardly a point is open, the
    closed part. Where there is neither, all of it is shifted.
    """
    is_open = gap > 0
    opened, closed = totals([jnp.where(is_open, gap, 0), jnp.where(is_open, 0, gap)])
    wanted = mean_gap * gap.size
    scales_open = (opened > 0) & (wanted > closed)
    scales_closed = (closed < 0) & (wanted < opened)
    open_scale = (wanted - closed) / jnp.where(scales_open, opened, 1)
    closed_scale = (wanted - opened) / jnp.where(scales_closed, closed, 1)
    by_closed = jnp.where(is_open, 1, closed_scale) * gap
    otherwise = jnp.where(scales_closed, by_closed, gap + (wanted - opened - closed) / gap.size)
    return jnp.where(scales_open, jnp.where(is_open, open_scale, 1) * gap, otherwise)


def cut(gap: Field, side: Field) -> Field:
    """Return a signed gap, cut at zero where it has left the side on which it was."""
    return jnp.where(side * gap > 0, gap, 0)


def onto_space(field: Field, is_moving: Mask) -> Field:
    """Return the nearest perturbation of V0 (16): of zero mean, on the points that may move."""
    return jnp.where(is_moving, field - mean_over(is_moving, field), 0)


def inward(field: Field, sign: Field | None) -> Field:
    """Return a field times the sign that it has in a cone, None for a positive one everywhere."""
    if sign is None:
        return field
    return sign * field


def onto_one_sided(
    field: Field, one_sided: Mask, is_moving: Mask, sign: Field | None = None
) -> Field:
    """Return the nearest field of C (25, 26): x >= 0 in contact, whatever its mean."""
    within = inward(jnp.maximum(inward(field, sign), 0), sign)
    return jnp.where(is_moving, jnp.where(one_sided, within, field), 0)


def onto_cone_of_signs(field: Field, one_sided: Mask, is_moving: Mask, sign: Field) -> Field:
    """Return the nearest field of zero mean with a sign of its own at each one-sided point.

    It is x - s, cut at zero where its sign is wrong, as in `onto_cone`. The mean of that decreases
    with the shift s, but is neither convex nor concave: a step of Newton's method is taken within
    the bracket of the root, which is halved otherwise.
    """
    highest = jnp.max(jnp.where(is_moving, field, -jnp.inf))
    lowest = jnp.min(jnp.where(is_moving, field, jnp.inf))
    least = jnp.finfo(field.dtype).eps * total(jnp.where(is_moving, jnp.abs(field), 0))

    def step(state: tuple[Array, ...]) -> tuple[Array, ...]:
        shift, low, high, _ = state
        mask = is_moving & ((sign * (field - shift) > 0) | ~one_sided)
        left, number = totals([jnp.where(mask, field - shift, 0), mask.astype(field.dtype)])
        low = jnp.where(left > 0, shift, low)
        high = jnp.where(left < 0, shift, high)
        newton = shift + left / jnp.maximum(number, 1)
        middle = (low + high) / 2
        following = jnp.where((newton > low) & (newton < high), newton, middle)
        goes_on = (jnp.abs(left) > least) & (following != shift)
        return jnp.where(goes_on, following, shift), low, high, goes_on

    start = (lowest + highest) / 2, lowest, highest, lowest < highest
    shift, *_ = jax.lax.while_loop(lambda state: state[3], step, start)
    shift = jnp.where(jnp.isfinite(shift), shift, 0)
    return onto_one_sided(field - shift, one_sided, is_moving, sign)


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

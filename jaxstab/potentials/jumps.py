"""Gaps at which the value or the slope of a law jumps."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core.checks import where_known
from jaxstab.core.compile import program
from jaxstab.core.types import Flag
from jaxstab.potentials.evaluation import derivatives
from jaxstab.potentials.profile import at_some_points, gaps_of
from jaxstab.potentials.varying import Potential, varying_fields, with_fields

# Gaps, a quantity there, and its derivative, along the first axis of an array or in a tuple.
_Side = Array | tuple[Array, Array, Array]
# The number of intervals that are searched, the likeliest first, for value and slope each.
_COUNT = 16
# A jump of the value below this part of the depth of the law, or of the slope below this part of
# the largest attraction, is none.
_LEAST_JUMP = 1e-3


class LawJump(eqx.Module):
    """The largest jump of a law's value (index 0) and of its slope (index 1).

    Attributes:
        gap: the gap of the jump [length].
        below, above: f [energy/area] and f' [pressure] on both sides of it.
        size: the jump over the depth of the law or its largest attraction.
        is_absent: whether neither of them jumps.
    """

    gap: Float[Array, " two"]
    below: Float[Array, " two"]
    above: Float[Array, " two"]
    size: Float[Array, " two"]
    is_absent: Flag


@program
def law_jump(potential: Potential, lengths: Float[Array, "..."]) -> LawJump:
    """Locate the largest jumps of a law's value and slope.

    On neighbouring gaps the trapezoid of the derivative predicts the change of value and slope.
    Intervals where it fails more than on both sides are halved until only rounding divides their
    ends. A steep change has vanished by then, a jump remains.
    """
    law, gaps = jax.lax.stop_gradient((at_some_points(potential), gaps_of(lengths)))
    value, slope, curvature = map(jnp.atleast_2d, _where_defined(law, gaps))
    table = jnp.stack([value, slope])
    rates = jnp.stack([slope, curvature])
    finite = jnp.where(jnp.isfinite(table), table, 0)
    scale = jnp.max(jnp.stack([-finite[0], finite[1]]), axis=(1, 2))
    fields = [jnp.ravel(field) for field in varying_fields(law)]

    high = table[..., :-1]
    low = table[..., 1:]
    largest = jnp.maximum(jnp.abs(high), jnp.abs(low))
    sizes = jnp.maximum(scale[:, None, None], largest)
    missed = (
        _trapezoid_error((gaps[1:], low, rates[..., 1:]), (gaps[:-1], high, rates[..., :-1]))
        / sizes
    )
    missed = jnp.where(jnp.isfinite(missed), missed, 0)
    # A jump at a gap of the table shows on both sides of it.
    beside = jnp.pad(missed, ((0, 0), (0, 0), (2, 2)))
    spikes = missed - 2 * jnp.maximum(beside[..., 4:], beside[..., :-4])
    # Without a barrier XLA sorts a constant law's intervals while it compiles, for seconds.
    spikes = jax.lax.optimization_barrier(spikes.reshape(2, -1))
    chosen = jax.lax.top_k(spikes, _COUNT)[1]
    interval = chosen % (gaps.size - 1)
    own = with_fields(law, [field[chosen // (gaps.size - 1)] for field in fields])
    is_value = np.array([[True], [False]])

    def side(gap: Float[Array, "*ends two chosen"]) -> Float[Array, "three *ends two chosen"]:
        value, slope, curvature = _where_defined(own, gap)
        quantity = jnp.where(is_value, value, slope)
        return jnp.stack([gap, quantity, jnp.where(is_value, slope, curvature)])

    def halve(_: int, ends: Float[Array, "three ends two chosen"]) -> Array:
        low = ends[:, 0]
        high = ends[:, 1]
        middle = side((low[0] + high[0]) / 2)
        is_low = _trapezoid_error(low, middle) >= _trapezoid_error(middle, high)
        return jnp.where(is_low, jnp.stack([low, middle], 1), jnp.stack([middle, high], 1))

    ends = side(gaps[jnp.stack([interval + 1, interval])])
    ends = jax.lax.fori_loop(0, jnp.finfo(gaps.dtype).nmant - 6, halve, ends)
    low = ends[:, 0]
    high = ends[:, 1]
    _, largest, steepest = jnp.max(jnp.abs(ends), 1)
    # A number that underflows is no jump, nor is the rounding of a law that is brought to zero.
    limits = jnp.finfo(gaps.dtype)
    rounding = 64 * limits.eps * jnp.abs(side(0.75 * low[0])[1])
    change = jnp.abs(high[1] - low[1]) - 4 * limits.tiny - rounding
    change = change - 4 * steepest * (high[0] - low[0])
    size = change / jnp.maximum(scale[:, None], largest)
    size = jnp.where(jnp.isfinite(size), size, 0)
    sides = jnp.stack([high[0], low[1], high[1], size])
    gap, below, above, size = sides[:, jnp.arange(2), jnp.argmax(size, 1)]
    return LawJump(gap, below, above, size, jnp.all(size <= _LEAST_JUMP))


def _where_defined(law: Potential, gaps: Array) -> tuple[Array, ...]:
    """Return f, f' and f'', all NaN where f is, since a derivative may be a number there."""
    fields = derivatives(law, gaps)
    return tuple(jnp.where(jnp.isnan(fields[0]), jnp.nan, field) for field in fields)


def _trapezoid_error(low: _Side, high: _Side) -> Array:
    """Return the error of the trapezoidal rule between two gaps."""
    return jnp.abs(high[1] - low[1] - (low[2] + high[2]) / 2 * (high[0] - low[0]))


@where_known
def require_no_jump(jump: LawJump) -> None:
    """Raise `ValueError` if the value or the slope of a known law jumps."""
    jump = jax.tree.map(np.asarray, jump)
    if jump.is_absent:
        return
    # A jump of the value is one of the slope too.
    which = int(jump.size[0] <= _LEAST_JUMP)
    gap, below, above = (float(side[which]) for side in (jump.gap, jump.below, jump.above))
    raise ValueError(
        f"The potential's {('value', 'slope')[which]} jumps from {below:.6g} to {above:.6g} at a "
        f"gap of {gap:.6g}. Give a law with a continuous value and slope. One that is to end there "
        f"is brought to zero smoothly by jaxstab.potentials.CutOff(law, {gap:.6g}), given the law "
        "without its end. In place of a table give a smooth fit, as a spline of third order."
    )

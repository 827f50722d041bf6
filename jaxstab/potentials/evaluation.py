"""Evaluation of a law and its derivatives, by automatic differentiation, on a field of gaps."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array

from jaxstab.core.checks import cast
from jaxstab.core.closures import as_pytree
from jaxstab.core.types import Field, Scalar
from jaxstab.potentials.sums import Sum
from jaxstab.potentials.varying import Potential, averaged_laws, by_points, varying_fields


def as_module(potential: Potential, dtype: DTypeLike) -> Potential:
    """Convert a potential to a pytree of arrays that acts on gaps of `dtype`.

    Raises:
        ValueError: if it does not map a scalar gap to a real scalar, or hides that it varies over
            the surface.
        TypeError: if it cannot be traced by JAX, or is a class of laws instead of a law.

    Example:
        >>> law32 = js.potentials.as_module(lambda gap: -0.03 * jnp.exp(-gap / 0.06), jnp.float32)
        >>> law32(jnp.float32(0.0)).dtype
        dtype('float32')
    """
    if not callable(potential):
        raise ValueError(f"The potential is {potential!r}: give a function of the gap.")
    if isinstance(potential, type):
        name = potential.__name__
        raise TypeError(
            f"The potential is the class {name}: give a law with its numbers, {name}(...)."
        )
    if isinstance(potential, Sum):
        # Each law alone, so that parameters of modules keep their names beside a bare function.
        return Sum(tuple(as_module(law, dtype) for law in potential.laws))
    potential = cast(potential, dtype)
    cure = (
        "it must return one real scalar, the energy per area. (It is applied point by point; its "
        "parameters must be scalars too, or fields inside of jaxstab.potentials.Varying.)"
    )
    argument = jax.ShapeDtypeStruct((), dtype)
    with averaged_laws() as averaged:
        law = as_pytree("The potential", potential, cure, argument)
    if averaged and not varying_fields(law):
        raise ValueError(
            "The potential calls a law that varies over the surface, which would be its mean "
            "everywhere: make all of it one equinox.Module whose parameters are arrays, and give "
            "that to jaxstab.potentials.Varying."
        )
    return law


def derivatives(potential: Potential, gap: Field) -> tuple[Field, Field, Field]:
    """Return f(g) [energy/area], f'(g) [pressure] and f''(g) [pressure/length] at every point.

    Example:
        >>> [f"{x:.3f}" for x in js.potentials.derivatives(law, np.array(0.0))]
        ['-0.030', '0.500', '-8.333']
    """
    if all(map(eqx.is_array, jax.tree.leaves(potential))):
        # Programs evaluate the law in many places, and trace it once.
        return _traced_once(potential, gap)
    return _derivatives(potential, gap)


def _derivatives(potential: Potential, gap: Field) -> tuple[Field, Field, Field]:
    fields, law_at = by_points(potential)
    shapes = [field.shape for field in fields]
    try:
        jnp.broadcast_shapes(*shapes, gap.shape)
    except ValueError:
        raise ValueError(
            f"The law varies over points of shape {shapes[0]}, but the gaps have shape "
            f"{gap.shape}: give one for each point."
        ) from None

    def at_point(gap: Scalar, *values: Array) -> tuple[Array, Array, Array]:
        law = law_at(values)

        def slope_and_value(gap: Scalar) -> tuple[Array, Array]:
            value, slope = jax.value_and_grad(law)(gap)
            return slope, value

        try:
            # Nested derivatives compute their common parts once.
            (slope, value), curvature = jax.value_and_grad(slope_and_value, has_aux=True)(gap)
        except (TypeError, ValueError):
            # A loop of an unknown number of steps has forward-mode derivatives only.
            one = (jnp.ones_like(gap),)
            along = partial(jax.jvp, law, tangents=one)
            (value, slope), (_, curvature) = jax.jvp(lambda gap: along((gap,)), (gap,), one)
        return value, slope, curvature

    value, slope, curvature = jnp.vectorize(at_point)(gap, *fields)
    return value.astype(gap.dtype), slope.astype(gap.dtype), curvature.astype(gap.dtype)


_traced_once = jax.jit(_derivatives, inline=True)


def energy_density(potential: Potential, gap: Field) -> Field:
    """Return f(g) at every point [energy/area].

    Example:
        >>> f"{js.potentials.energy_density(law, state.gap).min():.3f}"
        '-0.030'
    """
    return derivatives(potential, gap)[0]


def slope(potential: Potential, gap: Field) -> Field:
    """Return f'(g), the attraction, at every point [pressure].

    Example:
        >>> f"{js.potentials.slope(law, np.array(0.0)):.3f}"
        '0.500'
    """
    return derivatives(potential, gap)[1]


def curvature(potential: Potential, gap: Field) -> Field:
    """Return f''(g) at every point [pressure/length].

    Example:
        >>> f"{js.potentials.curvature(law, np.array(0.0)):.3f}"
        '-8.333'
    """
    return derivatives(potential, gap)[2]

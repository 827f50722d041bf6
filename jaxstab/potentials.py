"""Interaction laws: scalar functions of the gap that return an energy per area.

Derivatives are taken by automatic differentiation only, so that a law is one formula.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxstab.checks import cast, known, parameter, require, require_positive
from jaxstab.functions import as_pytree

Potential = Callable[[Float[Array, ""]], Float[Array, ""]]
Field = Float[Array, " *grid"]


class _RangedLaw(eqx.Module):
    """A law with a surface energy [energy/area] and a range [length]."""

    surface_energy: Float[Array, ""]
    length: Float[Array, ""]

    def __init__(self, surface_energy: ArrayLike, length: ArrayLike):
        self.surface_energy = parameter(surface_energy)
        self.length = parameter(length)
        energy = known(self.surface_energy)
        finite = (energy >= 0) & (energy < np.inf)
        require("The surface energy", energy, finite, "it must be finite and not negative.")
        require_positive("The length of the potential", self.length)

    def _reduced(self, gap: Float[Array, ""]) -> Float[Array, ""]:
        # By a product: over a whole field, a quotient takes longer than all the rest.
        return gap * (1 / self.length)


class Exponential(_RangedLaw):
    """f(g) = -gamma exp(-g / rho) (Rey & Bleyer, eq. 45).

    Arguments:
        surface_energy: gamma [energy/area].
        length: rho, the range [length].

    Raises:
        ValueError: if gamma is negative or rho is not positive.
    """

    def __call__(self, gap: Float[Array, ""]) -> Float[Array, ""]:
        """Return the energy per area at a gap [length]."""
        return -self.surface_energy * jnp.exp(-self._reduced(gap))


class Gaussian(_RangedLaw):
    """f(g) = -gamma exp(-g^2 / (2 rho^2)) (Rey & Bleyer, eq. 46).

    Arguments:
        surface_energy: gamma [energy/area].
        length: rho, the range [length].

    Raises:
        ValueError: if gamma is negative or rho is not positive.
    """

    def __call__(self, gap: Float[Array, ""]) -> Float[Array, ""]:
        """Return the energy per area at a gap [length]."""
        return -self.surface_energy * jnp.exp(-(self._reduced(gap) ** 2) / 2)


class Rational(_RangedLaw):
    """f(g) = -gamma / (1 + g^2 / rho^2) (Rey & Bleyer, eq. 47), a long-range law.

    Arguments:
        surface_energy: gamma [energy/area].
        length: rho, the range [length].

    Raises:
        ValueError: if gamma is negative or rho is not positive.
    """

    def __call__(self, gap: Float[Array, ""]) -> Float[Array, ""]:
        """Return the energy per area at a gap [length]."""
        return -self.surface_energy / (1 + self._reduced(gap) ** 2)


class Dugdale(_RangedLaw):
    """f' = sigma / (1 + exp((g - rho) / w)): the attraction sigma up to a gap rho, then none.

    The edge of Dugdale's step is smoothed over w; sigma is such that f(0) = -gamma, the work of
    adhesion. Its wall is contact itself.

    Arguments:
        surface_energy: gamma [energy/area].
        length: rho, the range [length].
        smoothing: w / rho, over which the attraction falls from 73 to 27 % of sigma.

    Raises:
        ValueError: if gamma is negative, or rho or the smoothing is not positive.
    """

    smoothing: Float[Array, ""]

    def __init__(self, surface_energy: ArrayLike, length: ArrayLike, smoothing: ArrayLike = 0.1):
        super().__init__(surface_energy, length)
        self.smoothing = parameter(smoothing)
        require_positive("The smoothing of the potential", self.smoothing)

    def __call__(self, gap: Float[Array, ""]) -> Float[Array, ""]:
        """Return the energy per area at a gap [length]."""
        edge = 1 / self.smoothing
        left = jax.nn.softplus(edge * (1 - self._reduced(gap)))
        return -self.surface_energy * left / jax.nn.softplus(edge)


class LennardJones(_RangedLaw):
    """f(g) = gamma / 2 ((z0 / g)^9 - 3 (z0 / g)^3): the 9-3 law between a solid and a wall.

    It repels below z0, where it is least, at -gamma; no gap closes against it.

    Arguments:
        surface_energy: gamma, the depth of the minimum [energy/area].
        length: z0, the gap at the minimum [length].

    Raises:
        ValueError: if gamma or z0 is not positive.
    """

    def __init__(self, surface_energy: ArrayLike, length: ArrayLike):
        super().__init__(surface_energy, length)
        require_positive("The surface energy of a law with a core", self.surface_energy)

    def __call__(self, gap: Float[Array, ""]) -> Float[Array, ""]:
        """Return the energy per area at a gap [length]."""
        attraction = 1 / self._reduced(gap) ** 3
        # In this form infinite, not undefined, at zero gap.
        return self.surface_energy / 2 * attraction * (attraction**2 - 3)


class NoAdhesion(eqx.Module):
    """f(g) = 0: contact without adhesion."""

    def __call__(self, gap: Float[Array, ""]) -> Float[Array, ""]:
        """Return zero energy per area at any gap [length]."""
        return jnp.zeros_like(gap)


class Varying(eqx.Module):
    """A law that varies over the surface: f(g, x), where parameters of `law` are fields f(x).

    As a function of one gap for all points it is the mean over the surface.

    Arguments:
        law: a law of which parameters are arrays of the grid's shape, others numbers. With a core
            it must have one everywhere.
    """

    law: Potential

    def __call__(self, gap: Float[Array, ""]) -> Float[Array, ""]:
        """Return the mean energy per area at a gap [length]."""
        return jnp.mean(self.law(gap))


class Within(eqx.Module):
    """A law between surfaces of which one is not everywhere; elsewhere nothing acts.

    Arguments:
        law: the law; what varies in it does so over all points.
        is_there: where the surface is.
    """

    law: Potential
    is_there: Bool[Array, " *grid"]

    def __call__(self, gap: Float[Array, ""]) -> Float[Array, ""]:
        """Return the energy per area at a gap of a point [length]."""
        return jnp.where(self.is_there, self.law(gap), 0)


class Scaled(eqx.Module):
    """A law whose energy is that of another one times a factor.

    Attributes:
        law: the other one.
        factor: the factor.
        has_core: whether they have a core, None if that is not known.
    """

    law: Potential
    factor: Float[Array, ""]
    has_core: bool | None = eqx.field(static=True, default=None)

    def __call__(self, gap: Float[Array, ""]) -> Float[Array, ""]:
        """Return the other energy per area at a gap [length], times the factor."""
        return self.factor * self.law(gap)


def as_module(potential: Potential, dtype: Any) -> Potential:
    """Return `potential` as a pytree of arrays that acts on gaps of `dtype`.

    Raises:
        ValueError: if it does not map a scalar gap to a real scalar.
        TypeError: if it cannot be traced by JAX.
    """
    if not callable(potential):
        raise ValueError(f"The potential is {potential!r}: give a function of the gap.")
    if isinstance(potential, eqx.Module):
        potential = cast(potential, dtype)
    cure = (
        "it must return one real scalar, the energy per area. (It is applied point by point; its "
        "parameters must be scalars too, or fields inside of jaxstab.potentials.Varying.)"
    )
    return as_pytree("The potential", potential, jax.ShapeDtypeStruct((), dtype), cure)


def derivatives(potential: Potential, gap: Field) -> tuple[Field, Field, Field]:
    """Return f(g) [energy/area], f'(g) [pressure] and f''(g) [pressure/length] at every point."""

    fields, law_at = _by_points(potential)
    shapes = [field.shape for field in fields]
    try:
        jnp.broadcast_shapes(*shapes, gap.shape)
    except ValueError:
        raise ValueError(
            f"The law varies over points of shape {shapes[0]}, but the gaps have shape "
            f"{gap.shape}: give one for each point."
        ) from None

    def at_point(gap: Float[Array, ""], *values: Array) -> tuple[Array, Array, Array]:
        law = law_at(values)

        def slope_and_value(gap: Float[Array, ""]) -> tuple[Array, Array]:
            value, slope = jax.value_and_grad(law)(gap)
            return slope, value

        # Nested, so that what the three share is computed once.
        (slope, value), curvature = jax.value_and_grad(slope_and_value, has_aux=True)(gap)
        return value, slope, curvature

    value, slope, curvature = jnp.vectorize(at_point)(gap, *fields)
    return value.astype(gap.dtype), slope.astype(gap.dtype), curvature.astype(gap.dtype)


def everywhere(potential: Potential) -> Potential:
    """Return a law as it is where there is a surface."""

    def is_limited(node: Any) -> bool:
        return isinstance(node, Within)

    return jax.tree.map(
        lambda node: node.law if is_limited(node) else node, potential, is_leaf=is_limited
    )


def varying_fields(potential: Potential) -> list[Array]:
    """Return the parameters of a law that vary over the surface."""
    return _by_points(potential)[0]


def with_fields(potential: Potential, fields: Sequence[Array]) -> Potential:
    """Return a law with others in place of its `varying_fields`."""
    return _by_points(potential)[1](fields)


def _by_points(potential: Potential) -> tuple[list[Array], Callable[[Sequence[Array]], Potential]]:
    """Return the fields of a law, and what makes a law of others in their place."""

    def varies(node: Any) -> Any:
        if isinstance(node, Within):
            return replace(node, law=flagged(node.law), is_there=True)
        is_varying = isinstance(node, Varying)
        return jax.tree.map(lambda leaf: is_varying and jnp.ndim(leaf) > 0, node)

    def flagged(node: Any) -> Any:
        return jax.tree.map(varies, node, is_leaf=lambda node: isinstance(node, Varying | Within))

    flags = flagged(potential)
    leaves, structure = jax.tree.flatten(potential)
    is_field = jax.tree.leaves(flags)

    def law_at(values: Sequence[Array]) -> Potential:
        rest = iter(values)
        merged = [next(rest) if f else leaf for leaf, f in zip(leaves, is_field, strict=True)]
        return jax.tree.unflatten(structure, merged)

    return [leaf for leaf, f in zip(leaves, is_field, strict=True) if f], law_at


def energy_density(potential: Potential, gap: Field) -> Field:
    """Return f(g) at every point [energy/area]."""
    return derivatives(potential, gap)[0]


def slope(potential: Potential, gap: Field) -> Field:
    """Return f'(g), the attraction, at every point [pressure]."""
    return derivatives(potential, gap)[1]


def curvature(potential: Potential, gap: Field) -> Field:
    """Return f''(g) at every point [pressure/length]."""
    return derivatives(potential, gap)[2]

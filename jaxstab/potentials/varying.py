"""Laws made of other laws: varying over the surface, restricted to a mask, or scaled."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, PyTree

from jaxstab.core.display import inline
from jaxstab.core.types import Mask, Scalar
from jaxstab.core.units import NUMBER
from jaxstab.potentials.sums import Law

Potential = Callable[[Scalar], Scalar]

_averaged: ContextVar[list["Varying"] | None] = ContextVar("averaged", default=None)


class Varying(Law):
    """A law that varies over the surface: f(g, x), where parameters of `law` are fields f(x).

    As a function of one gap for all points it is the mean over the surface.

    Arguments:
        law: a law of which parameters are arrays of the grid's shape, others numbers. With a core
            it must have one everywhere.

    Raises:
        TypeError: for a function, and for a law with parameters that are no arrays.

    Example:
        >>> patchy = js.potentials.Varying(js.potentials.Exponential(0.03 * (heights > 0), 0.06))
        >>> f"{js.potentials.energy_density(patchy, jnp.zeros(grid.shape)).min():.2f}"
        '-0.03'
    """

    law: Potential

    __repr__ = inline

    def __check_init__(self) -> None:
        # A bare function does not say which of its arrays vary, and would be the mean everywhere.
        if not all(hasattr(leaf, "shape") for leaf in jax.tree.leaves(self.law)):
            raise TypeError(
                "The law that varies holds more than arrays: give one of jaxstab.potentials, or an "
                "equinox.Module whose parameters are arrays. A function has no "
                "parameters that can vary."
            )

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the mean energy per area at a gap [length]."""
        averaged = _averaged.get()
        if averaged is not None and any(map(jnp.ndim, jax.tree.leaves(self.law))):
            averaged.append(self)
        return jnp.mean(self.law(gap))


@contextmanager
def averaged_laws() -> Iterator[list[Varying]]:
    """Collect the varying laws that are evaluated as their mean over the surface."""
    laws: list[Varying] = []
    outer = _averaged.set(laws)
    try:
        yield laws
    finally:
        _averaged.reset(outer)


class Within(eqx.Module):
    """A law that acts on the part of the grid with a surface, and is zero elsewhere.

    Arguments:
        law: the law; its fields have values at all points.
        is_there: the mask of the surface.
    """

    law: Potential
    is_there: Mask

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap of a point [length]."""
        return jnp.where(self.is_there, self.law(gap), 0)


class Yielding(eqx.Module):
    """A law but for a mask, where the surface bears its hardness whatever its displacement.

    Arguments:
        law: the law; its fields have values at all points.
        yields: the mask.
        hardness: H [pressure].
    """

    law: Potential
    yields: Mask
    hardness: Array

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap of a point [length]."""
        return jnp.where(self.yields, -self.hardness * gap, self.law(gap))


class Scaled(eqx.Module):
    """A multiple of a law.

    Attributes:
        law: the law.
        factor: the factor.
        has_core: whether the law has a core, None if unknown.
    """

    law: Potential
    factor: Annotated[Scalar, NUMBER]
    has_core: bool | None = eqx.field(static=True, default=None)

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length], times the factor."""
        return self.factor * self.law(gap)


def everywhere(potential: Potential) -> Potential:
    """Return a law without its restriction to a mask."""

    def is_restricted(node: PyTree) -> bool:
        return isinstance(node, Within | Yielding)

    def law_everywhere(node: PyTree) -> PyTree:
        if is_restricted(node):
            return everywhere(node.law)
        return node

    return jax.tree.map(law_everywhere, potential, is_leaf=is_restricted)


def varying_fields(potential: Potential) -> list[Array]:
    """Return the parameters of a law that vary over the surface."""
    return by_points(potential)[0]


def with_fields(potential: Potential, fields: Sequence[Array]) -> Potential:
    """Return a law with its `varying_fields` replaced."""
    return by_points(potential)[1](fields)


def by_points(potential: Potential) -> tuple[list[Array], Callable[[Sequence[Array]], Potential]]:
    """Return the fields of a law, and the function that makes a law of other fields."""

    def is_of_points(node: PyTree) -> bool:
        return isinstance(node, Varying | Within | Yielding)

    def varies(node: PyTree) -> PyTree:
        if isinstance(node, Within):
            return replace(node, law=flags_of(node.law), is_there=True)
        if isinstance(node, Yielding):
            return replace(node, law=flags_of(node.law), yields=True, hardness=True)
        is_varying = isinstance(node, Varying)
        return jax.tree.map(lambda leaf: is_varying and jnp.ndim(leaf) > 0, node)

    def flags_of(node: PyTree) -> PyTree:
        return jax.tree.map(varies, node, is_leaf=is_of_points)

    flags = flags_of(potential)
    leaves, structure = jax.tree.flatten(potential)
    is_field = jax.tree.leaves(flags)

    def law_at(values: Sequence[Array]) -> Potential:
        rest = iter(values)
        merged = list(leaves)
        for place, varies in enumerate(is_field):
            if varies:
                merged[place] = next(rest)
        return jax.tree.unflatten(structure, merged)

    return [leaf for leaf, f in zip(leaves, is_field, strict=True) if f], law_at

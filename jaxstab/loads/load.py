"""The interface of loads, and the condition on the gap that solvers see: a `Control`."""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.core import model
from jaxstab.core.accuracy import rounding_of_fields
from jaxstab.core.checks import cast, concrete, in_words, parameter, require
from jaxstab.core.display import inline
from jaxstab.core.grid import mean
from jaxstab.core.stack import Stackable
from jaxstab.core.types import ArrayLike, Field, FieldMap, Flag, Mask, Scalar
from jaxstab.core.units import Dimensioned, dimensions
from jaxstab.potentials.profile import Profile
from jaxstab.solids.solid import Solid


class Control(eqx.Module):
    """The condition that a load sets on the gap of one surface.

    Attributes:
        fixes_mean: whether perturbations under the load have zero mean.
        stores_energy: whether the load's energy is one that it gives back, as a spring does.
        largest_reaction: H + f'(0), from which on a point in contact yields, so that its signed gap
            falls below zero; None on a surface that does not yield [pressure].
        largest_pressure: the mean of H, which no mean pressure exceeds; None likewise [pressure].
    """

    fixes_mean: ClassVar[bool]
    stores_energy: ClassVar[bool] = True

    largest_reaction: Field | None = eqx.field(default=None, kw_only=True)
    largest_pressure: Scalar | None = eqx.field(default=None, kw_only=True)

    def mean_gap_of(self, gap: Field) -> Scalar:
        """Return the mean of a gap on which p0 does its work [length]."""
        return mean(gap)

    @property
    @abstractmethod
    def stiffness(self) -> Scalar | None:
        """How p0 grows with the mean gap: the load's part of the Hessian [pressure/length].

        None where it has none.
        """

    @property
    @abstractmethod
    def is_feasible(self) -> Flag:
        """Whether any gap meets the load."""

    @property
    def presses(self) -> Flag:
        """Whether the load brings surfaces together that are apart."""
        return self.energy(jnp.ones(())) > self.energy(jnp.zeros(()))

    @abstractmethod
    def starting_gap(self, heights: Field) -> Field:
        """Return the gap of the undeformed solid, negative where it would enter the surface."""

    def separated_gap(self, heights: Field, profile: Profile) -> Field:
        """Return the gap of a separated state where there is one, else `starting_gap`."""
        return self.starting_gap(heights)

    @abstractmethod
    def restore(self, gap: Field) -> Field:
        """Return a gap that meets the load, near to one that is nowhere negative."""

    def cut(self, gap: Field, side: Field | None = None) -> Field:
        """Return a gap cut at zero.

        A signed one, of a surface that yields, is cut only where it has left its side.
        """
        if self.largest_reaction is None:
            return jnp.maximum(gap, 0)
        if side is None:
            return gap
        return model.cut(gap, side)

    @abstractmethod
    def admissible(self, gap: Field, side: Field | None = None) -> Field:
        """Return a gap that meets the load and is nowhere negative, near to any other.

        A signed one may be negative where its side is.
        """

    @abstractmethod
    def error(self, gap: Field) -> Scalar:
        """Return the relative error of a gap under the load."""

    def is_met(self, gap: Field) -> Flag:
        """Whether a gap meets the load, to within the rounding of fields."""
        return self.error(gap) <= rounding_of_fields(gap.dtype)

    @abstractmethod
    def energy(self, mean_gap: Array) -> Array:
        """Return the energy of the load at a mean gap, or at several [energy/area]."""

    @abstractmethod
    def net_pressure(self, gradient: Field, gap: Field) -> Field:
        """Return K u + p0 + f'(g) from K u + f'(g) [pressure]."""

    @abstractmethod
    def resisting(self, attraction: Field, gap: Field) -> Field:
        """Return the part of the attraction that neither load nor contact takes [pressure]."""

    @abstractmethod
    def mean_imbalance(self, imbalance: Field, attraction: Field, gap: Field) -> Scalar:
        """Return the mean imbalance of pressures over the mean of the pressures in balance."""

    @abstractmethod
    def project(self, field: Field, is_moving: Mask) -> Field:
        """Return the nearest perturbation of the moving points that the load allows."""

    def release_level(self, gap: Field, net: Field) -> ArrayLike:
        """Return the net pressure below which a point in contact is pulled off [pressure]."""
        return 0

    def side(self, gap: Field, net: Field) -> Field | None:
        """Return the side of zero on which a signed gap is, or to which it may leave: 1 or -1.

        It is zero where a point is held; None on a surface that does not yield.
        """
        largest = self.largest_reaction
        if largest is None:
            return None
        level = self.release_level(gap, net)
        leaves = jnp.where(net < level, 1, jnp.where(net > largest + level, -1, 0))
        return jnp.where(gap == 0, leaves, jnp.sign(gap)).astype(gap.dtype)

    def moving(self, gap: Field, net: Field) -> Mask:
        """Return the points that may move: those out of contact, and those that leave it."""
        side = self.side(gap, net)
        if side is None:
            return (gap > 0) | (net < self.release_level(gap, net))
        return side != 0

    def imbalance(self, net: Field, gap: Field) -> Field:
        """Return the part of the net pressure that is out of balance [pressure]."""
        return model.imbalance(net, gap, self.largest_reaction)

    def precondition(self, inverse: FieldMap, force: Field, is_moving: Mask) -> Field:
        """Return the move of the moving points under a force, by roughly the inverse of K."""
        return inverse(force)

    def escape_gap(self, profile: Profile) -> Scalar:
        """Return the gap beyond which nothing holds the surfaces against the load [length]."""
        return jnp.array(jnp.inf)

    def has_escaped(self, gap: Field, escape_gap: Scalar) -> Flag:
        """Whether the load has separated the surfaces for good."""
        return jnp.array(False)


class Load(Stackable, Dimensioned):
    """A load on the surfaces: one value, or an array of values for a sweep.

    Attributes:
        quantity: the name of the value in figures; by default the name of the class.
        unit: the dimension of the value, as its field declares it: "length" or "pressure".
        is_position: whether the value is a displacement, which counts from the zero of the heights.
    """

    quantity: ClassVar[str] = ""
    is_position: ClassVar[bool] = False

    value: eqx.AbstractVar[Float[Array, "..."]]

    __repr__ = inline

    @property
    def unit(self) -> str:
        """The dimension of the value."""
        return dimensions(type(self)).get("value", "")

    @abstractmethod
    def control(self, solid: Solid, heights: Field) -> Control:
        """Return the condition of the load on the gap between this solid and this surface."""

    def far_displacement(self, mean_pressure: Array) -> Array | None:
        """Return the displacement of the far side at a mean pressure, None where it is not known.

        It counts from the zero of the heights [length].
        """
        return None

    def warn_if_soft(self, solid: Solid) -> None:
        """Warn of a machine that is far too soft for a solid; only a spring can be."""

    def at(self, value: Array) -> "Load":
        """Return this load with another value."""
        return eqx.tree_at(lambda load: load.value, self, value)

    def after_indentation(self, depth: Scalar) -> "Load":
        """Return this load for a surface that lies lower by an indentation of a mean depth."""
        return self

    def relative_to(self, datum: Scalar) -> "Load":
        """Return this load for heights relative to a datum [length]."""
        if not self.is_position:
            return self
        dtype = jnp.promote_types(self.value.dtype, datum.dtype)
        return self.at(self.value.astype(dtype) - datum.astype(dtype))


def require_load(load: Load) -> None:
    """Raise `TypeError` if `load` is not one, or has numbers whose units are not known.

    Raises `ValueError` if its numbers differ in shape.
    """
    if not isinstance(load, Load):
        given = in_words(load)
        if isinstance(load, type):
            given = f"the class {load.__name__}, without its value"
        raise TypeError(
            f"The load is {given}: give the prescribed quantity, by MeanDisplacement, MeanGap, "
            "MeanPressure, FarDisplacement or Spring."
        )
    kind = type(load)
    shape = jnp.shape(load.value)
    numbers = {name for name, value in vars(load).items() if eqx.is_inexact_array(value)}
    unknown = sorted(numbers - {*dimensions(kind)})
    if unknown and kind.in_units_of is Dimensioned.in_units_of:
        raise TypeError(
            f"{unknown[0]} of {kind.__name__} has no dimension, which its units follow from: "
            f'declare it, as in {unknown[0]}: Annotated[Array, jaxstab.Dimension("pressure")].'
        )
    if any(jnp.shape(leaf)[: len(shape)] != shape for leaf in jax.tree.leaves(load)):
        raise ValueError(
            f"The load is {load!r}, its value of shape {shape}: give all of its numbers that shape."
        )


def require_loads(load: Load, shape: tuple[int, ...], takes: str, cure: str) -> None:
    """Raise `TypeError` for something that is no load, `ValueError` for other than so many."""
    require_load(load)
    if load.value.shape != shape:
        raise ValueError(
            f"{takes}, but {type(load).__name__} holds an array of shape {load.value.shape}: {cure}"
        )


def require_same_machine(load: Load) -> None:
    """Raise `ValueError` if the entries of a load, where known, differ in more than their value."""
    for leaf in jax.tree.leaves(eqx.tree_at(lambda load: load.value, load, None)):
        numbers = concrete(leaf).ravel()
        cure = "its values must belong to one machine, so give one stiffness for all of them."
        require("The load", load, (numbers == numbers[0]).all(), cure)


def prescribed_value(value: ArrayLike) -> Float[Array, "..."]:
    """Return a prescribed value as an array."""
    given = parameter(value)
    return cast(given, given.dtype)

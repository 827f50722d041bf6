"""A contact as a function of its parameters, and the curve of its mean pressures over loads."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from jaxstab.calibration.least_squares import Curve, Order, Slopes, Values
from jaxstab.contact import Contact
from jaxstab.core.results import RESULTS
from jaxstab.equilibrium import PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find_equilibrium, with_derivatives
from jaxstab.equilibrium.window import whole_start
from jaxstab.loads import Load

Where = Callable[[Contact], Any]


@dataclass(frozen=True)
class Pick:
    """A function that picks parts of a contact, equal to another that picks the same.

    Functions that are written anew, as with each run of a cell, would be compiled anew.
    """

    where: Where = field(compare=False)
    places: tuple[int, ...]
    structure: jax.tree_util.PyTreeDef

    @classmethod
    def of(cls, where: Where, contact: Contact) -> "Pick":
        """Return the parameters that a function picks from a contact."""
        leaves, structure = jax.tree.flatten(contact)
        opaque = [object() for _ in leaves]
        try:
            picked, tree = jax.tree.flatten(where(jax.tree.unflatten(structure, opaque)))
            return cls(where, tuple(map(opaque.index, picked)), tree)
        except (TypeError, ValueError):
            raise TypeError(
                "`where` computes with the contact's parameters: it must only pick them."
            ) from None

    def __call__(self, contact: Contact) -> Any:
        """Return these parts of a contact."""
        return self.where(contact)


def values_of(tree: Any) -> tuple[Values, Callable[[Values], Any]]:
    """Return the floating-point leaves of a pytree as a vector, and the way back."""
    leaves, rest = eqx.partition(tree, eqx.is_inexact_array)
    values, unravel = ravel_pytree(leaves)
    return values, lambda values: eqx.combine(unravel(values), rest)


@dataclass(frozen=True)
class Model:
    """A contact, which of its parameters may change, and how they follow from a vector."""

    contact: Contact
    where: Pick
    unravel: Callable[[Values], Any]

    def contact_at(self, values: Values) -> Contact:
        """Return the contact with other parameters."""
        return eqx.tree_at(self.where, self.contact, self.unravel(values))

    def curve(self, values: Values, loads: Load, order: Order) -> Slopes:
        """Return the mean pressures at loads and their Jacobian, NaN without an equilibrium."""
        return self._along(jax.value_and_grad(self._pressure, has_aux=True), values, loads, order)

    def pressures(self, values: Values, loads: Load, order: Order) -> Curve:
        """Return the mean pressures alone, in a fraction of the time."""
        return self._along(lambda *inputs: (self._pressure(*inputs), None), values, loads, order)[0]

    def _along(self, at_load: Callable, values: Values, loads: Load, order: Order) -> Any:
        def independent(load: Load) -> Any:
            (pressure, _), row = at_load(values, load, None)
            return pressure, row

        def follow(start: Array, load: Load) -> tuple[Array, Any]:
            (pressure, gap), row = at_load(values, load, start)
            return jnp.where(jnp.isnan(pressure), start, gap), (pressure, row)

        if order == "independent":
            return jax.vmap(independent)(loads)
        first = jax.tree.map(lambda leaf: leaf[0], loads)
        start = self.contact.control(first).starting_gap(self.contact.heights)
        return jax.lax.scan(follow, start, loads)[1]

    def _pressure(self, values: Values, load: Load, start: Array | None) -> tuple[Array, Array]:
        """Return the mean pressure at one load and the gap, from which the next one can start."""
        method = PreconditionedConjugateGradient()
        whole, start = whole_start(self.contact_at(values), load, start)
        inputs = jax.lax.stop_gradient((whole, load, method, start))
        found = with_derivatives(whole, load, find_equilibrium(*inputs)).on_surface(whole.solid)
        is_found = found.result == RESULTS.successful
        return jnp.where(is_found, found.mean_pressure, jnp.nan), found.gap

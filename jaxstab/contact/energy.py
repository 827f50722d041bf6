"""The energy that a load supplies, and the energy of a contact that losses are compared with.

On a branch the potential E + W, with W the energy of the load, changes by the work of the load:
dE + dW = F dl.
"""

import jax
import jax.numpy as jnp

from jaxstab.contact.contact import Contact
from jaxstab.core.accuracy import rounding_of_numbers
from jaxstab.core.types import Scalar
from jaxstab.loads.load import Load


def supply_of(
    contact: Contact, load: Load, mean_gap: Scalar, mean_pressure: Scalar
) -> tuple[Scalar, Scalar]:
    """Return W [energy] at an equilibrium, and F = d(E + W) / dl [energy over unit of l]."""
    area = contact.grid.area
    control = contact.control(load)

    def potential(value: Scalar) -> Scalar:
        return area * contact.control(load.at(value)).energy(mean_gap)

    held, force = jax.value_and_grad(potential)(load.value)
    if control.fixes_mean:
        # The machine that holds the gap does the work of its pressure.
        force = -area * mean_pressure
    return held, force


def characteristic_energy(contact: Contact) -> Scalar:
    """Return the elastic energy of full contact plus the deepest adhesive energy everywhere."""
    values = contact.profile.values
    deepest = -jnp.min(jnp.where(jnp.isfinite(values), values, 0))
    elastic = contact.solid.conforming_energy(contact.heights)
    return elastic + contact.area * deepest


def rounding_of(energy: Scalar, pressing: Scalar) -> Scalar:
    """Return the part of a loss near a state of this energy that may be rounding [energy].

    `pressing` is area times mean pressure times mean gap: the rounding of the gap counts too, under
    a high pressure it does work.
    """
    return rounding_of_numbers(energy.dtype) * (jnp.abs(energy) + jnp.abs(pressing))

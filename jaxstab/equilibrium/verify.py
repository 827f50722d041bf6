"""Whether a state is an equilibrium of the contact that it is used with."""

import jax.numpy as jnp

from jaxstab.contact.contact import Contact
from jaxstab.contact.residual import Balance
from jaxstab.core.compile import program
from jaxstab.core.grid import total
from jaxstab.core.results import RESULTS
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.equilibrium.window import padded_state

# Rounding may add this to a residual, and to a load that is met, in units of the precision.
_ROUNDING = 1e3


@program
def recognised(contact: Contact, equilibrium: Equilibrium) -> RESULTS:
    """Return whether a state is in equilibrium in this contact, under its load."""
    contact, equilibrium = padded_state(contact, equilibrium)
    unit = contact.characteristic_pressure
    contact = contact.in_units_of(unit)
    equilibrium = equilibrium.in_units_of(unit)
    control = contact.control(equilibrium.load)
    balance = contact.balance(control)(equilibrium.gap)
    return recognised_by(balance, contact, equilibrium)


def recognised_by(balance: Balance, contact: Contact, equilibrium: Equilibrium) -> RESULTS:
    """Return the same, from the balance of pressures evaluated anew."""
    gap = equilibrium.gap
    reaction = equilibrium.reaction
    pressure = equilibrium.pressure
    rounding = _ROUNDING * jnp.finfo(gap.dtype).eps
    load_error = contact.control(equilibrium.load).error(gap)
    is_own = (balance.residual <= 2 * equilibrium.residual + rounding) & (load_error <= rounding)
    result = RESULTS.where(is_own, RESULTS.successful, RESULTS.other_contact)
    result = RESULTS.where(jnp.isfinite(balance.residual), result, RESULTS.nonfinite)
    is_finite = jnp.isfinite(total(gap) + total(reaction) + total(pressure))
    is_found = (equilibrium.result == RESULTS.successful) & is_finite
    return RESULTS.where(is_found, result, RESULTS.no_equilibrium)

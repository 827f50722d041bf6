"""Whether a state is an equilibrium of the contact that it is used with."""

import jax.numpy as jnp

from jaxstab.contact.contact import Contact
from jaxstab.contact.residual import Balance
from jaxstab.core.accuracy import rounding_of_fields
from jaxstab.core.compile import program
from jaxstab.core.grid import total
from jaxstab.core.results import RESULTS
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.equilibrium.posing import posed_state


@program
def verify(contact: Contact, equilibrium: Equilibrium) -> RESULTS:
    """Return whether a state is in equilibrium in this contact, under its load."""
    problem = posed_state(contact, equilibrium)
    control = problem.contact.control(problem.equilibrium.load)
    balance = problem.contact.balance(control)(problem.equilibrium.gap)
    return verify_balance(balance, problem.contact, problem.equilibrium)


def verify_balance(balance: Balance, contact: Contact, equilibrium: Equilibrium) -> RESULTS:
    """Return the same, from the balance of pressures evaluated anew."""
    gap = equilibrium.gap
    reaction = equilibrium.reaction
    pressure = equilibrium.pressure
    rounding = rounding_of_fields(gap.dtype)
    is_met = contact.control(equilibrium.load).is_met(gap)
    is_own = (balance.residual <= 2 * equilibrium.residual + rounding) & is_met
    result = RESULTS.where(is_own, RESULTS.successful, RESULTS.other_contact)
    result = RESULTS.where(jnp.isfinite(balance.residual), result, RESULTS.nonfinite)
    is_finite = jnp.isfinite(total(gap + reaction + pressure))
    is_found = (equilibrium.result == RESULTS.successful) & is_finite
    return RESULTS.where(is_found, result, RESULTS.no_equilibrium)

"""The transfer of states between a window and the padded grid that it is solved on.

On any other solid it is the identity.
"""

from dataclasses import replace
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxstab.contact.contact import Contact
from jaxstab.contact.hessian import Hessian
from jaxstab.core.checks import concrete, is_traced
from jaxstab.core.compile import program
from jaxstab.core.grid import mean, mirrored, padded, where_window
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field
from jaxstab.core.warn import warn
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.loads.load import Load

Start = TypeVar("Start", Field, Field | None)

# The edges may carry this part of the largest pressure.
_MOST_AT_EDGES = 1e-2


class WindowWarning(UserWarning):
    """The contact is not small compared with its window."""


def padded_state(contact: Contact, equilibrium: Equilibrium) -> tuple[Contact, Equilibrium]:
    """Return a contact and its equilibrium on the grid that it is solved on.

    Outside of the window the displacement is that which the pressures on it make there.
    """
    extended = contact.padded
    solid = extended.solid
    if extended is contact:
        return contact, equilibrium
    shape = solid.displacement(padded(equilibrium.pressure, 0))
    window = equilibrium.gap + contact.heights
    far = mean(window - solid.surface(shape))
    is_there = where_window(equilibrium.gap)
    displacement = jnp.where(is_there, padded(window, 0), shape + far)
    gap = jnp.where(is_there, padded(equilibrium.gap, 0), displacement - extended.heights)
    return extended, replace(
        equilibrium,
        displacement=displacement + contact.datum,
        gap=gap,
        pressure=padded(equilibrium.pressure, 0),
        reaction=padded(equilibrium.reaction, 0),
        in_contact=padded(equilibrium.in_contact, False),
    )


def padded_start(contact: Contact, load: Load, gap: Start) -> tuple[Contact, Start | Field]:
    """Return a contact on the grid that it is solved on, and a gap there to start from.

    Outside of the window its displacement leaves no pressure. Without a gap to start from it is the
    gap of the undeformed solid on a window, and elsewhere None.
    """
    extended = contact.padded
    if extended is contact:
        return contact, gap
    constant, window, load, gap = jax.lax.stop_gradient((extended, contact, load, gap))
    if gap is None:
        # A solid that is not deformed has no pressures anywhere.
        return extended, _continued(constant, window.control(load).starting_gap(window.heights))
    return extended, _relaxed_outside(constant, load, gap)


def warn_at_edges(contact: Contact, equilibrium: Equilibrium) -> None:
    """Warn, where values are known, if a surface that ends acts on the solid at its edges."""
    is_found = equilibrium.result == RESULTS.successful
    if not contact.solid.is_window or is_traced((contact, equilibrium)) or not is_found:
        return
    pressures = abs(concrete(equilibrium.pressure))
    ends = [pressures.take(np.array([0, n - 1]), axis) for axis, n in enumerate(pressures.shape)]
    largest = pressures.max()
    at_edges = max(end.max() for end in ends)
    if at_edges > _MOST_AT_EDGES * largest:
        warn(
            f"at the edges of the window the pressure exceeds {_MOST_AT_EDGES:.0%} of its largest "
            "value: contact or adhesion reaches the edge of the window. Use a larger one.",
            WindowWarning,
        )


@program
def _continued(extended: Contact, gap: Field) -> Field:
    """Return a gap of which the displacement goes on outside of the window by its mirror images."""
    is_there = where_window(gap)
    displacement = mirrored(gap + extended.solid.surface(extended.heights))
    return jnp.where(is_there, padded(gap, 0), displacement - extended.heights)


@program
def _relaxed_outside(extended: Contact, load: Load, gap: Field) -> Field:
    solid = extended.solid
    control = extended.control(load)
    is_outside = ~where_window(gap)
    start = _continued(extended, gap)
    hessian = Hessian(solid, jnp.zeros_like(start), control.stiffness, is_outside)
    system = LinearSystem(
        hessian,
        hessian.inverse(solid.min_stiffness),
        lambda field: jnp.where(is_outside, field, 0),
    )
    move, _ = system.solution(-control.net_pressure(extended.gradient(start), start))
    return jnp.maximum(start + jnp.where(is_outside, move, 0), 0)

"""The transfer of states between a window and the padded grid that it is solved on.

On any other solid it is the identity.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxstab.contact.contact import Contact
from jaxstab.contact.hessian import Hessian
from jaxstab.core.checks import concrete, where_known
from jaxstab.core.compile import program
from jaxstab.core.grid import mean, mirrored, padded, where_window
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field
from jaxstab.core.warn import warn
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.loads.load import Load

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


@where_known
def warn_at_edges(contact: Contact, equilibrium: Equilibrium) -> None:
    """Warn, where values are known, if a surface that ends acts on the solid at its edges."""
    if not contact.solid.is_window or equilibrium.result != RESULTS.successful:
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
def continued(contact: Contact, gap: Field) -> Field:
    """Return a gap whose displacement goes on outside of the window by its mirror images."""
    if not contact.solid.is_window:
        return gap
    is_there = where_window(gap)
    displacement = mirrored(gap + contact.solid.surface(contact.heights))
    return jnp.where(is_there, padded(gap, 0), displacement - contact.heights)


def relaxed_outside(contact: Contact, load: Load, gap: Field) -> Field:
    """Return a gap whose displacement leaves no pressure outside of the window."""
    if not contact.solid.is_window:
        return gap
    return _relaxed_outside(*jax.lax.stop_gradient((contact, load, gap)))


@program
def _relaxed_outside(contact: Contact, load: Load, gap: Field) -> Field:
    solid = contact.solid
    control = contact.control(load)
    is_outside = ~where_window(gap)
    start = continued(contact, gap)
    hessian = Hessian(solid, jnp.zeros_like(start), control.stiffness, is_outside)
    system = LinearSystem(
        hessian,
        hessian.inverse(solid.min_stiffness),
        lambda field: jnp.where(is_outside, field, 0),
    )
    move, _ = system.solution(-control.net_pressure(contact.gradient(start), start))
    return jnp.maximum(start + jnp.where(is_outside, move, 0), 0)

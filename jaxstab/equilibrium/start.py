"""Where a solve starts: from a gap or a state that is given, or from the solid at rest."""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxstab.contact.contact import Contact
from jaxstab.core.checks import concrete, numbers, require, require_finite, require_shape
from jaxstab.core.compile import program
from jaxstab.core.grid import resample
from jaxstab.core.types import ArrayLike, Field
from jaxstab.equilibrium.equilibrium import Equilibrium, State, single_start
from jaxstab.equilibrium.posing import continue_by_mirrors, posed_gap
from jaxstab.loads.load import Control, Load

Initial = ArrayLike | State | None


def start_of(contact: Contact, load: Load, initial: Initial) -> Field:
    """Return a gap to start a solve from, by default that of the undeformed solid.

    Arguments:
        contact: the contact as it is solved (`pose`).
        load: the load of the start, in the same unit.
        initial: a gap [length], an equilibrium or a result with one, on the grid of the surface.

    Raises:
        ValueError: for an initial gap that is not finite, of another shape than the grid, or
            nowhere positive under a load that holds the mean gap.
    """
    if initial is None:
        return _at_rest(contact, load)
    return posed_gap(contact, load, given_gap(contact, load, initial))


def initial_of_path(contact: Contact, load: Load, initial: Initial) -> Initial:
    """Return what a path begins with: by default separated surfaces, if a spring allows it."""
    if initial is None and _kind_of_control(contact, load).stiffness is not None:
        return _separated_gap(contact, load)
    return initial


def given_gap(contact: Contact, load: Load, initial: ArrayLike | State) -> Field:
    """Return a start as a gap on the grid of the surface, checked."""
    solid = contact.solid
    heights = solid.surface(contact.heights)
    shape = heights.shape
    if isinstance(initial, eqx.Module):
        state = single_start(initial)
        gap = state.gap
        if isinstance(state, Equilibrium) and contact.hardness is not None:
            gap = state.signed_gap
        if isinstance(state, Equilibrium) and gap.ndim == len(shape) and gap.shape != shape:
            displacement = resample(state.displacement, shape)
            gap = displacement - contact.datum - heights
    else:
        gap = numbers(initial, "The initial gap")
    require_shape("The initial gap", gap.shape, shape, "give one on the contact's grid.")
    gap = contact.grid.device_put(gap)
    require_finite("The initial gap", gap)
    if _kind_of_control(contact, load).fixes_mean and contact.hardness is None:
        largest = concrete(gap).max()
        cure = "it must be positive somewhere, for a load that holds the mean gap."
        require("The largest initial gap", largest, largest > 0, cure)
    return gap


@program
def _at_rest(contact: Contact, load: Load) -> Field:
    heights = contact.solid.surface(contact.heights)
    # A solid that is not deformed has no pressures beyond the surface either.
    start = _control_of_surface(contact, load).starting_gap(heights)
    if contact.hardness is not None:
        # Nothing has yielded yet.
        start = jnp.maximum(start, 0)
    return continue_by_mirrors(contact, start)


@program
def _separated_gap(contact: Contact, load: Load) -> Field:
    heights = contact.solid.surface(contact.heights)
    return _control_of_surface(contact, load).separated_gap(heights, contact.profile)


def _kind_of_control(contact: Contact, load: Load) -> Control:
    """Return the condition that a load sets on the gap, without its numbers."""
    return jax.eval_shape(lambda: contact.control(load))


def _control_of_surface(contact: Contact, load: Load) -> Control:
    """Return the condition of a load on the gap of the surface itself."""
    heights = contact.solid.surface(contact.heights)
    return load.relative_to(contact.datum).control(contact.solid, heights)

"""A contact as it is solved, and a result as its user gets it: what the entry points share.

Solvers and searches know neither units nor windows. A contact is posed for them once, in its
characteristic pressure and on the grid of the computation, of which a window is a part. What they
find is brought back once.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Protocol, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxstab.contact.contact import Contact
from jaxstab.contact.hessian import Hessian
from jaxstab.contact.window import MOST_AT_EDGES
from jaxstab.core.checks import concrete, where_known
from jaxstab.core.compile import program
from jaxstab.core.grid import mean
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.rings import Rings
from jaxstab.core.types import Field, Scalar
from jaxstab.core.warn import warn
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.loads.load import Load
from jaxstab.solids.free_half_space import mirrored, padded, where_window
from jaxstab.solids.solid import Solid


class WindowWarning(UserWarning):
    """The contact is not small compared with its window.

    Example:
        The contact of a paraboloid reaches the edges of its window:

        >>> free = js.FreeHalfSpace(grid, youngs_modulus=1.0)
        >>> sphere = js.Contact(free, js.surfaces.paraboloid(grid, radius=1.0), law)
        >>> import warnings
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     found = js.equilibrate(sphere, js.MeanPressure(0.3))
        >>> [each.category.__name__ for each in caught]
        ['WindowWarning']
    """


class _Result(Protocol):
    @property
    def result(self) -> RESULTS: ...
    def in_units_of(self, pressure: Scalar) -> Self: ...
    def on_surface(self, solid: Solid) -> Self: ...


State = TypeVar("State", Load, Equilibrium)
Found = TypeVar("Found", bound=_Result)


class Posed(eqx.Module):
    """A contact on the grid and in the unit of solvers.

    Attributes:
        contact: the contact.
        unit: the characteristic pressure, in the unit of the user [pressure].
    """

    contact: Contact
    unit: Scalar


class PosedLoad(Posed):
    """A contact and its load, or several, as they are solved."""

    load: Load


class PosedEquilibrium(Posed):
    """A contact and one of its equilibria, as they are solved."""

    equilibrium: Equilibrium


def pose(contact: Contact, load: Load) -> PosedLoad:
    """Return a contact and a load, or several, as they are solved."""
    own, unit = _pose(contact.padded)
    return PosedLoad(own, unit, _in_units_of(load, unit))


def posed_state(contact: Contact, equilibrium: Equilibrium) -> PosedEquilibrium:
    """Return a contact and one of its equilibria, on the grid and in the unit of solvers.

    A contact that yields is the one over the surface that the state leaves, on which it is an
    equilibrium without indentation.
    """
    padded_contact, padded_equilibrium = padded_state(*as_left(contact, equilibrium))
    own, unit = _pose(padded_contact)
    return PosedEquilibrium(own, unit, _in_units_of(padded_equilibrium, unit))


def as_left(contact: Contact, equilibrium: Equilibrium) -> tuple[Contact, Equilibrium]:
    """Return the contact over the surface that a state leaves, and the state as one of it."""
    if contact.hardness is None:
        return contact, replace(equilibrium, indentation=None, plastic_work=None)
    return contact.after(equilibrium), _without_indentation(equilibrium)


@program
def _without_indentation(equilibrium: Equilibrium) -> Equilibrium:
    indentation = equilibrium.indentation
    plastic_work = equilibrium.plastic_work
    assert indentation is not None and plastic_work is not None
    return replace(
        equilibrium,
        load=equilibrium.load.after_indentation(jnp.mean(indentation)),
        indentation=jnp.zeros_like(indentation),
        plastic_work=jnp.zeros_like(plastic_work),
    )


@program
def indented_by(found: Equilibrium, before: Equilibrium) -> Equilibrium:
    """Return a state over the surface that another has left, as one over the surface before."""
    assert found.indentation is not None and found.plastic_work is not None
    assert before.indentation is not None and before.plastic_work is not None
    return replace(
        found,
        indentation=before.indentation + found.indentation,
        plastic_work=before.plastic_work + found.plastic_work,
    )


def _pose(contact: Contact) -> tuple[Contact, Scalar]:
    contact = eqx.tree_at(lambda contact: contact.solid, contact, contact.solid.prepared)
    return _in_characteristic_pressure(contact.known_core, contact)


# A program of its own, which all kinds of loads and states share.
@partial(program, static_argnums=0)
def _in_characteristic_pressure(has_core: bool | None, contact: Contact) -> tuple[Contact, Scalar]:
    unit = contact.characteristic_pressure
    return contact.in_units_of(unit, has_core), unit


@program
def _in_units_of(state: State, unit: Scalar) -> State:
    return state.in_units_of(unit)


def finish(found: Found, problem: Posed, describe: Callable[[Found], str], throw: bool) -> Found:
    """Return a result in the unit and on the grid of the user, or raise its failure.

    Arguments:
        found: the result of a search.
        problem: the contact that it was found for.
        describe: returns the message for a failed result.
        throw: whether to raise a failure.
    """
    result = as_given(found, problem)
    return throw_failure(result.result, result, lambda: describe(result), throw)


def as_given(found: Found, problem: Posed) -> Found:
    """Return a result in the unit and on the grid in which the contact was given."""
    return _as_given(found, problem.unit, problem.contact.solid)


@program
def _as_given(found: Found, unit: Scalar, solid: Solid) -> Found:
    return found.in_units_of(1 / unit).on_surface(solid)


def padded_state(contact: Contact, equilibrium: Equilibrium) -> tuple[Contact, Equilibrium]:
    """Return a contact and its equilibrium on the grid that it is solved on.

    Outside of the window the displacement is that which the pressures on it make there.
    """
    extended = contact.padded
    solid = extended.solid
    if extended is contact:
        return contact, equilibrium
    shape = solid.displacement(padded(equilibrium.pressure, 0))
    window = equilibrium.signed_gap + contact.heights
    far = mean(window - solid.surface(shape))
    is_there = where_window(equilibrium.gap)
    displacement = jnp.where(is_there, padded(window, 0), shape + far)
    gap = jnp.where(is_there, padded(equilibrium.gap, 0), displacement - extended.heights)
    indentation = None
    if equilibrium.indentation is not None:
        indentation = padded(equilibrium.indentation, 0)
    return extended, replace(
        equilibrium,
        displacement=displacement + contact.datum,
        gap=gap,
        pressure=padded(equilibrium.pressure, 0),
        reaction=padded(equilibrium.reaction, 0),
        in_contact=padded(equilibrium.in_contact, False),
        indentation=indentation,
    )


@where_known
def warn_at_edges(contact: Contact, equilibrium: Equilibrium) -> None:
    """Warn, where values are known, if a surface that ends acts on the solid at its edges."""
    if not contact.solid.is_window or equilibrium.result != RESULTS.successful:
        return
    pressures = abs(concrete(equilibrium.pressure))
    first = [0]
    place = "edges of the window"
    if isinstance(contact.grid, Rings):
        # The first ring is the axis.
        first = []
        place = "rim of the disc"
    ends = [pressures.take([*first, n - 1], axis) for axis, n in enumerate(pressures.shape)]
    largest = pressures.max()
    at_edges = max(end.max() for end in ends)
    if at_edges > MOST_AT_EDGES * largest:
        warn(
            f"at the {place} the pressure exceeds {MOST_AT_EDGES:.0%} of its largest value: "
            f"contact or adhesion reaches the {place}. Use a larger one.",
            WindowWarning,
        )


@program
def continue_by_mirrors(contact: Contact, gap: Field) -> Field:
    """Return a gap whose displacement goes on outside of the window by its mirror images."""
    if not contact.solid.is_padded:
        return gap
    is_there = where_window(gap)
    displacement = mirrored(gap + contact.solid.surface(contact.heights))
    return jnp.where(is_there, padded(gap, 0), displacement - contact.heights)


def posed_gap(contact: Contact, load: Load, gap: Field) -> Field:
    """Return a gap of the surface on the grid of solvers, without pressure outside of a window."""
    if not contact.solid.is_padded:
        return gap
    return _relaxed_outside(*jax.lax.stop_gradient((contact, load, gap)))


@program
def _relaxed_outside(contact: Contact, load: Load, gap: Field) -> Field:
    solid = contact.solid
    control = contact.control(load)
    is_outside = ~where_window(gap)
    start = continue_by_mirrors(contact, gap)
    hessian = Hessian(solid, jnp.zeros_like(start), control.stiffness, is_outside)
    system = LinearSystem(
        hessian,
        hessian.inverse(solid.min_stiffness),
        lambda field: jnp.where(is_outside, field, 0),
    )
    move, _ = system.solution(-control.net_pressure(contact.gradient(start), start))
    moved = start + jnp.where(is_outside, move, 0)
    if contact.hardness is None:
        return jnp.maximum(moved, 0)
    return jnp.where(is_outside, jnp.maximum(moved, 0), moved)

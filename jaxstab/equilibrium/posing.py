"""A contact as it is solved, and a result as its user gets it: what the entry points share.

Solvers and searches know neither units nor windows. A contact is posed for them once, in its
characteristic pressure and on the grid of the computation, of which a window is a part. What they
find is brought back once.
"""

from collections.abc import Callable
from functools import partial
from typing import Generic, Protocol, Self, TypeVar

import equinox as eqx

from jaxstab.contact.contact import Contact
from jaxstab.core.compile import program
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.types import Scalar
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.equilibrium.window import padded_state
from jaxstab.loads.load import Load
from jaxstab.solids.solid import Solid


class _Result(Protocol):
    @property
    def result(self) -> RESULTS: ...
    def in_units_of(self, pressure: Scalar) -> Self: ...
    def on_surface(self, solid: Solid) -> Self: ...


State = TypeVar("State", Load, Equilibrium)
Found = TypeVar("Found", bound=_Result)


class Posed(eqx.Module, Generic[State]):
    """A contact and its load, or one of its equilibria, on the grid and in the unit of solvers.

    Attributes:
        contact: the contact.
        state: its load, or an equilibrium.
        unit: the characteristic pressure, in the unit of the user [pressure].
    """

    contact: Contact
    state: State
    unit: Scalar


def posed(contact: Contact, load: Load) -> Posed[Load]:
    """Return a contact and a load, or several, as they are solved."""
    return _posed(contact.padded, load)


def posed_state(contact: Contact, equilibrium: Equilibrium) -> Posed[Equilibrium]:
    """Return a contact and one of its equilibria, on the grid and in the unit of solvers."""
    return _posed(*padded_state(contact, equilibrium))


def _posed(contact: Contact, state: State) -> Posed[State]:
    own, unit = _in_characteristic_pressure(contact.known_core, contact)
    return Posed(own, _in_units_of(state, unit), unit)


# A program of its own, which all kinds of loads and states share.
@partial(program, static_argnums=0)
def _in_characteristic_pressure(has_core: bool | None, contact: Contact) -> tuple[Contact, Scalar]:
    unit = contact.characteristic_pressure
    return contact.in_units_of(unit, has_core), unit


@program
def _in_units_of(state: State, unit: Scalar) -> State:
    return state.in_units_of(unit)


def finished(found: Found, problem: Posed, describe: Callable[[Found], str], throw: bool) -> Found:
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

"""The steps around a search that the entry points share."""

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from typing import Any, Protocol, Self, TypeVar, TypeVarTuple

import jax

from jaxstab.contact.contact import Contact
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.implicit import refuse_derivatives
from jaxstab.core.interrupts import interrupts_held
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.types import Scalar
from jaxstab.core.units import Dimensioned
from jaxstab.solids.solid import Solid


class _Result(Protocol):
    @property
    def result(self) -> RESULTS: ...
    def in_units_of(self, pressure: Scalar) -> Self: ...
    def on_surface(self, solid: Solid) -> Self: ...


State = TypeVar("State", bound=Dimensioned)
Sought = TypeVar("Sought")
Found = TypeVar("Found", bound=_Result)
Others = TypeVarTuple("Others")


# Histories end in NaN, and a result that was not found is NaN.
@own_conventions()
def answer(
    search: Callable[[Contact, State, *Others], Sought],
    contact: Contact,
    state: State,
    *others: *Others,
    describe: Callable[[Found], str],
    throw: bool,
    bar: tuple[int, str, bool | None] = (0, "", False),
    differentiable: Callable[[Contact, State, Sought], Found] | None = None,
    has_units: bool = False,
) -> Found:
    """Return the result of a search in the units and on the grid of the user, or raise its failure.

    Arguments:
        search: called with the inputs, as constants in the characteristic pressure.
        contact: the contact, on the grid that it is solved on.
        state: its load or equilibrium there.
        others: more inputs, without dimension of pressure.
        describe: returns the message for a failed result.
        throw: whether to raise a failure.
        bar: the total and the unit of a progress bar, and whether to show it.
        differentiable: returns the result as a differentiable function of contact and state; by
            default an error is raised where derivatives are taken.
        has_units: whether the search converts units itself, within its programs.
    """
    own = contact
    own_state = state
    unit = None
    if not has_units:
        own, own_state, unit = _in_characteristic_units(contact.known_core, contact, state)
    given: Any = own, own_state, others
    given = given if differentiable else refuse_derivatives(given)
    constants: tuple[Contact, State, tuple[*Others]] = jax.lax.stop_gradient(given)
    progress = progress_bar(*bar[:2], shown=bar[2], inputs=constants)
    with progress:
        sought = search(*constants[:2], *constants[2])
    # An interrupt here would lose a long search. Short ones, whose loops it ends, have their units.
    with nullcontext() if has_units else interrupts_held():
        found: Any = differentiable(own, own_state, sought) if differentiable else sought
        found = _in_units_of_user(found, unit, contact.solid)
    return throw_failure(found.result, found, lambda: describe(found), throw)


@partial(program, static_argnums=0)
def _in_characteristic_units(
    has_core: bool | None, contact: Contact, state: State
) -> tuple[Contact, State, Scalar]:
    """Return a contact and its load or state in the characteristic pressure, and that pressure."""
    unit = contact.characteristic_pressure
    return contact.in_units_of(unit, has_core), state.in_units_of(unit), unit


@program
def _in_units_of_user(found: Found, unit: Scalar | None, solid: Solid) -> Found:
    """Return a result in the units and on the grid of the user."""
    found = found if unit is None else found.in_units_of(1 / unit)
    return found.on_surface(solid)

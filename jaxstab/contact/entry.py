"""The steps around a search that the entry points share."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol, Self, TypeVar

import jax
from jaxtyping import PyTree

from jaxstab.contact.contact import Contact
from jaxstab.core.checks import is_traced
from jaxstab.core.progress import Bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.types import Scalar
from jaxstab.core.units import Dimensioned
from jaxstab.solids import Solid


class _Result(Protocol):
    @property
    def result(self) -> RESULTS: ...
    def in_units_of(self, pressure: Scalar) -> Self: ...
    def on_surface(self, solid: Solid) -> Self: ...


Found = TypeVar("Found", bound=_Result)


def answer(
    search: Callable[..., Found],
    contact: Contact,
    state: Dimensioned,
    *others: PyTree,
    bar: AbstractContextManager[Bar],
    derivatives: Callable[..., Found] | None,
    describe: Callable[[Found], str],
    throw: bool,
    has_units: bool = False,
) -> Found:
    """Return the result of a search in the units and on the grid of the user, or raise its failure.

    Arguments:
        search: called with the bar and the inputs, constants in the contact's own unit of pressure.
        contact: the contact, on the grid that it is solved on.
        state: its load or equilibrium there. By these two a result can be differentiated.
        others: more inputs, without dimension of pressure.
        bar: the progress bar.
        derivatives: attaches them, given contact, state and result; None where there are none.
        describe: says what has failed.
        throw: whether to raise a failure.
        has_units: whether the search converts units itself, within its programs.
    """
    own, unit = (contact, None) if has_units else contact.in_own_units()
    inputs = own, state if unit is None else state.in_units_of(unit), *others
    # Histories end in NaN, and a result that was not found is NaN.
    with jax.debug_nans(False), bar as shown:
        found = search(shown, *jax.lax.stop_gradient(inputs))
    if derivatives is not None and is_traced(inputs[:2]):
        found = derivatives(*inputs[:2], found)
    if unit is not None:
        found = found.in_units_of(1 / unit)
    found = found.on_surface(contact.solid)
    return throw_failure(found.result, found, lambda: describe(found), throw)

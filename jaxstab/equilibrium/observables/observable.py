"""Observables: results computed from a state, whose numbers stand beside its own."""

from dataclasses import fields, replace
from typing import ClassVar, Self

import equinox as eqx

from jaxstab.core.display import Outcome
from jaxstab.core.units import NO_UNITS, Units, axes_of


class Observable(Outcome):
    """The result of an observable, a function of a contact and a state.

    A subclass declares the fields, each with its dimension. Fields of one number, or of one for
    each side of the grid, are columns along a path (`jaxstab.observe`). In figures and files they
    have the name and the dimension of the field.

        class Dissipated(js.results.Observable):
            power: Annotated[Float[Array, ""], Dimension("energy/time")]

    Attributes:
        shown: the columns that a printed table has, by default all.
        units: the units of length and of pressure, None where unknown.

    Example:
        >>> from typing import Annotated
        >>> class Depth(js.results.Observable):
        ...     depth: Annotated[jax.Array, js.Dimension("length")]
        >>> def depth(contact, state):
        ...     return Depth(jnp.max(state.gap), units=contact.units)
        >>> f"{depth(contact, state).depth:.2f}"
        '0.21'
    """

    shown: ClassVar[tuple[str, ...]] = ()

    units: Units = eqx.field(static=True, default=NO_UNITS, repr=False, kw_only=True)

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """Return the names of the fields that are columns along a path."""
        axes = axes_of(cls)
        return tuple(name for name, sides in axes.items() if {*sides} <= {"sides"})

    def row(self) -> Self:
        """Return the columns alone: fields on the grid, and of a number that varies, are None."""
        others = {field.name for field in fields(self)} - {*self.columns(), "units"}
        return replace(self, **dict.fromkeys(others))

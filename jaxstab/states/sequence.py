"""Recorded states in order, along a branch or a load path."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.contact import Contact
from jaxstab.core.checks import is_readable
from jaxstab.core.display import Outcome, several
from jaxstab.core.stack import first_entries
from jaxstab.core.units import (
    AREA,
    ENERGY,
    LENGTH,
    NO_UNITS,
    NUMBER,
    PRESSURE,
    Dimensioned,
    Units,
)
from jaxstab.equilibrium.equilibrium import PressedSurface
from jaxstab.loads import Load

Part = TypeVar("Part")


class PathInterrupted(UserWarning):
    """A path was interrupted; it holds the states so far.

    Example:
        A script that is not to go on with part of a path makes an error of it:

        >>> import warnings
        >>> with warnings.catch_warnings(action="error", category=js.exceptions.PathInterrupted):
        ...     path = js.follow(contact, js.MeanGap([0.3, 0.03, 0.3]))
        >>> f"{path[-1].load.value:.1f}"
        '0.3'
    """


class States(PressedSurface):
    """The recorded states of a path, in order.

    Attributes:
        mean_gap: mean(g) [length].
        mean_pressure: p0, positive in compression [pressure].
        contact_area: the number of contact points over the number of all points.
        area: the area of the cell [length^2]; on a line its length [length].
        energy: elastic and adhesive energy of the surface [energy].
        work: done up to here on surface and spring by the load: the change of their energy, the
            loss in the jumps, and the plastic work [energy].
        dissipation: energy lost in the jumps up to here [energy].
        gap: g, None without `fields` [length].
        units: the units of length and of pressure, None where unknown.
        is_window: whether the surface is a window, pressed by a force, and not repeated.
        indentation: z, of the surface with which the path began, None without `fields` or if
            nothing yields [length].
        plastic_work: that it took since the first state; None if nothing yields [energy].

    Example:
        >>> path = js.follow(contact, js.MeanGap([0.3, 0.03, 0.3]), fields=True)
        >>> f"{path.equilibrium.contact_area.max():.3f}"
        '0.516'
    """

    mean_gap: Annotated[Float[Array, "*states"], LENGTH]
    mean_pressure: Annotated[Float[Array, "*states"], PRESSURE]
    contact_area: Annotated[Float[Array, "*states"], NUMBER]
    area: Annotated[Float[Array, "*states"], AREA]
    energy: Annotated[Float[Array, "*states"], ENERGY]
    work: Annotated[Float[Array, "*states"], ENERGY]
    dissipation: Annotated[Float[Array, "*states"], ENERGY]
    gap: Annotated[Float[Array, " *states_and_grid"], LENGTH] | None
    units: Units = eqx.field(static=True, default=NO_UNITS, repr=False)
    is_window: bool = eqx.field(static=True, default=False, repr=False)
    indentation: Annotated[Float[Array, " *states_and_grid"], LENGTH] | None = None
    plastic_work: Annotated[Float[Array, "*states"], ENERGY] | None = None

    @classmethod
    def of(cls, contact: Contact, energy: Float[Array, "*states"], **fields: Any) -> "States":
        """Return states of a contact, which gives area and units."""
        return cls(
            energy=energy,
            area=jnp.broadcast_to(contact.area, energy.shape),
            units=contact.units,
            is_window=contact.solid.is_window,
            **fields,
        )


class PathState(Outcome):
    """A recorded state of a path, or several: `path[-1]`, `path[3:5]`.

    A state with a gap can start further equilibria and paths, as `initial=`.

    Attributes:
        load: its load.
        equilibrium: the state.

    Example:
        >>> path = js.follow(contact, js.MeanGap([0.3, 0.03, 0.3]), fields=True)
        >>> f"{path[-1].load.value:.1f}"
        '0.3'
    """

    load: Load
    equilibrium: States

    @property
    def indentation(self) -> Array | None:
        """The indentation of the surface with which the path began [length], if it is known."""
        return self.equilibrium.indentation


class StateSequence(Dimensioned):
    """States in order: `path[3]` is one of them, `path[3:5]` are several, `len(path)` all.

    In a batch, as after `jax.vmap`, `batch[3]` is the fourth path, without empty entries.

    Attributes:
        load: the loads of the recorded states.
        equilibrium: these states.
    """

    load: Load
    equilibrium: States
    # The fields with an axis of states, and the one of events along it.
    _of_states: ClassVar[tuple[str, ...]] = ("load", "equilibrium")
    _of_events: ClassVar[str]

    def __len__(self) -> int:
        return len(self.load)

    def __getitem__(self, index: Any) -> PathState | Self:
        if self.load.value.ndim > 1:
            entry = np.arange(len(self))[index]
            return jax.tree.map(lambda leaf: leaf[entry], self).recorded
        return PathState(self.load[index], self.equilibrium[index])

    @property
    def recorded(self) -> Self:
        """The same without empty entries, in which the loads are NaN.

        The arrays of a result of `jax.jit` have room for more states and events than there are:
        `jax.jit(f)(x).recorded` has as many as there are. In a trace, and of several at once, it is
        the result as it is.
        """
        if self.load.value.ndim != 1 or not is_readable(self):
            return self
        events = getattr(self, self._of_events)
        parts = {name: (getattr(self, name), self.load) for name in self._of_states}
        parts[self._of_events] = events, events.load
        return replace(
            self,
            **{
                name: first_entries(part, int(np.isfinite(load.value).sum()))
                for name, (part, load) in parts.items()
            },
        )

    def __iter__(self) -> Iterator[PathState | Self]:
        return (self[i] for i in range(len(self)))

    @property
    def _extent(self) -> str:
        """The first and the last load and the number of states, in words."""
        loads = np.asarray(self.load.value)
        units = self.equilibrium.units
        first, last = (units.text(loads[i], self.load.unit, digits=6) for i in (0, -1))
        return f"{type(self.load).__name__} {first} to {last} in {several(loads.size, 'state')}"

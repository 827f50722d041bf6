"""Observables beside the states of a path or a sweep."""

from collections.abc import Callable
from typing import Annotated, Any, Literal

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxstab.contact import Contact, require_contact
from jaxstab.core import display
from jaxstab.core.checks import is_traced
from jaxstab.core.stack import Stackable, nothing_like, stacked
from jaxstab.core.types import ArrayLike
from jaxstab.core.units import AREA, LENGTH, NUMBER, SPRING_CONSTANT, VISCOSITY, VOLUME, Dimensioned
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.observables.clusters import Neighbours
from jaxstab.equilibrium.observables.conductance import CONDUCTANCE, conductance_at
from jaxstab.equilibrium.observables.flow import Solver
from jaxstab.equilibrium.observables.leakage import leakage_at
from jaxstab.equilibrium.observables.patches import patches_at, require_known
from jaxstab.loads import Load
from jaxstab.paths.curve.branch import Branch
from jaxstab.paths.path import Path, States
from jaxstab.paths.sweep import Sweep

Name = Literal["patches", "conductance", "leakage"]


class PatchNumbers(Stackable, Dimensioned):
    """What `jaxstab.patches` says of each state, in numbers.

    Attributes:
        number: how many patches there are.
        area: that of all points in contact [length^2]; on a line a length.
        true_area: the same corrected for the grid [length^2].
        largest: that of the largest patch [length^2].
        perimeter: the length of the whole interface, along the sides of points [length].
        percolates: for each side, whether a patch goes on along it without end.
    """

    number: Int[Array, "*states"]
    area: Annotated[Float[Array, "*states"], AREA]
    true_area: Annotated[Float[Array, "*states"], AREA]
    largest: Annotated[Float[Array, "*states"], AREA]
    perimeter: Annotated[Float[Array, "*states"], LENGTH]
    percolates: Bool[Array, "*states sides"]

    __repr__ = display.block


class ConductanceNumbers(Stackable, Dimensioned):
    """What `jaxstab.conductance` says of each state, in numbers.

    Attributes:
        conductance: C [length/resistivity].
        incremental_stiffness: the force over a small approach with the contact points held
            [force/length].
    """

    conductance: Annotated[Float[Array, "*states"], CONDUCTANCE]
    incremental_stiffness: Annotated[Float[Array, "*states"], SPRING_CONSTANT]

    __repr__ = display.block


class LeakageNumbers(Stackable, Dimensioned):
    """What `jaxstab.leakage` says of each state, in numbers.

    Attributes:
        permeability: k, a tensor [length^3].
        viscosity: that given [pressure time].
    """

    permeability: Annotated[Float[Array, "*states sides sides"], VOLUME]
    viscosity: Annotated[Float[Array, "*states"], VISCOSITY]

    __repr__ = display.block


class Observed(Stackable, Dimensioned):
    """The states of a path or a sweep, and observables beside them; all have an axis of states.

    Attributes:
        load: the loads.
        equilibrium: the states.
        patches: their patches, None unless asked for.
        conductance: their conductance, None unless asked for.
        leakage: what leaks through them, None unless asked for.
    """

    load: Load
    equilibrium: States | Equilibrium
    patches: PatchNumbers | None
    conductance: ConductanceNumbers | None
    leakage: LeakageNumbers | None

    def __repr__(self) -> str:
        try:
            return display.table(_columns(self))
        except display.UNREADABLE:
            return display.block(self)


def observe(
    states: Path | Branch | Sweep | Equilibrium,
    *names: Name,
    contact: Contact | None = None,
    resistivities: tuple[ArrayLike, ArrayLike] = (0.5, 0.5),
    viscosity: ArrayLike = 1.0,
    neighbours: Neighbours = 4,
    solver: Solver | None = None,
) -> Observed:
    """Return observables beside the states of a path or a sweep.

        observed = js.observe(path, "patches", "conductance", contact=contact)
        observed.patches.number, observed.conductance.conductance

    They are computed one state after another, outside of JAX transformations. Of states that were
    not found numbers are NaN, and there are no patches. `jaxstab.save` writes them with the states.

    Arguments:
        states: what `follow` or `continuation`, with `fields=True`, or `sweep` returned; or a stack
            of equilibria.
        names: "patches", "conductance", "leakage".
        contact: the contact of these states, which they do not hold.
        resistivities: as in `jaxstab.conductance`; by default they add up to one.
        viscosity: as in `jaxstab.leakage`.
        neighbours: as in `jaxstab.patches`.
        solver: as in `jaxstab.leakage`.

    Raises:
        TypeError: for states of another kind, without a contact, and as the observables.
        ValueError: for a path without gaps, a name that does not exist or none, a single state,
            states of another grid, and as the observables.
        SolverError: as the observables.
    """
    if not isinstance(states, Path | Branch | Sweep | Equilibrium):
        raise TypeError(
            f"{type(states).__name__} has no states to observe: give what jaxstab.follow or "
            "jaxstab.sweep returned, then the names, and the contact as `contact=`."
        )
    if contact is None:
        raise TypeError(
            f"A {type(states).__name__} does not hold its contact: give it too, as in "
            'jaxstab.observe(path, "patches", contact=contact).'
        )
    require_contact(contact)
    require_known((states, contact), "observe")
    settings: dict[str, Callable[[Any], Any]] = {
        "patches": lambda gap: _patch_numbers(contact, gap, neighbours),
        "conductance": lambda gap: _conductance_numbers(contact, gap, resistivities),
        "leakage": lambda gap: _leakage_numbers(contact, gap, viscosity, solver),
    }
    unknown = [name for name in names if name not in settings]
    if unknown or not names:
        given = repr(unknown[0]) if unknown else "missing"
        raise ValueError(f"The name of an observable is {given}: choose of {', '.join(settings)}.")
    equilibrium = states if isinstance(states, Equilibrium) else states.equilibrium
    gaps = _gaps(contact, equilibrium)
    columns = {name: _column(settings[name], gaps) for name in names}
    return Observed(
        load=states.load,
        equilibrium=equilibrium,
        patches=columns.get("patches"),
        conductance=columns.get("conductance"),
        leakage=columns.get("leakage"),
    )


def _gaps(contact: Contact, equilibrium: States | Equilibrium) -> np.ndarray:
    if equilibrium.gap is None:
        raise ValueError(
            "The path kept no gaps, and observables are computed from these: follow it again with "
            "fields=True, as in jaxstab.follow(contact, load, fields=True)."
        )
    gaps = np.asarray(equilibrium.gap)
    shape = contact.grid.shape
    if gaps.ndim != len(shape) + 1 or gaps.shape[1:] != shape:
        raise ValueError(
            f"The states have gaps of shape {gaps.shape}, the contact's grid is {shape}: give "
            "several states in one row, and the contact that they came from."
        )
    if not len(gaps):
        raise ValueError("There are no states to observe: the path or the sweep is empty.")
    return gaps


def _column(observable: Callable[[Any], Any], gaps: np.ndarray) -> Any:
    rows = []
    for gap in gaps:
        is_found = np.isfinite(gap).all()
        # The numbers of a state not found have the shapes that those of any gap have.
        row = observable(gap if is_found else np.ones_like(gap))
        rows.append(row if is_found else jax.tree.map(nothing_like, row))
    return stacked(rows, rows[0])


def _patch_numbers(contact: Contact, gap: Any, neighbours: Neighbours) -> PatchNumbers:
    found = patches_at(contact, gap == 0, np.zeros_like(gap), neighbours)
    return PatchNumbers(
        number=found.number,
        area=found.area,
        true_area=found.true_area,
        largest=found.largest,
        perimeter=found.perimeter,
        percolates=found.percolates,
    )


def _conductance_numbers(
    contact: Contact, gap: Any, resistivities: tuple[ArrayLike, ArrayLike]
) -> ConductanceNumbers:
    found = conductance_at(contact, jax.device_put(gap == 0), resistivities)
    return ConductanceNumbers(found.conductance, found.incremental_stiffness)


def _leakage_numbers(
    contact: Contact, gap: Any, viscosity: ArrayLike, solver: Solver | None
) -> LeakageNumbers:
    found = leakage_at(contact, gap, viscosity, solver)
    return LeakageNumbers(found.permeability, found.viscosity)


def _columns(observed: Observed) -> dict[str, list[str]]:
    if is_traced(observed):
        raise TypeError("What JAX is tracing has no numbers yet.")
    units = observed.equilibrium.units
    columns = display.load_column(observed.load, units, ".6g")

    def add(name: str, values: Any, dimension: str) -> None:
        columns.update(display.measured_column(name, values, units, dimension, ".6g"))

    add("contact area", observed.equilibrium.contact_area, NUMBER)
    if observed.patches is not None:
        add("patches", observed.patches.number, NUMBER)
        add("true area", observed.patches.true_area, AREA)
    if observed.conductance is not None:
        add("conductance", observed.conductance.conductance, CONDUCTANCE)
    if observed.leakage is not None:
        permeability = observed.leakage.permeability
        for i, side in enumerate("xy"[: permeability.shape[-1]]):
            add(f"permeability {side}", permeability[..., i, i], VOLUME)
    return columns

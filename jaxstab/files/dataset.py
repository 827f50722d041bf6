"""Results as labelled data sets of xarray."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import PyTree

from jaxstab.branches import Branch, CriticalLoad
from jaxstab.contact import Contact, require_contact, require_same_contact
from jaxstab.core.checks import require_known, require_shape
from jaxstab.core.display import text
from jaxstab.core.optional_packages import require_packages, versions
from jaxstab.core.results import RESULTS
from jaxstab.core.units import LENGTH, unit_symbol
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.verify import verify
from jaxstab.evolution import Evolution
from jaxstab.evolution.evolution import OF_RUN
from jaxstab.files.records import NamedArray, Recorder, Structure
from jaxstab.files.tabulated_law import law_variables
from jaxstab.loading import Path
from jaxstab.loading.sweep import Sweep
from jaxstab.loads import Load
from jaxstab.observation import Observed
from jaxstab.stability import Stability
from jaxstab.transitions import Detachment, Transition

# Xarray is imported where it is used, since its import is slow.
if TYPE_CHECKING:
    import xarray

# Dimensions, values and attributes.
DataVariable = tuple[Sequence[str], np.ndarray, dict[str, str]]
Result = (
    Equilibrium
    | Stability
    | Sweep
    | Path
    | CriticalLoad
    | Branch
    | Evolution
    | Transition
    | Detachment
    | Observed
)

# The number of the format, to be raised when this version could not read files of the next.
FORMAT = 4
# The order of a material's moduli in a coated half space.
_MODULI = ("youngs_modulus", "poisson_ratio")
# The long names of fields whose own names do not explain them.
_NAMES = {
    "attempt_rate": "attempt rate of thermal motion",
    "back": "energy of the saddle above the end",
    "barriers": "barrier to detached surfaces",
    "bound": "proved lower bound of the smallest eigenvalue",
    "complementarity": "least reaction over the rms pressure",
    "contact_area": "number of contact points over the number of all points",
    "datum": "height that heights count from",
    "dielectric": "thickness of the dielectric over its relative permittivity",
    "viscous_dissipation": "energy dissipated in the solid",
    "end": "end of the branch",
    "energies": "energy of the images and the load, above the start",
    "errors": "error of the barriers since the load before",
    "factor": "factor of the law",
    "images": "gap along the string",
    "is_direct": "whether each pass leads straight to detached surfaces",
    "hardness": "largest pressure that the surface bears",
    "indentation": "depth of the plastic indentation",
    "incremental_stiffness": "force over a small approach",
    "index": "number of negative eigenvalues on the free points",
    "largest_compression": "largest mean pressure at the end of any step",
    "largest_tension": "largest tension at the end of any step",
    "length": "range",
    "loads": "mean pressure, positive in compression",
    "jump_dissipation": "energy lost in jumps",
    "mean_pressure": "mean pressure, positive in compression",
    "mode": "mode of unit norm",
    "num_applications": "applications of the Hessian",
    "num_passes": "loads at which the pass was computed",
    "poisson_ratio": "Poisson's ratio",
    "pressure": "elastic pressure, positive in compression",
    "rate": "rate of the tension",
    "ratios": "moduli of the branches over the relaxed one",
    "reached": "time of the last state found",
    "residual": "relative residual",
    "stored": "energy stored, above the start",
    "strains": "displacement of each spring, first relative to the far side",
    "surface_energy": "work of adhesion",
    "there": "energy of the saddle above the start",
    "true_area": "area corrected for the grid",
    "youngs_modulus": "Young's modulus",
}
_STATES = {"load": ("state",), "equilibrium": ("state",)}
_OWN_AXES: Mapping[type, Mapping[str, tuple[str, ...]]] = {
    Path: {**_STATES, "jumps": ("jump",)},
    Branch: {**_STATES, "index": ("state",), "turns": ("turn",)},
    Evolution: dict.fromkeys(OF_RUN, ()) | dict.fromkeys(("jump_times", "jump_losses"), ("jump",)),
    Detachment: dict.fromkeys(("loads", "barriers", "errors"), ("load",)),
    Transition: {"minima": ("minimum",), "images": ("image",), "energies": ("image",)},
}


def to_dataset(contact: Contact, result: Result, *, fields: bool = True) -> xarray.Dataset:
    """Return a result as a data set with named dimensions, coordinates, units and long names.

    Fields have the dimensions x and y. The states of a sweep have the dimension `load`, the states
    of a path or a branch `state`, jumps `jump`, turns `turn`, images of a transition `image`, the
    minima beside its saddle `minimum`, and the barriers of a detachment `load`. Beside the result
    the data set holds every parameter of contact, law and solid, the law at many gaps, and the
    versions of the packages.

    Arguments:
        contact: the contact problem.
        result: a result of `equilibrate`, `assess_stability`, `sweep`, `follow`, `pull_off`,
            `critical_load`, `continuation`, `transition`, `detachment`, `evolve` or `observe` for
            it.
        fields: whether to keep the fields and histories, without which `jaxstab.load` cannot give
            the result back.

    Returns:
        The data set, in the units of the contact; plain numbers have the unit "1".

    Raises:
        ImportError: without xarray.
        TypeError: for something that is not a result, or is traced.
        ValueError: for a result on another grid, or several paths or branches at once.

    Example:
        >>> f"{js.to_dataset(contact, state).mean_pressure.item():.4f}"
        '-0.1768'
    """
    require_packages("Labelled data sets", "data", "xarray")
    import xarray

    require_contact(contact)
    holder: Any = result
    alone = result
    if isinstance(result, Transition):
        # It is known by the state that it starts from.
        holder = result.start
    elif isinstance(result, Detachment):
        holder = result.pull_off
    elif isinstance(result, Evolution):
        # Its contact is written once.
        alone = replace(result, contact=None)
    elif isinstance(result, Path):
        # The surface that is left follows from its indentation.
        alone = replace(result.recorded, contact=None)
    elif isinstance(result, Branch):
        alone = result.recorded
    states = getattr(holder, "equilibrium", holder)
    load = getattr(holder, "load", None)
    axes = _axes(contact, result, states)
    require_known((contact, result), "to_dataset")
    _require_own(contact, states)
    recorder = Recorder(contact.grid)
    structure: Structure = {
        "contact": recorder.structure(contact, ("contact",)),
        "result": recorder.structure(alone, (), *axes),
    }
    records = recorder.records
    if not fields:
        # Without the fields of a result it cannot be built again.
        structure = None
        long = {*contact.grid.sides, "record"}
        records = {name: x for name, x in records.items() if not long & set(x.dims)}
    dataset = xarray.Dataset(
        {name: _variable(record, contact, load) for name, record in records.items()},
        attrs=_attributes(contact, result, load, structure),
    )
    return dataset.assign_coords(_coordinates(contact, recorder.indicators, dataset)).assign(
        law_variables(contact)
    )


def _axes(
    contact: Contact, result: Result, states: PyTree
) -> tuple[tuple[str, ...], Mapping[str, tuple[str, ...]]]:
    """Return the names of a result's leading axes, and of fields with other leading axes."""
    if not isinstance(result, Result):
        raise TypeError(
            f"{type(result).__name__} is no result of equilibrate, assess_stability, sweep, "
            "follow, pull_off, critical_load, continuation, transition, detachment, evolve or "
            "observe. If it holds an equilibrium, give that; a state of a path becomes one by "
            "equilibrate(contact, path[i].load, initial=path[i])."
        )
    own = _OWN_AXES.get(type(result), {})
    axes: tuple[str, ...] = ()
    stacked = 0
    if isinstance(result, Evolution):
        if result.is_batch:
            raise ValueError("These are several evolutions: choose one, as evolution[0].")
        require_same_contact(contact, result.contact, "The evolution")
        return ("state",)[: result.times.ndim], own
    if isinstance(result, Path):
        _require_one("paths", result)
        stacked = 1
        field = result.jumps.mode
    elif isinstance(result, Branch):
        _require_one("branches", result)
        stacked = 1
        field = result.turns.mode
    elif isinstance(result, Detachment):
        # A batch of rates has axes of its own.
        field = result.pull_off.gap
    else:
        stacked = len(result.stack_shape)
        last = "load" if isinstance(result, Sweep) else "state"
        axes = (*(f"batch_{i}" for i in range(stacked - 1)), last)[:stacked]
        own = {name: (*axes, *last) for name, last in own.items()}
        field = states.cone.mode if isinstance(states, Stability) else states.gap
    cure = "give the contact that it came from."
    require_shape("A field of the result", np.shape(field)[stacked:], contact.grid.shape, cure)
    return axes, own


def _require_one(kind: str, result: Path | Branch) -> None:
    if result.result.code.ndim:
        raise ValueError(f"These are several {kind}: choose one of them, as {kind}[0].")


def _require_own(contact: Contact, states: PyTree) -> None:
    """Raise `ValueError` if the first or the last state found is no equilibrium of the contact."""
    if not isinstance(states, Equilibrium):
        return
    found = np.flatnonzero(np.ravel(states.result == RESULTS.successful))
    for i in {*found[:1], *found[-1:]}:
        place = np.unravel_index(i, states.stack_shape)
        state = jax.tree.map(itemgetter(place), states)
        if verify(contact, state) != RESULTS.successful:
            raise ValueError(
                "The result is no equilibrium of this contact, which has other heights, another "
                "law or another solid: give the contact that it came from."
            )


def _variable(record: NamedArray, contact: Contact, load: Load | None) -> DataVariable:
    *holders, field = (word for word in record.path if word not in ("table", "contact"))
    dimension = record.dimension
    if field == "value" and holders[-1:] == ["load"] and load is not None:
        name = f"load: {type(load).__name__}"
        dimension = load.unit
    else:
        if holders[-1:] in (["layer"], ["base"]) and field.isdigit():
            field = _MODULI[int(field)]
        name = _NAMES.get(field, field.replace("_", " "))
    if dimension == "load" and load is not None:
        dimension = load.unit
    silent = ("equilibrium", "stability", "observables", "load", "solid", "grid", "potential")
    words = [word.replace("_", " ") for word in holders if word not in silent]
    attributes = {"long_name": ", ".join([*words, name])}
    unit = unit_symbol(contact.units, dimension)
    if unit:
        attributes["units"] = unit
    return record.dims, record.values, attributes


def _coordinates(
    contact: Contact, indicators: dict[str, list[str]], dataset: xarray.Dataset
) -> dict[str, object]:
    grid = contact.grid
    unit = unit_symbol(contact.units, LENGTH)
    coordinates: dict[str, object] = {}
    for axis, (name, places) in enumerate(zip(grid.sides, grid.coordinates, strict=False)):
        if name in dataset.dims:
            places = np.moveaxis(np.asarray(places), axis, -1).reshape(-1, grid.shape[axis])[0]
            coordinates[name] = (name, places, {"long_name": name, "units": unit})
    for name, columns in indicators.items():
        if name in dataset:
            coordinates[f"{name}_indicator"] = (f"{name}_indicator", columns)
    return coordinates


def common_attributes() -> dict[str, object]:
    """Return the versions of the packages, and the number of the format."""
    return {
        "versions": json.dumps(versions() | {"python": platform.python_version()}),
        "format": FORMAT,
    }


def _attributes(
    contact: Contact, result: Result, load: Load | None, structure: Structure
) -> dict[str, object]:
    attributes = {
        "title": f"{type(result).__name__} of an adhesive contact, by jaxstab",
        "solid": text(contact.solid, contact.units),
        "law": text(contact.potential, contact.units),
        **common_attributes(),
    }
    if load is not None:
        attributes["load_kind"] = type(load).__name__
    units = {"unit_of_length": contact.unit, "unit_of_pressure": contact.pressure_unit}
    attributes |= {name: unit for name, unit in units.items() if unit}
    if structure is not None:
        attributes["structure"] = json.dumps(structure)
    return attributes

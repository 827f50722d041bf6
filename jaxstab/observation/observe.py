"""Observables beside the states of a path or a sweep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxstab.branches.branch import Branch
from jaxstab.contact import Contact, require_contact, require_same_contact
from jaxstab.core import display
from jaxstab.core.checks import require_known
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.stack import Stackable, nothing_like, stack_of
from jaxstab.core.types import Field
from jaxstab.core.units import NUMBER, axes_of, dimensions
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrium import state_at
from jaxstab.equilibrium.observables.observable import Observable
from jaxstab.equilibrium.posing import as_given, pose, posed_gap
from jaxstab.evolution.evolution import Evolution
from jaxstab.loading.path import Path
from jaxstab.loading.sweep import Sweep
from jaxstab.loads import Load
from jaxstab.states.columns import load_column, measured_columns
from jaxstab.states.sequence import States


class Observed(Stackable, eqx.Module):
    """The states of a path or a sweep and their observables; all have an axis of states.

    An observable is an attribute, by the name of its function: `observed.patches.number`.

    Attributes:
        load: the loads.
        equilibrium: the states.
        observables: the observables by name, with their columns.

    Example:
        >>> sweep = js.sweep(contact, js.MeanGap([0.03, 0.05]))
        >>> observed = js.observe(contact, sweep, js.patches)
        >>> [f"{a:.3f}" for a in observed.patches.area]
        ['0.516', '0.324']
    """

    load: Load
    equilibrium: States | Equilibrium
    observables: dict[str, Observable]

    def __getattr__(self, name: str) -> Any:
        found = vars(self).get("observables", {})
        if name not in found:
            raise AttributeError(f"Observed has no {name}: it holds {', '.join(found)}.")
        return found[name]

    @display.readable
    def __repr__(self) -> str:
        return display.table(_table(self))


def observe(
    contact: Contact,
    states: Path | Branch | Evolution | Sweep | Equilibrium,
    *observables: Callable[[Contact, Equilibrium], Observable],
) -> Observed:
    """Return observables for all states of a path or a sweep.

        observed = js.observe(contact, path, js.patches, js.conductance)
        observed.patches.number, observed.conductance.conductance

    An observable is a built-in or user-defined function of a contact and an equilibrium that
    returns an `Observable`. Give settings by `functools.partial`, as in `partial(js.leakage,
    viscosity=1e-3)`. States are evaluated one after another, outside JAX transformations. For
    states that were not found numbers are NaN, and there are no patches. `jaxstab.plots.observed`
    draws a column, and `jaxstab.save` writes them with the states.

    Arguments:
        contact: the contact of these states.
        states: the result of `follow`, `continuation` or `evolve`, with `fields=True`, or of
            `sweep`; or a stack of equilibria. A state of a viscoelastic contact has the pressures
            at its time, and the stiffness of the relaxed solid.
        observables: the functions: `jaxstab.patches`, `jaxstab.conductance`, `jaxstab.leakage`.

    Raises:
        TypeError: for states of another kind, an observable that is no function or returns no
            `Observable`, and as the observables.
        ValueError: for a path without gaps, an observable with a name of another one or of the
            result's own fields, a column of another shape than it declares, no state that was
            found, a single state, states of another grid, and as the observables.
        SolverError: as the observables.

    Example:
        >>> sweep = js.sweep(contact, js.MeanGap([0.03, 0.05]))
        >>> [f"{a:.3f}" for a in js.observe(contact, sweep, js.patches).patches.area]
        ['0.516', '0.324']
    """
    require_contact(contact)
    if not isinstance(states, Path | Branch | Evolution | Sweep | Equilibrium):
        raise TypeError(
            f"{type(states).__name__} has no states to observe: give the result of jaxstab.follow "
            "or jaxstab.sweep, as in jaxstab.observe(contact, path, jaxstab.patches)."
        )
    wrong = [repr(x) for x in observables if not callable(x)] or ["missing"] * (not observables)
    if wrong:
        raise TypeError(f"The observable is {wrong[0]}: give functions, as jaxstab.patches.")
    names = [_name(observable) for observable in observables]
    if len({*names}) < len(names):
        raise ValueError(
            f"The observables are named {', '.join(names)}: names must differ. Observe them in "
            "separate calls, or write a function with a name of its own."
        )
    # Files keep the table of the law by this name.
    own = sorted({"law", *(field.name for field in fields(Observed))} & {*names})
    if own:
        raise ValueError(f"{own[0]} is a name of the result itself: rename the observable.")
    if isinstance(states, Evolution):
        require_same_contact(contact, states.contact, "The evolution")
    require_known((states, contact), "observe")
    if isinstance(states, Path | Branch):
        states = states.recorded
    equilibrium: Any = states
    if not isinstance(states, Equilibrium):
        equilibrium = states.equilibrium
    gaps = _gaps(contact, equilibrium)
    are_found = [bool(np.isfinite(gap).all()) for gap in gaps]
    if not any(are_found):
        raise ValueError("No state was found, so that there is nothing to observe.")
    found: dict[str, list[Observable]] = {name: [] for name in names}
    for i in np.flatnonzero(are_found):
        state = equilibrium[i]
        if isinstance(states, Evolution):
            moved, state = states[i].instant
            state = state.on_surface(moved.solid)
        elif not isinstance(state, Equilibrium):
            state = _equilibrium_at(contact, states.load[i], gaps[i])
        for name, observable in zip(names, observables, strict=True):
            found[name].append(_row(observable, contact, state))
    columns = {name: _with_empty_rows(rows, are_found) for name, rows in found.items()}
    return Observed(states.load, equilibrium, columns)


def _name(observable: Callable[..., Any]) -> str:
    function = observable
    if isinstance(observable, partial):
        function = observable.func
    return getattr(function, "__name__", type(function).__name__)


def _gaps(contact: Contact, equilibrium: States | Equilibrium) -> np.ndarray:
    if equilibrium.gap is None:
        raise ValueError(
            "The path kept no gaps, and observables are computed from these: compute it again with "
            "fields=True, as in jaxstab.follow(contact, load, fields=True)."
        )
    gaps = np.asarray(equilibrium.gap)
    shape = contact.grid.shape
    if gaps.ndim != len(shape) + 1 or gaps.shape[1:] != shape:
        raise ValueError(
            f"The states have gaps of shape {gaps.shape}, the contact's grid is {shape}: give "
            "several states in one row, and the contact that they came from. For a single state "
            "call the observable itself, as jaxstab.patches(contact, state)."
        )
    return gaps


def _equilibrium_at(contact: Contact, load: Load, gap: np.ndarray) -> Equilibrium:
    problem = pose(contact, load)
    start = posed_gap(problem.contact, problem.load, jax.device_put(gap))
    return as_given(state_at(problem.contact, problem.load, start), problem)


def _row(observable: Callable[..., Any], contact: Contact, state: Equilibrium) -> Observable:
    result = observable(contact, state)
    if not isinstance(result, Observable):
        raise TypeError(
            f"{_name(observable)} returned a {type(result).__name__}: return a subclass of "
            "jaxstab.results.Observable, which declares the columns."
        )
    # Numbers of Python have no precision of their own.
    row = jax.tree.map(jnp.asarray, result.row())
    kind = type(result)
    axes = axes_of(kind)
    sides = len(contact.grid.shape)
    declared = "declare a column as Float[Array, ''], or for each side as Float[Array, 'sides']."
    for name in [field.name for field in fields(kind) if not field.metadata.get("static")]:
        if name not in axes:
            raise TypeError(f"{name} of {kind.__name__} is declared as no array: {declared}")
        found = getattr(row, name)
        expected = (sides,) * len(axes[name])
        if name in kind.columns() and getattr(found, "shape", None) != expected:
            raise ValueError(
                f"{name} of {kind.__name__} is {display.text(found)}, not of shape {expected}: "
                f"{declared}"
            )
    return row


@program
def _nothing_like(row: Observable) -> Observable:
    return jax.tree.map(nothing_like, row)


@own_conventions()
def _with_empty_rows(rows: list[Observable], are_found: list[bool]) -> Observable:
    """Return the rows of the states that were found, and of the others nothing."""
    filled = [_nothing_like(rows[0])] * len(are_found)
    for place, row in zip(np.flatnonzero(are_found), rows, strict=True):
        filled[place] = row
    return stack_of(filled, rows[0])


def _table(observed: Observed) -> dict[str, list[str]]:
    units = observed.equilibrium.units
    columns = load_column(observed.load, units, ".6g")

    def add(name: str, values: Field, dimension: str) -> None:
        columns.update(measured_columns({name: values}, units, dimension, ".6g"))

    add("contact area", observed.equilibrium.contact_area, NUMBER)
    for key, result in observed.observables.items():
        for field in result.shown or result.columns():
            name = field.replace("_", " ")
            if field == "number":
                name = key
            for suffix, values in by_side(getattr(result, field)):
                add(name + suffix, values, dimensions(type(result)).get(field, NUMBER))
    return columns


def by_side(values: Field) -> list[tuple[str, Field]]:
    """Return a column, or one for each side with its name: of a tensor the diagonal."""
    if values.ndim < 2:
        return [("", values)]
    sides = range(values.shape[-1])
    return [(f" {'xy'[i]}", values[(..., *(i,) * (values.ndim - 1))]) for i in sides]

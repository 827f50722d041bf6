"""Equilibrium and stability at many loads: each from the same start, or from the one before."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from jaxstab.contact import Contact, require_contact
from jaxstab.contact.resolution import FOR_STATES, warned_once
from jaxstab.core import display
from jaxstab.core.checks import concrete, is_transformed, require_key, require_one_of
from jaxstab.core.compile import program
from jaxstab.core.control_flow import cond
from jaxstab.core.display import column
from jaxstab.core.equality import Comparable
from jaxstab.core.interrupts import early_ends
from jaxstab.core.loop import solver_or_default
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.stack import Stackable, first_entries, stack_of
from jaxstab.core.types import Field, Flag
from jaxstab.core.units import STIFFNESS
from jaxstab.core.warn import warn
from jaxstab.equilibrium import (
    Equilibrium,
    EquilibriumSolver,
    PreconditionedConjugateGradient,
)
from jaxstab.equilibrium.equilibrate import equilibrium_from
from jaxstab.equilibrium.posing import pose, posed_gap
from jaxstab.equilibrium.start import Initial, given_gap, initial_of_path, start_of
from jaxstab.loads import Load, require_load
from jaxstab.stability import ConeSolver, ProjectedLOBPCG, Stability, assess_stability
from jaxstab.states.columns import load_column, measured_columns, state_columns

Order = Literal["independent", "continuation"]


class SweepInterrupted(UserWarning):
    """A sweep was interrupted; it holds the loads done so far.

    Example:
        A script that is not to go on with part of the loads makes an error of it:

        >>> import warnings
        >>> with warnings.catch_warnings(action="error", category=js.exceptions.SweepInterrupted):
        ...     sweep = js.sweep(contact, js.MeanGap([0.05, 0.1]))
        >>> len(sweep)
        2
    """


class Sweep(Stackable, Comparable):
    """Equilibria at many loads and their stability; every field has a leading axis of loads.

    `sweep[3]` is one state, without that axis; `len(sweep)`, slices and loops work as in a list.

    Attributes:
        load: the loads.
        equilibrium: the equilibrium at each load.
        stability: the stability of each, or None where the sweep left it out.

    Example:
        >>> sweep = js.sweep(contact, js.MeanGap([0.05, 0.1]))
        >>> len(sweep), f"{sweep[1].equilibrium.contact_area:.3f}"
        (2, '0.090')
    """

    load: Load
    equilibrium: Equilibrium
    stability: Stability | None

    @display.readable
    def __repr__(self) -> str:
        return display.table(_columns(self))


def sweep(
    contact: Contact,
    load: Load,
    *,
    order: Order = "independent",
    equilibrium_solver: EquilibriumSolver | None = None,
    stability: bool = True,
    stability_solver: ConeSolver | None = None,
    initial: Initial = None,
    key: PRNGKeyArray | None = None,
    progress: bool | None = None,
    throw: bool = False,
) -> Sweep:
    """Return the equilibrium and its stability at each of many loads.

    `equilibrate` and `assess_stability` return the same for each load, by the same compiled
    programs. Only inside `jax.jit`, `jax.vmap` and `jax.grad`, and for independent loads on an
    accelerator, are all loads one program, which can neither be interrupted nor show progress.

    Ctrl-C ends a sweep after the load that is being solved, and returns the loads done so far.

    Arguments:
        contact: the contact problem.
        load: a load that holds a one-dimensional array of values.
        order: "independent" solves each load from the same start; "continuation" each from the
            last equilibrium found (Rey & Bleyer, section 4.2.3). Surfaces that a tension has
            pulled apart stay so, `pulled_off`, until there is a pressure.
        equilibrium_solver: the algorithm for equilibria, by default the one of `equilibrate`.
        stability: whether to assess the equilibria too.
        stability_solver: the algorithm for the cone, as in `assess_stability`.
        initial: where to start, as in `equilibrate`.
        key: the random key of the eigensolvers' starts, as in `assess_stability`.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        throw: raise if any load fails; otherwise each load carries its own `result`, and one that
            fails leaves the others as they would have been.

    Each load acts on the surface as the contact has it: one that yields, with a hardness, does not
    remember the load before, also in the order "continuation". `follow` remembers.

    Returns:
        The results, stacked along a leading axis of loads.

    Raises:
        ValueError: for a single load or none, an order that does not exist, or an initial gap that
            is invalid in `equilibrate`.
        TypeError: for something that is not a load, or not a solver of its kind.
        SolverError: if `throw` and a load failed.
        KeyboardInterrupt: if interrupted before the first load was done.

    Example:
        >>> sweep = js.sweep(contact, js.MeanGap([0.05, 0.1]))
        >>> [f"{p:.4f}" for p in sweep.equilibrium.mean_pressure]
        ['-0.1768', '-0.1244']
        >>> print(sweep[1].stability.verdict)
        held_by_contact
    """
    require_contact(contact)
    require_load(load)
    if load.value.ndim != 1 or load.value.size == 0:
        raise ValueError(
            f"sweep takes a one-dimensional array of loads, but {type(load).__name__} holds one "
            f"of shape {load.value.shape}: use jaxstab.equilibrate for a single load, "
            "and jax.vmap for several sweeps."
        )
    require_one_of("order", order, Order.__args__)
    equilibrium_solver = solver_or_default(
        equilibrium_solver, EquilibriumSolver, PreconditionedConjugateGradient
    )
    stability_solver = solver_or_default(stability_solver, ConeSolver, ProjectedLOBPCG)
    load.warn_if_soft(contact.solid)
    if order == "continuation":
        initial = initial_of_path(contact, load[0], initial)
    begin = _Last.of(contact, load, initial)
    if key is not None:
        require_key(key)
    problem = _SweepProblem(contact, equilibrium_solver, stability_solver, key, order, stability)
    if is_transformed((problem, load, begin)):
        with warned_once(contact, FOR_STATES):
            if order == "independent":
                return _solve_together(problem, load, begin, throw)
            return _solve_in_turn(problem, load, begin, throw)
    # A result that was not found is NaN. Other settings of JAX would compile programs anew.
    with (
        jax.debug_nans(False),
        jax.debug_infs(False),
        warned_once(contact, FOR_STATES),
        progress_bar("sweep", load.value.size, "load", shown=progress) as bar,
    ):
        if order == "independent" and jax.default_backend() != "cpu":
            found = _solve_in_batch(problem, load, begin)
            bar.update(len(found))
        else:
            found = _solve_one_by_one(problem, load, begin, bar.update)
        if throw:
            _throw_first_failure(found)
        return found


class _Last(eqx.Module):
    """Where the next load starts: from a gap if one is known, or with the surfaces apart."""

    gap: Field
    is_known: Flag
    is_apart: Flag

    @classmethod
    def of(cls, contact: Contact, load: Load, initial: Initial) -> _Last:
        """Return where the first load starts."""
        no, yes = jax.device_put((False, True))
        if initial is None:
            return cls(contact.heights, no, no)
        gap = given_gap(contact, load, initial)
        return cls(gap.astype(contact.heights.dtype), yes, no)


class _SweepProblem(eqx.Module):
    """The data that all loads of a sweep share."""

    contact: Contact
    equilibrium_solver: EquilibriumSolver
    stability_solver: ConeSolver
    key: PRNGKeyArray | None
    order: Order = eqx.field(static=True)
    assesses: bool = eqx.field(static=True)

    def solve(self, last: _Last, load: Load, throw: bool = False) -> tuple[_Last, Sweep]:
        """Return the state at one load, and where the next load starts."""
        contact = self.contact
        problem = pose(contact, load)
        inputs = problem.contact, problem.load

        def start_together() -> Field:
            return cond(
                concrete(last.is_known),
                lambda: posed_gap(*inputs, last.gap),
                lambda: start_of(*inputs, None),
            )

        start = cond(concrete(last.is_apart), lambda: _apart(*inputs), start_together)
        equilibrium = equilibrium_from(
            start, contact, load, problem, self.equilibrium_solver, throw
        )
        stability = None
        if self.assesses:
            stability = assess_stability(
                contact, equilibrium, self.stability_solver, key=self.key, throw=throw
            )
        state = Sweep(load, equilibrium, stability)
        if self.order == "independent":
            return last, state
        return self._after(last, equilibrium), state

    def _after(self, last: _Last, found: Equilibrium) -> _Last:
        """Return where the next load starts: from the last state that was found, or apart."""
        is_found = found.result == RESULTS.successful
        return _Last(
            gap=cond(concrete(is_found), lambda: found.signed_gap, lambda: last.gap),
            is_known=cond(concrete(is_found), lambda: is_found, lambda: last.is_known),
            is_apart=found.result == RESULTS.pulled_off,
        )


def _solve_one_by_one(
    problem: _SweepProblem, load: Load, begin: _Last, report: Callable[[], object]
) -> Sweep:
    states = []
    last = begin
    try:
        for one in load:
            # While it waits, an interrupt stays pending.
            last, state = jax.block_until_ready(problem.solve(last, one))
            states.append(state)
            report()
    except early_ends():
        if not states:
            raise
        message = f"The sweep was interrupted: {len(states)} of {load.value.size} loads are done."
        warn(message, SweepInterrupted)
    return stack_of(states, states[0])


@partial(program, static_argnames="throw")
def _solve_in_turn(problem: _SweepProblem, load: Load, begin: _Last, throw: bool) -> Sweep:
    return jax.lax.scan(partial(problem.solve, throw=throw), begin, load)[1]


@partial(program, static_argnames="throw")
def _solve_together(problem: _SweepProblem, load: Load, begin: _Last, throw: bool = False) -> Sweep:
    return jax.vmap(lambda load: problem.solve(begin, load, throw)[1])(load)


def _solve_in_batch(problem: _SweepProblem, load: Load, begin: _Last) -> Sweep:
    """Solve all loads together, and copies of the last up to a number that has a program."""
    number = load.value.size
    # NumPy compiles nothing.
    copies = np.minimum(np.arange(_size_of_batch(number)), number - 1)
    more = jax.tree.map(lambda leaf: np.asarray(leaf)[copies], load)
    return first_entries(_solve_together(problem, more, begin), number)


def _size_of_batch(number: int) -> int:
    """Return the least of 1, 2, 3, 4, 6, 8, 12, 16, 24, ... that holds `number`."""
    power = 1 << (number - 1).bit_length()
    if number <= 3 * power // 4:
        return 3 * power // 4
    return power


@program
def _apart(contact: Contact, load: Load) -> Field:
    """Return a gap of surfaces that were pulled apart: far away, or about to touch if pressed."""
    control = contact.control(load)
    # Nothing holds surfaces beyond the gaps at which the law is looked at.
    distance = jnp.where(control.presses, 0, 2 * contact.profile.gaps[0])
    return jnp.max(contact.heights) - contact.heights + distance


def _throw_first_failure(found: Sweep) -> None:
    failed = [state for state in found if _result(state) != RESULTS.successful]
    if not failed:
        return
    load = failed[0].load
    throw_failure(
        _result(failed[0]),
        found,
        lambda: (
            f"{len(failed)} of {len(found)} loads failed, the first at "
            f"{type(load).__name__}({float(load.value):.6g})"
        ),
    )


def _result(state: Sweep) -> RESULTS:
    equilibrium = state.equilibrium
    stability = state.stability
    if stability is None:
        return equilibrium.result
    is_found = equilibrium.result == RESULTS.successful
    return RESULTS.where(is_found, stability.result, equilibrium.result)


def _columns(sweep: Sweep) -> dict[str, list[str]]:
    equilibrium = sweep.equilibrium
    stability = sweep.stability
    pairs = {}
    if stability is not None:
        pairs = stability.pairs
    columns = {
        **load_column(sweep.load, equilibrium.units, ".6g"),
        **state_columns(equilibrium),
    }
    for name, pair in pairs.items():
        values = {name.replace("_", " "): pair.eigenvalue}
        columns |= measured_columns(values, equilibrium.units, STIFFNESS)
    results = equilibrium.result.name
    if stability is not None:
        verdicts = stability.verdict.name
        locally = np.char.add(verdicts, ", locally")
        columns["verdict"] = column(np.where(stability.is_local, locally, verdicts), str)
        results = np.where(results == "successful", stability.result.name, results)
    solvers = column(results, str)
    steps = [column(x.num_steps, str) for x in (equilibrium, *pairs.values())]
    return columns | {"steps": list(map(" + ".join, zip(*steps, strict=True))), "solvers": solvers}

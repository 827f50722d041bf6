"""Equilibrium and stability at many loads: all at once, or each from the one before."""

from contextlib import nullcontext
from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, PRNGKeyArray

from jaxstab import display
from jaxstab.contact import Contact
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import Solver, find_equilibrium, initial_gap
from jaxstab.equilibrium.equilibrate import with_derivatives as equilibrium_with_derivatives
from jaxstab.lanes import by_lanes
from jaxstab.loads import Load, require_load
from jaxstab.programs import program
from jaxstab.progress import advance, progress_bar
from jaxstab.resolution import warn_if_coarse
from jaxstab.results import RESULTS, VERDICTS, throw_failure
from jaxstab.stability import ConeSolver, ProjectedLOBPCG, Stability
from jaxstab.stability.assess import judge
from jaxstab.stability.assess import with_derivatives as stability_with_derivatives
from jaxstab.stacks import Stackable


class Sweep(Stackable, eqx.Module):
    """Equilibria at many loads and their stability; every field has a leading axis of loads.

    `sweep[3]` is one state, without that axis; `len(sweep)`, slices and loops work as in a list.

    Attributes:
        load: the loads.
        equilibrium: the equilibrium at each load.
        stability: the stability of each.
    """

    load: Load
    equilibrium: Equilibrium
    stability: Stability

    __repr__ = display.sweep


def sweep(
    contact: Contact,
    load: Load,
    *,
    order: Literal["independent", "continuation"] = "independent",
    equilibrium_solver: Solver | None = None,
    stability_solver: ConeSolver | None = None,
    initial: ArrayLike | Equilibrium | None = None,
    key: PRNGKeyArray | None = None,
    progress: bool = False,
    throw: bool = False,
) -> Sweep:
    """Return the equilibrium and its stability at each of many loads.

    Arguments:
        contact: the contact problem.
        load: a load that holds a one-dimensional array of values.
        order: "independent" solves all loads together, each from the same start;
            "continuation" one after another, each from the last equilibrium found (Rey & Bleyer,
            section 4.2.3).
        equilibrium_solver: the algorithm for equilibria, by default that of `equilibrate`.
        stability_solver: the algorithm for the cone, as in `assess_stability`.
        initial: where to start, as in `equilibrate`.
        key: the random key of the eigensolvers' starts, as in `assess_stability`.
        progress: show a progress bar.
        throw: raise if any load fails; otherwise each load carries its own `result`, and one that
            fails leaves the others as they would have been.

    Returns:
        The results, stacked along a leading axis of loads.

    Raises:
        ValueError: for a single load or none, an order that does not exist, or an initial gap that
            `equilibrate` refuses.
        SolverError: if `throw` and a load failed.
    """
    require_load(load)
    if load.value.ndim != 1 or load.value.size == 0:
        raise ValueError(
            f"sweep takes a one-dimensional array of loads, but {type(load).__name__} holds one "
            f"of shape {load.value.shape}: use jaxstab.equilibrate for a single load."
        )
    if order not in ("independent", "continuation"):
        raise ValueError(f'order is {order!r}: choose "independent" or "continuation".')
    warn_if_coarse(contact)
    equilibrium_solver = equilibrium_solver or PreconditionedConjugateGradient()
    stability_solver = stability_solver or ProjectedLOBPCG()
    key = jax.random.key(0) if key is None else key
    gap = initial_gap(contact, load, initial)

    solve = _solve_together if order == "independent" else _solve_in_turn
    with progress_bar(load.value.size, "load") if progress else nullcontext():
        result = solve(
            contact, load, equilibrium_solver, stability_solver, gap, key, progress=progress
        )
    return _throw_failures(result) if throw else result


@partial(program, static_argnames="progress")
def _solve_together(
    contact: Contact,
    load: Load,
    equilibrium_solver: Solver,
    stability_solver: ConeSolver,
    initial: Float[Array, " *grid"] | None,
    key: PRNGKeyArray,
    progress: bool,
) -> Sweep:
    @by_lanes
    def solve(load: Load, shared: tuple) -> Sweep:
        contact, equilibrium_solver, stability_solver, initial, key = shared
        equilibrium = find_equilibrium(contact, load, equilibrium_solver, initial)
        stability = judge(contact, equilibrium, stability_solver, key)
        if progress:
            advance(stability.verdict == VERDICTS.stable)
        return Sweep(load, equilibrium, stability)

    shared = jax.lax.stop_gradient((contact, equilibrium_solver, stability_solver, initial))
    found = jax.vmap(solve, in_axes=(0, None))(jax.lax.stop_gradient(load), (*shared, key))

    def attach(load: Load, found: Sweep) -> Sweep:
        equilibrium = equilibrium_with_derivatives(contact, load, found.equilibrium)
        stability = stability_with_derivatives(contact, equilibrium, found.stability)
        return Sweep(load, equilibrium, stability)

    return jax.vmap(attach)(load, found)


@partial(program, static_argnames="progress")
def _solve_in_turn(
    contact: Contact,
    load: Load,
    equilibrium_solver: Solver,
    stability_solver: ConeSolver,
    initial: Float[Array, " *grid"] | None,
    key: PRNGKeyArray,
    progress: bool,
) -> Sweep:
    Carry = tuple[Float[Array, " *grid"], Bool[Array, ""]]

    def solve(carry: Carry, load: Load) -> tuple[Carry, Sweep]:
        last, has_last = carry
        fresh = load.control(contact.heights).starting_gap(contact.heights)
        start = jnp.where(has_last, last, fresh)
        equilibrium = find_equilibrium(contact, load, equilibrium_solver, start)
        stability = judge(contact, equilibrium, stability_solver, key)
        if progress:
            advance(stability.verdict == VERDICTS.stable)
        found = equilibrium.result == RESULTS.successful
        last = jnp.where(found, equilibrium.gap, last)
        return (last, has_last | found), Sweep(load, equilibrium, stability)

    nothing = jnp.zeros_like(contact.heights)
    last = nothing if initial is None else initial.astype(nothing.dtype)
    first = (last, jnp.array(initial is not None))
    _, result = jax.lax.scan(solve, first, load)
    return result


def _throw_failures(result: Sweep) -> Sweep:
    codes = result.stability.result
    failed = codes != RESULTS.successful
    first = jax.tree.map(lambda leaf: leaf[jnp.argmax(failed)], result)
    code = first.equilibrium.result
    code = RESULTS.where(code == RESULTS.successful, first.stability.result, code)
    return throw_failure(
        code,
        result,
        lambda: (
            f"{int(failed.sum())} of {failed.size} loads failed, the first at "
            f"{type(first.load).__name__}({float(first.load.value):.6g})"
        ),
    )

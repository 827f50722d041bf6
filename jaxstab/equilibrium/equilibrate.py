"""The equilibrium of a contact under a load, by any of the solvers beside this file."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.contact.contact import Contact, require_contact
from jaxstab.contact.resolution import warn_if_coarse
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.control_flow import by_entries
from jaxstab.core.implicit import attach, where_traced
from jaxstab.core.loop import Iteration, solver_or_default
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field
from jaxstab.equilibrium.derivatives import changes_of_fields
from jaxstab.equilibrium.equilibrium import (
    DIFFERENTIABLE,
    OF_YIELDING,
    Equilibrium,
    State,
    equilibrium_at,
)
from jaxstab.equilibrium.posing import PosedLoad, finish, pose, warn_at_edges
from jaxstab.equilibrium.solvers.base import EquilibriumSolver, Problem, SolverState
from jaxstab.equilibrium.solvers.conjugate_gradients import PreconditionedConjugateGradient
from jaxstab.equilibrium.start import start_of
from jaxstab.equilibrium.validity import warn_beyond_hardness
from jaxstab.loads.held_gap import GapControl
from jaxstab.loads.load import Control, Load, require_loads


def equilibrate(
    contact: Contact,
    load: Load,
    solver: EquilibriumSolver | None = None,
    *,
    initial: ArrayLike | State | None = None,
    throw: bool = True,
) -> Equilibrium:
    """Return an equilibrium of the contact under a load (Rey & Bleyer, eq. 14).

    With strong adhesion there can be several; which one is found depends on where the solver
    starts. If surface and start share a symmetry, the result has it too. It can then be a saddle
    between states without the symmetry: to avoid this, start from a gap without it.

    With a hardness H (`Contact`) the pressure is nowhere above H. Where it is H, the surface is
    flattened by the `indentation` z, from the surface as the contact has it. The state is a minimum
    of u.Ku / 2 + sum f(g) + H sum z, z >= 0, with u = g + h - z. Loads act on u: `MeanGap` holds
    the mean of u - h, over the surface before it is flattened. A contact that has been flattened
    before remembers it in its heights: see `Contact.after`, and `jaxstab.follow`.

    Fields, mean pressure and energy are differentiable functions of the contact and the load, in
    both modes and to any order. Contact area, residual and history count as constants, and so does
    the start of the solver. A derivative is NaN where it does not exist: without a converged
    equilibrium, at a fold, and where a gap or a reaction is zero to within the residual, that is,
    if a point is about to touch or to be released, or to yield.

    Arguments:
        contact: the contact problem.
        load: the prescribed quantity, with a single value.
        solver: the algorithm, `PreconditionedConjugateGradient()` by default.
        initial: a gap [length], an equilibrium or a result with one as the start, brought under the
            load. By default the undeformed solid, cut where it meets the surface.
        throw: raise an error if the solver fails. With False look at `result` instead. Under vmap
            the failure of one entry raises for all, so choose False there.

    Returns:
        The equilibrium, in the precision of the contact's heights; NaN throughout for a load or a
        contact without an answer.

    Warns:
        ContactWarning: if the mean pressure in contact exceeds E* / 20, where pressures have a unit
            and E* is above 0.1 GPa, as of solids that yield.

    Raises:
        ValueError: for an array of loads, or an initial gap that is not finite and positive
            somewhere, or of another shape than the grid.
        TypeError: for something that is not a load, or not a solver for equilibria.
        SolverError: if `throw`, for a load that no gap satisfies or a solve that did not converge.

    Example:
        >>> state = js.equilibrate(contact, js.MeanGap(0.05))
        >>> f"{state.mean_pressure:.4f}, {state.contact_area:.3f}"
        '-0.1768, 0.324'
    """
    require_contact(contact)
    cure = "use jaxstab.sweep, or jax.vmap."
    require_loads(load, (), "equilibrate takes one load", cure)
    load.warn_if_soft(contact.solid)
    solver = solver_or_default(solver, EquilibriumSolver, PreconditionedConjugateGradient)
    warn_if_coarse(contact)
    problem = pose(contact, load)
    start = start_of(problem.contact, problem.load, initial)
    return equilibrium_from(start, contact, load, problem, solver, throw)


def equilibrium_from(
    start: Field,
    contact: Contact,
    load: Load,
    problem: PosedLoad,
    solver: EquilibriumSolver,
    throw: bool,
) -> Equilibrium:
    """Return the equilibrium of a contact under a load, given both as they are posed too."""
    found = solve(problem.contact, problem.load, solver, start)
    equilibrium = finish(found, problem, partial(_describe, contact), throw)
    # As it was given, without the rounding of conversions.
    equilibrium = replace(equilibrium, load=load)
    warn_at_edges(contact, equilibrium)
    warn_beyond_hardness(contact, equilibrium.mean_pressure, equilibrium.contact_area)
    return equilibrium


@own_conventions()
def solve(contact: Contact, load: Load, solver: EquilibriumSolver, start: Field) -> Equilibrium:
    """Return the equilibrium of a contact under a load as they are posed, differentiable."""
    constants = jax.lax.stop_gradient((contact, load, solver, start))
    return with_derivatives(find(*constants), (contact, load))


@where_traced
def with_derivatives(found: Equilibrium, inputs: tuple[Contact, Load]) -> Equilibrium:
    """Return an equilibrium as a differentiable function of the contact and the load."""
    contact, load = inputs
    names = DIFFERENTIABLE
    if found.indentation is not None:
        names += OF_YIELDING
    fields = {name: getattr(found, name) for name in names}
    fields = attach(changes_of_fields, fields, found.result == RESULTS.successful, inputs)
    return replace(found, **fields, load=load, area=contact.area)


def find(contact: Contact, load: Load, solver: EquilibriumSolver, start: Field) -> Equilibrium:
    """Return the equilibrium that a solver finds from a gap, without derivatives.

    All in the characteristic pressure. Whatever seeks an equilibrium shares this program.
    """
    return _find(contact, load, solver.in_precision(contact.heights.dtype), start)


@program
@by_entries
def _find(contact: Contact, load: Load, solver: EquilibriumSolver, initial: Field) -> Equilibrium:
    problem = Problem.of(contact, contact.control(load))
    return conclude(contact, load, solver.run(problem, restored_start(contact, load, initial)))


def restored_start(contact: Contact, load: Load, initial: Field) -> Field:
    """Return a gap to start a solver from, NaN for a load or a contact without an answer."""
    control = contact.control(load)
    start = initial.astype(contact.heights.dtype)
    if contact.hardness is None:
        start = jnp.maximum(start, 0)
    size = jnp.ones((), start.dtype)
    if control.fixes_mean and contact.hardness is None:
        # Only its shape counts, and a sum of numbers near one has no overflow.
        size = jnp.max(start)
    start = start / jnp.where(control.is_feasible & contact.is_valid, size, jnp.nan)
    gap = control.restore(start)
    lift = partial(_lift_off_core, contact, control)
    return jax.lax.cond(contact.has_core, lift, lambda gap: gap, gap)


def conclude(contact: Contact, load: Load, iteration: Iteration[SolverState]) -> Equilibrium:
    """Return the equilibrium that a solver has come to, and how."""
    control = contact.control(load)
    gap = iteration.state.gap
    balance = iteration.state.balance
    # A solver keeps its gap under the load, unless a number in it is none.
    is_valid_gap = jnp.isfinite(balance.energy) & control.is_met(gap)
    result = RESULTS.where(is_valid_gap, iteration.result, RESULTS.nonfinite)
    if contact.solid.is_window:
        is_sunk = jnp.sum(gap <= 0) > jnp.sum(contact.solid.surface(gap <= 0))
        result = RESULTS.where(is_sunk, RESULTS.sunk, result)
    result = RESULTS.where(balance.has_escaped, RESULTS.pulled_off, result)
    result = RESULTS.where(control.is_feasible, result, RESULTS.infeasible_load)
    result = RESULTS.where(contact.is_valid, result, RESULTS.invalid_contact)

    return equilibrium_at(
        contact,
        load,
        gap,
        balance,
        residual=iteration.residual,
        num_steps=iteration.num_steps,
        result=result,
        history=iteration.history,
    )


def _lift_off_core(contact: Contact, control: Control, gap: Field) -> Field:
    """Return the gap, or where it lies deep in the core a wider one of lower energy.

    A gap that nowhere does may be a state of equilibrium, which is to be kept whatever others are
    lower.
    """
    profile = contact.profile
    # Under tension, energy falls without end further out: look for the minimum near the core.
    energies = profile.values + jnp.maximum(control.energy(profile.gaps), 0)
    lifted = control.restore(gap + profile.gaps[jnp.nanargmin(energies)])
    # Deep is where the law has taken back more than all that it gives.
    innermost = profile.gaps[jnp.nanargmin(profile.values)]
    is_deep = (profile.gaps < innermost) & ~(profile.values <= -jnp.nanmin(profile.values))
    deep = jnp.max(jnp.where(is_deep, profile.gaps, 0))

    def energies_of(gap: Field) -> Float[Array, " energies"]:
        surface = contact.energy(gap) / contact.grid.cell_area
        return jnp.stack([surface, surface + gap.size * control.energy(control.mean_gap_of(gap))])

    # That a tension gains by drawing the surfaces apart says nothing of the core.
    is_better = jnp.any(energies_of(gap) <= energies_of(lifted))
    stays = (is_better & jnp.all(gap > 0)) | jnp.all(gap > deep)
    return jnp.where(stays, gap, lifted)


def _describe(contact: Contact, equilibrium: Equilibrium) -> str:
    # Known also where derivatives are being taken.
    contact, equilibrium = jax.lax.stop_gradient((contact, equilibrium))
    load = equilibrium.load
    control = contact.control(load)
    held = ""
    if isinstance(control, GapControl):
        held = f", a mean gap of {control.mean_gap:.6g},"
    return (
        f"No equilibrium found at {type(load).__name__}({load.value:.6g}){held} after "
        f"{equilibrium.num_steps} steps with a relative residual of {equilibrium.residual:.3g}"
    )

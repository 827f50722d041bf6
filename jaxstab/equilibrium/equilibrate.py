"""The equilibrium of a contact under a load, by any of the solvers beside this file."""

from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxstab.checks import is_traced, known, parameter, require, require_finite
from jaxstab.contact import Contact
from jaxstab.derivatives import attach
from jaxstab.display import block
from jaxstab.equilibrium.implicit import DIFFERENTIABLE, changes_of_fields
from jaxstab.equilibrium.polonsky_keer_rey import PolonskyKeerRey
from jaxstab.equilibrium.preconditioned import PreconditionedConjugateGradient
from jaxstab.equilibrium.saddle_newton import SaddleNewton
from jaxstab.grid import resample, total
from jaxstab.iterate import History
from jaxstab.lanes import by_lanes
from jaxstab.loads import Control, GapControl, Load, require_load
from jaxstab.potentials import slope
from jaxstab.programs import program
from jaxstab.resolution import warn_if_coarse
from jaxstab.results import RESULTS, throw_failure
from jaxstab.stacks import Stackable, require_single

# Over the precision: what part of itself a mean gap may be off.
_ROUNDING = 1e3

# The fields that hold pressures, or energies.
_PRESSURES = ("pressure", "reaction", "mean_pressure", "energy")

Solver = PolonskyKeerRey | PreconditionedConjugateGradient | SaddleNewton


class Equilibrium(Stackable, eqx.Module):
    """An equilibrium K u + p0 + f'(g) = mu, g >= 0, mu >= 0, mu g = 0 (Rey & Bleyer, 9 and 10).

    Attributes:
        load: the load that holds it.
        displacement: u = g + h [length].
        gap: g, exactly zero at the points in contact [length].
        pressure: the elastic pressure K u + p0, positive in compression [pressure].
        reaction: mu, the pressure of contact; zero out of contact [pressure].
        in_contact: where the surfaces touch.
        mean_pressure: p0 = mean(mu - f'(g)), positive in compression [pressure].
        contact_area: the number of contact points over that of all points.
        energy: elastic and adhesive energy of the surface [energy].
        residual: the relative optimality residual.
        num_steps: steps that the solver took.
        result: a member of `RESULTS`: how the solver ended.
        history: the indicator "residual" as the solver went, and "energy" [energy/area] where the
            solver measures it.
    """

    load: Load
    displacement: Float[Array, " *grid"]
    gap: Float[Array, " *grid"]
    pressure: Float[Array, " *grid"]
    reaction: Float[Array, " *grid"]
    in_contact: Bool[Array, " *grid"]
    mean_pressure: Float[Array, ""]
    contact_area: Float[Array, ""]
    energy: Float[Array, ""]
    residual: Float[Array, ""]
    num_steps: Int[Array, ""]
    result: RESULTS
    history: History

    __repr__ = block

    def in_units_of(self, pressure: Float[Array, ""]) -> "Equilibrium":
        """Return the same state with pressures in another unit; lengths stay."""
        return replace(
            self,
            load=self.load.in_units_of(pressure),
            history=self.history.scaled(energy=1 / pressure),
            **_in_units_of(pressure, {name: getattr(self, name) for name in _PRESSURES}),
        )


class _HoldsEquilibrium(Protocol):
    @property
    def equilibrium(self) -> Equilibrium: ...


# Also an entry of a sweep, or a fold.
State = Equilibrium | _HoldsEquilibrium


def equilibrate(
    contact: Contact,
    load: Load,
    solver: Solver | None = None,
    *,
    initial: ArrayLike | State | None = None,
    throw: bool = True,
) -> Equilibrium:
    """Return an equilibrium of the contact under a load (Rey & Bleyer, eq. 14).

    With strong adhesion there can be several; which one is found depends on where the solver
    starts. Where surface and start share a symmetry, so does what is found, which can then be a
    saddle towards states without it: start from a gap that lacks the symmetry to leave it.

    Fields, mean pressure and energy are differentiable functions of the contact and the load, in
    both modes and to any order; contact area, residual and history count as constants, and where
    the solver starts does not matter. On the verge of contact and at a fold they have no
    derivative.

    Arguments:
        contact: the contact problem.
        load: what is prescribed, a single value.
        solver: the algorithm, `PreconditionedConjugateGradient()` by default.
        initial: a gap [length], an equilibrium or what holds one to start from, brought under the
            load; by default the undeformed solid, cut where it meets the surface.
        throw: raise where the solver fails, or a derivative is asked for that does not exist (in
            forward mode outside of jit, of any field); otherwise look at `result`, and such a
            derivative is NaN. Under vmap the failure of
            one lane raises for all, so choose False there.

    Returns:
        The equilibrium, in the precision of the contact's heights; NaN throughout for a load or a
        contact without an answer.

    Raises:
        ValueError: for an array of loads, or an initial gap that is not finite and positive
            somewhere, or of another shape than the grid.
        TypeError: for something that is not a load.
        SolverError: if `throw`, for a load that no gap satisfies or a solve that did not converge.
    """
    require_load(load)
    if load.value.shape != ():
        raise ValueError(
            f"equilibrate takes one load, but {type(load).__name__} holds an array of shape "
            f"{load.value.shape}: use jaxstab.sweep, or jax.vmap."
        )
    warn_if_coarse(contact)
    solver = solver or PreconditionedConjugateGradient()
    start = initial_gap(contact, load, initial)
    if start is None:
        # One program for all starts.
        start = _undeformed(load, contact.heights)
    inputs = jax.lax.stop_gradient((contact, load, solver, start))
    # Histories end in NaN, and what was not found is NaN.
    with jax.debug_nans(False):
        equilibrium = find_equilibrium(*inputs)
    if is_traced((contact, load)):
        equilibrium = with_derivatives(contact, load, equilibrium, throw)
    if not throw:
        return equilibrium
    return throw_failure(equilibrium.result, equilibrium, lambda: _describe(contact, equilibrium))


@jax.jit
def _undeformed(load: Load, heights: Float[Array, " *grid"]) -> Float[Array, " *grid"]:
    return load.control(heights).starting_gap(heights)


def find_equilibrium(
    contact: Contact, load: Load, solver: Solver, initial: Float[Array, " *grid"] | None
) -> Equilibrium:
    """Do what `equilibrate` does, on checked arguments, without derivatives."""
    has_core = contact.has_core
    has_core = None if is_traced(has_core) else bool(has_core)
    return _find_in_own_units(contact, load, solver, initial, has_core)


@partial(program, static_argnames="has_core")
def _find_in_own_units(
    contact: Contact,
    load: Load,
    solver: Solver,
    initial: Float[Array, " *grid"] | None,
    has_core: bool | None,
) -> Equilibrium:
    unit = contact.own_pressure
    own = contact.in_units_of(unit, has_core), load.in_units_of(unit)
    found = by_lanes(_find)(*own, solver, initial).in_units_of(1 / unit)
    overflows = (found.result == RESULTS.successful) & ~jnp.isfinite(found.energy)
    result = RESULTS.where(overflows, RESULTS.nonfinite, found.result)
    return replace(found, load=load, result=result)


def with_derivatives(
    contact: Contact, load: Load, found: Equilibrium, throw: bool = False
) -> Equilibrium:
    """Return an equilibrium as a differentiable function of the contact and the load."""
    unit = contact.own_pressure
    fields = _in_units_of(unit, {name: getattr(found, name) for name in DIFFERENTIABLE})
    is_found = found.result == RESULTS.successful
    own = contact.in_units_of(unit), load.in_units_of(unit)
    fields = attach(changes_of_fields, throw, fields, is_found, own)
    return replace(found, load=load, **_in_units_of(1 / unit, fields))


def _in_units_of(pressure: Float[Array, ""], fields: dict[str, Array]) -> dict[str, Array]:
    return {
        name: field / pressure if name in _PRESSURES else field for name, field in fields.items()
    }


def _find(
    contact: Contact, load: Load, solver: Solver, initial: Float[Array, " *grid"] | None
) -> Equilibrium:
    control = load.control(contact.heights)
    start = control.starting_gap(contact.heights) if initial is None else initial
    start = jnp.maximum(start.astype(contact.heights.dtype), 0)
    gap = control.restore(start / jnp.max(start) if control.fixes_mean else start)
    lift = partial(_lift_off_core, contact, control)
    gap = jax.lax.cond(contact.has_core, lift, lambda gap: gap, gap)
    gap = jnp.where(control.is_feasible & contact.is_valid, gap, jnp.nan)
    iteration = solver.solve(contact, control, gap)
    gap, balance = iteration.state.gap, iteration.state.balance
    energy = (balance.elastic_energy + balance.adhesion) * contact.grid.cell_area
    is_met = control.missed(gap) <= _ROUNDING * jnp.finfo(gap.dtype).eps
    is_finite = jnp.isfinite(energy) & is_met
    result = RESULTS.where(is_finite, iteration.result, RESULTS.nonfinite)
    result = RESULTS.where(balance.has_escaped, RESULTS.pulled_off, result)
    result = RESULTS.where(control.is_feasible, result, RESULTS.infeasible_load)
    result = RESULTS.where(contact.is_valid, result, RESULTS.invalid_contact)

    in_contact = gap == 0
    # Failed states have a gap of NaN throughout.
    reaction = jnp.where(in_contact, balance.net, 0 * gap)
    attraction = slope(contact.potential, gap)
    mean_pressure = jnp.mean(reaction - attraction)
    return Equilibrium(
        load=load,
        displacement=contact.displacement(gap),
        gap=gap,
        pressure=balance.net - attraction,
        reaction=reaction,
        in_contact=in_contact,
        mean_pressure=mean_pressure,
        contact_area=jnp.mean(jnp.where(jnp.isnan(gap), gap, in_contact)),
        energy=energy,
        residual=iteration.residual,
        num_steps=iteration.num_steps,
        result=result,
        history=iteration.history,
    )


def _lift_off_core(
    contact: Contact, control: Control, gap: Float[Array, " *grid"]
) -> Float[Array, " *grid"]:
    """Return the gap, or a wider one if its energy is lower or that of the gap not finite."""
    scan = contact.scan
    # Under tension, energy falls without end further out: look for the minimum near the core.
    energies = scan.values + jnp.maximum(control.work(scan.gaps), 0)
    lifted = control.restore(gap + scan.gaps[jnp.nanargmin(energies)])

    def energy(gap: Float[Array, " *grid"]) -> Float[Array, ""]:
        return contact.energy(gap) / contact.grid.cell_area + control.work(total(gap))

    is_better = energy(gap) <= energy(lifted)
    return jnp.where(is_better & jnp.all(gap > 0), gap, lifted)


def initial_gap(
    contact: Contact, load: Load, initial: ArrayLike | State | None
) -> Float[Array, " *grid"] | None:
    """Return what was given as `initial` as a gap on the contact's grid, checked.

    Raises:
        ValueError: if its shape is not the grid's, or it is not finite, or nowhere positive where
            the load holds the mean gap; for a stack of states, or one that has another number of
            sides.
        TypeError: for an array that is complex or masked, or a result that is not a state.
    """
    if initial is None:
        return None
    shape = contact.grid.shape
    if isinstance(initial, eqx.Module):
        state = single_equilibrium(initial)
        gap = state.gap
        if gap.ndim == len(shape) and gap.shape != shape:
            gap = contact.gap(resample(state.displacement, shape))
    else:
        gap = parameter(initial, "The initial gap")
    if gap.shape != shape:
        raise ValueError(f"The initial gap has shape {gap.shape}, the grid {shape}.")
    require_finite("The initial gap", gap)
    if load.control(contact.heights).fixes_mean:
        largest = known(gap).max()
        cure = "it must be positive somewhere, for a load that holds the mean gap."
        require("The largest initial gap", largest, largest > 0, cure)
    return gap


def single_equilibrium(state: Any) -> Equilibrium:
    """Return the one equilibrium that a state is or holds.

    Raises:
        TypeError: for something that is not a state.
        ValueError: for a stack of states.
    """
    equilibrium = getattr(state, "equilibrium", state)
    if not isinstance(equilibrium, Equilibrium):
        raise TypeError(
            f"{type(state).__name__} is not a state: give what jaxstab.equilibrate returned, or an "
            "entry of a sweep."
        )
    require_single(equilibrium)
    return equilibrium


def equilibrium_of(contact: Contact, state: State) -> Equilibrium:
    """Return the one equilibrium that a state is or holds, on the contact's grid.

    Raises:
        TypeError: for something that is not a state.
        ValueError: for a stack of states, or one that is not on the contact's grid.
    """
    equilibrium = single_equilibrium(state)
    if equilibrium.gap.shape != contact.grid.shape:
        raise ValueError(
            f"The equilibrium has shape {equilibrium.gap.shape}, the contact's grid "
            f"{contact.grid.shape}: use the contact that it came from."
        )
    return equilibrium


def _describe(contact: Contact, equilibrium: Equilibrium) -> str:
    # Known also where derivatives are being taken.
    contact, equilibrium = jax.lax.stop_gradient((contact, equilibrium))
    load = equilibrium.load
    control = load.control(contact.heights)
    held = f", a mean gap of {control.mean_gap:.6g}," if isinstance(control, GapControl) else ""
    return (
        f"No equilibrium found at {type(load).__name__}({load.value:.6g}){held} after "
        f"{equilibrium.num_steps} steps with a relative residual of {equilibrium.residual:.3g}"
    )

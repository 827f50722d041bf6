"""The equilibrium of a contact under a load, by any of the solvers beside this file."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxstab.contact import Contact, Load
from jaxstab.equilibrium.polonsky_keer_rey import PolonskyKeerRey
from jaxstab.iterate import Report
from jaxstab.potentials import slope
from jaxstab.results import RESULTS, throw_failure


class Equilibrium(eqx.Module):
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


def equilibrate(
    contact: Contact,
    load: Load,
    solver: PolonskyKeerRey | None = None,
    *,
    initial: Float[Array, " *grid"] | Equilibrium | None = None,
    throw: bool = True,
) -> Equilibrium:
    """Return an equilibrium of the contact under a load (Rey & Bleyer, eq. 14).

    With strong adhesion there can be several; which one is found depends on where the solver
    starts.

    Arguments:
        contact: the contact problem.
        load: what is prescribed, a single value.
        solver: the algorithm, `PolonskyKeerRey()` by default.
        initial: a gap [length] or an equilibrium to start from, moved to the load's mean gap; by
            default the undeformed solid, cut where it meets the surface.
        throw: raise where the solver fails; otherwise look at `result`. Under vmap the failure of
            one lane raises for all, so choose False there.

    Returns:
        The equilibrium, in the precision of the contact's heights; NaN throughout for a load or a
        contact without an answer.

    Raises:
        ValueError: for an array of loads, or an initial gap of another shape than the grid.
        SolverError: if `throw`, for a load that no gap satisfies or a solve that did not converge.
    """
    if load.value.shape != ():
        raise ValueError(
            f"equilibrate takes one load, but {type(load).__name__} holds an array of shape "
            f"{load.value.shape}: use jaxstab.sweep, or jax.vmap."
        )
    initial = initial.gap if isinstance(initial, Equilibrium) else initial
    if initial is not None and initial.shape != contact.grid.shape:
        raise ValueError(
            f"The initial gap has shape {initial.shape}, the grid {contact.grid.shape}."
        )
    solver = PolonskyKeerRey() if solver is None else solver
    equilibrium = find_equilibrium(contact, load, solver, initial)
    if not throw:
        return equilibrium
    return throw_failure(equilibrium.result, equilibrium, lambda: _describe(contact, equilibrium))


@partial(jax.jit, static_argnames="report")
def find_equilibrium(
    contact: Contact,
    load: Load,
    solver: PolonskyKeerRey,
    initial: Float[Array, " *grid"] | None,
    report: Report | None = None,
) -> Equilibrium:
    """Do what `equilibrate` does, on checked arguments and without raising."""
    mean_gap = load.mean_gap(contact.heights)
    is_feasible = (mean_gap > 0) & jnp.isfinite(mean_gap)
    start = undeformed_gap(contact, load) if initial is None else initial
    gap = _feasible_gap(start.astype(contact.heights.dtype), mean_gap)
    gap = jnp.where(is_feasible & contact.is_valid, gap, jnp.nan)
    iteration = solver.solve(contact, gap, report)
    gap, balance = iteration.state.gap, iteration.state.balance
    energy = contact.energy(gap)
    result = RESULTS.where(jnp.isfinite(energy), iteration.result, RESULTS.nonfinite)
    result = RESULTS.where(is_feasible, result, RESULTS.infeasible_load)
    result = RESULTS.where(contact.is_valid, result, RESULTS.invalid_contact)

    in_contact = gap == 0
    reaction = jnp.where(in_contact, balance.net, 0)
    mean_pressure = jnp.mean(reaction - slope(contact.potential, gap))
    return Equilibrium(
        load=load,
        displacement=contact.displacement(gap),
        gap=gap,
        pressure=balance.elastic + mean_pressure,
        reaction=reaction,
        in_contact=in_contact,
        mean_pressure=mean_pressure,
        contact_area=jnp.mean(in_contact, dtype=gap.dtype),
        energy=energy,
        residual=iteration.residual,
        num_steps=iteration.num_steps,
        result=result,
    )


def undeformed_gap(contact: Contact, load: Load) -> Float[Array, " *grid"]:
    """Return the gap of the undeformed solid, negative where it would enter the surface."""
    return load.mean_gap(contact.heights) + jnp.mean(contact.heights) - contact.heights


def _feasible_gap(
    gap: Float[Array, " *grid"], mean_gap: Float[Array, ""]
) -> Float[Array, " *grid"]:
    """Return a gap that is nowhere negative and has the mean gap."""
    gap = jnp.maximum(gap, 0)
    return gap * (mean_gap / jnp.mean(gap))


def _describe(contact: Contact, equilibrium: Equilibrium) -> str:
    load = equilibrium.load
    return (
        f"No equilibrium found at {type(load).__name__}({float(load.value):.6g}), a mean gap of "
        f"{float(load.mean_gap(contact.heights)):.6g}, after {int(equilibrium.num_steps)} steps "
        f"with a relative residual of {float(equilibrium.residual):.3g}"
    )

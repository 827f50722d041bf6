"""The lowest modes of an equilibrium on a linear space."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, PRNGKeyArray

from jaxstab.contact.contact import Contact, require_elastic
from jaxstab.contact.resolution import warn_if_coarse
from jaxstab.core.checks import integer, key_or_default, require, require_one_of
from jaxstab.core.compile import program
from jaxstab.core.implicit import refuse_derivatives
from jaxstab.core.loop import solver_or_default
from jaxstab.core.results import RESULTS
from jaxstab.equilibrium.equilibrium import Equilibrium, State, equilibrium_of
from jaxstab.equilibrium.posing import finish, posed_state
from jaxstab.equilibrium.verify import verify_balance
from jaxstab.stability.cones import Subspace
from jaxstab.stability.eigenpair import Eigenpair, eigenpair_of
from jaxstab.stability.solvers.base import BLOCK_SIZE, SpaceSolver, noise
from jaxstab.stability.solvers.davidson import Davidson

# Modes beyond those asked for, which make them converge sooner.
_GUARD = 2


def lowest_modes(
    contact: Contact,
    equilibrium: State,
    count: int,
    *,
    space: Literal["lower_bound", "critical"] = "lower_bound",
    solver: SpaceSolver | None = None,
    key: PRNGKeyArray | None = None,
    throw: bool = True,
) -> Eigenpair:
    """Return the lowest eigenvalues of A = K + D on a linear space, and their modes.

    Arguments:
        contact: the contact problem.
        equilibrium: one of its equilibria, or a result that holds it: an entry of a sweep, a fold.
        count: how many.
        space: "lower_bound" for all perturbations that the load allows, "critical" for those that
            do not move points in contact.
        solver: the algorithm, `Davidson()` by default.
        key: the random key of the vectors to start from, `jax.random.key(0)` by default.
        throw: raise where the solver fails; otherwise look at `result`.

    Returns:
        The eigenpairs from the lowest up, along a leading axis; steps, applications and history,
        the same for each, are the sums over all. Beyond the dimension of the space they are
        +inf, with the result "too_many_modes".

    Raises:
        ValueError: if the equilibrium has another grid or precision than the contact, or the space
            is unknown. If the count is not positive, or larger than the dimension of V0.
        TypeError: if the count is not an integer, the solver not one for linear spaces, or the
            key not a random one.
        SolverError: if `throw`, for an equilibrium or modes that did not converge, or a count
            larger than the dimension of the space.

    Example:
        >>> modes = js.lowest_modes(contact, state, 2, space="critical")
        >>> [f"{x:.3f}" for x in modes.eigenvalue]
        ['1.282', '1.951']
    """
    equilibrium = equilibrium_of(contact, equilibrium)
    require_elastic(contact, "lowest_modes")
    count = integer("count", count)
    require("count", count, count >= 1, "ask for one mode or more.")
    require_one_of("space", space, ("lower_bound", "critical"))
    warn_if_coarse(contact)
    solver = solver_or_default(solver, SpaceSolver, Davidson)
    key = key_or_default(key)
    problem = posed_state(contact, equilibrium)
    most = problem.contact.grid.size - contact.control(equilibrium.load).fixes_mean
    require("count", count, count <= most, f"{most} directions are admissible: ask for fewer.")
    problem = refuse_derivatives(problem)
    pairs = _search(count, space == "critical", problem.contact, problem.equilibrium, solver, key)
    return finish(pairs, problem, _describe, throw)


@partial(program, static_argnums=(0, 1))
def _search(
    count: int,
    stays_in_contact: bool,
    contact: Contact,
    equilibrium: Equilibrium,
    solver: SpaceSolver,
    key: PRNGKeyArray,
) -> Eigenpair:
    control = contact.control(equilibrium.load)
    state = verify_balance(contact.balance(control)(equilibrium.gap), contact, equilibrium)
    is_equilibrium = state == RESULTS.successful
    # Where there is nothing to assess, nothing moves.
    is_moving = is_equilibrium & ~((equilibrium.gap == 0) & stays_in_contact)
    space = Subspace(is_moving, control.fixes_mean)
    hessian = contact.hessian(equilibrium.gap, control).restriction(space.is_moving)
    starts = noise(key, max(count + _GUARD, BLOCK_SIZE), equilibrium.gap)
    found = solver.solve(hessian, space, starts, count)
    found = replace(found, num_applications=found.num_applications + count - 1)
    dimension = jnp.sum(is_moving) - control.fixes_mean

    def pair_at(place: Int[Array, ""]) -> Eigenpair:
        result = RESULTS.where(place < dimension, found.result, RESULTS.too_many_modes)
        result = RESULTS.where(is_equilibrium, result, state)
        minimum = replace(found, result=result)
        return eigenpair_of(hessian, space, minimum, found.vector[place]).with_proof(True)

    return jax.vmap(pair_at)(jnp.arange(count))


def _describe(pairs: Eigenpair) -> str:
    message = f"The {len(pairs)} lowest modes were not found"
    if pairs.result[-1] == RESULTS.too_many_modes:
        dimension = int(jnp.sum(pairs.result != RESULTS.too_many_modes))
        message += f" among {dimension} admissible directions"
    return message

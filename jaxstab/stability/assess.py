"""The stability of an equilibrium, from the smallest eigenvalues of its energy's Hessian."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from jaxstab.contact.contact import Contact
from jaxstab.contact.resolution import warn_if_coarse
from jaxstab.core.checks import key_or_default
from jaxstab.core.compile import in_pieces, own_conventions, program
from jaxstab.core.control_flow import cond
from jaxstab.core.implicit import where_traced
from jaxstab.core.loop import solver_or_default
from jaxstab.core.progress import advance_to, progress_bar
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Flag, Mask
from jaxstab.equilibrium.equilibrium import Equilibrium, State, equilibrium_of
from jaxstab.equilibrium.posing import finish, posed_state
from jaxstab.stability.angular_modes import require_orders, with_angular_modes
from jaxstab.stability.barrier import differentiable as differentiable_margins
from jaxstab.stability.barrier import margins_of
from jaxstab.stability.cones import Subspace
from jaxstab.stability.derivatives import differentiable
from jaxstab.stability.eigenpair import Eigenpair
from jaxstab.stability.eigenproblems import AssessedState, SmallestPairs, problems_of
from jaxstab.stability.search import smallest_eigenpairs
from jaxstab.stability.solvers.base import ConeSolver
from jaxstab.stability.solvers.cone_lobpcg import ProjectedLOBPCG
from jaxstab.stability.solvers.davidson import Davidson
from jaxstab.stability.symmetry import warn_of_symmetry
from jaxstab.stability.verdict import (
    VERDICTS,
    Stability,
    describe,
    first_failure,
    proof_of,
    verdict_on,
)

# The lower bound, the critical cone and the cone take one search each.
_NUM_SEARCHES = 3
# A pressure that is below H by less than this part of it is H.
AT_HARDNESS = 1e-6


@runtime_checkable
class HasInstant(Protocol):
    """A state in time: the contact as it answers at once, and its equilibrium."""

    @property
    def instant(self) -> tuple[Contact, Equilibrium]: ...  # noqa: D102


def assess_stability(
    contact: Contact | HasInstant,
    equilibrium: State | None = None,
    solver: ConeSolver | None = None,
    *,
    key: PRNGKeyArray | None = None,
    orders: int = 0,
    verdict_only: bool = False,
    progress: bool | None = None,
    throw: bool = True,
) -> Stability:
    """Return the stability of an equilibrium against admissible perturbations (Rey & Bleyer, 22).

    On a linear space the eigenvalue is the smallest. The critical cone is a linear space if all
    contact points are under pressure. On the cone the eigenvalue is the smallest found from several
    starts, and proved to be the smallest if the mode of the lower bound is admissible. From 512 x
    512 points on, outside of transformations, the search starts from the mode on a coarser grid of
    about 256 x 256 points, and stops if its eigenvalue is within 1 % of the coarser one. If all but
    a few points touch, the starts can miss the smallest; then a state that is only held by contact
    may be called "stable".

    A surface with a hardness (`Contact`) is judged as it is left: where the pressure is H, the
    indentation can grow and never falls. Perturbations there are one-sided, x <= 0, in both cones;
    at a pressure below H they are as above.

    Eigenvalues, modes, barrier and complementarity are differentiable functions of the contact and
    the equilibrium: d lambda = x.(dA) x, A depending on the gap too. A derivative is NaN where it
    does not exist: for a multiple eigenvalue, for a least reaction that several points share, for
    the barrier of a state not held by contact, and for an eigenvalue that was not found. If several
    modes on different faces of the cone are equally low, the derivative belongs to the mode found.

    Arguments:
        contact: the contact problem; or one state of an `Evolution`, judged by the glassy solid,
            which answers at once.
        equilibrium: one of its equilibria, or a result that holds it: an entry of a sweep, a fold;
            none for a state of an evolution.
        solver: the algorithm for the cone, `ProjectedLOBPCG()` by default. Its tolerance applies
            to all three numbers.
        key: the random key of the vectors to start from, `jax.random.key(0)` by default.
        orders: on rings, the number of orders m = 1, 2, ... of perturbations x(r) cos(m theta) to
            judge beside the axisymmetric ones, by a dense eigenproblem each. The verdict then
            holds for all of these; by default for axisymmetric perturbations alone.
        verdict_only: stop when a number proves the verdict; those not computed are NaN, with the
            result "not_computed".
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        throw: raise an error if a solver fails. With False look at `result` instead. Under vmap
            the failure of one entry raises for all, so choose False there.

    Returns:
        Three eigenvalues with their modes, and the verdict that they prove.

    Warns:
        SymmetryWarning: for an unstable state whose mode breaks a symmetry that surface and gap
            share, a mirror image or a period along a side, as on a mirrored scan.

    Raises:
        ValueError: if the equilibrium has another grid or precision than the contact; for orders
            of a contact that is not on rings.
        TypeError: if the solver is not one for cones, the key not a random one, or an equilibrium
            is given beside a state of an evolution.
        SolverError: if `throw`, for an equilibrium or an eigenvalue that did not converge.

    Example:
        >>> stability = js.assess_stability(contact, state)
        >>> f"{stability.cone.eigenvalue:.3f}, {stability.critical.eigenvalue:.3f}"
        '-2.276, 1.282'
        >>> print(stability.verdict)
        held_by_contact
    """
    if isinstance(contact, HasInstant):
        if equilibrium is not None:
            raise TypeError(
                "A state of an evolution holds its equilibrium: give no other beside it."
            )
        contact, equilibrium = contact.instant
    equilibrium = equilibrium_of(contact, equilibrium)
    warn_if_coarse(contact)
    solver = solver_or_default(solver, ConeSolver, ProjectedLOBPCG)
    key = key_or_default(key)
    orders = require_orders(contact, orders)
    problem = posed_state(contact, equilibrium)
    inputs = problem.contact, problem.equilibrium
    solver = solver.in_units_of(problem.unit)
    constants = jax.lax.stop_gradient((*inputs, solver, key, jax.device_put(verdict_only)))
    watch = progress_bar("stability", _NUM_SEARCHES, "search", shown=progress, inputs=constants)
    with own_conventions(), watch:
        stability = _assess(*constants)
        # Not all searches are needed.
        advance_to(lambda: _NUM_SEARCHES)
        stability = with_derivatives(stability, inputs)
    stability = finish(stability, problem, describe, throw)
    warn_of_symmetry(contact, equilibrium, stability)
    return with_angular_modes(stability, contact, equilibrium.gap, orders)


@in_pieces
def _assess(
    contact: Contact,
    equilibrium: Equilibrium,
    solver: ConeSolver,
    key: PRNGKeyArray,
    verdict_only: Flag,
) -> Stability:
    problems, state = problems_of(contact, equilibrium)
    spaces = Davidson(solver.tolerance_in(equilibrium.gap.dtype))
    found = smallest_eigenpairs(problems, solver, spaces, key, verdict_only)
    is_equilibrium = state.result == RESULTS.successful
    found = cond(is_equilibrium, lambda: found, lambda: found.without_numbers(state.result))
    return _stability(equilibrium, state, found)


@program
def _stability(equilibrium: Equilibrium, state: AssessedState, found: SmallestPairs) -> Stability:
    """Return the verdict on the eigenpairs of a search."""
    found = found.in_order()
    softest = jnp.abs(found.critical_hull.eigenvalue)
    pairs = found.lower_bound, found.cone, found.critical, found.critical_hull
    lower_bound, cone, critical, critical_hull = state.with_error_of_state(pairs, softest)
    # On a smaller set the smallest is not lower.
    cone = replace(cone, bound=jnp.maximum(cone.bound, lower_bound.bound))
    critical = replace(critical, bound=jnp.maximum(critical.bound, cone.bound))
    result = first_failure(lower_bound, cone, critical)
    # If the smallest eigenvalue is positive with all doubtful points free, so is the one on the
    # smaller cone.
    is_critical_positive = (critical.sign > 0) | (critical_hull.sign > 0)
    verdict = VERDICTS.where(
        result == RESULTS.successful,
        verdict_on(lower_bound, cone, critical, is_critical_positive),
        VERDICTS.undecided,
    )
    is_held = verdict == VERDICTS.held_by_contact
    complementarity, barrier = margins_of(state.scale, state.area, equilibrium, cone, is_held)
    return Stability(
        lower_bound=lower_bound,
        cone=cone,
        critical=critical,
        complementarity=complementarity,
        barrier=barrier,
        verdict=verdict,
        proved=proof_of(verdict, cone, critical),
        result=result,
        units=equilibrium.units,
    )


@where_traced
def with_derivatives(stability: Stability, inputs: tuple[Contact, Equilibrium]) -> Stability:
    """Return a stability as a differentiable function of the contact and the equilibrium."""
    contact, equilibrium = inputs
    fixes_mean = contact.control(equilibrium.load).fixes_mean

    gap = equilibrium.gap
    free = ~(gap == 0)
    largest = contact.largest_reaction
    if largest is not None:
        # The law has no curvature where the surface yields, as where a signed gap is negative.
        yields = ~free & (equilibrium.reaction >= (1 - AT_HARDNESS) * largest)
        gap = jnp.where(yields, -1, gap)

    def attach(pair: Eigenpair, is_moving: Mask) -> Eigenpair:
        face = Subspace(is_moving, fixes_mean)
        return differentiable(pair, face, contact, equilibrium.load, gap)

    cone = attach(stability.cone, free | (stability.cone.mode != 0))
    margins = stability.complementarity, stability.barrier
    is_held = stability.verdict == VERDICTS.held_by_contact
    complementarity, barrier = differentiable_margins(margins, contact, equilibrium, cone, is_held)
    return replace(
        stability,
        lower_bound=attach(stability.lower_bound, jnp.ones_like(free)),
        cone=cone,
        critical=attach(stability.critical, free | (stability.critical.mode != 0)),
        complementarity=complementarity,
        barrier=barrier,
    )

"""The stability of an equilibrium, from the smallest eigenvalues of its energy's Hessian."""

from dataclasses import replace
from functools import partial
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from jaxstab.contact.contact import Contact
from jaxstab.contact.entry import answer
from jaxstab.contact.hessian import Hessian
from jaxstab.contact.resolution import warn_if_coarse
from jaxstab.core import model
from jaxstab.core.checks import is_traced
from jaxstab.core.compile import program
from jaxstab.core.control_flow import by_entries
from jaxstab.core.grid import total
from jaxstab.core.loop import solver_or_default
from jaxstab.core.progress import advance_to
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Mask, Scalar
from jaxstab.equilibrium.derivatives import third_derivative
from jaxstab.equilibrium.equilibrium import Equilibrium, State, equilibrium_of
from jaxstab.equilibrium.verify import recognised_by
from jaxstab.equilibrium.window import padded_state
from jaxstab.stability.barrier import differentiable as differentiable_margins
from jaxstab.stability.barrier import margins_of, pressure_scale
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.derivatives import differentiable
from jaxstab.stability.eigenpair import Eigenpair
from jaxstab.stability.eigenproblems import Eigenproblems, Found
from jaxstab.stability.search import smallest_eigenpairs
from jaxstab.stability.solvers.base import ConeSolver
from jaxstab.stability.solvers.cone_lobpcg import ProjectedLOBPCG
from jaxstab.stability.solvers.davidson import Davidson
from jaxstab.stability.verdict import (
    VERDICTS,
    Stability,
    describe,
    first_failure,
    proof_of,
    verdict_on,
)

_Inputs = tuple[Contact, Equilibrium, ConeSolver, PRNGKeyArray]
# The lower bound, the critical cone and the cone take one search each.
_NUM_SEARCHES = 3
# Reactions below this part of the pressure count as none, in units of the precision.
_ROUNDING = 1e3
# How much more than estimated a gap may be off.
_DOUBT = 10


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
    verdict_only: bool = False,
    progress: bool | None = None,
    throw: bool = True,
) -> Stability:
    """Return the stability of an equilibrium against admissible perturbations (Rey & Bleyer, 22).

    On a linear space the eigenvalue is the smallest. The critical cone is a linear space if all
    contact points are under pressure. On the cone the eigenvalue is the smallest found from several
    starts, and proved to be the smallest if the mode of the lower bound is admissible. From 512 x
    512 points on, the search starts from the mode on every other point, and stops if its eigenvalue
    is within 1 % of the coarser one. If all but a few points touch, the starts can miss the
    smallest; then a state that is only held by contact may be called "stable".

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
        verdict_only: stop when a number proves the verdict; those not computed are NaN, with the
            result "not_computed".
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        throw: raise an error if a solver fails. With False look at `result` instead. Under vmap
            the failure of one entry raises for all, so choose False there.

    Returns:
        Three eigenvalues with their modes, and the verdict that they prove.

    Raises:
        ValueError: if the equilibrium has another grid or precision than the contact.
        TypeError: if the solver is not one for cones, the key not a random one, or an equilibrium
            is given beside a state of an evolution.
        SolverError: if `throw`, for an equilibrium or an eigenvalue that did not converge.
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
    key = jax.random.key(0) if key is None else key
    contact, equilibrium = padded_state(contact, equilibrium)
    return answer(
        partial(_assess, verdict_only),
        contact,
        equilibrium,
        solver,
        key,
        bar=(_NUM_SEARCHES, "search", progress),
        differentiable=with_derivatives,
        describe=describe,
        throw=throw,
        has_units=True,
    )


def _assess(verdict_only: bool, *inputs: *_Inputs) -> Stability:
    stability = (_assess_batch if is_traced(inputs) else _assess_one)(verdict_only, *inputs)
    # Not all searches are needed.
    advance_to(lambda: _NUM_SEARCHES)
    return stability


# A program, or `jax.vmap` outside of `jax.jit` would compile it anew with each call.
@partial(program, static_argnums=0)
def _assess_batch(verdict_only: bool, *inputs: *_Inputs) -> Stability:
    return by_entries(partial(_assess_one, verdict_only))(*inputs)


def with_derivatives(contact: Contact, equilibrium: Equilibrium, stability: Stability) -> Stability:
    """Return a stability as a differentiable function of the contact and the equilibrium."""
    if not is_traced((contact, equilibrium)):
        return stability
    # Squares of pressures over lengths stay in range in this unit.
    unit = contact.own_pressure
    contact, equilibrium = contact.in_units_of(unit), equilibrium.in_units_of(unit)
    stability = stability.in_units_of(unit)
    fixes_mean = contact.control(equilibrium.load).fixes_mean

    def attach(pair: Eigenpair, is_moving: Mask) -> Eigenpair:
        face = Subspace(is_moving, fixes_mean)
        return differentiable(pair, face, contact, equilibrium.load, equilibrium.gap)

    free = ~equilibrium.in_contact
    cone = attach(stability.cone, free | (stability.cone.mode > 0))
    margins = stability.complementarity, stability.barrier
    is_held = stability.verdict == VERDICTS.held_by_contact
    complementarity, barrier = differentiable_margins(margins, contact, equilibrium, cone, is_held)
    found = replace(
        stability,
        lower_bound=attach(stability.lower_bound, jnp.ones_like(free)),
        cone=cone,
        critical=attach(stability.critical, free | (stability.critical.mode > 0)),
        complementarity=complementarity,
        barrier=barrier,
    )
    return found.in_units_of(1 / unit)


def _assess_one(
    verdict_only: bool,
    contact: Contact,
    equilibrium: Equilibrium,
    solver: ConeSolver,
    key: PRNGKeyArray,
) -> Stability:
    problems, state = _problems(contact, equilibrium, key)
    found = smallest_eigenpairs(
        problems,
        solver,
        Davidson(solver.tolerance_in(equilibrium.gap.dtype)),
        verdict_only=verdict_only,
    )
    return _stability(equilibrium, state, found)


class _AssessedState(eqx.Module):
    """The data of a state that its stability is computed from.

    Attributes:
        result: whether it is an equilibrium of this contact.
        unit: the contact's own unit of pressure, in which all is meanwhile.
        area: the area of a point [length^2].
        scale: the rms of elastic pressure and attraction [pressure].
        imbalance: the norm of the pressures that are out of balance [pressure].
        sharpness: f'''(g) at the free points [pressure/length^2].
    """

    result: RESULTS
    unit: Scalar
    area: Scalar
    scale: Scalar
    imbalance: Scalar
    sharpness: Field

    def covered(self, pair: Eigenpair, softest: Scalar) -> Eigenpair:
        """Return a pair whose error covers the error of the state, given its softest eigenvalue.

        The gap may be off by dg = A^-1 r, and d lambda = sum f''' x^2 dg. Without an equilibrium
        there is no number.
        """
        is_found = self.result == RESULTS.successful
        off = _DOUBT * self.imbalance / jnp.where(softest > 0, softest, 1)
        change = jnp.sqrt(total((off * self.sharpness * pair.mode**2) ** 2))
        return replace(
            pair,
            eigenvalue=jnp.where(is_found, pair.eigenvalue, jnp.nan),
            error=pair.error + change,
            proved=pair.proved & is_found,
            bound=jnp.where(is_found, pair.bound - change, -jnp.inf),
            result=RESULTS.where(is_found, pair.result, self.result),
        )


@program
def _problems(
    contact: Contact, equilibrium: Equilibrium, key: PRNGKeyArray
) -> tuple[Eigenproblems, _AssessedState]:
    """Return the eigenproblems of an equilibrium, and the data of that state."""
    unit = contact.own_pressure
    contact, equilibrium = contact.in_units_of(unit), equilibrium.in_units_of(unit)
    gap, in_contact = equilibrium.gap, equilibrium.in_contact
    control = contact.control(equilibrium.load)
    balance = contact.balance(control)(gap)
    result = recognised_by(balance, contact, equilibrium)
    is_found = result == RESULTS.successful
    in_contact &= is_found
    curvature = jnp.where(is_found, balance.curvature, 0)
    hessian = Hessian(contact.solid, curvature, control.stiffness)
    imbalance = jnp.sqrt(total(model.imbalance(balance.net, gap) ** 2))
    scale = pressure_scale(contact, gap, equilibrium.pressure)
    # The net pressure of a point may be wrong by this.
    error = imbalance + _ROUNDING * jnp.finfo(gap.dtype).eps * scale
    weak = in_contact & (balance.net <= error)
    nearly_touching = ~in_contact & (gap * hessian.solid.max_stiffness <= error)
    # Where there is nothing to assess, nothing moves.
    nowhere = contact.grid.device_put(jnp.zeros_like(in_contact) | ~is_found)
    problems = Eigenproblems(
        hessian=hessian,
        cone=AdmissibleCone(in_contact, nowhere, control.fixes_mean),
        critical_cone=AdmissibleCone(weak, nowhere | (in_contact & ~weak), control.fixes_mean),
        key=key,
        nearly_touching=nearly_touching,
        touches=jnp.any(in_contact),
        is_weak=jnp.any(weak),
        is_doubtful=jnp.any(weak | nearly_touching),
    )
    sharpness = jnp.where(in_contact, 0, third_derivative(contact, gap))
    state = _AssessedState(result, unit, contact.grid.cell_area, scale, imbalance, sharpness)
    return problems, state


@program
def _stability(equilibrium: Equilibrium, state: _AssessedState, found: Found) -> Stability:
    """Return the verdict on the eigenpairs of a search."""
    equilibrium, found = equilibrium.in_units_of(state.unit), found.ordered()
    softest = jnp.abs(found.hull.eigenvalue)
    lower_bound, cone, critical, hull = (
        state.covered(pair, softest)
        for pair in (found.lower_bound, found.cone, found.critical, found.hull)
    )
    # On a smaller set the smallest is not lower.
    cone = replace(cone, bound=jnp.maximum(cone.bound, lower_bound.bound))
    critical = replace(critical, bound=jnp.maximum(critical.bound, cone.bound))
    result = first_failure(lower_bound, cone, critical)
    # Where all points in doubt may move and nothing gives way, nothing does where they stay.
    holds = (critical.sign > 0) | (hull.sign > 0)
    verdict = VERDICTS.where(
        result == RESULTS.successful,
        verdict_on(lower_bound, cone, critical, holds),
        VERDICTS.undecided,
    )
    is_held = verdict == VERDICTS.held_by_contact
    complementarity, barrier = margins_of(state.scale, state.area, equilibrium, cone, is_held)
    stability = Stability(
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
    return stability.in_units_of(1 / state.unit)

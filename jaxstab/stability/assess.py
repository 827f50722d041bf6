"""The stability of an equilibrium, from the smallest eigenvalues of its energy's Hessian."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxstab.checks import is_traced
from jaxstab.contact import Contact
from jaxstab.display import block
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrate import State, equilibrium_of
from jaxstab.equilibrium.implicit import third_derivative
from jaxstab.equilibrium.recognition import recognised_by
from jaxstab.grid import total
from jaxstab.hessian import Hessian
from jaxstab.lanes import by_lanes
from jaxstab.programs import program
from jaxstab.resolution import warn_if_coarse
from jaxstab.results import RESULTS, VERDICTS, throw_failure
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpairs import Eigenpair
from jaxstab.stability.implicit import differentiable
from jaxstab.stability.margins import Barrier, margins_of, pressure_scale
from jaxstab.stability.margins import differentiable as differentiable_margins
from jaxstab.stability.modes import noise
from jaxstab.stability.projected import ProjectedLOBPCG
from jaxstab.stability.search import ConeSolver, Found, Search
from jaxstab.stacks import Stackable

# Random vectors to start from.
_NUM_RANDOM = 8
# Over the precision: reactions below this part of the pressure are none.
_ROUNDING = 1e3
# How much more than estimated a gap may be off.
_DOUBT = 10


class Stability(Stackable, eqx.Module):
    """What is known of the stability of an equilibrium.

    Always lower_bound <= cone <= critical.

    Attributes:
        lower_bound: the smallest eigenvalue among all perturbations that the load allows: those of
            zero mean under a prescribed mean gap, all under a prescribed pressure.
        cone: that on V0+, where perturbations do not enter the surface either (Rey & Bleyer,
            eq. 26). Positive means stable; negative proves nothing where contact presses, since
            lifting off then costs energy at first order.
        critical: that on the critical cone, where points in contact stay if they press, and may
            lift off if they do not. Negative means unstable.
        complementarity: the least reaction at a point in contact, over the rms of elastic pressure
            and attraction; +inf without contact. Near zero, a point is about to lift off.
        barrier: that of a state held by contact, along the cone's mode to second order; NaN
            elsewhere.
        verdict: a member of `VERDICTS`.
        result: how the solvers ended: the first failure, or successful.
    """

    lower_bound: Eigenpair
    cone: Eigenpair
    critical: Eigenpair
    complementarity: Float[Array, ""]
    barrier: Barrier
    verdict: VERDICTS
    result: RESULTS

    __repr__ = block

    def in_units_of(self, pressure: Float[Array, ""]) -> "Stability":
        """Return the same stability with pressures in another unit; lengths stay."""
        return replace(
            self,
            lower_bound=self.lower_bound.in_units_of(pressure),
            cone=self.cone.in_units_of(pressure),
            critical=self.critical.in_units_of(pressure),
            barrier=replace(self.barrier, height=self.barrier.height / pressure),
        )

    @property
    def pairs(self) -> dict[str, Eigenpair]:
        """The three eigenpairs by name, from the lowest to the highest."""
        return {"lower_bound": self.lower_bound, "cone": self.cone, "critical": self.critical}


def assess_stability(
    contact: Contact,
    equilibrium: State,
    solver: ConeSolver | None = None,
    *,
    key: PRNGKeyArray | None = None,
    verdict_only: bool = False,
    throw: bool = True,
) -> Stability:
    """Return the stability of an equilibrium against admissible perturbations (Rey & Bleyer, 22).

    On a linear space the eigenvalue is the smallest; the critical cone is one where all contact
    presses. On the cone it is the smallest that several starts lead to, or proved to be the
    smallest where the mode of the lower bound is admissible. Where all but a few points touch,
    starts can miss the smallest, and call "stable" what is held by contact.

    Eigenvalues, modes, barrier and complementarity are differentiable functions of the contact and
    the equilibrium: d lambda = x.(dA) x, A depending on the gap too. No derivative
    has a multiple eigenvalue, a least reaction that several points share, and the barrier of a
    state that is not held. Of several modes on different faces of the cone that are equally low,
    the derivative is that of the one found.

    Arguments:
        contact: the contact problem.
        equilibrium: one of its equilibria, or what holds it: an entry of a sweep, a fold.
        solver: the algorithm for the cone, `ProjectedLOBPCG()` by default. Its tolerance is that
            of all three numbers.
        key: the random key of the vectors to start from, `jax.random.key(0)` by default.
        verdict_only: stop when a number proves the verdict; those not computed are NaN, with the
            result "not_computed".
        throw: raise where a solver fails, or a derivative is asked for that does not exist (in
            forward mode outside of jit, of any of the numbers); otherwise look at `result`,
            and such a derivative is NaN. Under vmap the failure of one lane raises for all, so
            choose False there.

    Returns:
        Three eigenvalues with their modes, and the verdict that they prove.

    Raises:
        ValueError: if the equilibrium is not on the contact's grid.
        SolverError: if `throw`, for an equilibrium or an eigenvalue that did not converge.
    """
    equilibrium = equilibrium_of(contact, equilibrium)
    warn_if_coarse(contact)
    solver = ProjectedLOBPCG() if solver is None else solver
    key = jax.random.key(0) if key is None else key
    inputs = jax.lax.stop_gradient((contact, equilibrium, solver, key))
    # Histories end in NaN, and what was not found is NaN.
    with jax.debug_nans(False):
        stability = judge(*inputs, verdict_only)
    if is_traced((contact, equilibrium)):
        stability = with_derivatives(contact, equilibrium, stability, throw)
    if not throw:
        return stability
    return throw_failure(stability.result, stability, lambda: _describe(stability))


def judge(
    contact: Contact,
    equilibrium: Equilibrium,
    solver: ConeSolver,
    key: PRNGKeyArray,
    verdict_only: bool = False,
) -> Stability:
    """Do what `assess_stability` does, on checked arguments, without derivatives."""
    if is_traced((contact, equilibrium, solver, key)):
        return by_lanes(partial(_judge, verdict_only))(contact, equilibrium, solver, key)
    return _judge(verdict_only, contact, equilibrium, solver, key)


def with_derivatives(
    contact: Contact, equilibrium: Equilibrium, stability: Stability, throw: bool = False
) -> Stability:
    """Return a stability as a differentiable function of the contact and the equilibrium."""
    fixes_mean = equilibrium.load.control(contact.heights).fixes_mean

    def attach(pair: Eigenpair, is_moving: Bool[Array, " *grid"]) -> Eigenpair:
        face = Subspace(is_moving, fixes_mean)
        return differentiable(pair, face, contact, equilibrium.gap, throw)

    free = ~equilibrium.in_contact
    cone = attach(stability.cone, free | (stability.cone.mode > 0))
    margins = stability.complementarity, stability.barrier
    is_held = stability.verdict == VERDICTS.held_by_contact
    complementarity, barrier = differentiable_margins(
        margins, contact, equilibrium, cone, is_held, throw
    )
    return replace(
        stability,
        lower_bound=attach(stability.lower_bound, jnp.ones_like(free)),
        cone=cone,
        critical=attach(stability.critical, free | (stability.critical.mode > 0)),
        complementarity=complementarity,
        barrier=barrier,
    )


def _judge(
    verdict_only: bool,
    contact: Contact,
    equilibrium: Equilibrium,
    solver: ConeSolver,
    key: PRNGKeyArray,
) -> Stability:
    search, state = _prepared(contact, equilibrium, key, verdict_only)
    return _stability(equilibrium, state, search.run(solver))


class _State(eqx.Module):
    """What is known of a state before its stability is.

    Attributes:
        result: whether it is an equilibrium of this contact.
        unit: the contact's own unit of pressure, in which all is meanwhile.
        area: that of a point [length^2].
        scale: the rms of elastic pressure and attraction [pressure].
        imbalance: the norm of the pressures that are out of balance [pressure].
        sharpness: f'''(g) at the free points [pressure/length^2].
    """

    result: RESULTS
    unit: Float[Array, ""]
    area: Float[Array, ""]
    scale: Float[Array, ""]
    imbalance: Float[Array, ""]
    sharpness: Float[Array, " *grid"]

    def covered(self, pair: Eigenpair, softest: Float[Array, ""]) -> Eigenpair:
        """Return a pair whose error covers that of the state, the softest of whose modes is given.

        The gap may be off by dg = A^-1 r, and d lambda = sum f''' x^2 dg. Without an equilibrium
        there is no number.
        """
        is_found = self.result == RESULTS.successful
        off = _DOUBT * self.imbalance / jnp.where(softest > 0, softest, 1)
        change = jnp.sqrt(total((self.sharpness * pair.mode**2) ** 2)) * off
        return replace(
            pair,
            eigenvalue=jnp.where(is_found, pair.eigenvalue, jnp.nan),
            error=pair.error + change,
            result=RESULTS.where(is_found, pair.result, self.result),
        )


@partial(program, static_argnames="verdict_only")
def _prepared(
    contact: Contact, equilibrium: Equilibrium, key: PRNGKeyArray, verdict_only: bool
) -> tuple[Search, _State]:
    """Return the search at an equilibrium, and what is known of that."""
    unit = contact.own_pressure
    contact, equilibrium = contact.in_units_of(unit), equilibrium.in_units_of(unit)
    gap, in_contact = equilibrium.gap, equilibrium.in_contact
    control = equilibrium.load.control(contact.heights)
    balance = contact.balance(control)(gap)
    result = recognised_by(balance, contact, equilibrium)
    hessian = Hessian(contact.solid.multiplier.astype(gap.dtype), balance.curvature)
    missed = jnp.where(in_contact, jnp.minimum(balance.net, 0), balance.net)
    imbalance = jnp.sqrt(total(missed**2))
    scale = pressure_scale(contact, gap, equilibrium.pressure)
    # By how much the net pressure of a point may be wrong.
    error = imbalance + _ROUNDING * jnp.finfo(gap.dtype).eps * scale
    weak = in_contact & (balance.net <= error)
    verge = ~in_contact & (gap * jnp.max(hessian.multiplier) <= error)
    nowhere = jnp.zeros_like(in_contact)
    random = noise(key, _NUM_RANDOM, gap)
    search = Search(
        hessian=hessian,
        cone=AdmissibleCone(in_contact, nowhere, control.fixes_mean),
        critical_cone=AdmissibleCone(weak, in_contact & ~weak, control.fixes_mean),
        # From NaN, solvers end at once.
        random=jnp.where(result == RESULTS.successful, random, jnp.nan),
        verge=verge,
        touches=jnp.any(in_contact),
        is_weak=jnp.any(weak),
        is_doubtful=jnp.any(weak | verge),
        verdict_only=verdict_only,
    )
    sharpness = jnp.where(in_contact, 0, third_derivative(contact, gap))
    state = _State(result, unit, contact.grid.cell_area, scale, imbalance, sharpness)
    return search, state


@jax.jit
def _stability(equilibrium: Equilibrium, state: _State, found: Found) -> Stability:
    """Return the verdict on what a search has found."""
    equilibrium = equilibrium.in_units_of(state.unit)
    found = found.ordered()
    softest = jnp.abs(found.hull.eigenvalue)
    lower_bound, cone, critical, hull = (
        state.covered(pair, softest)
        for pair in (found.lower_bound, found.cone, found.critical, found.hull)
    )
    result = _first_failure(lower_bound, cone, critical)
    # Where all points in doubt may move and nothing gives way, nothing does where they stay.
    holds = (critical.sign > 0) | (hull.sign > 0)
    verdict = VERDICTS.where(
        result == RESULTS.successful,
        _verdict(lower_bound, cone, critical, holds),
        VERDICTS.undecided,
    )
    is_held = verdict == VERDICTS.held_by_contact
    complementarity, barrier = margins_of(state.scale, equilibrium, cone, is_held)
    stability = Stability(
        lower_bound=lower_bound,
        cone=cone,
        critical=critical,
        complementarity=complementarity,
        barrier=barrier.over(state.area),
        verdict=verdict,
        result=result,
    )
    return stability.in_units_of(1 / state.unit)


def _first_failure(*pairs: Eigenpair) -> RESULTS:
    result = RESULTS.successful
    for pair in reversed(pairs):
        failed = (pair.result != RESULTS.successful) & (pair.result != RESULTS.not_computed)
        result = RESULTS.where(failed, pair.result, result)
    return result


def _verdict(
    lower_bound: Eigenpair, cone: Eigenpair, critical: Eigenpair, holds: Bool[Array, ""]
) -> VERDICTS:
    is_held = (cone.sign < 0) & holds
    verdict = VERDICTS.where(is_held, VERDICTS.held_by_contact, VERDICTS.undecided)
    verdict = VERDICTS.where(critical.sign < 0, VERDICTS.unstable, verdict)
    is_stable = (cone.sign > 0) | (lower_bound.sign > 0)
    return VERDICTS.where(is_stable, VERDICTS.stable, verdict)


def _describe(stability: Stability) -> str:
    for name, pair in stability.pairs.items():
        if pair.result == RESULTS.other_contact:
            return "There is nothing to assess"
        if pair.result != RESULTS.successful and pair.result != RESULTS.not_computed:
            return (
                f"The {name} eigenvalue was not found after {int(pair.num_steps)} steps; at "
                f"{float(pair.eigenvalue):.6g} the projected residual is {float(pair.residual):.3g}"
            )
    return "All eigenvalues were found"

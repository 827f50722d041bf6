"""The stability of an equilibrium, from the smallest eigenvalues of its energy's Hessian."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxstab.contact import Contact
from jaxstab.equilibrium import Equilibrium
from jaxstab.iterate import History, refuse_derivatives
from jaxstab.lanes import by_lanes
from jaxstab.resolution import warn_if_coarse
from jaxstab.results import RESULTS, VERDICTS, throw_failure
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.proximal import ProximalIteration, admissible_pair, unit_vector


class Eigenpair(eqx.Module):
    """A smallest eigenvalue of A = K + D among admissible unit vectors, and its mode.

    Attributes:
        eigenvalue: lambda = x.Ax / x.x, without the factor 1/2 of Rey & Bleyer's eq. 26
            [pressure/length]; +inf where no perturbation is admissible.
        mode: x, of unit Euclidean norm; zero where no perturbation is admissible.
        residual: the projected residual |x - P(x - (A x - lambda x) / b)|, b a bound on |A|.
        error: b times the residual: how far the eigenvalue is from one of A's, to first order
            [pressure/length].
        num_steps: steps that the solver took.
        result: a member of `RESULTS`: how the solver ended.
        history: the indicators "residual", "epsilon" and "eta" of the solver as it went.
    """

    eigenvalue: Float[Array, ""]
    mode: Float[Array, " *grid"]
    residual: Float[Array, ""]
    error: Float[Array, ""]
    num_steps: Int[Array, ""]
    result: RESULTS
    history: History


class Stability(eqx.Module):
    """What is known of the stability of an equilibrium.

    Attributes:
        cone: the smallest eigenvalue found on V0+, where perturbations do not enter the surface
            and, under a prescribed mean gap, have zero mean (Rey & Bleyer, eq. 26). Positive means
            stable; negative proves nothing where contact presses, since lifting off then costs
            energy at first order.
        lower_bound: that among all perturbations of zero mean; not computed yet.
        critical: that on the critical cone; not computed yet.
        verdict: a member of `VERDICTS`.
    """

    cone: Eigenpair
    lower_bound: Eigenpair | None
    critical: Eigenpair | None
    verdict: VERDICTS


def assess_stability(
    contact: Contact,
    equilibrium: Equilibrium,
    solver: ProximalIteration | None = None,
    *,
    key: PRNGKeyArray | None = None,
    throw: bool = True,
) -> Stability:
    """Return the stability of an equilibrium against admissible perturbations (Rey & Bleyer, 22).

    The solver finds a local minimiser of the Rayleigh quotient. Where the cone is not a linear
    space it can miss a smaller one: assess again with other keys where it matters.

    Arguments:
        contact: the contact problem.
        equilibrium: one of its equilibria.
        solver: the algorithm, `ProximalIteration()` by default.
        key: the random key of the vector to start from, `jax.random.key(0)` by default.
        throw: raise where the solver fails; otherwise look at `cone.result`. Under vmap the
            failure of one lane raises for all, so choose False there.

    Returns:
        Eigenvalue, mode and verdict; the verdict is "undecided" unless the cone eigenvalue is
        positive by more than its error and both solvers converged.

    Raises:
        ValueError: if the equilibrium is not on the contact's grid.
        SolverError: if `throw`, for an equilibrium or an eigenvalue that did not converge.
    """
    if equilibrium.gap.shape != contact.grid.shape:
        raise ValueError(
            f"The equilibrium has shape {equilibrium.gap.shape}, the contact's grid "
            f"{contact.grid.shape}: assess it with the contact that it came from (and a sweep with "
            "jaxstab.sweep or jax.vmap)."
        )
    warn_if_coarse(contact)
    solver = solver or ProximalIteration()
    key = jax.random.key(0) if key is None else key
    stability = judge(contact, equilibrium, solver, key)
    if not throw:
        return stability
    return throw_failure(stability.cone.result, stability, lambda: _describe(stability.cone))


@jax.jit
def judge(
    contact: Contact,
    equilibrium: Equilibrium,
    solver: ProximalIteration,
    key: PRNGKeyArray,
) -> Stability:
    """Do what `assess_stability` does, on checked arguments and without raising."""
    contact, equilibrium = refuse_derivatives((contact, equilibrium))
    return by_lanes(_judge)(contact, equilibrium, solver, key)


def _judge(
    contact: Contact, equilibrium: Equilibrium, solver: ProximalIteration, key: PRNGKeyArray
) -> Stability:
    is_equilibrium = equilibrium.result == RESULTS.successful
    fixes_mean = equilibrium.load.control(contact.heights).fixes_mean
    cone = AdmissibleCone(equilibrium.in_contact, fixes_mean)
    pair = _smallest_eigenpair(contact, equilibrium, solver, cone, key, is_equilibrium)
    is_stable = (pair.result == RESULTS.successful) & (pair.eigenvalue > pair.error)
    verdict = VERDICTS.where(is_stable, VERDICTS.stable, VERDICTS.undecided)
    return Stability(cone=pair, lower_bound=None, critical=None, verdict=verdict)


def _smallest_eigenpair(
    contact: Contact,
    equilibrium: Equilibrium,
    solver: ProximalIteration,
    cone: AdmissibleCone,
    key: PRNGKeyArray,
    is_equilibrium: Bool[Array, ""],
) -> Eigenpair:
    gap = equilibrium.gap
    operator, diagonal = contact.hessian(gap), contact.curvature(gap)
    # K is positive, so that |A| lies between the largest of K + D and the smallest of D.
    highest = contact.solid.max_stiffness + jnp.maximum(jnp.max(diagonal), 0)
    bound = jnp.maximum(highest, -jnp.min(diagonal))

    start = unit_vector(cone, jax.random.normal(key, gap.shape, gap.dtype))
    start = jnp.where(is_equilibrium, start, jnp.nan)
    iteration = solver.solve(operator, bound, cone, start)
    eigenvalue, mode, _ = admissible_pair(operator, bound, cone, iteration.state.x)
    # One projected gradient step sets to exactly zero what the contact holds.
    moved = mode - (operator(mode) - eigenvalue * mode) / bound
    eigenvalue, mode, residual = admissible_pair(operator, bound, cone, moved)
    return Eigenpair(
        eigenvalue=jnp.where(cone.is_trivial, jnp.inf, eigenvalue),
        mode=mode,
        residual=residual,
        error=bound * residual,
        num_steps=iteration.num_steps,
        result=RESULTS.where(is_equilibrium, iteration.result, RESULTS.no_equilibrium),
        history=iteration.history,
    )


def _describe(pair: Eigenpair) -> str:
    return (
        f"No smallest eigenvalue found after {int(pair.num_steps)} steps; at "
        f"{float(pair.eigenvalue):.6g} the projected residual is {float(pair.residual):.3g}"
    )

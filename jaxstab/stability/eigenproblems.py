"""The eigenproblems of an equilibrium, and their smallest eigenpairs."""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxstab.contact.contact import Contact
from jaxstab.contact.hessian import Hessian
from jaxstab.core.accuracy import rounding_of_fields
from jaxstab.core.checks import array
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose
from jaxstab.core.grid import total
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.equilibrium.derivatives import third_derivative
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.equilibrium.verify import verify_balance
from jaxstab.stability.barrier import pressure_scale
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import Eigenpair, admissible_pair, lower
from jaxstab.stability.lowest_pair import cost_of, with_cost
from jaxstab.stability.ritz import norms
from jaxstab.stability.solvers.base import ConeProblem

# How much more than estimated a gap may be off.
_DOUBT = 10


class Eigenproblems(eqx.Module):
    """The eigenproblems of an equilibrium.

    Attributes:
        cone: A on V0+, where all points may move.
        critical_cone: A on the critical cone.
        nearly_touching: points that may be in contact, to within the error of the state.
        touches: whether the surfaces touch anywhere.
        is_weak: whether they do so anywhere without pressing beyond an error.
        is_doubtful: whether it is in doubt of any point that it touches or presses.
    """

    cone: ConeProblem
    critical_cone: ConeProblem
    nearly_touching: Mask
    touches: Flag
    is_weak: Flag
    is_doubtful: Flag


class AssessedState(eqx.Module):
    """The data of a state that its stability is computed from.

    Attributes:
        result: whether it is an equilibrium of this contact.
        area: the area of a point [length^2].
        scale: the rms of elastic pressure and attraction [pressure].
        imbalance: the norm of the pressures that are out of balance [pressure].
        sharpness: f'''(g) at the free points [pressure/length^2].

    Imbalance and sharpness are zero if it is none.
    """

    result: RESULTS
    area: Scalar
    scale: Scalar
    imbalance: Scalar
    sharpness: Field

    def with_error_of_state(self, pairs: Sequence[Eigenpair], softest: Scalar) -> list[Eigenpair]:
        """Return pairs whose errors cover the error of the state, given its softest eigenvalue.

        The gap may be off by dg = A^-1 r, and d lambda = sum f''' x^2 dg.
        """
        off = _DOUBT * self.imbalance / jnp.where(softest > 0, softest, 1)
        changes = off * norms([self.sharpness * pair.mode**2 for pair in pairs])
        return [
            replace(pair, error=pair.error + change, bound=pair.bound - change)
            for pair, change in zip(pairs, changes, strict=True)
        ]


class SmallestPairs(eqx.Module):
    """The smallest eigenpairs of an equilibrium.

    Attributes:
        lower_bound: on all perturbations that the load allows.
        cone: on V0+.
        critical: on the critical cone.
        critical_hull: on the linear space around the critical cone.
    """

    lower_bound: Eigenpair
    cone: Eigenpair
    critical: Eigenpair
    critical_hull: Eigenpair

    def without(self, name: str) -> "SmallestPairs":
        """Return the same, with one of the pairs not computed."""
        pair = getattr(self, name)
        unknown = array(np.nan, pair.eigenvalue.dtype)
        left_out = replace(pair, eigenvalue=unknown, result=RESULTS.not_computed)
        return replace(self, **{name: left_out})

    def without_numbers(self, result: RESULTS) -> "SmallestPairs":
        """Return pairs without numbers, of a state that is no equilibrium."""
        dtype = self.cone.eigenvalue.dtype
        changes = {
            "eigenvalue": array(np.nan, dtype),
            "proved": array(False),
            "bound": array(-np.inf, dtype),
            "result": result,
        }
        pairs = self.lower_bound, self.cone, self.critical, self.critical_hull
        return SmallestPairs(*(replace(pair, **changes) for pair in pairs))

    def in_order(self) -> "SmallestPairs":
        """Return pairs of which none is above one on a smaller cone."""
        critical = with_cost(cost_of(self.critical_hull), self.critical)
        on_critical = critical.eigenvalue, critical.mode
        cone = lower(self.cone, *on_critical)
        on_cone = cone.eigenvalue, cone.mode
        # The one on V0+ is not above the critical one, but may be unknown.
        lower_bound = lower(
            self.lower_bound, *choose(jnp.isnan(cone.eigenvalue), on_critical, on_cone)
        )
        return replace(self, lower_bound=lower_bound, cone=cone, critical=critical)


@program
def problems_of(contact: Contact, equilibrium: Equilibrium) -> tuple[Eigenproblems, AssessedState]:
    """Return the eigenproblems of an equilibrium, and the data of that state."""
    gap = equilibrium.gap
    control = contact.control(equilibrium.load)
    balance = contact.balance(control)(gap)
    result = verify_balance(balance, contact, equilibrium)
    is_found = result == RESULTS.successful
    is_closed = (gap == 0) & is_found
    imbalance = jnp.sqrt(total(control.imbalance(balance.net, gap) ** 2))
    scale = pressure_scale(contact, gap, equilibrium.pressure)
    # The net pressure of a point may be wrong by this.
    error = imbalance + rounding_of_fields(gap.dtype) * scale
    weak = is_closed & (balance.net <= error)
    curvature = balance.curvature
    sign = None
    if control.largest_reaction is not None:
        # The surface yields on where its pressure is H, which it may have missed by its residual
        # when it was found.
        missed = error + equilibrium.residual * scale * jnp.sqrt(gap.size)
        yields = is_closed & (balance.net >= control.largest_reaction - missed)
        weak |= yields
        sign = jnp.where(yields, -1, 1).astype(gap.dtype)
        curvature = jnp.where(yields, 0, curvature)
    nearly_touching = ~is_closed & (gap * contact.solid.max_stiffness <= error)
    # Where there is nothing to assess, nothing moves.
    nowhere = contact.grid.device_put(jnp.zeros_like(is_closed) | ~is_found)
    v0 = AdmissibleCone(is_closed, nowhere, control.fixes_mean, sign)
    critical = AdmissibleCone(weak, nowhere | (is_closed & ~weak), control.fixes_mean, sign)
    hessian = Hessian(contact.solid, curvature, control.stiffness, v0.is_moving)
    problems = Eigenproblems(
        cone=ConeProblem(hessian, v0),
        critical_cone=ConeProblem.of(hessian, critical),
        nearly_touching=nearly_touching,
        touches=jnp.any(is_closed),
        is_weak=jnp.any(weak),
        is_doubtful=jnp.any(_positive(weak, sign) | nearly_touching),
    )
    sharpness = jnp.where(v0.is_moving & ~is_closed, third_derivative(contact, gap), 0)
    imbalance = jnp.where(is_found, imbalance, 0)
    state = AssessedState(result, contact.grid.cell_area, scale, imbalance, sharpness)
    return problems, state


@program
def covering_doubt(problems: Eigenproblems, found: SmallestPairs) -> SmallestPairs:
    """Return the pairs on both cones with errors that cover the points in doubt.

    The critical eigenvalue lies between the hull's, where these points all move freely, and
    the quotient of its mode where they all stay. On V0+ those that nearly touch may be one-sided
    too, which raises the quotient of the mode; and those that hardly press may be free, where the
    mode leaves a residual.
    """
    hessian = problems.cone.operator
    v0 = problems.cone.domain
    near = problems.nearly_touching
    critical = found.critical
    hull = found.critical_hull
    cone = found.cone
    held = Subspace(~(v0.one_sided | near), v0.fixes_mean)
    above, _, _ = admissible_pair(hessian.restriction(held.is_moving), held, critical.mode)
    rise = _rise(above, critical.eigenvalue)
    fall = _rise(critical.eigenvalue, hull.eigenvalue - hull.error)

    pressing = v0.one_sided & ~_positive(problems.critical_cone.domain.one_sided, v0.sign)
    closed = AdmissibleCone(v0.one_sided | near, v0.held, v0.fixes_mean, v0.sign)
    opened = AdmissibleCone(pressing, v0.held, v0.fixes_mean, v0.sign)
    above, _, _ = admissible_pair(hessian, closed, cone.mode)
    _, _, residual = admissible_pair(hessian, opened, cone.mode)
    off = jnp.maximum(_rise(above, cone.eigenvalue), hessian.scale * residual)
    return replace(
        found,
        critical=_with_error(critical, jnp.maximum(rise, fall)),
        cone=_with_error(cone, off),
    )


def _positive(one_sided: Mask, sign: Field | None) -> Mask:
    """Return the one-sided points that do not yield."""
    if sign is None:
        return one_sided
    return one_sided & (sign > 0)


def _rise(above: Scalar, below: Scalar) -> Scalar:
    # Two infinite numbers are alike.
    return jnp.where(above == below, 0, above - below)


def _with_error(pair: Eigenpair, error: Scalar) -> Eigenpair:
    error = jnp.where(jnp.isnan(error), jnp.inf, error)
    pair = replace(pair, error=jnp.maximum(pair.error, error))
    return pair.with_proof(pair.proved)

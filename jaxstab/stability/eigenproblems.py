"""The eigenproblems of an equilibrium, and their smallest eigenpairs."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, PRNGKeyArray

from jaxstab.contact.hessian import Hessian
from jaxstab.core.compile import program
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Flag, Mask, Scalar
from jaxstab.stability.cones import AdmissibleCone, Subspace
from jaxstab.stability.eigenpair import Eigenpair, admissible_pair, lowered
from jaxstab.stability.lowest_pair import with_cost_of


class Eigenproblems(eqx.Module):
    """The eigenproblems of an equilibrium.

    Attributes:
        hessian: A.
        cone: V0+.
        critical_cone: the critical cone.
        key: the random key of vectors to start from.
        nearly_touching: points that may be in contact, to within the error of the state.
        touches: whether the surfaces touch anywhere.
        is_weak: whether they do so anywhere without pressing beyond an error.
        is_doubtful: whether it is in doubt of any point that it touches or presses.
    """

    hessian: Hessian
    cone: AdmissibleCone
    critical_cone: AdmissibleCone
    key: PRNGKeyArray
    nearly_touching: Mask
    touches: Flag
    is_weak: Flag
    is_doubtful: Flag


class Found(eqx.Module):
    """The smallest eigenpairs of an equilibrium.

    Attributes:
        lower_bound: on all perturbations that the load allows.
        cone: on V0+.
        critical: on the critical cone.
        hull: on the linear space around the critical cone.
        is_proved: whether the verdict was proved before `critical` was known.
        is_decided: whether the verdict was proved before `cone` was known.
    """

    lower_bound: Eigenpair
    cone: Eigenpair
    critical: Eigenpair
    hull: Eigenpair
    is_proved: Bool[Array | np.ndarray, ""]
    is_decided: Bool[Array | np.ndarray, ""]

    def ordered(self) -> "Found":
        """Return pairs of which none is above one on a smaller cone; NaN if not computed."""
        critical = _unless(self.is_proved, with_cost_of(self.hull, self.critical))
        cone = lowered(_unless(self.is_decided, self.cone), critical)
        lower_bound = lowered(lowered(self.lower_bound, cone), critical)
        return replace(self, lower_bound=lower_bound, cone=cone, critical=critical)


def _unless(is_left_out: Bool[Array | np.ndarray, ""], pair: Eigenpair) -> Eigenpair:
    return replace(
        pair,
        eigenvalue=jnp.where(is_left_out, jnp.nan, pair.eigenvalue),
        result=RESULTS.where(is_left_out, RESULTS.not_computed, pair.result),
    )


@program
def covering_doubt(problems: Eigenproblems, found: Found) -> Found:
    """Return the pairs on both cones with errors that cover the points in doubt.

    The critical eigenvalue lies between the hull's, where these points all move freely, and
    the quotient of its mode where they all stay. On V0+ those that nearly touch may be one-sided
    too, which raises the quotient of the mode; and those that hardly press may be free, where the
    mode leaves a residual.
    """
    hessian, v0, near = problems.hessian, problems.cone, problems.nearly_touching
    critical, hull, cone = found.critical, found.hull, found.cone
    held = Subspace(~(v0.one_sided | near), v0.fixes_mean)
    above, _, _ = admissible_pair(hessian.restricted(held.is_moving), held, critical.mode)
    rise = _rise(above, critical.eigenvalue)
    fall = _rise(critical.eigenvalue, hull.eigenvalue - hull.error)

    closed = replace(v0, one_sided=v0.one_sided | near)
    opened = replace(v0, one_sided=v0.one_sided & ~problems.critical_cone.one_sided)
    above, _, _ = admissible_pair(hessian, closed, cone.mode)
    _, _, residual = admissible_pair(hessian, opened, cone.mode)
    off = jnp.maximum(_rise(above, cone.eigenvalue), hessian.scale * residual)
    return replace(
        found,
        critical=_with_error(critical, jnp.maximum(rise, fall)),
        cone=_with_error(cone, off),
    )


def _rise(above: Scalar, below: Scalar) -> Scalar:
    # Two infinite numbers are alike.
    return jnp.where(above == below, 0, above - below)


def _with_error(pair: Eigenpair, error: Scalar) -> Eigenpair:
    error = jnp.where(jnp.isnan(error), jnp.inf, error)
    pair = replace(pair, error=jnp.maximum(pair.error, error))
    return pair.with_proof(pair.proved)

"""Errors of eigenvalues where it is in doubt of some points that they touch or press."""

from dataclasses import replace

import jax.numpy as jnp

from jaxstab.core.compile import program
from jaxstab.core.types import Scalar
from jaxstab.stability.cones import Subspace
from jaxstab.stability.eigenpair import Eigenpair, admissible_pair
from jaxstab.stability.eigenproblems import Eigenproblems, Found


@program
def covering_doubt(problems: Eigenproblems, found: Found) -> Found:
    """Return the pairs on both cones with errors that cover the points in doubt.

    The critical eigenvalue lies between that of the hull, where these points all move freely, and
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

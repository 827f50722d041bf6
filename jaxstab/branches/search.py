"""The way along a stable branch to its fold.

The branch is followed towards the fold by the square of the eigenvalue, which falls linearly with
the load. Newton's method goes the last part of it.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxstab.branches.branch import Field, Point, Scalar, linearised, point_at
from jaxstab.branches.fold import FoldNewton
from jaxstab.branches.limit import Limit, limit_of
from jaxstab.contact import Contact
from jaxstab.equilibrium import PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find
from jaxstab.grid import total
from jaxstab.history import Indicators
from jaxstab.iterate import Iteration, IterativeSolver
from jaxstab.loads import Load
from jaxstab.results import KINDS, RESULTS
from jaxstab.stability.modes import BLOCK_SIZE, noise

# The part that a step goes of the way to where the fold is foreseen.
_SHARE = 0.75
# How much more than predicted the gap may change on the same branch. Near a fold, where it goes
# with the root of the distance, a step of three quarters of the way changes it by 4 / 3.
_SURPRISE = 2


def follow_to_fold(contact: Contact, loads: Load, start: Field | None) -> Limit:
    """Return where the branch from the first load ends on its way to the second."""
    first, last = (jax.tree.map(lambda leaf, i=i: leaf[i], loads) for i in (0, 1))
    equilibrium = find(contact, first, PreconditionedConjugateGradient(), start)
    is_found = equilibrium.result == RESULTS.successful
    gap = equilibrium.gap
    point = point_at(contact, first, gap, noise(jax.random.key(0), BLOCK_SIZE, gap))
    approach = _Approach().solve(contact, point, last, is_found)
    near = approach.state
    newton = FoldNewton().solve(contact, near.point, is_found)
    end = newton.state.load.value
    is_between = (end - first.value) * (last.value - end) >= 0
    # Another one may be the end of another branch.
    is_near = jnp.abs(end - near.point.load.value) <= _SURPRISE * jnp.abs(near.distance)
    is_ahead = near.distance * (last.value - near.point.load.value) > 0
    is_foreseen = is_near & (is_ahead | (approach.result == RESULTS.successful))
    is_fold = (newton.result == RESULTS.successful) & is_between & is_foreseen
    result = RESULTS.where(is_fold, RESULTS.successful, RESULTS.no_fold)
    limit = limit_of(KINDS.fold, jnp.zeros_like(gap, bool), newton)
    return replace(
        limit,
        num_steps=equilibrium.num_steps + approach.num_steps + newton.num_steps,
        result=RESULTS.where(is_found, result, equilibrium.result),
    )


class _Approaching(eqx.Module):
    point: Point
    rate: Field
    distance: Scalar
    fraction: Scalar


class _Approach(IterativeSolver):
    """Steps along a stable branch, from load to load, to near the fold ahead of it."""

    tolerance: Scalar | None = None
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray, default=100)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-3, "float32": 1e-2}
    patience: ClassVar[int] = 15

    def solve(
        self, contact: Contact, point: Point, last: Load, is_needed: Bool[Array, ""]
    ) -> Iteration[_Approaching]:
        """Go from a point of the branch towards a load beyond its end, if there is such a point."""
        width = jnp.abs(last.value - point.load.value)

        def foresee(point: Point, fraction: Scalar) -> _Approaching:
            linear = linearised(contact, point.load, point.gap, point.pair)
            moved, _ = linear.system.solution(-linear.imbalance_rate)
            rate = moved + linear.gap_rate
            slope = total(linear.eigenvalue_slope * rate)
            return _Approaching(point, rate, -point.pair.eigenvalue / (2 * slope), fraction)

        def is_ahead(state: _Approaching) -> Bool[Array, ""]:
            left = last.value - state.point.load.value
            return (state.distance * left > 0) & (jnp.abs(state.distance) < jnp.abs(left))

        def step(state: _Approaching) -> _Approaching:
            old = state.point
            left = last.value - old.load.value
            stride = jnp.where(is_ahead(state), _SHARE * state.distance, left) * state.fraction
            load = old.load.at(old.load.value + stride)
            start = jnp.maximum(old.gap + stride * state.rate, 0)
            solver = PreconditionedConjugateGradient()
            equilibrium = find(contact, load, solver, start)
            is_found = equilibrium.result == RESULTS.successful
            new = point_at(contact, load, jnp.where(is_found, equilibrium.gap, 1), old.modes)
            change = jnp.sqrt(total((new.gap - old.gap) ** 2))
            foreseen = _SURPRISE * jnp.abs(stride) * jnp.sqrt(total(state.rate**2))
            is_same = is_found & (change <= foreseen) & (new.pair.eigenvalue > 0)
            point = jax.tree.map(partial(jnp.where, is_same), new, old)
            fraction = jnp.where(is_same, jnp.minimum(2 * state.fraction, 1), state.fraction / 3)
            return foresee(point, fraction)

        def measure(state: _Approaching) -> Indicators:
            return {"residual": jnp.where(is_ahead(state), jnp.abs(state.distance) / width, 1)}

        start, limit = foresee(point, jnp.ones_like(width)), jnp.where(is_needed, self.max_steps, 0)
        return self.iterate(step, measure, start, limit)

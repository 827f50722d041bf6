"""The way along a stable branch to its fold.

The branch is followed towards the fold by the square of the eigenvalue, which falls linearly with
the load. The loss of a step shows whether it stayed on the branch. Newton's method goes the last
part of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact
from jaxstab.core.grid import mean, total
from jaxstab.core.history import Indicators
from jaxstab.core.loop import IterativeSolver, integer_parameter
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.equilibrium import fields_of
from jaxstab.loads import Control, Load
from jaxstab.paths.branch_end.fold import FoldNewton
from jaxstab.paths.branch_end.linearise import Point, linearised, point_at
from jaxstab.paths.branch_end.locate import Limit, limit_of
from jaxstab.paths.energy import own_energy, smallest_loss, supply_of
from jaxstab.paths.kinds import KINDS
from jaxstab.stability.lowest_modes import BLOCK_SIZE, noise

# The part that a step goes of the way to where the fold is foreseen.
_SHARE = 0.75
# How much farther than foreseen the fold may lie.
_SURPRISE = 2
# How far a step of a solver may move a point: farther ones were seen to leap over minima.
_MAX_MOVE = 0.1
# Jumps that lose a smaller part of the problem's own energy do not end a branch.
SMALLEST_JUMP = {"float64": 1e-6, "float32": 1e-5}


def branch_solver(control: Control) -> PreconditionedConjugateGradient:
    """Return the solver of the equilibria along a branch under a load.

    Where the mean gap is held, no long step draws the surfaces apart.
    """
    return PreconditionedConjugateGradient(max_move=None if control.fixes_mean else _MAX_MOVE)


def follow_to_fold(contact: Contact, loads: Load, start: Field | None) -> Limit:
    """Return where the branch from the first load ends on its way to the second."""
    first, last = (jax.tree.map(lambda leaf, i=i: leaf[i], loads) for i in (0, 1))
    equilibrium = find(contact, first, PreconditionedConjugateGradient(), start)
    is_found = equilibrium.result == RESULTS.successful
    gap = equilibrium.gap
    point = point_at(contact, first, gap, noise(jax.random.key(0), BLOCK_SIZE, gap))
    newton, approach = FoldNewton(), _Approach()
    way = _Way(contact, last, jnp.abs(last.value - first.value))
    approach = approach.run(way, point, jnp.where(is_found, approach.max_steps, 0))
    near = approach.state
    newton = newton.run(contact, near.point, jnp.where(is_found, newton.max_steps, 0))
    fold = newton.state
    end = fold.load.value
    is_between = (end - first.value) * (last.value - end) >= 0
    # Another one may be the end of another branch: far away, or one on the far side of it.
    is_near = jnp.abs(end - near.point.load.value) <= _SURPRISE * jnp.abs(near.distance)
    is_ahead = near.distance * (last.value - near.point.load.value) > 0
    linear = linearised(contact, fold.load, fold.gap, fold.pair)
    is_end = linear.branches_off | ((near.point.load.value - end) * linear.side > 0)
    is_foreseen = is_near & is_end & (is_ahead | (approach.result == RESULTS.successful))
    is_fold = (newton.result == RESULTS.successful) & is_between & is_foreseen
    result = RESULTS.where(is_fold, RESULTS.successful, RESULTS.no_fold)
    limit = limit_of(KINDS.fold, jnp.zeros_like(gap, bool), newton)
    return replace(
        limit,
        num_steps=equilibrium.num_steps + approach.num_steps + newton.num_steps,
        result=RESULTS.where(is_found, result, equilibrium.result),
    )


class _Approaching(eqx.Module):
    """A point of the branch, and how it goes on from there.

    Attributes:
        point: the state.
        rate: how its gap follows the load.
        potential: E + W [energy].
        force: F, how it follows the load on the branch [energy over that of the load].
        force_rate: how that does.
        smallest_loss: from which a step has left the branch [energy].
        distance: how far ahead a fold is foreseen, with its sign.
        fraction: the part of a step that is tried next.
    """

    point: Point
    rate: Field
    potential: Scalar
    force: Scalar
    force_rate: Scalar
    smallest_loss: Scalar
    distance: Scalar
    fraction: Scalar

    def loss_to(self, new: "_Approaching") -> Scalar:
        """Return the loss of the step to another point, zero on the same smooth branch.

        The work of the load is known to the fifth order of the step.
        """
        stride = new.point.load.value - self.point.load.value
        supplied = stride * (self.force + new.force) / 2
        supplied += stride**2 * (self.force_rate - new.force_rate) / 12
        return self.potential + supplied - new.potential


@dataclass(frozen=True)
class _Way:
    """The way from a state of a branch to a load beyond its end, as wide as their loads differ."""

    contact: Contact
    last: Load
    width: Scalar

    def foresee(self, point: Point, fraction: Scalar) -> _Approaching:
        """Return a point of the branch, and how it goes on from there."""
        contact, load, gap = self.contact, point.load, point.gap
        threshold = SMALLEST_JUMP[gap.dtype.name] * own_energy(contact)
        linear = linearised(contact, load, gap, point.pair)
        moved, _ = linear.system.solution(-linear.imbalance_rate)
        rate = moved + linear.gap_rate
        slope = total(linear.eigenvalue_slope * rate)

        def account(value: Scalar, gap: Field) -> tuple[Scalar, tuple[Scalar, Scalar]]:
            at, (fields, _) = load.at(value), fields_of(contact, load.at(value), gap)
            pressure, mean_gap = fields["mean_pressure"], mean(fields["gap"])
            held, force = supply_of(contact, at, mean_gap, pressure)
            potential = fields["energy"] + held
            least = smallest_loss(contact, threshold, potential, mean_gap, pressure)
            return force, (potential, least)

        here, along = (load.value, gap), (jnp.ones_like(load.value), rate)
        force, force_rate, (potential, least) = jax.jvp(account, here, along, has_aux=True)
        distance = -point.pair.eigenvalue / (2 * slope)
        return _Approaching(point, rate, potential, force, force_rate, least, distance, fraction)

    def is_ahead(self, state: _Approaching) -> Flag:
        """Return whether a fold is foreseen on the way."""
        left = self.last.value - state.point.load.value
        return (state.distance * left > 0) & (jnp.abs(state.distance) < jnp.abs(left))


class _Approach(IterativeSolver):
    """Steps along a stable branch, from load to load, to near the fold ahead of it."""

    tolerance: Scalar | None = None
    max_steps: Int[Array, ""] = eqx.field(converter=integer_parameter, default=100)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-3, "float32": 1e-2}
    patience: ClassVar[int] = 15

    def init(self, problem: _Way, start: Point) -> _Approaching:
        """Return a point of the branch, and how it goes on."""
        return problem.foresee(start, jnp.ones_like(problem.width))

    def step(self, problem: _Way, state: _Approaching) -> _Approaching:
        """Return the next point, or the same with a shorter step ahead."""
        contact, old = problem.contact, state.point
        left = problem.last.value - old.load.value
        stride = jnp.where(problem.is_ahead(state), _SHARE * state.distance, left) * state.fraction
        load = old.load.at(old.load.value + stride)
        start = jnp.maximum(old.gap + stride * state.rate, 0)
        equilibrium = find(contact, load, branch_solver(contact.control(load)), start)
        is_found = equilibrium.result == RESULTS.successful
        new = point_at(contact, load, jnp.where(is_found, equilibrium.gap, 1), old.modes)
        ahead = problem.foresee(new, jnp.minimum(2 * state.fraction, 1))
        is_same = is_found & (new.pair.eigenvalue > 0)
        is_same &= jnp.abs(state.loss_to(ahead)) <= state.smallest_loss
        nearer = replace(state, fraction=state.fraction / 3)
        return jax.tree.map(partial(jnp.where, is_same), ahead, nearer)

    def measure(self, problem: _Way, state: _Approaching) -> Indicators:
        """Return how far ahead the fold is, over the whole way."""
        is_ahead = problem.is_ahead(state)
        return {"residual": jnp.where(is_ahead, jnp.abs(state.distance) / problem.width, 1)}

"""A step along the curve that is tried: its target, and the point that is found there.

Pseudo-arclength (Keller 1977): the next point lies on the plane across the tangent at a distance
ahead, or at the active-set change ahead if that is nearer. The point that the corrector finds is
taken only if it lies on the same curve, as the two ends of the step tell.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.corrector import AT_STATES, Condition, CorrectorOutcome, at_change, on_plane
from jaxstab.branches.curve import BorderedVector, ContinuationProblem, Place
from jaxstab.branches.events import ActiveSetChanges, changes_ahead
from jaxstab.branches.interpolation import (
    Cubics,
    changes_as_predicted,
    most_changes,
    stays_positive,
    turns_as_predicted,
)
from jaxstab.contact.hessian import Block
from jaxstab.core.accuracy import EQUILIBRIUM, EXACT, rounding_of_numbers
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.states.kinds import KINDS

# The least cosine between the tangents at both ends of a step, and that from which steps grow.
_LEAST_COSINE = 0.95
_STRAIGHT = 0.99
# A step is cut to this part of its length, and to the second where the corrector has found no
# point: there the curve bends on a much smaller scale.
CUT = 0.4
_CUT_IF_LOST = 0.1
# The distance of a state from its prediction over the length of the step: at most this on a smooth
# piece, and the second over several pieces, between which the curve has kinks.
_FARTHEST = 0.1
_FARTHEST_LEAP = 0.3


class ArclengthStep(eqx.Module):
    """The outcome of a step, and the next one to try.

    Attributes:
        here: the last state.
        length: of the step that is tried next [length].
        index: the number of negative eigenvalues there.
        expected: the number with which the branch goes on, `UNKNOWN` where it may be any.
        modes: the lowest modes there.
        turn: the turning point or bifurcation passed on the way to it, if there is one.
        aims_at_last_load: whether the next step is one to the last load.
        reached_last_load: whether this one was.
        is_new: whether it is a new state; otherwise the step was cut.
        is_found: whether a state was found at all, of this branch or not.
    """

    here: Place
    length: Scalar
    index: Int[Array, ""]
    expected: Int[Array, ""]
    modes: Block
    turn: "TurnInStep"
    aims_at_last_load: Flag
    reached_last_load: Flag
    is_new: Flag
    is_found: Flag


class TurnInStep(eqx.Module):
    """A turning point or a bifurcation in a step.

    Attributes:
        exists: whether there is one.
        at: the point.
        kind: its kind.
        mode: the direction of the branch there, or of another one that crosses it.
    """

    exists: Flag
    at: BorderedVector
    kind: KINDS
    mode: Field


class Target(eqx.Module):
    """The target of a step, and the problem of its corrector.

    Attributes:
        changes: the active-set changes ahead.
        reach: how far ahead it leads [length].
        is_change: whether to the first active-set change ahead.
        opens: whether a contact point is released there.
        follows: whether the free points may change on the way.
        predicted: the point on the tangent.
        start: the point where the corrector starts.
        row: the gradient of the distance along the tangent.
        condition: the condition that the corrector meets.
        close: the residual that it is to reach.
    """

    changes: ActiveSetChanges
    reach: Scalar
    is_change: Flag
    opens: Flag
    follows: Flag
    predicted: BorderedVector
    start: BorderedVector
    row: BorderedVector
    condition: Condition
    close: Scalar


class Judgement(eqx.Module):
    """The point that the corrector has found, judged by the two ends of the step.

    Attributes:
        gap: its gap, without the corrector's error where it is taken [length].
        is_found: whether it is a point of some curve.
        is_taken: whether it is the next state, if the events in the step explain it.
        overshoots: whether it lies on this curve, but beyond the last load, to which the next step
            leads then.
        turns: whether the load turns in the step.
        share: the part of the step to try next if this one is not taken.
        is_easy: whether the next step may be longer.
    """

    gap: Field
    is_found: Flag
    is_taken: Flag
    overshoots: Flag
    turns: Flag
    share: Scalar
    is_easy: Flag


class StepTrial(NamedTuple):
    """A step that is tried.

    Attributes:
        problem: the problem of the branch.
        step: the step before, from whose state this one begins.
        target: its target.
        judgement: of the point that the corrector has found.
        reached: the place there.
    """

    problem: ContinuationProblem
    step: ArclengthStep
    target: Target
    judgement: Judgement
    reached: Place


@program
def target_of(problem: ContinuationProblem, step: ArclengthStep) -> Target:
    """Return the target of the next step: a distance, or the first active-set change before it.

    A step to the last load has no active-set change there as its target: it would be cut there
    without end.
    """
    curve = problem.curve
    old = step.here
    length = step.length
    dtype = step.length.dtype
    changes = changes_ahead(curve, old, problem.min_step)
    most = most_changes(changes.net.size)
    # A change right before the last load is passed with it.
    number = jnp.sum(changes.distances <= length - step.aims_at_last_load * problem.min_step)
    follows = (number > jnp.sum(changes.tied)) & (most > 1)
    if most > 1:
        length = jnp.minimum(length, jnp.sort(changes.distances.ravel())[most])
    is_change = (number > 0) & ~follows
    opens = jnp.any(changes.point & ~old.is_free)
    reach = jnp.where(is_change, changes.first, length)

    row = curve.gradient_of(old.tangent)
    # In a short step the place along it is known to no more digits than the state.
    rounding = rounding_of_numbers(dtype) * curve.length(old.at)
    scale = jnp.maximum(reach, rounding / EQUILIBRIUM[dtype.name])
    ahead = on_plane(row, row.times(old.at) + reach, scale)
    span = jnp.abs(problem.last_load - problem.first_load)
    end = on_plane(curve.load_gradient, problem.last_load - curve.load_offset, span)
    event = at_change(curve, changes.point, opens, problem.max_step)
    condition = choose(is_change, event, choose(step.aims_at_last_load, end, ahead))

    predicted = old.at.plus(old.tangent, reach)
    least = jnp.where(curve.contact.has_core, old.at.gap / 5, -jnp.inf)
    least = jnp.where(follows, jnp.maximum(least, 0), least)
    start = BorderedVector(jnp.maximum(predicted.gap, least), predicted.pressure)
    close = jnp.where(is_change, *jnp.array([EXACT[dtype.name], AT_STATES[dtype.name]], dtype))
    return Target(
        changes, reach, is_change, opens, follows, predicted, start, row, condition, close
    )


@program
def judge(
    problem: ContinuationProblem, step: ArclengthStep, target: Target, found: CorrectorOutcome
) -> Judgement:
    """Return whether the point that the corrector has found lies on the same curve."""
    curve = problem.curve
    old = step.here
    changes = target.changes
    reach = target.reach
    place = found.place
    tangent = found.place.tangent
    length = target.row.times(place.at.minus(old.at))
    cosine = curve.product(tangent, old.tangent)
    farthest = jnp.where(target.follows, _FARTHEST_LEAP, _FARTHEST)
    is_near = curve.length(place.at.minus(target.predicted)) <= farthest * reach
    is_straight = (length > 0) & (cosine > _LEAST_COSINE)
    cubics = Cubics(old, place, length, cosine)
    forces = found.forces
    after = forces.net, curve.net_rate(forces.curvature, tangent)
    leaps = changes_as_predicted(cubics, changes, after)
    smooth, share = stays_positive(curve, cubics, changes, target.is_change, after, forces.scale)
    # Where gaps or reactions alone are at fault, up to where they are positive.
    is_over = found.is_found & is_near & is_straight & ~target.follows & (share < 1)
    cut = jnp.where(found.is_found, CUT, _CUT_IF_LOST)
    share = jnp.where(is_over, jnp.maximum(0.9 * share, 0.1), cut)
    is_smooth = jnp.where(target.follows, leaps, smooth & turns_as_predicted(curve, cubics))
    is_easy = cosine > _STRAIGHT

    turns = curve.rate(old.tangent) * curve.rate(tangent) < 0
    beyond = problem.is_beyond(place.at) & ~(step.aims_at_last_load & ~target.is_change)
    is_sound = found.is_found & is_near & is_straight & is_smooth
    is_sound &= ~(turns & (target.is_change | step.aims_at_last_load | beyond))
    gap = jnp.where(place.is_free, jnp.maximum(place.at.gap, 0), 0)
    gap = jnp.where(target.is_change & changes.point, 0, gap)
    # Of a turn beside a change of the free points it is not known which came first.
    is_clear = ~(turns & jnp.any(place.is_free != old.is_free))
    is_taken = is_sound & is_clear & ~beyond
    gap = jnp.where(is_taken, gap, place.at.gap)
    return Judgement(
        gap=gap,
        is_found=found.is_found,
        is_taken=is_taken,
        overshoots=is_sound & beyond,
        turns=turns,
        share=share,
        is_easy=is_easy,
    )

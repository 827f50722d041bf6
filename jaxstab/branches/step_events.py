"""The events in a step along the curve, and the account that they give of the Morse index.

The number of negative eigenvalues changes as the events in the step say: by one at a fold, by one
at an active-set change where the load turns, by none elsewhere, except where another branch
crosses: there modes change sign that have no part in this one.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.curve import Place
from jaxstab.branches.events import Beyond, beyond_change, beyond_none, fold_between
from jaxstab.branches.morse_index import MOST, UNKNOWN, index_of, no_modes
from jaxstab.branches.step_trial import StepTrial, TurnInStep
from jaxstab.contact.hessian import Block
from jaxstab.core.checks import array
from jaxstab.core.compile import program
from jaxstab.core.control_flow import cond
from jaxstab.core.grid import mean_over, total
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.states.kinds import KINDS

# In steps of at most this part of the longest, a mode without a part in the branch may change its
# sign: the farther from a bifurcation, the more of its mode does belong to the branch.
_ACROSS = 1e-3


class StepEvents(eqx.Module):
    """The events in a step.

    Attributes:
        fold: the place where the load turns at a fold.
        is_flat: whether the rate of the load vanishes there.
        beyond: the place beyond the step.
        index: the number of negative eigenvalues there.
        modes: the lowest modes there.
        opened_index: the number with all points free that change sides together; without such
            points the same.
        opened_modes: the lowest modes with these.
    """

    fold: Place
    is_flat: Flag
    beyond: Beyond
    index: Int[Array, ""]
    modes: Block
    opened_index: Int[Array, ""]
    opened_modes: Block


class Account(eqx.Module):
    """The account that the events in a step give of the Morse index behind it.

    Attributes:
        is_sound: whether the branch goes on behind them, and has not reached the last load before.
        agrees: whether they explain the index.
        is_unexplained: whether they do not, but another branch that crosses may.
        index: the index at the place behind, `UNKNOWN` too where that of its change is.
        expected: the index with which the branch goes on, `UNKNOWN` where it may be any.
        turn: the turn at one of them, or the bifurcation.
    """

    is_sound: Flag
    agrees: Flag
    is_unexplained: Flag
    index: Int[Array, ""]
    expected: Int[Array, ""]
    turn: TurnInStep


def events_in(trial: StepTrial) -> StepEvents:
    """Return the fold in a step, the place beyond it, and its number of negative eigenvalues."""
    problem, step, target, judgement, reached = trial
    curve = problem.curve
    fold, is_flat = cond(
        judgement.turns,
        lambda: fold_between(curve, step.here, reached),
        lambda: (reached, array(True)),
    )
    beyond = cond(
        target.is_change,
        lambda: beyond_change(curve, reached, target.changes, target.opens),
        lambda: beyond_none(reached),
    )
    inputs = curve.contact, curve.load, beyond.place.at.gap
    if problem.to_limit:
        # It matters whether the branch goes on unstable, and not by which mode.
        found = index_of(*inputs, step.modes, opened=beyond.opened, counts_all=False)
        return StepEvents(fold, is_flat, beyond, *found, *found)
    found = index_of(*inputs, step.modes)
    opened = cond(
        beyond.is_tied,
        lambda: index_of(*inputs, no_modes(beyond.opened), opened=beyond.opened, precise=True),
        lambda: found,
    )
    return StepEvents(fold, is_flat, beyond, *found, *opened)


class IndexChange(eqx.Module):
    """How the load turns in a step, and how that changes the Morse index.

    Attributes:
        back: whether the load turns back at the active-set change.
        touches: whether a point touches there.
        is_tied: whether several points change sides there, at once.
        change: the expected change of the Morse index, without a sign where the load turns at a
            fold; unknown where several points change sides at once.
    """

    back: Flag
    touches: Flag
    is_tied: Flag
    change: Int[Array, ""]

    @classmethod
    def at(cls, trial: StepTrial, beyond: Beyond) -> "IndexChange":
        """Return how the load turns in a step that ends at a place beyond its events."""
        problem, _, target, judgement, reached = trial
        curve = problem.curve
        new = beyond.place
        back = curve.rate(reached.tangent) * curve.rate(new.tangent) < 0
        # At a release the released point has no part in the index yet.
        touches = target.is_change & ~target.opens
        loses_one = touches & back & ~beyond.is_tied
        change = jnp.where(judgement.turns, 1, jnp.where(loses_one, -1, 0))
        return cls(back, touches, beyond.is_tied, change)

    def explains(self, turns: Flag, before: Int[Array, ""], after: Int[Array, ""]) -> Flag:
        """Return whether it explains the number of negative eigenvalues after the step."""
        is_known = (before >= 0) & (after >= 0) & (after < MOST)
        found = jnp.where(turns, jnp.abs(after - before), after - before)
        return ~is_known | (found == self.change)


@program
def account_of(trial: StepTrial, events: StepEvents) -> Account:
    """Return whether the events in a step explain the Morse index behind it, or modes might.

    Modes that have no part in the branch, since they break a symmetry, may change sign as they
    like: there other branches cross it. Points that tie, by symmetry, take such modes with them at
    once.
    """
    problem, step, target, judgement, _ = trial
    index_change = IndexChange.at(trial, events.beyond)
    is_tied = index_change.is_tied
    index = jnp.where(is_tied & (events.opened_index < 0), UNKNOWN, events.index).astype(int)
    before = jnp.where(is_tied & index_change.touches, events.opened_index, index)
    agrees = index_change.explains(judgement.turns, step.expected, before)
    splits = is_tied & ~index_change.back & (index >= 0) & (index != events.opened_index)
    if problem.to_limit:
        # A bifurcation is a limit, however long the step.
        agrees |= is_tied | ((step.index == 0) & (index > 0) & ~judgement.turns)
        splits = is_tied & ~index_change.back & (step.index == 0) & (index > 0)
    is_beyond = judgement.turns & problem.is_beyond(events.fold.at)
    opens = target.is_change & target.opens
    expected = jnp.where(is_tied & opens, events.opened_index, index + (opens & index_change.back))
    is_unknown = (expected >= MOST) | (index < 0)
    if problem.to_limit:
        is_unknown |= is_tied
    kind = KINDS.where(target.opens, KINDS.release, KINDS.touch)
    kind = KINDS.where(target.is_change, kind, KINDS.fold)
    mode = jnp.where(judgement.turns, events.fold.tangent.gap, events.beyond.place.tangent.gap)
    if not problem.to_limit:
        mode = jnp.where(splits, _mode_of_tie(trial, events), mode)
    return Account(
        is_sound=events.beyond.goes_on & events.is_flat & ~is_beyond,
        agrees=agrees,
        # The farther from a bifurcation, the smaller the part of the mode that does belong to it.
        is_unexplained=~agrees & ~splits & (step.length <= _ACROSS * problem.max_step),
        index=index,
        expected=jnp.where(is_unknown, UNKNOWN, expected).astype(int),
        turn=TurnInStep(
            exists=judgement.turns | index_change.back | splits,
            at=events.fold.at,
            kind=KINDS.where(splits, KINDS.bifurcation, kind),
            mode=mode,
        ),
    )


def _mode_of_tie(trial: StepTrial, events: StepEvents) -> Field:
    """Return the unstable mode that most moves points apart that change sides together."""
    flips = events.beyond.place.is_free != trial.reached.is_free
    modes = events.opened_modes[:-1]

    def apart(mode: Field) -> Scalar:
        return total(jnp.where(flips, (mode - mean_over(flips, mode)) ** 2, 0))

    parts = jax.vmap(apart)(modes)
    is_unstable = jnp.arange(len(modes)) < events.opened_index
    return modes[jnp.argmax(jnp.where(is_unstable, parts, -1))]

"""The limit of a branch of equilibria, a fold or a release, located exactly."""

from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact
from jaxstab.core.conditional import first_good
from jaxstab.core.history import History
from jaxstab.core.loop import Iteration
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.loads import Load
from jaxstab.paths.branch_end.fold import FoldNewton
from jaxstab.paths.branch_end.kind import reason_of
from jaxstab.paths.branch_end.linearise import Point, point_at
from jaxstab.paths.branch_end.release import (
    Held,
    ReleaseNewton,
    first_of,
    first_releases,
    horizon,
    least_open_closed,
)
from jaxstab.paths.kinds import KINDS
from jaxstab.stability.eigenpair import Eigenpair
from jaxstab.stability.lowest_modes import BLOCK_SIZE, noise

# How far from where it was seen to lie a limit may be found, over how near that is known.
_LEEWAY = 10
_NUM_TRIES = 4


class Limit(eqx.Module):
    """Where a branch ends.

    Attributes:
        load: the load there.
        gap: the last gap of the branch [length].
        kind: a fold or a release.
        point: the contact point that lets go; none at a fold.
        critical: the lowest eigenpair on the points that are free or let go; its error is at least
            as large if the eigenvalue contradicts the kind.
        residual: of the balance of pressures and the condition of the kind.
        num_steps: steps that it took to find it.
        history: of the residual.
        is_exact: whether these conditions are met; otherwise the limit lies a little further on.
        result: how the search ended.
    """

    load: Load
    gap: Field
    kind: KINDS
    point: Mask
    critical: Eigenpair
    residual: Scalar
    num_steps: Int[Array, ""]
    history: History
    is_exact: Flag
    result: RESULTS

    @property
    def is_event(self) -> Flag:
        """Whether its conditions are met: at a release the energy falls as the point opens."""
        falls = self.critical.eigenvalue < self.critical.error
        return self.is_exact & ((self.kind == KINDS.fold) | falls)

    @property
    def is_found(self) -> Flag:
        """Whether there is one."""
        return self.result == RESULTS.successful


def limit_of(kind: KINDS, point: Mask, newton: Iteration[Point]) -> Limit:
    """Return a limit from the end of Newton's method."""
    state = newton.state
    return Limit(
        load=state.load,
        gap=state.gap,
        kind=kind,
        point=point,
        critical=state.pair,
        residual=newton.residual,
        num_steps=newton.num_steps,
        history=newton.history,
        is_exact=newton.result == RESULTS.successful,
        result=newton.result,
    )


def limit_ahead(contact: Contact, load: Load, gap: Field, ahead: Scalar) -> Limit:
    """Return the limit of a branch from a state close to it, of whichever kind it is.

    It is of the kind that the state suggests, or else the release of the point that is first to let
    go, which may lie a little further on. The last state of a branch may lie past its end, by no
    more than its residual. Then the point that let go is the one that is least open. If the
    conditions of none of them are met, it is the first, and not exact.
    """

    def limit_from(number: Array) -> Limit:
        state = jnp.where(number % 2 == 0, gap, least_open_closed(gap))
        releases = first_releases(contact, load, state, ahead)
        kind, _ = reason_of(contact, load, state, releases)
        kind = KINDS.where(number < 2, kind, KINDS.release)
        return locate(contact, load, state, kind, first_of(releases), ahead)

    return first_good(limit_from, lambda limit: limit.is_event, _NUM_TRIES)


def locate(
    contact: Contact, load: Load, gap: Field, kind: KINDS, point: Mask, ahead: Scalar
) -> Limit:
    """Return the limit of a branch, at a point if it is a release, from a state close to it.

    So far ahead, with its sign, a load has no state of this branch. Where points touch or let go
    between the two, the limit is that state itself, and said not to be exact.
    """
    ahead = horizon(load, gap, ahead)
    residual = contact.balance(contact.control(load))(gap).residual
    here = Held(load, gap, jnp.zeros_like(gap, bool))
    none = jnp.zeros((), int), RESULTS.no_fold, History.empty(["residual"], gap.dtype)

    def unless_far(newton: Iteration[Any], start: Any) -> Iteration[Any]:
        distance = jnp.abs(newton.state.load.value - load.value)
        is_near = (newton.result == RESULTS.successful) & (distance <= _LEEWAY * jnp.abs(ahead))
        unmoved = replace(newton, state=start, residual=residual, result=RESULTS.no_fold)
        return jax.tree.map(partial(jnp.where, is_near), newton, unmoved)

    def release() -> Iteration[Held]:
        return unless_far(ReleaseNewton().run(contact, replace(here, point=point)), here)

    is_release = kind == KINDS.release
    released = jax.lax.cond(is_release, release, lambda: Iteration(here, residual, *none))
    held = released.state
    starts = noise(jax.random.key(0), BLOCK_SIZE, gap)
    near = point_at(contact, held.load, held.gap, starts, held.point)
    end = jax.lax.cond(
        is_release,
        lambda: replace(released, state=near),
        lambda: unless_far(FoldNewton().run(contact, near), near),
    )
    result = RESULTS.where(jnp.isfinite(end.residual), RESULTS.successful, RESULTS.nonfinite)
    limit, pair = limit_of(kind, held.point, end), end.state.pair
    # Of points that let go at once, one alone may end no branch.
    error = jnp.where(limit.is_event, pair.error, jnp.maximum(pair.error, jnp.abs(pair.eigenvalue)))
    return replace(limit, critical=replace(pair, error=error), result=result)

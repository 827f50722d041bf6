"""The limit of a branch of equilibria, a fold or a release, located exactly."""

from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxstab.branches.branch import point_at
from jaxstab.branches.fold import FoldNewton
from jaxstab.branches.reason import reason_of
from jaxstab.branches.release import Held, ReleaseNewton, first_of, first_releases
from jaxstab.contact import Contact
from jaxstab.iterate import History, Iteration
from jaxstab.loads import Load
from jaxstab.results import KINDS, RESULTS
from jaxstab.stability.cones import Subspace
from jaxstab.stability.davidson import Davidson
from jaxstab.stability.eigenpairs import Eigenpair
from jaxstab.stability.modes import BLOCK_SIZE, lowest_pair, noise

Field = Float[Array, " *grid"]
Mask = Bool[Array, " *grid"]
Scalar = Float[Array, ""]

# How far from where it was seen to lie a limit may be found, over how near that is known.
_LEEWAY = 10


class Limit(eqx.Module):
    """Where a branch ends.

    Attributes:
        load: the load there.
        gap: the last gap of the branch [length].
        kind: a fold or a release.
        point: the contact point that lets go; none at a fold.
        critical: the lowest eigenpair on the points that are free or let go.
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
    is_exact: Bool[Array, ""]
    result: RESULTS

    @property
    def is_found(self) -> Bool[Array, ""]:
        """Whether there is one."""
        return self.result == RESULTS.successful


def limit_of(
    kind: KINDS, state: Any, point: Mask, critical: Eigenpair, newton: Iteration[Any]
) -> Limit:
    """Return a limit from what Newton's method ended at."""
    return Limit(
        load=state.load,
        gap=state.gap,
        kind=kind,
        point=point,
        critical=critical,
        residual=newton.residual,
        num_steps=newton.num_steps,
        history=newton.history,
        is_exact=newton.result == RESULTS.successful,
        result=newton.result,
    )


def limit_ahead(contact: Contact, load: Load, gap: Field, ahead: Scalar) -> Limit:
    """Return the limit of a branch from a state close to it, of whichever kind it is.

    The arguments are those of `locate`.
    """
    kind, _ = reason_of(contact, load, gap, ahead)
    return locate(contact, load, gap, kind, ahead)


def locate(contact: Contact, load: Load, gap: Field, kind: KINDS, ahead: Scalar) -> Limit:
    """Return the limit of a branch from a state close to it.

    Where points touch or let go between the two, it is that state itself, and said not to be exact.

    Arguments:
        contact: the contact problem.
        load: that of the state.
        gap: of the state.
        kind: of the limit, a fold or a release.
        ahead: how far ahead the load lies that has no state of this branch, with its sign.
    """
    starts = noise(jax.random.key(0), BLOCK_SIZE, gap)
    nowhere = jnp.zeros_like(gap, bool)
    near = point_at(contact, load, gap, starts)

    def at_fold() -> Limit:
        newton = FoldNewton().solve(contact, near)
        return limit_of(KINDS.fold, newton.state, nowhere, newton.state.pair, newton)

    def at_release() -> Limit:
        point = first_of(first_releases(contact, load, gap, ahead))
        newton = ReleaseNewton().solve(contact, Held(load, gap, point))
        found = newton.state
        control = contact.control(found.load)
        space = Subspace((found.gap > 0) | point, control.fixes_mean)
        hessian = contact.hessian(found.gap, control)
        pair, _ = lowest_pair(Davidson(), hessian, space, starts)
        return limit_of(KINDS.release, found, point, pair, newton)

    limit = jax.lax.cond(kind == KINDS.release, at_release, at_fold)
    distance = jnp.abs(limit.load.value - load.value)
    is_near = (distance <= _LEEWAY * jnp.abs(ahead)) & limit.is_found
    residual = contact.balance(contact.control(load))(gap).residual
    rough = replace(
        limit,
        load=load,
        gap=gap,
        point=nowhere,
        critical=near.pair,
        residual=residual,
        is_exact=jnp.array(False),
        result=RESULTS.where(jnp.isfinite(residual), RESULTS.successful, RESULTS.nonfinite),
    )
    return jax.tree.map(partial(jnp.where, is_near), limit, rough)

"""The lowest pass out of a state, found by pushes along its modes."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from jaxstab.contact import Contact, require_elastic
from jaxstab.contact.resolution import FOR_JUMPS, warned_once
from jaxstab.core.checks import integer, require, require_known
from jaxstab.core.compile import program
from jaxstab.core.results import RESULTS, SolverError
from jaxstab.core.types import Field, Flag
from jaxstab.equilibrium import Equilibrium, equilibrate
from jaxstab.equilibrium.equilibrium import State, equilibrium_of
from jaxstab.stability import assess_stability, lowest_modes
from jaxstab.stability.perturb import amplitude_of
from jaxstab.transitions.pass_to_detached import pulls
from jaxstab.transitions.result import Transition
from jaxstab.transitions.saddle import are_apart
from jaxstab.transitions.transition import transition

# How far a state is pushed, one after another: parts of its mean gap.
_SHARES = 0.1, 0.3, 1.0, 3.0


def easiest_exit(
    contact: Contact,
    equilibrium: State,
    *,
    num_modes: int = 4,
    key: PRNGKeyArray | None = None,
    throw: bool = True,
) -> Transition:
    """Return the lowest pass found out of a stable state, and the state beyond it.

    The state is pushed along its lowest modes, in both directions, and along the cone's, farther
    and farther until it relaxes to another state. The transition to these states with
    the lowest barrier is returned; there may be a lower one. Under a dead load that pulls, the
    transition to detached surfaces is among them: it follows the branch around the pull-off, which
    on rough surfaces takes most of the time. The function runs neither under `jax.jit` nor under
    `jax.vmap`.

    Arguments:
        contact: the contact problem.
        equilibrium: one of its stable equilibria, or a result that holds it.
        num_modes: how many of the lowest modes that the load allows are tried.
        key: the random key of the searches for modes, `jax.random.key(0)` by default.
        throw: raise where no push leads to another state; otherwise look at `result`.

    Raises:
        ValueError: as `assess_stability`, and for no mode.
        TypeError: under JAX transformations.
        SolverError: where modes are not found, and if `throw` where no pass is.

    Example:
        >>> closed = js.equilibrate(contact, js.MeanGap(0.0624), initial=state)
        >>> f"{js.easiest_exit(contact, closed).there:.2e}"
        '2.13e-07'
    """
    equilibrium = equilibrium_of(contact, equilibrium)
    require_elastic(contact, "easiest_exit")
    require_known((contact, equilibrium), "easiest_exit")
    number = integer("num_modes", num_modes)
    require("num_modes", number, number >= 1, "try one mode or more.")
    most = contact.grid.size - contact.control(equilibrium.load).fixes_mean
    cure = f"the load allows {most} independent moves of the points: give at most that."
    require("num_modes", number, number <= most, cure)
    with warned_once(contact, FOR_JUMPS):
        modes = lowest_modes(contact, equilibrium, number, key=key)
        stability = assess_stability(contact, equilibrium, key=key, throw=False)
        if stability.verdict == "unstable":
            raise ValueError("The state is unstable: give a stable one, as by jaxstab.relax_along.")
        cone = stability.cone
        both = [sign * mode for mode in np.asarray(modes.mode) for sign in (1, -1)]
        directions = [cone.mode, *map(jax.device_put, both)]
        states: list[Equilibrium] = []
        for direction in directions:
            end = _state_beyond(contact, equilibrium, direction)
            if end is not None and all(are_apart(end, other) for other in states):
                states.append(end)
        ends: list[Equilibrium | None] = [*states]
        if pulls(equilibrium.load):
            ends.append(None)
        if not ends:
            # From the state to itself: the result says so.
            ends.append(equilibrium)
        exits = [
            transition(contact, equilibrium.load, equilibrium, end, throw=False) for end in ends
        ]
    found = [one for one in exits if one.result == RESULTS.successful]
    if found:
        return min(found, key=lambda one: float(one.there))
    if not throw:
        return exits[0]
    cure = "Try more modes (`num_modes`), or give another state to `transition`."
    if ends[-1] is None:
        cure = f"To detached surfaces there is none either: {RESULTS[exits[-1].result]}. {cure}"
    raise SolverError(
        f"None of {len(directions)} pushes led over a pass to another state; {len(states)} other "
        f"states were found. {cure}",
        exits[0],
    )


def _state_beyond(contact: Contact, state: Equilibrium, direction: Field) -> Equilibrium | None:
    """Return the other state that the least push along a direction leads to, if there is one."""
    for share in _SHARES:
        start, is_push = _push(state.gap, direction, share)
        if not is_push:
            return None
        end = equilibrate(contact, state.load, initial=start, throw=False)
        if end.result == RESULTS.successful and are_apart(end, state):
            return jax.block_until_ready(end)
    return None


@program
def _push(gap: Field, direction: Field, share: float) -> tuple[Field, Flag]:
    """Return a gap after a push along a direction, and whether it is a gap to start from."""
    start = jnp.maximum(gap + amplitude_of(gap, direction, share) * direction, 0)
    is_push = jnp.any(direction) & jnp.all(jnp.isfinite(direction)) & jnp.any(start > 0)
    return start, is_push

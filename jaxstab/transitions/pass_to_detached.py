"""The pass to detached surfaces under a dead load that pulls, as a transition.

The climbs on the branch of a state (`branch_pass`) are those of the state and of minima that it
meets on the way.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxstab.contact import Contact
from jaxstab.core.checks import concrete, require_known, where_known
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import stack_of
from jaxstab.core.types import ArrayLike, Field
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.equilibrium import State, detached_where, state_at
from jaxstab.equilibrium.posing import finish, pose
from jaxstab.equilibrium.start import start_of
from jaxstab.loads import Load, MeanPressure
from jaxstab.transitions.branch_pass import MAX_STEPS, Climb, Image, climbs_on_branch
from jaxstab.transitions.result import Transition, heights_above, with_derivatives
from jaxstab.transitions.saddle import Saddle

NOT_DETACHED = "No pass to detached surfaces was found at {!r}"
# The number of states that are returned by default, of a string or a branch.
IMAGES = 16


def largest_climb(
    contact: Contact, load: MeanPressure, start: ArrayLike | State
) -> tuple[Transition, bool]:
    """Return the largest climb on the way from a state to detached surfaces.

    It is a transition from the minimum below it, which is the state itself if it meets no other on
    the way: whether that is so, is returned too. See `transition` to None, for the same state.

    Raises:
        SolverError: if no pass is found.
    """
    problem = pose(contact, load)
    inputs = problem.contact, problem.load
    first = start_of(*inputs, start)

    def largest(climbs: list[Climb]) -> Climb:
        return max(climbs, key=lambda climb: climb.height)

    found, is_direct = pass_to_detached(IMAGES, largest, *inputs, first)
    return finish(found, problem, lambda _: NOT_DETACHED.format(load), True), is_direct


def pulls(load: Load) -> bool:
    """Return whether a load, of known value, is a dead one that pulls."""
    return isinstance(load, MeanPressure) and bool(concrete(load.value) < 0)


@where_known
def require_pull(load: Load) -> None:
    """Raise `ValueError` unless a load is a dead one that pulls."""
    if not pulls(load):
        raise ValueError(
            f"The end is None, for detached surfaces without an equilibrium, and the load {load!r}"
            " does not pull them apart for good, as MeanPressure below zero does: give the "
            "separated equilibrium at this load as the end, or a gap that relaxes to it."
        )


def pass_to_detached(
    number: int,
    chosen: Callable[[list[Climb]], Climb],
    contact: Contact,
    load: Load,
    first: Field,
) -> tuple[Transition, bool]:
    """Return the transition over a climb from the minimum near a gap, and whether it is alone."""
    constants = jax.lax.stop_gradient((contact, load, first))
    require_known(constants, "A transition to detached surfaces")
    with (
        own_conventions(),
        progress_bar("transition", MAX_STEPS, "states", shown=None, inputs=constants),
    ):
        start = find(*constants[:2], PreconditionedConjugateGradient(), constants[2])
        climbs, result = climbs_on_branch(*constants[:2], start, number)
        minimum, (saddle, minima, images), _ = chosen(climbs)
        places = np.linspace(0, len(images) - 1, min(number, len(images)))
        shown = [images[i] for i in places.round().astype(int)]
        shown = stack_of(shown, shown[0])
        found = _over(*constants[:2], minimum, saddle, minima, shown, result)
        return with_derivatives(found, (contact, load), ("there",)), len(climbs) == 1


@program
def _over(
    contact: Contact,
    load: Load,
    start: Equilibrium,
    saddle: Saddle,
    minima: Equilibrium,
    images: Image,
    result: RESULTS,
) -> Transition:
    """Return the transition from a state over a saddle to detached surfaces."""
    is_found = result == RESULTS.successful
    top = state_at(contact, load, jnp.where(is_found, saddle.gap, jnp.nan))
    (there,) = heights_above((top.gap, start.gap), contact, load)
    return Transition(
        jnp.where(is_found, there, jnp.nan),
        jnp.where(is_found, jnp.full_like(there, jnp.inf), jnp.nan),
        start,
        detached_where(jnp.array(True), state_at(contact, load, start.gap)),
        replace(top, result=result),
        saddle.mode,
        minima,
        images.gap,
        images.energy - images.energy[0],
        result,
    )

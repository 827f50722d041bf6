"""The pass between two states at one load, or from one to detached surfaces."""

from operator import itemgetter

import jax

from jaxstab.contact import Contact, require_contact, require_elastic
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.checks import integer, require
from jaxstab.core.compile import own_conventions
from jaxstab.core.types import ArrayLike
from jaxstab.equilibrium.equilibrium import State
from jaxstab.equilibrium.posing import finish, pose
from jaxstab.equilibrium.start import start_of
from jaxstab.loads import Load, require_loads
from jaxstab.transitions.pass_by_string import pass_by_string
from jaxstab.transitions.pass_to_detached import (
    IMAGES,
    NOT_DETACHED,
    pass_to_detached,
    require_pull,
)
from jaxstab.transitions.result import Transition, with_derivatives
from jaxstab.transitions.string import StringMethod


def transition(
    contact: Contact,
    load: Load,
    start: ArrayLike | State,
    end: ArrayLike | State | None,
    *,
    num_images: int = IMAGES,
    throw: bool = True,
) -> Transition:
    """Return the pass between two equilibria at one load, on a path of least energy.

    A string of states between the two descends in energy, with gaps that are nowhere negative. Its
    highest state climbs, and Newton's method leads from there to the saddle: an equilibrium
    with exactly one negative eigenvalue on the critical space, above both ends. This is the pass to
    which the straight line between the two states leads; there may be others, and lower ones.

    Under a dead load that pulls, detached surfaces have no equilibrium, and None is the end. The
    branch of equilibria is followed from the start around its pull-off and back to the load. A
    state there with one negative eigenvalue is a saddle. It joins the states on its two sides:
    minima, or detached surfaces. If the first saddle leads straight from the start to detached
    surfaces, it is the pass. Otherwise the branch is followed on, through further minima, until its
    saddles join both, and the pass is the highest saddle on the lowest way between them. Passes
    off the branch are not found. With None the function runs neither under `jax.jit` nor under
    `jax.vmap`.

    The barriers have first derivatives with respect to the contact and the load: at states of
    equilibrium the energy follows them at a fixed gap. Second derivatives are NaN.

    Arguments:
        contact: the contact problem.
        load: a single value, at which both states are.
        start: the equilibrium that is left, or a gap that relaxes to it.
        end: the equilibrium that is reached, for instance the other side of a jump, or a gap; None
            for detached surfaces, under a `MeanPressure` below zero.
        num_images: the number of states on the string, including its ends; with None the largest
            number of states of the branch that are returned.
        throw: raise where no saddle is found; otherwise look at `result`.

    Raises:
        ValueError: for an array of loads, states on another grid, fewer than three images, or None
            under another load than one that pulls.
        TypeError: with None, under `jax.jit` or `jax.vmap`.
        SolverError: if `throw`, where the two relax to the same state, no saddle is found, or with
            None the branch ends before (`lost_branch`) or without a pass (`no_detachment`).

    Example:
        >>> load = js.MeanGap(0.0624)
        >>> closed, open = (js.equilibrate(contact, load, initial=x) for x in (state, None))
        >>> way = js.transition(contact, load, closed, open)
        >>> f"{way.there:.2e}, {way.back:.2e}"
        '2.13e-07, 4.79e-07'
    """
    require_contact(contact)
    require_elastic(contact, "transition")
    require_loads(load, (), "transition takes one load", "use jax.vmap.")
    number = integer("num_images", num_images)
    require("num_images", number, number >= 3, "a string has a state between its ends.")
    load.warn_if_soft(contact.solid)
    warn_if_coarse(contact, FOR_JUMPS)
    problem = pose(contact, load)
    inputs = problem.contact, problem.load
    first = start_of(*inputs, start)
    if end is None:
        require_pull(jax.lax.stop_gradient(load))
        found, _ = pass_to_detached(number, itemgetter(0), *inputs, first)
        message = NOT_DETACHED.format(load)
    else:
        constants = jax.lax.stop_gradient((*inputs, first, start_of(*inputs, end)))
        with own_conventions():
            found = pass_by_string(StringMethod(num_images=number), *constants)
            found = with_derivatives(found, inputs, ("there", "back"))
        message = f"No pass was found between the two states at {load!r}"
    return finish(found, problem, lambda _: message, throw)

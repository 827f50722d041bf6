"""The test of a verdict: perturb an equilibrium along a mode, and see where it goes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.checks import (
    concrete,
    numbers,
    require,
    require_finite,
    require_shape,
    scalar_parameter,
)
from jaxstab.core.compile import program
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.types import ArrayLike, Field, Scalar
from jaxstab.equilibrium import Equilibrium, EquilibriumSolver, equilibrate
from jaxstab.equilibrium.equilibrium import State, found_equilibrium
from jaxstab.equilibrium.posing import as_left, indented_by
from jaxstab.equilibrium.verify import verify


def relax_along(
    contact: Contact,
    equilibrium: State,
    mode: ArrayLike,
    *,
    amplitude: ArrayLike | None = None,
    solver: EquilibriumSolver | None = None,
    throw: bool = True,
) -> Equilibrium:
    """Return the equilibrium to which a state relaxes after a push along a mode.

    The gap becomes g + t x, cut at zero, and is brought under the load; from there the energy
    descends to a minimum. After a small push, a state that is `stable` or `held_by_contact`
    returns. An `unstable` state, pushed along its critical mode, ends at a lower energy. A surface
    with a hardness is the one that the state leaves, which it may indent further.

    Arguments:
        contact: the contact problem.
        equilibrium: one of its equilibria, or a result that holds it: an entry of a sweep, a fold.
        mode: x, the direction of the push, of any length.
        amplitude: t [length]; by default such that no point moves by more than a thousandth of
            the mean gap. Its sign is the direction of the push.
        solver: the algorithm, by default the one of `equilibrate`. A solver that does not
            lower the energy tests nothing.
        throw: as in `equilibrate`.

    Returns:
        The new equilibrium, under the same load.

    Raises:
        ValueError: if equilibrium or mode are not on the contact's grid or not finite, the
            amplitude is not one finite number, or the push closes all of the gap where the load
            holds its mean.
        TypeError: if the mode is not real numbers, or the solver not one for equilibria.
        SolverError: as `equilibrate`, and for a state that is no equilibrium of the contact.

    Example:
        >>> mode = js.assess_stability(contact, state).cone.mode
        >>> back = js.relax_along(contact, state, mode)
        >>> bool(jnp.allclose(back.gap, state.gap, atol=1e-6))
        True
    """
    equilibrium = found_equilibrium(contact, equilibrium)
    x = numbers(mode, "The mode")
    require_shape("The mode", x.shape, contact.grid.shape, "give one on the contact's grid.")
    x = contact.grid.device_put(x)
    require_finite("The mode", x)
    t = None
    if amplitude is not None:
        t = scalar_parameter(amplitude, "The amplitude")
        require_finite("The amplitude", t)
    start, largest = _displaced_gap(contact.hardness is None, equilibrium.gap, x, t)
    cure = "it moves no point; give a direction to move in."
    largest = concrete(largest)
    require("The largest component of the mode", largest, largest > 0, cure)
    state = verify(contact, equilibrium)
    start = throw_failure(state, start, lambda: "There is nothing to relax", throw)
    left, at_rest = as_left(contact, equilibrium)
    released = equilibrate(left, at_rest.load, solver, initial=start, throw=throw)
    result = _first_failure(state, released.result)
    released = replace(released, result=result, load=equilibrium.load)
    if contact.hardness is None:
        return released
    return indented_by(released, equilibrium)


@partial(program, static_argnums=0)
def _displaced_gap(
    is_elastic: bool, gap: Field, mode: Field, amplitude: Scalar | None
) -> tuple[Field, Scalar]:
    """Return the gap after a push along a mode, and the mode's largest component."""
    if amplitude is None:
        amplitude = amplitude_of(gap, mode)
    start = gap + amplitude * mode
    if is_elastic:
        start = jnp.maximum(start, 0)
    return start, jnp.max(jnp.abs(mode))


@program
def _first_failure(before: RESULTS, after: RESULTS) -> RESULTS:
    return RESULTS.where(before == RESULTS.successful, after, before)


def amplitude_of(gap: Field, mode: Field, share: float = 1e-3) -> Scalar:
    """Return the amplitude at which a mode moves no point by more than a part of the mean gap."""
    largest = jnp.max(jnp.abs(mode))
    return share * jnp.mean(gap) / jnp.where(largest == 0, 1, largest)

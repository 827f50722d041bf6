"""The pass between two minima: the summit of a string of states, and the saddle near it.

The straight line between the two relaxes to a string of least energy. If no saddle is found near
its summit, the string is drawn anew around that, and relaxed.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.contact import Contact
from jaxstab.core.accuracy import NEGLIGIBLE
from jaxstab.core.compile import program
from jaxstab.core.control_flow import by_entries
from jaxstab.core.grid import total
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.equilibrium import state_at
from jaxstab.loads import Load
from jaxstab.transitions.result import Transition, heights_above
from jaxstab.transitions.saddle import Saddle, minima_beside, no_saddle, saddle_near
from jaxstab.transitions.string import Landscape, String, StringMethod

# The string is drawn anew around its highest image so often at most.
_MAX_ZOOMS = 5
# A string that is drawn anew takes so few steps: with more its images slide down its sides.
_FEW_STEPS = 8
# A string around the pass, the saddle found from it, and how often it was drawn anew.
_Zooming = tuple[String, Saddle, Array]


@program
@by_entries
def pass_by_string(
    method: StringMethod, contact: Contact, load: Load, first: Field, last: Field
) -> Transition:
    """Return the transition between the minima near two gaps."""
    solver = PreconditionedConjugateGradient()
    start, end = (find(contact, load, solver, gap) for gap in (first, last))
    are_found = (start.result == RESULTS.successful) & (end.result == RESULTS.successful)
    landscape = Landscape(contact, contact.control(load))
    string = method.run(landscape, (start.gap, end.gap)).state

    def goes_on(state: _Zooming) -> Flag:
        _, saddle, count = state
        return ~saddle.is_found & (count <= _MAX_ZOOMS) & are_found

    _, summit, _ = jax.lax.while_loop(
        goes_on,
        partial(_zoom, landscape, load, (start, end)),
        (string, no_saddle(string.summit), jnp.array(0)),
    )
    close = NEGLIGIBLE[start.gap.dtype.name]
    is_one = total((start.gap - end.gap) ** 2) <= close**2 * total(start.gap**2)
    result = RESULTS.where(summit.is_found, RESULTS.successful, RESULTS.no_pass)
    result = RESULTS.where(is_one, RESULTS.same_state, result)
    result = RESULTS.where(end.result == RESULTS.successful, result, end.result)
    result = RESULTS.where(start.result == RESULTS.successful, result, start.result)
    saddle = state_at(contact, load, jnp.where(summit.is_found, summit.gap, jnp.nan))
    there, back = heights_above((saddle.gap, start.gap, end.gap), contact, load)
    is_found = result == RESULTS.successful
    return Transition(
        jnp.where(is_found, there, jnp.nan),
        jnp.where(is_found, back, jnp.nan),
        start,
        end,
        replace(saddle, result=result),
        summit.mode,
        minima_beside(contact, load, summit, start.gap),
        string.images,
        string.energies - string.energies[0],
        result,
    )


def _zoom(
    landscape: Landscape, load: Load, ends: tuple[Equilibrium, Equilibrium], state: _Zooming
) -> _Zooming:
    """Return the string drawn anew around its summit, unless a saddle is found near to that."""
    string, _, count = state
    lowest = jnp.maximum(*(landscape.energy(end.gap) for end in ends))
    saddle = saddle_near(landscape.contact, load, string.summit, lowest)
    around = partial(_around_summit, landscape, string)
    return jax.lax.cond(saddle.is_found, lambda: string, around), saddle, count + 1


def _around_summit(landscape: Landscape, string: String) -> String:
    """Return a string between the neighbours of the highest image, relaxed."""
    corners = [string.images[string.highest + k] for k in (-1, 0, 1)]
    method = StringMethod(num_images=len(string.images), max_steps=_FEW_STEPS)
    return method.run(landscape, corners).state

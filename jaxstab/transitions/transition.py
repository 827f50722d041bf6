"""The pass between two equilibria at one load: the saddle point and the heights of the barrier."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.contact import Contact, require_contact
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.accuracy import NEGLIGIBLE
from jaxstab.core.checks import (
    concrete,
    integer,
    parameter,
    require,
    require_known,
    require_positive,
    where_known,
)
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.control_flow import by_entries
from jaxstab.core.display import Outcome
from jaxstab.core.grid import total
from jaxstab.core.implicit import attach, finite, pushed, undefined, where_traced
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import stacked
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.core.units import ENERGY, LENGTH, NUMBER
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.equilibrium import State, detached_where, state_at
from jaxstab.equilibrium.posing import finished, posed
from jaxstab.equilibrium.start import start_of
from jaxstab.loads import Load, MeanPressure, require_loads
from jaxstab.transitions.branch_pass import MAX_STEPS, Climb, Image, climbs_on_branch
from jaxstab.transitions.saddle import Saddle, minima_beside, no_saddle, saddle_near
from jaxstab.transitions.string import Landscape, String, StringMethod

# The string is drawn anew around its highest image so often at most.
_MAX_ZOOMS = 5
# A string that is drawn anew takes so few steps: with more its images slide down its sides.
_FEW_STEPS = 8

_IMAGES = 16
_NOT_DETACHED = "No pass to detached surfaces was found at {!r}"

# There and back; of the saddle, the start and the end. Detached surfaces are no end to come back
# from.
Heights = tuple[Scalar, ...]
Gaps = tuple[Field, ...]


class BarrierHeights(NamedTuple):
    """The energy of the pass above the state that is left, and above that which is reached."""

    there: Scalar
    back: Scalar


class Transition(Outcome):
    """The pass between two equilibria at one load.

    Attributes:
        there: energy of the saddle minus the energy of the start, at one load [energy].
        back: energy of the saddle minus the energy of the end [energy]; infinite from detached
            surfaces, whose energy falls without end under a dead load that pulls.
        start: the equilibrium that is left.
        end: the equilibrium that is reached; NaN, with no contact area, for detached surfaces.
        saddle: the equilibrium on the pass.
        mode: the unit vector along which its energy falls to both sides.
        minima: the two states to which a small push to either side leads, the one nearer to
            the start first. Where they are not start and end, there are minima between. NaN, with
            the result `pulled_off`, on the side on which the surfaces detach under a dead load.
        images: the gap along the string from start to end [length]; with detached surfaces as the
            end, of states along the branch from the start to the saddle.
        energies: of the images and of the load, minus the energy of the start [energy].
        result: how the search ended.
    """

    there: Annotated[Scalar, ENERGY]
    back: Annotated[Scalar, ENERGY]
    start: Equilibrium
    end: Equilibrium
    saddle: Equilibrium
    mode: Annotated[Field, NUMBER]
    minima: Equilibrium
    images: Annotated[Float[Array, " images *grid"], LENGTH]
    energies: Annotated[Float[Array, " images"], ENERGY]
    result: RESULTS

    @property
    def barrier(self) -> BarrierHeights:
        """The energies of the saddle above start and end: there and back [energy]."""
        return BarrierHeights(self.there, self.back)

    def rate(self, thermal_energy: ArrayLike, attempt_rate: ArrayLike) -> Scalar:
        """Return how often thermal motion leads over the pass: nu exp(-barrier / kT) [1/time].

        Arguments:
            thermal_energy: kT [energy].
            attempt_rate: nu, how often the state tries [1/time].

        Raises:
            ValueError: for numbers that are not positive.
        """
        energy = parameter(thermal_energy)
        attempts = parameter(attempt_rate)
        require_positive("The thermal energy", energy)
        require_positive("The attempt rate", attempts)
        return attempts * jnp.exp(-self.there / energy)


def transition(
    contact: Contact,
    load: Load,
    start: ArrayLike | State,
    end: ArrayLike | State | None,
    *,
    num_images: int = _IMAGES,
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
    """
    require_contact(contact)
    require_loads(load, (), "transition takes one load", "use jax.vmap.")
    number = integer("num_images", num_images)
    require("num_images", number, number >= 3, "a string has a state between its ends.")
    load.warn_if_soft(contact.solid)
    warn_if_coarse(contact, FOR_JUMPS)
    problem = posed(contact, load)
    inputs = problem.contact, problem.state
    first = start_of(*inputs, start)
    if end is None:
        _require_pull(jax.lax.stop_gradient(load))
        found, _ = _to_detached(number, itemgetter(0), *inputs, first)
        message = _NOT_DETACHED.format(load)
    else:
        constants = jax.lax.stop_gradient((*inputs, first, start_of(*inputs, end)))
        with own_conventions():
            found = _search(StringMethod(num_images=number), *constants)
            found = _with_barriers(found, inputs, ("there", "back"))
        message = f"No pass was found between the two states at {load!r}"
    return finished(found, problem, lambda _: message, throw)


def largest_climb(
    contact: Contact, load: MeanPressure, start: ArrayLike | State
) -> tuple[Transition, bool]:
    """Return the largest climb on the way from a state to detached surfaces.

    It is a transition from the minimum below it, which is the state itself if it meets no other on
    the way: whether that is so, is returned too. See `transition` to None, for the same state.

    Raises:
        SolverError: if no pass is found.
    """
    problem = posed(contact, load)
    inputs = problem.contact, problem.state
    first = start_of(*inputs, start)
    found, is_direct = _to_detached(_IMAGES, _largest, *inputs, first)
    return finished(found, problem, lambda _: _NOT_DETACHED.format(load), True), is_direct


def _largest(climbs: list[Climb]) -> Climb:
    return max(climbs, key=lambda climb: climb.height)


def pulls(load: Load) -> bool:
    """Return whether a load, of known value, is a dead one that pulls."""
    return isinstance(load, MeanPressure) and bool(concrete(load.value) < 0)


@where_known
def _require_pull(load: Load) -> None:
    """Raise `ValueError` unless a load is a dead one that pulls."""
    if not pulls(load):
        raise ValueError(
            f"The end is None, for detached surfaces without an equilibrium, and the load {load!r}"
            " does not pull them apart for good, as MeanPressure below zero does: give the "
            "separated equilibrium at this load as the end, or a gap that relaxes to it."
        )


@where_traced
def _with_barriers(
    found: Transition, inputs: tuple[Contact, Load], names: tuple[str, ...]
) -> Transition:
    """Return a pass whose finite barriers are functions of contact and load."""
    gaps = found.saddle.gap, found.start.gap, found.end.gap
    is_found = found.result == RESULTS.successful
    barriers = tuple(getattr(found, name) for name in names)
    known = gaps[: 1 + len(names)], is_found
    moved = attach(_changes_of_barriers, barriers, known, inputs)
    return replace(found, **dict(zip(names, moved, strict=True)))


def _changes_of_barriers(
    barriers: Heights, known: tuple[Gaps, Flag], inputs: tuple, changes: tuple
) -> tuple[Heights, Flag]:
    """Return how barriers change, at constant gaps, which are in equilibrium: a rule."""
    gaps, is_found = known
    gaps, inputs = finite(is_found, (gaps, inputs))
    # In second derivatives they count.
    gaps = attach(undefined, gaps, None, inputs)
    return pushed(partial(_barriers, gaps), inputs, changes), ~is_found


def _barriers(gaps: Gaps, contact: Contact, load: Load) -> Heights:
    """Return how far the energy of the first gap is above the energies of the others."""
    landscape = Landscape(contact, contact.control(load))
    top, *ends = (landscape.energy(landscape.control.restore(gap)) for gap in gaps)
    return tuple(top - end for end in ends)


# A string around the pass, the saddle found from it, and how often it was drawn anew.
_Zooming = tuple[String, Saddle, Array]


@program
@by_entries
def _search(
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
        partial(_zoomed, landscape, load, (start, end)),
        (string, no_saddle(string.summit), jnp.array(0)),
    )
    close = NEGLIGIBLE[start.gap.dtype.name]
    is_one = total((start.gap - end.gap) ** 2) <= close**2 * total(start.gap**2)
    result = RESULTS.where(summit.is_found, RESULTS.successful, RESULTS.no_pass)
    result = RESULTS.where(is_one, RESULTS.same_state, result)
    result = RESULTS.where(end.result == RESULTS.successful, result, end.result)
    result = RESULTS.where(start.result == RESULTS.successful, result, start.result)
    saddle = state_at(contact, load, jnp.where(summit.is_found, summit.gap, jnp.nan))
    there, back = _barriers((saddle.gap, start.gap, end.gap), contact, load)
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


def _zoomed(
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


def _to_detached(
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
        shown = stacked(shown, shown[0])
        found = _over(*constants[:2], minimum, saddle, minima, shown, result)
        return _with_barriers(found, (contact, load), ("there",)), len(climbs) == 1


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
    (there,) = _barriers((top.gap, start.gap), contact, load)
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

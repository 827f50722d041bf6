"""The pass between two equilibria at one load: the saddle point and the heights of the barrier."""

from dataclasses import replace
from functools import partial
from typing import Annotated, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.contact import Contact, require_contact
from jaxstab.contact.entry import answer
from jaxstab.contact.resolution import FOR_JUMPS
from jaxstab.core.checks import integer, is_traced, parameter, require, require_positive
from jaxstab.core.compile import program
from jaxstab.core.control_flow import by_entries
from jaxstab.core.display import Outcome
from jaxstab.core.grid import total
from jaxstab.core.implicit import attach, finite, pushed, undefined
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.core.units import ENERGY, LENGTH, NUMBER
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient, SaddleNewton
from jaxstab.equilibrium.equilibrate import find, posed
from jaxstab.equilibrium.equilibrium import State, state_at
from jaxstab.equilibrium.solvers.base import Problem
from jaxstab.loads import Load, require_loads
from jaxstab.paths.barriers.string import Landscape, String, StringMethod
from jaxstab.paths.curve.morse_index import index_of, some_modes
from jaxstab.stability.perturb import amplitude_of

Start = Field | None
# The string is drawn anew around its highest image so often at most.
_MAX_ZOOMS = 5
# A string that is drawn anew takes so few steps: with more its images slide down its sides.
_FEW_STEPS = 8
# A saddle may lie so high, over the barrier that the string shows.
_HIGHEST = 2
# States that differ by less are one, over the size of their gaps.
_SAME = {"float64": 1e-6, "float32": 1e-3}

# There and back; of the saddle, the start and the end.
Barriers = tuple[Scalar, Scalar]
Gaps = tuple[Field, Field, Field]


class BarrierHeights(NamedTuple):
    """The energy of the pass above the state that is left, and above that which is reached."""

    there: Scalar
    back: Scalar


class Transition(Outcome):
    """The pass between two equilibria at one load.

    Attributes:
        there: energy of the saddle minus the energy of the start, at one load [energy].
        back: energy of the saddle minus the energy of the end [energy].
        start: the equilibrium that is left.
        end: the equilibrium that is reached.
        saddle: the equilibrium on the pass.
        mode: the unit vector along which its energy falls to both sides.
        minima: the two states to which a small push to either side leads, the one nearer to
            the start first. Where they are not start and end, there are minima between.
        images: the gap along the string from start to end [length].
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
        energy, attempts = parameter(thermal_energy), parameter(attempt_rate)
        require_positive("The thermal energy", energy)
        require_positive("The attempt rate", attempts)
        return attempts * jnp.exp(-self.there / energy)


def transition(
    contact: Contact,
    load: Load,
    start: ArrayLike | State,
    end: ArrayLike | State,
    *,
    num_images: int = 16,
    throw: bool = True,
) -> Transition:
    """Return the pass between two equilibria at one load, on a path of least energy.

    A string of states between the two descends in energy, with gaps that are nowhere negative. Its
    highest state climbs, and Newton's method leads from there to the saddle: an equilibrium
    with exactly one negative eigenvalue on the critical space, above both ends. This is the pass to
    which the straight line between the two states leads; there may be others, and lower ones.

    The barriers have first derivatives with respect to the contact and the load: at states of
    equilibrium the energy follows them at a fixed gap. Second derivatives are NaN.

    Arguments:
        contact: the contact problem.
        load: a single value, at which both states are.
        start: the equilibrium that is left, or a gap that relaxes to it.
        end: the equilibrium that is reached, for instance the other side of a jump, or a gap.
        num_images: the number of states on the string, including its ends.
        throw: raise where no saddle is found; otherwise look at `result`.

    Raises:
        ValueError: for an array of loads, states on another grid, or fewer than three images.
        SolverError: if `throw`, where the two relax to the same state, or no saddle is found.
    """
    require_contact(contact)
    require_loads(load, (), "transition takes one load", "use jax.vmap.")
    number = integer("num_images", num_images)
    require("num_images", number, number >= 3, "a string has a state between its ends.")
    (padded, first), (_, last) = (posed(contact, load, s, FOR_JUMPS) for s in (start, end))
    return answer(
        partial(_search, number),
        padded,
        load,
        first,
        last,
        differentiable=_with_barriers,
        describe=lambda _: f"No pass was found between the two states at {load!r}",
        throw=throw,
    )


def _with_barriers(contact: Contact, load: Load, found: Transition) -> Transition:
    """Return a pass whose barriers are functions of contact and load."""
    if not is_traced((contact, load)):
        return found
    gaps = found.saddle.gap, found.start.gap, found.end.gap
    is_found = found.result == RESULTS.successful
    barriers = found.there, found.back
    there, back = attach(_changes_of_barriers, barriers, (gaps, is_found), (contact, load))
    return replace(found, there=there, back=back)


def _changes_of_barriers(
    barriers: Barriers, known: tuple[Gaps, Flag], inputs: tuple, changes: tuple
) -> tuple[Barriers, Flag]:
    """Return how barriers change, at constant gaps, which are in equilibrium: a rule."""
    gaps, is_found = known
    gaps, inputs = finite(is_found, (gaps, inputs))
    # In second derivatives they count.
    gaps = attach(undefined, gaps, None, inputs)
    return pushed(partial(_barriers, gaps), inputs, changes), ~is_found


def _barriers(gaps: Gaps, contact: Contact, load: Load) -> Barriers:
    """Return how far the energy of the first gap is above the energies of the other two."""
    landscape = Landscape(contact, contact.control(load))
    top, start, end = (landscape.energy(landscape.control.restore(gap)) for gap in gaps)
    return top - start, top - end


class _Climb(eqx.Module):
    """A string around the pass, how often it was drawn anew, and the saddle found from it."""

    string: String
    saddle: Field
    mode: Field
    count: Array
    is_found: Flag


@partial(program, static_argnums=0)
def _search(number: int, contact: Contact, load: Load, first: Start, last: Start) -> Transition:
    return by_entries(partial(_find, number))(contact, load, first, last)


def _find(number: int, contact: Contact, load: Load, first: Start, last: Start) -> Transition:
    """Return the transition between the minima near two gaps."""
    solver = PreconditionedConjugateGradient()
    start, end = (find(contact, load, solver, gap) for gap in (first, last))
    are_found = (start.result == RESULTS.successful) & (end.result == RESULTS.successful)
    landscape = Landscape(contact, contact.control(load))
    string = StringMethod().run(landscape, landscape.through((start.gap, end.gap), number)).state
    nothing = jnp.zeros_like(start.gap)
    climb = _Climb(string, string.summit, nothing, jnp.array(0), jnp.array(False))
    climb = jax.lax.while_loop(
        lambda climb: ~climb.is_found & (climb.count <= _MAX_ZOOMS) & are_found,
        partial(_climbed, landscape, load, (start, end)),
        climb,
    )
    close = _SAME[start.gap.dtype.name]
    is_one = total((start.gap - end.gap) ** 2) <= close**2 * total(start.gap**2)
    result = RESULTS.where(climb.is_found, RESULTS.successful, RESULTS.no_pass)
    result = RESULTS.where(is_one, RESULTS.same_state, result)
    result = RESULTS.where(end.result == RESULTS.successful, result, end.result)
    result = RESULTS.where(start.result == RESULTS.successful, result, start.result)
    saddle = state_at(contact, load, jnp.where(climb.is_found, climb.saddle, jnp.nan))
    there, back = _barriers((saddle.gap, start.gap, end.gap), contact, load)
    is_found = result == RESULTS.successful
    return Transition(
        jnp.where(is_found, there, jnp.nan),
        jnp.where(is_found, back, jnp.nan),
        start,
        end,
        replace(saddle, result=result),
        climb.mode,
        _sides(contact, load, climb, start.gap),
        string.images,
        string.energies - string.energies[0],
        result,
    )


def _climbed(
    landscape: Landscape, load: Load, ends: tuple[Equilibrium, Equilibrium], climb: _Climb
) -> _Climb:
    """Return the saddle near to the summit of a string, and the string drawn anew around it."""
    contact, control = landscape.contact, landscape.control
    string = climb.string
    problem = Problem.of(contact, control)
    summit = string.summit
    iteration = SaddleNewton(max_steps=60).run(problem, control.admissible(summit))
    gap = iteration.state.gap
    lowest = jnp.maximum(*(landscape.energy(end.gap) for end in ends))
    energy, seen = landscape.energy(gap), landscape.energy(summit)
    # Newton's method may have gone on to a higher one.
    is_close = (energy > lowest) & (energy - lowest <= _HIGHEST * (seen - lowest))
    index, modes = jax.lax.cond(
        (iteration.result == RESULTS.successful) & is_close,
        lambda: index_of(contact, load, gap, some_modes(gap), precise=True),
        lambda: (jnp.array(-1), some_modes(gap)),
    )
    is_found = index == 1
    further = jax.lax.cond(is_found, lambda: string, lambda: _zoomed(landscape, string))
    return _Climb(further, gap, modes[0], climb.count + 1, is_found)


def _sides(contact: Contact, load: Load, climb: _Climb, start: Field) -> Equilibrium:
    """Return the minima on both sides of the saddle, the one nearer to a gap first."""
    solver, control = PreconditionedConjugateGradient(), contact.control(load)
    push = amplitude_of(climb.saddle, climb.mode) * climb.mode

    def side(sign: Array) -> Equilibrium:
        pushed = control.admissible(climb.saddle + sign * push)
        return find(contact, load, solver, jnp.where(climb.is_found, pushed, jnp.nan))

    both = jax.lax.map(side, jnp.array([-1.0, 1.0], push.dtype))
    distances = jnp.stack([total((gap - start) ** 2) for gap in both.gap])
    order = jnp.where(distances[0] <= distances[1], jnp.array([0, 1]), jnp.array([1, 0]))
    return jax.tree.map(lambda leaf: leaf[order], both)


def _zoomed(landscape: Landscape, string: String) -> String:
    """Return a string between the neighbours of the highest image, relaxed."""
    corners = [string.images[string.highest + k] for k in (-1, 0, 1)]
    start = landscape.through(corners, len(string.images))
    return StringMethod(max_steps=_FEW_STEPS).run(landscape, start).state

"""The pass between two states at one load: its saddle, and the heights of its barrier."""

from dataclasses import replace
from functools import partial
from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.contact import Contact
from jaxstab.core.checks import parameter, require_positive
from jaxstab.core.display import Outcome
from jaxstab.core.implicit import attach, finite, no_derivatives, tangent_of, where_traced
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field, Flag, Scalar
from jaxstab.core.units import ENERGY, LENGTH, NUMBER
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load
from jaxstab.transitions.string import Landscape

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

    Example:
        >>> load = js.MeanGap(0.0624)
        >>> closed, open = (js.equilibrate(contact, load, initial=x) for x in (state, None))
        >>> way = js.transition(contact, load, closed, open)
        >>> bool(abs(way.there - way.back - (way.end.energy - way.start.energy)) < 1e-12)
        True
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


@where_traced
def with_derivatives(
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
    gaps = attach(no_derivatives, gaps, None, inputs)
    return tangent_of(partial(heights_above, gaps), inputs, changes), ~is_found


def heights_above(gaps: Gaps, contact: Contact, load: Load) -> Heights:
    """Return how far the energy of the first gap is above the energies of the others."""
    landscape = Landscape(contact, contact.control(load))
    top, *ends = (landscape.energy(landscape.control.restore(gap)) for gap in gaps)
    return tuple(top - end for end in ends)

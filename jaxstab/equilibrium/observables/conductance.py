"""The electrical or thermal conductance of a contact: of its constrictions.

Potential and elastic displacement are both harmonic, so that one follows from the other (J. R.
Barber, 2003): the conductance is the stiffness against a small move with the contact points held.
"""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar

import jax.numpy as jnp
import numpy as np

from jaxstab.contact import Contact
from jaxstab.core.checks import (
    cast,
    concrete,
    require,
    require_kind,
    scalar_parameter,
    where_known,
)
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.grid import Mesh, total
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.results import SolverError
from jaxstab.core.types import ArrayLike, Field, Flag, Mask, Scalar
from jaxstab.core.units import NUMBER, SPRING_CONSTANT, Dimension
from jaxstab.equilibrium.equilibrium import State, defined_contact
from jaxstab.equilibrium.observables.observable import Observable
from jaxstab.equilibrium.validity import warn_of_few_points
from jaxstab.solids import AxisymmetricHalfSpace, FreeHalfSpace, HalfSpace, Solid, Viscoelastic

# The solids in which displacements spread as potentials do.
_HalfSpaces = HalfSpace | FreeHalfSpace | AxisymmetricHalfSpace

CONDUCTANCE = Dimension("length/resistivity")


class Conductance(Observable):
    """The conductance of a contact of two half spaces, and its current.

    Attributes:
        conductance: C, the current over the difference of potentials, or heat over temperatures
            [length/resistivity]; on a line per length across it. Zero without contact,
            infinite in full contact, where nothing constricts the current.
        incremental_stiffness: the force over a small approach with the contact points fixed
            [force/length]; on a line [pressure].
        current: the fraction of the current that flows through each point, its sum 1; None along
            a path.

    Example:
        >>> f"{js.conductance(contact, state).incremental_stiffness:.2f}"
        '4.98'
    """

    shown: ClassVar[tuple[str, ...]] = ("conductance",)

    conductance: Annotated[Scalar, CONDUCTANCE]
    incremental_stiffness: Annotated[Scalar, SPRING_CONSTANT]
    current: Annotated[Field, NUMBER] | None


@own_conventions()
def conductance(
    contact: Contact,
    equilibrium: State,
    resistivities: tuple[ArrayLike, ArrayLike] = (0.5, 0.5),
) -> Conductance:
    """Return the electrical or thermal conductance of a contact.

    C = 2 K / (E* (rho1 + rho2)), K the incremental stiffness at a fixed contact (J. R. Barber,
    *Bounds on the electrical resistance between contacting elastic rough bodies*, 2003):
    all contact points (`Equilibrium.in_contact`) move by the same displacement, without pressure
    elsewhere. Adhesion has no part in K. C depends only on the contact points, not on E*, so its
    derivatives with respect to the load are zero between changes of these points.

    The potential is the difference between points far on both sides. In a periodic cell the
    potential that drives a uniform current is subtracted, so that C is the conductance of the
    constrictions in one cell. On a line with a free half space the points lie at a distance L, the
    length of the window.

    Works inside of `jax.jit` and `jax.vmap`, and with derivatives by resistivities and lengths.

    Arguments:
        contact: the contact problem, on a half space; of a viscoelastic one the relaxed modulus
            counts.
        equilibrium: one of its states.
        resistivities: rho1 and rho2 of the two bodies; of heat 1 over the conductivity. One may be
            zero, as in a perfect conductor. By default they add up to one.

    Warns:
        ContactWarning: for a contact of a handful of points, fewer than 5 along each side.

    Raises:
        TypeError: for another solid, and for something that is not a state.
        ValueError: for resistivities that are not two, negative, infinite or both zero, for a stack
            of states, one that was not found, and one of another grid, and where contact is not
            defined: without a closed gap under a law that repels at every gap.
        SolverError: if the linear system was not solved. Inside of a transformation all of these
            are NaN.

    Example:
        >>> f"{js.conductance(contact, state, resistivities=(1.0, 1.0)).conductance:.2f}"
        '4.98'
    """
    state = defined_contact(contact, equilibrium)
    warn_of_few_points(contact, state.contact_area)
    touches = state.in_contact
    solid = contact.solid
    if isinstance(solid, Viscoelastic):
        solid = solid.relaxed
    require_kind(
        solid,
        _HalfSpaces,
        "a solid in which displacements do not spread as potentials do: conductances are known for "
        "a HalfSpace, a FreeHalfSpace or an AxisymmetricHalfSpace.",
    )
    assert isinstance(solid, _HalfSpaces)
    inputs = solid, touches, state.gap, state.contact_area, _pair_of(resistivities)
    found, is_solved = _conductance(*inputs)
    _require_solved(is_solved)
    conductance, stiffness, current = found
    return Conductance(conductance, stiffness, current, units=contact.units)


@where_known
def _require_solved(is_solved: Flag) -> None:
    if not is_solved:
        raise SolverError(
            "The conductance was not found: its linear system was not solved to the precision. "
            "Use float64."
        )


def _pair_of(resistivities: tuple[ArrayLike, ArrayLike]) -> tuple[Scalar, Scalar]:
    if not (isinstance(resistivities, tuple | list) and len(resistivities) == 2):
        raise ValueError(f"The resistivities are {resistivities!r}: give two, (rho1, rho2).")
    first, second = (scalar_parameter(x, "A resistivity") for x in resistivities)
    # NumPy compiles nothing.
    known = [concrete(x) for x in (first, second)]
    for one in known:
        is_possible = (one >= 0) & (one < np.inf)
        require("A resistivity", one, is_possible, "it must be finite and not negative.")
    both = known[0] + known[1]
    require("The sum of the resistivities", both, both > 0, "one must be positive.")
    return first, second


@program
def _conductance(
    solid: _HalfSpaces,
    touches: Mask,
    gap: Field,
    contact_area: Scalar,
    resistivities: tuple[Scalar, Scalar],
) -> tuple[tuple[Scalar, Scalar, Field], Flag]:
    """Return conductance, stiffness and current, and whether the linear system was solved."""
    dtype = gap.dtype
    first, second = resistivities
    resistivity = (first + second).astype(dtype)
    pressure = _pressure(type(solid), solid.grid, touches)
    is_solved = ~jnp.isnan(pressure).any()
    pressure = jnp.where(jnp.isfinite(gap + contact_area).all(), pressure, jnp.nan)
    force = total(pressure)
    is_whole = jnp.all(touches) & (not solid.is_window)
    # E* is one.
    stiffness = jnp.where(is_whole, jnp.inf, force * solid.grid.cell_area.astype(dtype))
    current = jnp.where(is_whole, 1 / pressure.size, pressure / jnp.where(force > 0, force, 1))
    return (2 * stiffness / resistivity, solid.contact_modulus * stiffness, current), is_solved


def _pressure(kind: Callable[[Any, float], Solid], grid: Mesh, touches: Mask) -> Field:
    """Return the pressure under which the contact points sink by 1, for E* = 1 [1/length]."""
    solid = cast(kind(grid, 1.0).prepared, grid.lengths.dtype)
    # Full contact of a periodic cell takes no finite pressure.
    touches = touches & (jnp.any(~touches) | solid.is_window)
    field = touches.astype(grid.lengths.dtype)

    def apart(field: Field) -> Field:
        return jnp.where(touches, field, 0)

    shift = solid.min_stiffness

    def stiffen(field: Field) -> Field:
        if isinstance(solid, FreeHalfSpace):
            padded = solid.padded
            return padded.surface(padded.apply(jnp.pad(field, [(0, n) for n in field.shape])))
        return solid.apply(field) + shift * field

    return LinearSystem(solid.displacement, stiffen, apart).differentiable_solution(field)

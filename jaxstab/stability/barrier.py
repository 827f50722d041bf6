"""The margins of a state before it loses contact: the least reaction, and its energy barrier."""

from functools import partial
from typing import Annotated

import jax
import jax.numpy as jnp

from jaxstab.contact.contact import Contact
from jaxstab.core.display import Outcome, inline
from jaxstab.core.grid import total
from jaxstab.core.implicit import attach, finite, tangent_of
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.core.units import ENERGY, LENGTH
from jaxstab.equilibrium.derivatives import pressure_noise
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.potentials.evaluation import slope
from jaxstab.stability.eigenpair import Eigenpair

# Gap, elastic pressure and reaction; an eigenvalue and its mode.
Fields = tuple[Field, Field, Field]
Pair = tuple[Scalar, Field]


class Barrier(Outcome):
    """The barrier along the cone's mode, of the energy E(t) = t mu.x + t^2 lambda / 2.

    Attributes:
        height: (mu.x)^2 / (2 |lambda|) over the surface, where E is largest [energy].
        amplitude: t = mu.x / |lambda|, in units of the mode of unit norm [length].

    Example:
        >>> barrier = js.assess_stability(contact, state).barrier
        >>> f"{barrier.height:.5f}, {barrier.amplitude:.3f}"
        '0.00124, 0.528'
    """

    height: Annotated[Scalar, ENERGY]
    amplitude: Annotated[Scalar, LENGTH]

    __repr__ = inline


# Complementarity and barrier, as in `Stability`.
Margins = tuple[Scalar, Barrier]


def margins_of(
    scale: Scalar, area: Scalar, equilibrium: Equilibrium, cone: Eigenpair, is_held: Flag
) -> Margins:
    """Return the margins of a state, given the scale of pressure and the area of a point.

    The complementarity is +inf without contact; the barrier NaN where the state is not held.
    """
    complementarity, barrier = _margins(is_held, scale, area, *_state(equilibrium, cone))
    touches = jnp.any(equilibrium.gap == 0)
    return (
        jnp.where(touches, complementarity, jnp.inf),
        jax.tree.map(lambda number: jnp.where(is_held, number, jnp.nan), barrier),
    )


def differentiable(
    margins: Margins,
    contact: Contact,
    equilibrium: Equilibrium,
    cone: Eigenpair,
    is_held: Flag,
) -> Margins:
    """Return margins as functions of the contact, the equilibrium and the pair on the cone."""
    known = equilibrium.result == RESULTS.successful, is_held
    inputs = contact, *_state(equilibrium, cone)
    return attach(_changes_of_margins, margins, known, inputs)


def pressure_scale(contact: Contact, gap: Field, pressure: Field) -> Scalar:
    """Return the rms of elastic pressure and attraction [pressure]."""
    attraction = slope(contact.potential, gap)
    squares = total(pressure**2 + attraction**2)
    # Two `where`s keep the derivative of the root at zero out.
    positive = jnp.where(squares > 0, squares, 1)
    return jnp.where(squares > 0, jnp.sqrt(positive / attraction.size), 0)


def _state(equilibrium: Equilibrium, cone: Eigenpair) -> tuple[Fields, Pair]:
    fields = equilibrium.gap, equilibrium.pressure, equilibrium.reaction
    mode = cone.mode
    if equilibrium.indentation is not None:
        # Where the surface yields, a mode costs no energy at first order.
        mode = jnp.maximum(mode, 0)
    return fields, (cone.eigenvalue, mode)


def _formulae(is_held: Flag, contact: Contact, fields: Fields, pair: Pair) -> Margins:
    scale = pressure_scale(contact, *fields[:2])
    return _margins(is_held, scale, contact.grid.cell_area, fields, pair)


def _margins(is_held: Flag, scale: Scalar, area: Scalar, fields: Fields, pair: Pair) -> Margins:
    gap, _, reaction = fields
    least = jnp.min(jnp.where(gap == 0, reaction, jnp.max(reaction)))
    eigenvalue, mode = pair
    # The first-order cost of lifting off.
    cost = jnp.sum(reaction * mode)
    amplitude = -cost / jnp.where(is_held, eigenvalue, -1)
    height = cost * amplitude / 2 * area.astype(cost.dtype)
    return least / jnp.where(scale == 0, 1, scale), Barrier(height, amplitude)


def _changes_of_margins(
    _: Margins, known: tuple[Flag, Flag], inputs: tuple, changes: tuple
) -> tuple[Margins, tuple[Flag, Flag]]:
    is_found, is_held = known
    inputs = *finite(is_found, inputs[:2]), finite(is_held, inputs[2])
    contact, (gap, pressure, reaction), _ = inputs
    touches = gap == 0
    noise = pressure_noise(pressure + slope(contact.potential, gap), gap)
    least = jnp.min(jnp.where(touches, reaction, jnp.inf))
    is_tied = jnp.count_nonzero(touches & (reaction <= least + noise)) > 1
    changed = tangent_of(partial(_formulae, is_held), inputs, changes)
    return changed, (~is_found | is_tied, ~is_held)

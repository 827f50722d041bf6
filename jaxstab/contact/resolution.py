"""How long a range a grid resolves, and the warning that it is too coarse for the adhesion."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxstab.contact.contact import Contact, require_contact
from jaxstab.core.checks import concrete, positive_scalar, where_known
from jaxstab.core.compile import program
from jaxstab.core.display import text, times
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.warn import warn
from jaxstab.solids.solid import Solid

_MAX_REFINEMENT = 1024
# Whether a caller has warned already. A filter of warnings would have others repeated.
_is_said = ContextVar("is_said", default=False)


class ResolutionWarning(UserWarning):
    """The grid is too coarse for the adhesion.

    Example:
        >>> import warnings
        >>> short = js.potentials.Exponential(0.03, 0.01)
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     found = js.equilibrate(js.Contact(solid, heights, short), js.MeanGap(0.05))
        >>> caught[0].category.__name__
        'ResolutionWarning'
    """


# The resolution that a state needs, and a jump, where pinning shows in full.
FOR_STATES = 1.0
FOR_JUMPS = 4.0
# The error of a pull-off times the square of the resolution, measured on Johnson's wave.
PINNING = 0.2


@contextmanager
def warned_once(contact: Contact, needed: float) -> Iterator[None]:
    """Warn of a coarse grid before several solves, which then say nothing more of it."""
    warn_if_coarse(contact, needed)
    token = _is_said.set(True)
    try:
        yield
    finally:
        _is_said.reset(token)


def warn_if_coarse(contact: Contact, needed: float = FOR_STATES) -> None:
    """Warn if contact edges are pinned to the grid.

    It warns where `contact.resolution` is below the number needed. It does not warn inside of
    `jax.jit` and `jax.vmap`, where values are not known yet.
    """
    if _is_said.get():
        return
    _warn_of_pinning(contact.solid, contact.sharpest_curvature, needed)


@where_known
def _warn_of_pinning(solid: Solid, curvature: Scalar, needed: float) -> None:
    stiffest = concrete(_max_stiffness(solid.prepared))
    sharpest = concrete(curvature)
    if stiffest >= needed * sharpest:
        return
    resolution = stiffest / sharpest
    if resolution < FOR_STATES:
        effect = "contact edges may be pinned to the grid, and jumps be artefacts"
    else:
        percent = 100 * PINNING / resolution**2
        effect = f"loads of jumps and pull-offs may be off by {percent:.0f} %"
    message = (
        f"the grid of {times(solid.grid.shape)} points is too coarse for the adhesion: the "
        f"stiffness of its shortest wave is {resolution:.3g} of the largest |f''|, so that "
        f"{effect}. {_cure(solid, resolution / needed)}{_longer(resolution / needed)}"
    )
    warn(message, ResolutionWarning)


def resolved_range(contact: Contact, resolution: ArrayLike = FOR_JUMPS) -> Scalar:
    """Return the shortest range of the law that the grid resolves, with its work of adhesion.

    The largest |f''| is as 1 / range^2 if the work is the same, so that the range is that of the
    contact's law times sqrt(resolution / contact.resolution) [length]. A law with this `length`
    has the resolution that is asked for.

    Arguments:
        contact: the contact problem, whose law has a `length`, as the ones of
            `jaxstab.potentials` with a range.
        resolution: the `contact.resolution` to reach: by default 4, which pull-offs and jumps need;
            an equilibrium needs 1.

    Raises:
        TypeError: for a law without one number that is its range; the message has the factor.
        ValueError: if the resolution is not positive.

    Example:
        >>> f"{js.resolved_range(contact):.4f}"
        '0.0581'
    """
    require_contact(contact)
    needed = positive_scalar(resolution, "The resolution")
    factor = jnp.sqrt(needed / contact.resolution)
    length = getattr(contact.potential, "length", None)
    if not isinstance(length, jax.Array) or length.ndim > 0:
        raise TypeError(
            f"The law is {contact.potential!r}, without one range in its field `length`: multiply "
            f"the lengths of your law by {text(factor)}, at the same work of adhesion."
        )
    return factor * length


def pinning_error(contact: Contact) -> Scalar:
    """Return the relative error of a pull-off, or of the load of a jump, by pinning to the grid.

    It is 0.2 / resolution^2, as measured on Johnson's wave.
    """
    require_contact(contact)
    return PINNING / contact.resolution**2


@program
def _max_stiffness(solid: Solid) -> Scalar:
    return solid.max_stiffness


def _longer(share: np.floating) -> str:
    """Return how much longer a range this grid resolves; |f''| is the energy over its square."""
    # Rounded up, so that the warning is not given again.
    factor = math.ceil(10 * share**-0.5) / 10
    return f" This grid resolves a range {factor:g} times as long, with the same work of adhesion."


def _cure(solid: Solid, share: np.floating) -> str:
    """Return a grid that is stiff enough, from the present share of the stiffness needed."""
    grid = solid.grid
    refinement = 1
    stiffest = solid.max_stiffness
    # A stored number does not follow the grid.
    if any(leaf is stiffest for leaf in jax.tree.leaves(solid)):
        return "Use a finer grid, or a weaker or longer-ranged adhesion."
    while solid.max_stiffness * share < stiffest:
        refinement *= 2
        if refinement > _MAX_REFINEMENT:
            return "No grid of a size to compute with would do: use a weaker adhesion."
        # Waves that much shorter are the waves of as many points on a cell that much smaller.
        solid = eqx.tree_at(lambda solid: solid.grid, solid, grid.shrunk(refinement))
    finer = times(refinement * n for n in grid.shape)
    return f"A grid of {finer} would do, or a weaker or longer-ranged adhesion."

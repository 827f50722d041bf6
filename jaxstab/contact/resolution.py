"""The warning that a grid is too coarse for the adhesion on it."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import equinox as eqx
import jax
import numpy as np

from jaxstab.contact.contact import Contact
from jaxstab.core.checks import concrete, is_traced
from jaxstab.core.compile import program
from jaxstab.core.display import times
from jaxstab.core.types import Scalar
from jaxstab.core.warn import warn
from jaxstab.solids.solid import Solid

_MAX_REFINEMENT = 1024
# Whether a caller has warned already. A filter of warnings would have others repeated.
_is_said = ContextVar("is_said", default=False)


class ResolutionWarning(UserWarning):
    """The grid is too coarse for the adhesion."""


# The resolution that a state needs, and a jump, where pinning shows in full.
FOR_STATES, FOR_JUMPS = 1.0, 4.0
# The error of a pull-off times the square of the resolution, measured on Johnson's wave.
_PINNING = 0.2


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
    both = _max_stiffness(contact.solid), contact.profile.max_curvature
    stiffest, sharpest = map(concrete, both)
    if is_traced(both) or stiffest >= needed * sharpest:
        return
    resolution = stiffest / sharpest
    effect = (
        "contact edges may be pinned to the grid, and jumps be artefacts"
        if resolution < FOR_STATES
        else f"loads of jumps and pull-offs may be off by {100 * _PINNING / resolution**2:.0f} %"
    )
    message = (
        f"the grid of {times(contact.grid.shape)} points is too coarse for the adhesion: the "
        f"stiffness of its shortest wave is {resolution:.3g} of the largest |f''|, so that "
        f"{effect}. {_cure(contact, resolution / needed)}{_longer(resolution / needed)}"
    )
    warn(message, ResolutionWarning)


@program
def _max_stiffness(solid: Solid) -> Scalar:
    return solid.max_stiffness


def _longer(share: np.floating) -> str:
    """Return how much longer a range this grid resolves; |f''| is the energy over its square."""
    # Rounded up, so that the warning is not given again.
    factor = math.ceil(10 * share**-0.5) / 10
    return f" This grid resolves a range {factor:g} times as long, with the same work of adhesion."


def _cure(contact: Contact, share: np.floating) -> str:
    """Return a grid that is stiff enough, from the present share of the stiffness needed."""
    solid, refinement = contact.solid, 1
    stiffest = solid.max_stiffness
    # A stored number does not follow the grid.
    if any(leaf is stiffest for leaf in jax.tree.leaves(solid)):
        return "Use a finer grid, or a weaker or longer-ranged adhesion."
    while solid.max_stiffness * share < stiffest:
        refinement *= 2
        if refinement > _MAX_REFINEMENT:
            return "No grid of a size to compute with would do: use a weaker adhesion."
        # Waves that much shorter are the waves of as many points on a cell that much smaller.
        lengths = contact.grid.lengths / refinement
        solid = eqx.tree_at(lambda solid: solid.grid.lengths, solid, lengths)
    finer = times(refinement * n for n in contact.grid.shape)
    return f"A grid of {finer} would do, or a weaker or longer-ranged adhesion."

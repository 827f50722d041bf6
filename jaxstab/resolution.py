"""The warning that a grid is too coarse for the adhesion on it."""

import warnings

import equinox as eqx
import numpy as np

from jaxstab.checks import is_traced, known
from jaxstab.contact import Contact

_MAX_REFINEMENT = 1024
_already_said: dict[str | tuple[str, type[Warning], int], int] = {}


class ResolutionWarning(UserWarning):
    """The grid is too coarse for the adhesion."""


def warn_if_coarse(contact: Contact) -> None:
    """Warn, once for each such problem, if contact edges are pinned to the grid.

    That is where |f''| exceeds the stiffness of the shortest wave. Nothing is said inside of
    `jax.jit` and `jax.vmap`, where values are not known yet.
    """
    stiffest, sharpest = known(contact.solid.max_stiffness), known(contact.profile.max_curvature)
    if is_traced((stiffest, sharpest)) or stiffest >= sharpest:
        return
    resolution = stiffest / sharpest
    message = (
        f"the grid of {_times(contact.grid.shape)} points is too coarse for the adhesion: the "
        f"stiffness of its shortest wave is {resolution:.3g} of the largest |f''|, so that contact "
        f"edges may be pinned to the grid, and jumps be artefacts. {_cure(contact, resolution)}"
    )
    # A registry of its own, so that several functions say it once between them.
    warnings.warn_explicit(
        message, ResolutionWarning, "jaxstab", 1, module=__name__, registry=_already_said
    )


def _cure(contact: Contact, resolution: np.floating) -> str:
    solid, refinement = contact.solid, 1
    while solid.max_stiffness * resolution < contact.solid.max_stiffness:
        refinement *= 2
        if refinement > _MAX_REFINEMENT:
            return "No grid of a size to compute with would do."
        # Waves that much shorter are those of as many points on a cell that much smaller.
        lengths = contact.grid.lengths / refinement
        solid = eqx.tree_at(lambda solid: solid.grid.lengths, solid, lengths)
    finer = _times(tuple(refinement * n for n in contact.grid.shape))
    return f"A grid of {finer} would do, and so would a weaker or longer-ranged adhesion."


def _times(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))

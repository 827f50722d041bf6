"""The warning that a grid is too coarse for the adhesion on it."""

import warnings

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.checks import is_traced
from jaxstab.contact import Contact
from jaxstab.programs import program

_MAX_REFINEMENT = 1024
_already_said: dict[str | tuple[str, type[Warning], int], int] = {}


class ResolutionWarning(UserWarning):
    """The grid is too coarse for the adhesion."""


def warn_if_coarse(contact: Contact) -> None:
    """Warn, once for each such problem, if contact edges are pinned to the grid.

    That is where |f''| exceeds the stiffness of the shortest wave. Nothing is said inside of
    `jax.jit` and `jax.vmap`, where values are not known yet.
    """
    resolution = _resolution(contact)
    if is_traced(resolution) or resolution >= 1:
        return
    message = (
        f"the grid of {_times(contact.grid.shape)} points is too coarse for the adhesion: the "
        f"stiffness of its shortest wave is {resolution:.3g} of the largest |f''|, so that contact "
        f"edges may be pinned to the grid, and jumps be artefacts. {_cure(contact, resolution)}"
    )
    # A registry of its own, so that several functions say it once between them.
    warnings.warn_explicit(
        message, ResolutionWarning, "jaxstab", 1, module=__name__, registry=_already_said
    )


@program
def _resolution(contact: Contact) -> Float[Array, ""]:
    return contact.resolution


def _cure(contact: Contact, resolution: Array) -> str:
    shortest = jnp.max(contact.grid.wavenumbers)
    stiffest = contact.solid.stiffness_at(shortest)
    refinement = 2
    while contact.solid.stiffness_at(refinement * shortest) * resolution < stiffest:
        refinement *= 2
        if refinement > _MAX_REFINEMENT:
            return "No grid of a size to compute with would do."
    finer = _times(tuple(refinement * n for n in contact.grid.shape))
    return f"A grid of {finer} would do, and so would a weaker or longer-ranged adhesion."


def _times(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))

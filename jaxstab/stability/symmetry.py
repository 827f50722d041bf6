"""Symmetries of a surface that an unstable state has kept, and the warning that says so."""

from collections.abc import Iterator

import numpy as np

from jaxstab.contact.contact import Contact
from jaxstab.core.checks import concrete, is_readable, where_known
from jaxstab.core.rings import Rings
from jaxstab.core.warn import warn
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.stability.verdict import VERDICTS, Stability

# Fields agree with their images if one less their correlation is below these: heights to rounding,
# and gaps, which are known to the tolerance of a solver. A mode with less than the last differs.
_OF_HEIGHTS = 1e-9
_OF_GAPS = 1e-4
_OF_MODES = 0.5


class SymmetryWarning(UserWarning):
    """An unstable state has a symmetry of its surface that its mode breaks.

    Example:
        A flat surface at a gap at which attraction outweighs the elastic stiffness:

        >>> flat = js.Contact(solid, jnp.zeros(grid.shape), law)
        >>> even = js.equilibrate(flat, js.MeanGap(0.05))
        >>> import warnings
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     stability = js.assess_stability(flat, even)
        >>> caught[0].category.__name__
        'SymmetryWarning'
        >>> f"{stability.critical.eigenvalue:.2f}"
        '-0.48'
    """


@where_known
def warn_of_symmetry(contact: Contact, equilibrium: Equilibrium, stability: Stability) -> None:
    """Warn, where values are known, if an unstable state owes its place to a symmetry."""
    fields = contact.heights, equilibrium.gap, stability.critical.mode
    # Images along the radius are no symmetries.
    if isinstance(contact.grid, Rings):
        return
    if not is_readable((fields, stability.verdict)) or stability.verdict != VERDICTS.unstable:
        return
    heights, gap, mode = (np.asarray(concrete(field), float) for field in fields)
    broken = list(_broken_symmetries(heights, gap, mode, contact.solid.is_window))
    if broken:
        warn(
            f"the state is unstable, and its mode breaks a symmetry of surface and gap: "
            f"{' and '.join(broken)}. A solver keeps the symmetry of its start, even in a saddle. "
            "Go on along the mode, as by jaxstab.relax_along(contact, equilibrium, "
            "stability.critical.mode), or start from a gap without the symmetry.",
            SymmetryWarning,
        )


def _broken_symmetries(
    heights: np.ndarray, gap: np.ndarray, mode: np.ndarray, is_window: bool
) -> Iterator[str]:
    """Yield the symmetries along each side that heights and gap have, and the mode breaks."""
    heights, gap = heights - heights.mean(), gap - gap.mean()
    for axis, side in enumerate("xy"[: heights.ndim]):
        for is_mirrored, name in ((True, "a mirror image"), (False, "a period")):
            of_heights, of_gap, of_mode = (
                _correlations(field, axis, is_mirrored) for field in (heights, gap, mode)
            )
            keeps = (of_heights > 1 - _OF_HEIGHTS) & (of_gap > 1 - _OF_GAPS)
            if is_window:
                # A window has no period, and is mirrored about its middle alone.
                keeps[1:] = False
            if (keeps & (of_mode < _OF_MODES)).any():
                yield f"{name} along {side}"
                break


def _correlations(field: np.ndarray, axis: int, is_mirrored: bool) -> np.ndarray:
    """Return the correlations of a field with its image, or itself, shifted by 0 to n - 1 points.

    They are one for a constant, which has all symmetries.
    """
    image = field
    if is_mirrored:
        image = np.flip(field, axis)
    n = field.shape[axis]
    modes = np.fft.rfft(field, axis=axis) * np.fft.rfft(image, axis=axis).conj()
    others = tuple(i for i in range(field.ndim) if i != axis)
    products = np.fft.irfft(modes.sum(axis=others), n)
    square = np.sum(field**2)
    if square == 0:
        return np.ones(n)
    return products / square

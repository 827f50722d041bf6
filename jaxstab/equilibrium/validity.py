"""Warnings of states for which the model of an elastic solid, or its grid, does not hold."""

import numpy as np
from jaxtyping import Array, Float

from jaxstab.contact.contact import Contact
from jaxstab.core.checks import concrete, is_readable, where_known
from jaxstab.core.types import Scalar
from jaxstab.core.units import PRESSURE, PRESSURES
from jaxstab.core.warn import warn
from jaxstab.solids import AxisymmetricHalfSpace, FreeHalfSpace, HalfSpace, Viscoelastic

# The hardness of glasses and ceramics is about this part of E*, of metals less.
_HARDNESS = 1 / 20
# Softer solids are rubbers and gels, which strain without yielding [Pa].
_LEAST_MODULUS = 1e8
# Points along each side of a square, or of a line, whose area a grid tells to some 20 %.
_FEW = 5


class ContactWarning(UserWarning):
    """The pressure is more than an elastic solid bears, or the contact is a handful of points.

    Example:
        >>> light = js.equilibrate(contact, js.MeanGap(0.1))
        >>> import warnings
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     found = js.patches(contact, light)
        >>> caught[0].category.__name__
        'ContactWarning'
    """


@where_known
def warn_beyond_hardness(
    contact: Contact, mean_pressure: Float[Array, "..."], contact_area: Float[Array, "..."]
) -> None:
    """Warn if the mean pressure in contact of a state, or of one of several, exceeds E* / 20.

    It is at least p0 over the area fraction, whatever tension there is beside the contact. Only
    contacts whose pressures have a unit are of a material with a hardness, unless it is a rubber:
    in others heights and pressures may be scaled alike. One that has been given bounds pressures.
    """
    solid = contact.solid
    if isinstance(solid, Viscoelastic):
        solid = solid.relaxed
    has_modulus = isinstance(solid, HalfSpace | FreeHalfSpace | AxisymmetricHalfSpace)
    unit = contact.units.pressure
    is_bounded = contact.hardness is not None
    if unit is None or not has_modulus or is_bounded or not is_readable((mean_pressure, solid)):
        return
    modulus = float(concrete(solid.contact_modulus))
    if modulus * 10.0 ** PRESSURES[unit] < _LEAST_MODULUS:
        return
    pressures, areas = (np.asarray(x, float) for x in (mean_pressure, contact_area))
    in_contact = np.divide(pressures, areas, out=np.zeros_like(pressures), where=areas > 0)
    share = float(in_contact.max(initial=0)) / modulus
    if share > _HARDNESS:
        warn(
            f"the mean pressure of the points in contact is {share:.1g} E*, with an E* of "
            f"{contact.units.text(modulus, PRESSURE)}: metals, ceramics and glassy polymers "
            f"yield below {_HARDNESS:g} E*, so that their contact is larger and its pressure "
            "lower. Give the contact its `hardness`, press less, or take smoother heights.",
            ContactWarning,
        )


@where_known
def warn_of_few_points(contact: Contact, contact_area: Scalar) -> None:
    """Warn if the contact is a handful of points of the grid."""
    if not is_readable(contact_area):
        return
    shape = contact.grid.shape
    number = round(float(contact_area) * np.prod(shape))
    few = _FEW ** len(shape)
    if 0 < number < few:
        warn(
            f"fewer than {few} points of the grid are in contact: their number, area and "
            "conductance depend on the grid. Use a finer grid, or press more.",
            ContactWarning,
        )

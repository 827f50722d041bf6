"""Units of length, pressure and force by their symbols.

Contacts, surfaces and force curves take units as text: `jaxstab.Contact(..., unit="nm")`.
"""

from jaxstab.core.checks import require_one_of
from jaxstab.core.units import FORCES, LENGTHS, PRESSURES, unit_of

__all__ = ["powers_of_ten", "unit_of"]

_POWERS = {"length": LENGTHS, "pressure": PRESSURES, "force": FORCES}


def __dir__() -> list[str]:
    return __all__


def powers_of_ten(quantity: str) -> dict[str, int]:
    """Return the symbols of the units of a quantity, each with its power of ten in SI units.

    Arguments:
        quantity: "length", "pressure" or "force".

    Raises:
        ValueError: for another quantity.
    """
    require_one_of("quantity", quantity, _POWERS)
    return dict(_POWERS[quantity])

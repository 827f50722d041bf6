"""Units of length, pressure and force by their symbols.

Contacts, surfaces and force curves take units as text: `jaxstab.Contact(..., unit="nm")`.
"""

import math

from jaxstab.core.checks import require_one_of
from jaxstab.core.units import FORCES, LENGTHS, PRESSURES, suitable_prefix, unit_of

__all__ = ["powers_of_ten", "prefixed", "unit_of"]

_POWERS = {"length": LENGTHS, "pressure": PRESSURES, "force": FORCES}


def __dir__() -> list[str]:
    return __all__


def powers_of_ten(quantity: str) -> dict[str, int]:
    """Return the symbols of the units of a quantity, each with its power of ten in SI units.

    Arguments:
        quantity: "length", "pressure" or "force".

    Raises:
        ValueError: for another quantity.

    Example:
        >>> js.units.powers_of_ten("pressure")["MPa"]
        6
    """
    require_one_of("quantity", quantity, _POWERS)
    return dict(_POWERS[quantity])


def prefixed(largest: float, unit: str) -> tuple[float, str]:
    """Return a divisor of numbers up to the largest, and their unit with the prefix that suits it.

    For 4.2e4 and "Pa" these are 1000 and "kPa"; for zero, infinity and NaN one and the unit alone.

    Arguments:
        largest: the largest magnitude of the numbers, in the unit.
        unit: a unit that takes prefixes, as "Pa", "N", "m" or "J/m²".

    Example:
        >>> js.units.prefixed(2.5e-7, "m")
        (1e-09, 'nm')
    """
    largest = abs(largest)
    if largest == 0 or not math.isfinite(largest):
        return 1.0, unit
    power, prefix = suitable_prefix(largest)
    return 10.0**power, prefix + unit

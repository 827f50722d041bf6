"""Units of length."""

import numpy as np

from jaxstab.core.unit_system import LENGTHS, unit_of


def converted(value: np.ndarray, unit: str, other: str) -> np.ndarray:
    """Return lengths in another unit, rounded once: units are whole powers of ten apart."""
    exponent = LENGTHS[unit] - LENGTHS[other]
    return value * 10.0**exponent if exponent >= 0 else value / 10.0**-exponent

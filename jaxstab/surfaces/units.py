"""Units of length."""

from typing import Any

import numpy as np

_EXPONENTS = {"km": 3, "m": 0, "mm": -3, "µm": -6, "nm": -9, "Å": -10, "pm": -12}
# With the Greek letter, the micro sign, or neither; and the angstrom sign beside the letter.
_SPELLINGS = {
    "um": "µm",
    "\u03bcm": "µm",
    "A": "Å",
    "\u212b": "Å",
    "angstrom": "Å",
    "micron": "µm",
    "microns": "µm",
} | {
    prefix + name + plural: unit
    for prefix, unit in {"": "m", "kilo": "km", "milli": "mm", "micro": "µm", "nano": "nm"}.items()
    for name in ("meter", "metre")
    for plural in ("", "s")
}


def unit_of(name: Any) -> str:
    """Return the usual symbol of a unit of length."""
    word = str(name)
    unit = _SPELLINGS.get(word, _SPELLINGS.get(word.lower(), word))
    if not isinstance(name, str) or unit not in _EXPONENTS:
        raise ValueError(f"the unit is {name!r}: choose one of {', '.join(_EXPONENTS)}.")
    return unit


def unit_if_said(name: str | None) -> str | None:
    """Return the usual symbol of a unit of length, None where a file says none."""
    return unit_of(name) if name else None


def converted(value: np.ndarray, unit: str, other: str) -> np.ndarray:
    """Return lengths in another unit, rounded once: units are whole powers of ten apart."""
    exponent = _EXPONENTS[unit] - _EXPONENTS[other]
    return value * 10.0**exponent if exponent >= 0 else value / 10.0**-exponent

"""Westergaard (1939): a rigid sinusoid on an elastic half space, without adhesion, in line contact.

h = A cos(2 pi x / L). K. L. Johnson, *Contact Mechanics* (1985), section 13.2.
"""

import numpy as np

from jaxstab.core.checks import require
from jaxstab.references.arguments import Array, positive


def full_contact_pressure(amplitude: float, length: float, contact_modulus: float) -> float:
    """Return p* = pi E* A / L, the mean pressure at which contact becomes full [pressure].

    Raises:
        ValueError: for an amplitude, length or modulus that is not positive.

    Example:
        >>> f"{js.references.westergaard.full_contact_pressure(0.01, 1.0, 1.0):.4f}"
        '0.0314'
    """
    positive(amplitude=amplitude, length=length, contact_modulus=contact_modulus)
    return np.pi * contact_modulus * amplitude / length


def contact_fraction(
    mean_pressure: float, amplitude: float, length: float, contact_modulus: float
) -> float:
    """Return 2 a / L = (2 / pi) asin(sqrt(p / p*)), the part of the period in contact.

    Raises:
        ValueError: for a pressure that is negative or above p*, or others that are not positive.

    Example:
        >>> f"{js.references.westergaard.contact_fraction(0.01, 0.01, 1.0, 1.0):.4f}"
        '0.3816'
    """
    most = full_contact_pressure(amplitude, length, contact_modulus)
    is_partial = (mean_pressure >= 0) & (mean_pressure <= most)
    require("The mean pressure", mean_pressure, is_partial, f"give one from 0 to {most:.6g}.")
    ratio = mean_pressure / most
    return float(2 / np.pi * np.arcsin(np.sqrt(ratio)))


def pressure(
    x: Array,
    mean_pressure: float,
    amplitude: float,
    length: float,
    contact_modulus: float,
) -> Array:
    """Return p(x) = 2 p* cos(s) sqrt(sin(s_a)^2 - sin(s)^2) in contact, 0 elsewhere.

    Arguments:
        x: distance from a crest [length].
        mean_pressure: p [pressure].
        amplitude: A [length].
        length: the period L [length].
        contact_modulus: E* [pressure].

    Returns:
        The pressure [pressure]; s = pi x / L and s_a is its value at the edge of contact.

    Example:
        >>> found = js.references.westergaard.pressure(np.array([0.0, 0.5]), 0.01, 0.01, 1.0, 1.0)
        >>> [f"{p:.4f}" for p in found]
        ['0.0354', '0.0000']
    """
    edge = contact_fraction(mean_pressure, amplitude, length, contact_modulus) * np.pi / 2
    sine = np.sin(np.pi * x / length)
    under_root = np.maximum(np.sin(edge) ** 2 - sine**2, 0)
    shape = np.abs(np.cos(np.pi * x / length)) * np.sqrt(under_root)
    return 2 * full_contact_pressure(amplitude, length, contact_modulus) * shape

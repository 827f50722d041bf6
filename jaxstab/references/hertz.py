"""Hertz (1881): a rigid paraboloid on an elastic half space, without adhesion.

K. L. Johnson, *Contact Mechanics* (1985), section 4.2.
"""

import numpy as np

from jaxstab.references.arguments import not_negative, positive


def contact_radius(force: float, radius: float, contact_modulus: float) -> float:
    """Return a = (3 F R / (4 E*))^(1/3) [length].

    Raises:
        ValueError: for a negative force, and a radius or modulus that is not positive.

    Example:
        >>> f"{js.references.hertz.contact_radius(force=0.01, radius=1.0, contact_modulus=1.0):.4f}"
        '0.1957'
    """
    not_negative("force", force)
    positive(radius=radius, contact_modulus=contact_modulus)
    return float(np.cbrt(3 * force * radius / (4 * contact_modulus)))


def peak_pressure(force: float, radius: float, contact_modulus: float) -> float:
    """Return p = 3 F / (2 pi a^2), in the middle of the contact [pressure].

    Raises:
        ValueError: for a force, radius or modulus that is not positive.

    Example:
        >>> f"{js.references.hertz.peak_pressure(force=0.01, radius=1.0, contact_modulus=1.0):.4f}"
        '0.1246'
    """
    positive(force=force)
    return 3 * force / (2 * np.pi * contact_radius(force, radius, contact_modulus) ** 2)

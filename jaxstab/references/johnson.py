"""Johnson (1995): line contact of a rigid sinusoid and a half space, adhesion of zero range.

h = A cos(2 pi x / L), so that peak and valley are 2 A apart. Around each crest the surfaces touch
over a width 2 a; outside nothing acts, and opening the contact costs w per area.

Signs: pressures are positive in compression; the mean gap is A where the half space is flat and
touches the crests, and 0 in full contact. Numbers may be arrays, of
shapes that broadcast. A `ValueError` names an argument that is not positive and finite.

K. L. Johnson, Int. J. Solids Struct. 32, 423 (1995). In the equations theta = pi a / L, and
p* = pi E* A / L as in `westergaard`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxstab.core.checks import require
from jaxstab.core.roots import bisect
from jaxstab.references.arguments import Array, ArrayLike, positive


class WavyState(NamedTuple):
    """One equilibrium, or as many as the arrays have entries.

    Attributes:
        mean_pressure: p, positive in compression [pressure].
        mean_gap: the gap's mean over the period [length].
        contact_fraction: 2 a / L, the part of the period in contact [1].

    Example:
        >>> found = js.references.johnson.curve(0.5, 0.01, 1.0, 1.0, 1e-5)
        >>> f"{found.mean_pressure:.4f}, {found.mean_gap:.5f}"
        '0.0112, 0.00252'
    """

    mean_pressure: Array
    mean_gap: Array
    contact_fraction: Array


def adhesion_parameter(
    amplitude: ArrayLike, length: ArrayLike, contact_modulus: ArrayLike, work_of_adhesion: ArrayLike
) -> Array:
    """Return alpha = sqrt(2 w L / (pi^2 E* A^2)) (Johnson 1995) [1].

    It compares the energy of adhesion with the elastic energy of flattening.

    Arguments:
        amplitude: A [length].
        length: the period L [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].

    Example:
        >>> f"{js.references.johnson.adhesion_parameter(0.01, 1.0, 1.0, work_of_adhesion=1e-5):.3f}"
        '0.142'
    """
    amplitude, length, contact_modulus, work = positive(
        amplitude=amplitude,
        length=length,
        contact_modulus=contact_modulus,
        work_of_adhesion=work_of_adhesion,
    )
    return np.sqrt(2 * work * length / contact_modulus) / (np.pi * amplitude)


def curve(
    contact_fraction: ArrayLike,
    amplitude: ArrayLike,
    length: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> WavyState:
    """Return the state p / p* = sin(theta)^2 - alpha sqrt(tan(theta)), stable or not.

    Westergaard's pressure and the tension of periodic flat punches whose energy release rate is w
    (Johnson 1995). They lift the surface to a mean gap
    A (cos(theta)^2 + 2 (p / p*) ln(sin(theta))), by the displacement of each.

    Arguments:
        contact_fraction: 2 a / L, between 0 and 1 [1].
        amplitude: A [length].
        length: the period L [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].

    Raises:
        ValueError: if the fraction is not between 0 and 1, or another argument not positive and
            finite.

    Example:
        >>> found = js.references.johnson.curve(np.array([0.2, 0.5]), 0.01, 1.0, 1.0, 1e-5)
        >>> [f"{p:.4f}" for p in found.mean_pressure]
        ['0.0005', '0.0112']
    """
    contact_fraction, amplitude, length, contact_modulus, work = positive(
        contact_fraction=contact_fraction,
        amplitude=amplitude,
        length=length,
        contact_modulus=contact_modulus,
        work_of_adhesion=work_of_adhesion,
    )
    require("The contact fraction", contact_fraction, contact_fraction < 1, "give one below 1.")
    alpha = adhesion_parameter(amplitude, length, contact_modulus, work)
    theta = np.pi / 2 * contact_fraction
    ratio = np.sin(theta) ** 2 - alpha * np.sqrt(np.tan(theta))
    gap = amplitude * (np.cos(theta) ** 2 + 2 * ratio * np.log(np.sin(theta)))
    return WavyState(np.pi * contact_modulus * amplitude / length * ratio, gap, contact_fraction)


def pull_off(
    amplitude: ArrayLike, length: ArrayLike, contact_modulus: ArrayLike, work_of_adhesion: ArrayLike
) -> WavyState:
    """Return the state of the largest mean tension before contact is lost, where dp/da = 0.

    The smaller root of 4 sin(theta)^(3/2) cos(theta)^(5/2) = alpha (Johnson 1995).

    Arguments:
        amplitude: A [length].
        length: the period L [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].

    Raises:
        ValueError: if alpha is above 1.0652, where all partial contact is unstable; or if an
            argument is not positive and finite.

    Example:
        >>> f"{js.references.johnson.pull_off(0.01, 1.0, 1.0, 1e-5).mean_pressure:.5f}"
        '-0.00111'
    """
    return _fold(0.0, amplitude, length, contact_modulus, work_of_adhesion)


def jump_to_full_contact(
    amplitude: ArrayLike, length: ArrayLike, contact_modulus: ArrayLike, work_of_adhesion: ArrayLike
) -> WavyState:
    """Return the state of the largest mean pressure that leaves gaps, where dp/da = 0.

    The larger root of 4 sin(theta)^(3/2) cos(theta)^(5/2) = alpha (Johnson 1995).

    Arguments:
        amplitude: A [length].
        length: the period L [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].

    Raises:
        ValueError: if alpha is above 1.0652, where all partial contact is unstable; or if an
            argument is not positive and finite.

    Example:
        >>> f"{js.references.johnson.jump_to_full_contact(0.01, 1.0, 1.0, 1e-5).mean_pressure:.4f}"
        '0.0207'
    """
    return _fold(np.pi / 2, amplitude, length, contact_modulus, work_of_adhesion)


def is_full_by_itself(
    amplitude: ArrayLike, length: ArrayLike, contact_modulus: ArrayLike, work_of_adhesion: ArrayLike
) -> NDArray[np.bool_]:
    """Return whether contact becomes full without pressure: alpha > 3^(3/4) / 4 (Johnson 1995).

    Arguments:
        amplitude: A [length].
        length: the period L [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].

    Example:
        >>> [bool(js.references.johnson.is_full_by_itself(0.01, 1.0, 1.0, w)) for w in (1e-5, 1e-2)]
        [False, True]
    """
    alpha = adhesion_parameter(amplitude, length, contact_modulus, work_of_adhesion)
    return alpha > 3**0.75 / 4


# The angle at which 4 sin^(3/2) cos^(5/2) is largest; one fold lies on either side.
_MIDDLE = np.arctan(np.sqrt(3 / 5))


def _fold_parameter(theta: ArrayLike) -> Array:
    """Return the alpha for which contact of angle theta is at a fold."""
    return 4 * np.sin(theta) ** 1.5 * np.maximum(np.cos(theta), 0) ** 2.5


def _fold(
    end: float,
    amplitude: ArrayLike,
    length: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
) -> WavyState:
    """Return the fold between `end` and the middle."""
    alpha = adhesion_parameter(amplitude, length, contact_modulus, work_of_adhesion)
    largest = _fold_parameter(_MIDDLE)
    cure = f"give one up to {largest:.4f}."
    require("The adhesion parameter alpha", alpha, alpha <= largest, cure)
    theta = bisect(lambda theta: _fold_parameter(theta) - alpha, end, _MIDDLE)
    return curve(theta * 2 / np.pi, amplitude, length, contact_modulus, work_of_adhesion)

"""Maugis (1992): an elastic sphere with Dugdale's adhesion, between the JKR and the DMT limit.

A rigid paraboloid r^2 / (2 R) on an elastic half space of contact modulus E*, in contact up to the
radius a. From there to the outer radius c, where the gap is w / s, a constant tension s acts. The
branch of equilibria goes on without contact, a = 0, until c = 0 at d = -w / s.

Signs: forces are positive in compression; displacements count the approach of the bodies from
where the undeformed ones would touch in a point, positive into contact. Numbers may be arrays, of
shapes that broadcast. A `ValueError` names an argument that is not positive and finite; the
stiffness of a spring may be zero or infinite.

D. Maugis, J. Colloid Interface Sci. 150, 243 (1992); K. L. Johnson, J. A. Greenwood, J. Colloid
Interface Sci. 192, 326 (1997), for states without contact. In the equations A = a / a0 and
N = sqrt(c^2 - a^2) / a0 are in the units of `jkr.units`, C = hypot(A, N), t = arctan(N / A).
"""

from typing import NamedTuple

import numpy as np

from jaxstab.core.checks import require
from jaxstab.core.roots import bisect
from jaxstab.references import jkr
from jaxstab.references.arguments import Array, ArrayLike, not_negative, positive

# The range of ln(N / A), from nearly JKR to nearly no contact, and the range for folds, which ends
# before rounding blurs them.
_WIDTHS = (-40.0, 40.0)
_FOLDS = (-20.0, 20.0)


class DugdaleState(NamedTuple):
    """One equilibrium, or as many as the arrays have entries.

    Attributes:
        force: F, positive in compression [force].
        displacement: d, the approach, positive into contact [length].
        contact_radius: a [length].
        outer_radius: c, up to which the tension acts [length].

    Example:
        >>> lost = js.references.maugis.pull_off(1.0, 1.0, 1e-3, strength=0.1)
        >>> bool(lost.outer_radius > lost.contact_radius)
        True
    """

    force: Array
    displacement: Array
    contact_radius: Array
    outer_radius: Array


def transition_parameter(
    radius: ArrayLike, contact_modulus: ArrayLike, work_of_adhesion: ArrayLike, strength: ArrayLike
) -> Array:
    """Return lambda = 2 s / (pi w K^2 / R)^(1/3), K = 4 E* / 3: JKR if large, DMT if small.

    It is 1.157 times Tabor's parameter (Maugis 1992) [1].

    Arguments:
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        strength: s, the tension [pressure].

    Example:
        >>> f"{js.references.maugis.transition_parameter(1.0, 1.0, 1e-3, strength=0.1):.3f}"
        '1.127'
    """
    radius, contact_modulus, work, strength = positive(
        radius=radius,
        contact_modulus=contact_modulus,
        work_of_adhesion=work_of_adhesion,
        strength=strength,
    )
    return 2 * strength / np.cbrt(np.pi * work * (4 / 3 * contact_modulus) ** 2 / radius)


def curve(
    contact_radius: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    strength: ArrayLike,
) -> DugdaleState:
    """Return the state F / F0 = A^3 - lambda (A N + C^2 t), d / d0 = A^2 - (4/3) lambda N.

    The gap at c is w / s (Maugis 1992):
    (lambda/2) (A N + (C^2 - 2 A^2) t) + (4/3) lambda^2 (N t - C + A) = 1.

    Arguments:
        contact_radius: a [length].
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        strength: s, the tension [pressure].

    Example:
        >>> found = js.references.maugis.curve(0.3, 1.0, 1.0, 1e-3, strength=0.1)
        >>> f"{found.force:.4f}"
        '0.0152'
    """
    (contact_radius,) = positive(contact_radius=contact_radius)
    unit, parameter = _scales(radius, contact_modulus, work_of_adhesion, strength)
    ratio = contact_radius / unit.contact_radius
    width = bisect(lambda width: ratio - _radii(width, parameter)[0], *_WIDTHS)
    return _with_units(unit, *_in_contact(ratio, ratio * np.exp(width), parameter))


def without_contact(
    outer_radius: ArrayLike,
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    strength: ArrayLike,
) -> DugdaleState:
    """Return the state F = -pi s c^2, d = c^2 / (2 R) - 4 s c / (pi E*) - w / s without contact.

    The gap at c is w / s (Johnson & Greenwood 1997). At `first_touch`, where the middle touches,
    `curve` takes over.

    Arguments:
        outer_radius: c, at most the outer radius of `first_touch` [length].
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        strength: s, the tension [pressure].

    Raises:
        ValueError: if c is negative or too large, or another argument not positive and finite.

    Example:
        >>> found = js.references.maugis.without_contact(0.05, 1.0, 1.0, 1e-3, strength=0.1)
        >>> f"{found.force / (np.pi * 0.05**2 * 0.1):.2f}"
        '-1.00'
    """
    c = not_negative("outer_radius", outer_radius)
    unit, parameter = _scales(radius, contact_modulus, work_of_adhesion, strength)
    largest = _first_outer(parameter) * unit.contact_radius
    require("The outer radius", c, c <= largest, "give at most the outer radius of first_touch.")
    return _with_units(unit, *_without_contact(c / unit.contact_radius, parameter))


def first_touch(
    radius: ArrayLike, contact_modulus: ArrayLike, work_of_adhesion: ArrayLike, strength: ArrayLike
) -> DugdaleState:
    """Return the state between `without_contact` and `curve`: a = 0, and no gap in the middle.

    lambda pi C^2 / 4 + (4/3) lambda^2 (pi/2 - 1) C = 1 (the equation of `curve` for A = 0).

    Arguments:
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        strength: s, the tension [pressure].

    Example:
        >>> touch = js.references.maugis.first_touch(1.0, 1.0, 1e-3, strength=0.1)
        >>> f"{touch.force:.5f}, {touch.contact_radius:.1f}"
        '-0.00234, 0.0'
    """
    unit, parameter = _scales(radius, contact_modulus, work_of_adhesion, strength)
    return _with_units(unit, *_without_contact(_first_outer(parameter), parameter))


def pull_off(
    radius: ArrayLike,
    contact_modulus: ArrayLike,
    work_of_adhesion: ArrayLike,
    strength: ArrayLike,
    stiffness: ArrayLike = 0.0,
) -> DugdaleState:
    """Return the state of detachment under a spring: dF/dd = -k.

    The least F under dead load, k = 0 (Maugis 1992), and the least d under held displacement, k
    infinite; for lambda < 0.938 the latter comes after contact has been lost, at
    c = 4 s R / (pi E*) (Johnson & Greenwood 1997).

    Arguments:
        radius: R of the paraboloid [length].
        contact_modulus: E* [pressure].
        work_of_adhesion: w [energy/area].
        strength: s, the tension [pressure].
        stiffness: k of the spring [force/length].

    Example:
        >>> lost = js.references.maugis.pull_off(1.0, 1.0, 1e-3, strength=0.1)
        >>> f"{lost.force / (np.pi * 1e-3):.3f}"
        '-1.585'
    """
    unit, parameter = _scales(radius, contact_modulus, work_of_adhesion, strength)
    of_force, of_displacement = jkr.spring_weights(stiffness, unit)
    width = bisect(
        lambda width: -_slope(*_radii(width, parameter), parameter, of_force, of_displacement),
        *_FOLDS,
    )
    in_contact = _in_contact(*_radii(width, parameter), parameter)

    # F + k d without contact is a parabola in c; its lowest point is the fold if it is reached.
    curvature = of_displacement - np.pi * parameter * of_force
    bends_up = curvature > 0
    outer = of_displacement * 8 * parameter / (3 * np.pi) / np.where(bends_up, curvature, 1)
    is_apart = bends_up & (outer < _first_outer(parameter))
    both = zip(_without_contact(outer, parameter), in_contact, strict=True)
    return _with_units(unit, *(np.where(is_apart, *fields) for fields in both))


def _scales(
    radius: ArrayLike, contact_modulus: ArrayLike, work_of_adhesion: ArrayLike, strength: ArrayLike
) -> tuple[jkr.Scales, Array]:
    """Return the characteristic quantities, and lambda, the curve's only parameter in them."""
    sphere = radius, contact_modulus, work_of_adhesion
    return jkr.units(*sphere), transition_parameter(*sphere, strength)


def _positive_root(square: Array, linear: Array) -> Array:
    """Return x > 0 with square x^2 + linear x = 1."""
    return 2 / (linear + np.sqrt(linear**2 + 4 * square))


def _radii(width: Array, parameter: Array) -> tuple[Array, Array]:
    """Return A and N of given ln(N / A)."""
    n = np.exp(width)
    t = np.arctan(n)
    # C / A - 1, of which rounding would leave little near JKR, is n^2 / (1 + C / A).
    square = parameter / 2 * (n**2 * t + (n - t))
    linear = 4 / 3 * parameter**2 * (n * t - n**2 / (1 + np.hypot(1, n)))
    ratio = _positive_root(square, linear)
    return ratio, n * ratio


def _slope(
    ratio: Array, n: Array, parameter: Array, of_force: Array, of_displacement: Array
) -> Array:
    """Return d(x F + y d)/dA along the branch of equilibria, without a positive factor.

    x and y are `spring_weights`. Suffixes `_by_a` and `_by_n` are derivatives with respect to A and
    N: of the gap at c, which is the same all along the branch, and of x F + y d.
    """
    c = np.hypot(ratio, n)
    t = np.arctan2(n, ratio)
    sine = n / c
    cosine = ratio / c
    # dN / dA = -gap_by_a / gap_by_n.
    gap_by_a = parameter * ratio * (sine * cosine - t)
    gap_by_a = gap_by_a - 4 / 3 * parameter**2 * sine**2 * cosine / (1 + cosine)
    gap_by_n = parameter * n * (sine * cosine + t)
    gap_by_n = gap_by_n + 4 / 3 * parameter**2 * (t + sine * cosine - sine)
    load_by_a = of_force * (3 * ratio**2 - 2 * parameter * ratio * t) + 2 * of_displacement * ratio
    load_by_n = -2 * of_force * parameter * (ratio + n * t) - 4 / 3 * of_displacement * parameter
    return load_by_a * gap_by_n - load_by_n * gap_by_a


def _in_contact(ratio: Array, n: Array, parameter: Array) -> DugdaleState:
    """Return the state of given A and N, in units."""
    c = np.hypot(ratio, n)
    t = np.arctan2(n, ratio)
    force = ratio**3 - parameter * (ratio * n + c**2 * t)
    return DugdaleState(force, ratio**2 - 4 / 3 * parameter * n, ratio, c)


def _without_contact(c: Array, parameter: Array) -> DugdaleState:
    """Return the state of given C, also where surfaces would overlap, in units."""
    bulge = 8 / (3 * np.pi) * parameter * c
    displacement = c**2 / 2 - bulge - 2 / (np.pi * parameter)
    return DugdaleState(-np.pi / 2 * parameter * c**2, displacement, 0 * c, c)


def _first_outer(parameter: Array) -> Array:
    """Return C where the middle touches."""
    return _positive_root(np.pi / 4 * parameter, 4 / 3 * parameter**2 * (np.pi / 2 - 1))


def _with_units(unit: jkr.Scales, *numbers: Array) -> DugdaleState:
    """Return a state whose fields are given in units."""
    fields = zip(numbers, (*unit, unit.contact_radius), strict=True)
    fields = np.broadcast_arrays(*(number * scale for number, scale in fields))
    return DugdaleState(*(field.copy() for field in fields))

"""Equilibria of an axisymmetric tip on an elastic half space, with Dugdale's attraction.

A tension s = w / h acts between surfaces that are closer than the range h. In contact up to the
radius a, with tension up to the radius c, and with N = sqrt(c^2 - a^2), cos(phi) = a / c and the
tip's penetration D without adhesion (`tips`)

    d = D(a) - (2 s / E*) N,
    F = 2 E* int_0^a (D(a) - D(t)) dt - 2 s (a N + c^2 phi),
    h = (2 / pi) int_a^c (D(t) - D(a)) / sqrt(c^2 - t^2) dt + (4 s / (pi E*)) (N phi - (c - a)).

For a paraboloid these are the equations of D. Maugis, J. Colloid Interface Sci. 150, 243 (1992),
with the limits of JKR (s large) and DMT (s small). Before contact (K. L. Johnson and J. A.
Greenwood, J. Colloid Interface Sci. 192, 326 (1997)), with the shape f of the tip,

    d = f(c) - 4 s c / (pi E*) - h,   F = -pi s c^2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from jaxstab.lab.tips import FlatPunch, Tip

# States in contact and before it; the points of Gauss of the integrals, which are smooth.
_IN_CONTACT = 300
_BEFORE = 100
_GAUSS = 8
# Radii are dense where the contact begins.
_POWER = 1.5
# Steps of the secant for ln(N / a), by the logarithm of the gap, which is nearly straight; the
# first slope, the least and the largest one, and the error at which they end.
_STEPS = 20
_SLOPE = 2.0
_FLATTEST, _STEEPEST = 0.5, 4.0
_CLOSE = 1e-9
# Radii among which the largest is sought [m].
_TRIED_RADII = np.geomspace(1e-12, 1.0, 300)
# How near a contact comes to the largest radius of a tip.
_NEXT_TO = 1e-9
# The states go on a little beyond the travel.
_SPARE = 0.02
# The widest and the narrowest zone of attraction N / a.
_WIDEST, _NARROWEST = 20.0, -18.0

_nodes, _weights = np.polynomial.legendre.leggauss(_GAUSS)
_NODES = (_nodes + 1) / 2
_WEIGHTS = _weights / 2


class TipEquilibria(NamedTuple):
    """Equilibria in order along their branch, from apart to deep in contact.

    Attributes:
        indentation: d, from where the undeformed surfaces touch, positive into the solid [m].
        force: F, positive in compression [N].
    """

    indentation: np.ndarray
    force: np.ndarray


def without_adhesion(
    tip: Tip | FlatPunch, modulus: float, travel: float, compliance: float
) -> TipEquilibria:
    """Return Sneddon's states from no contact to a travel of the far end of a spring.

    Arguments:
        tip: the tip.
        modulus: E* [Pa].
        travel: d + F / k of the deepest state [m].
        compliance: 1 / k of the spring [m/N].
    """
    if isinstance(tip, FlatPunch):
        return _punch(tip, modulus, 0.0, travel, compliance)
    radii = _radii(tip, modulus, 0.0, travel, compliance)
    depths = tip.penetration(radii)
    forces = 2 * modulus * _pressure_integral(tip, radii, depths)
    return TipEquilibria(np.append(0.0, depths), np.append(0.0, forces))


def with_adhesion(
    tip: Tip | FlatPunch,
    modulus: float,
    work: float,
    length: float,
    travel: float,
    compliance: float,
) -> TipEquilibria:
    """Return all equilibria, stable or not, from where the attraction begins to a travel.

    Arguments:
        tip: the tip; a flat punch is one with an attraction of no range (Kendall).
        modulus: E* [Pa].
        work: w [J/m^2].
        length: h, the range of the attraction [m].
        travel: d + F / k of the deepest state [m].
        compliance: 1 / k of a spring [m/N].
    """
    if isinstance(tip, FlatPunch):
        return _punch(tip, modulus, work, travel, compliance)
    tension = work / length
    ratio = tension / modulus
    radii = _radii(tip, modulus, work, travel, compliance)
    depths = tip.penetration(radii)
    zone = np.exp(_log_zone(tip, radii, depths, length, ratio))
    widths = radii * zone
    outer = np.hypot(radii, widths)
    indentation = depths - 2 * ratio * widths
    force = 2 * modulus * _pressure_integral(tip, radii, depths)
    force -= 2 * tension * (radii * widths + outer**2 * np.arctan(zone))
    touch = _first_touch(tip, length, ratio, outer[0])
    c = touch * np.linspace(0, 1, _BEFORE)
    before = tip.shape(c) - 4 * ratio * c / np.pi - length
    return TipEquilibria(
        np.concatenate([before, indentation]),
        np.concatenate([-np.pi * tension * c**2, force]),
    )


def _punch(
    tip: FlatPunch, modulus: float, work: float, travel: float, compliance: float
) -> TipEquilibria:
    """Return F = 2 E* A d from the pull-off at d = -sqrt(2 pi w A / E*) on."""
    stiffness = 2 * modulus * tip.radius
    pull_off = np.sqrt(2 * np.pi * work * tip.radius / modulus)
    depth = travel / (1 + stiffness * compliance)
    indentation = np.linspace(-pull_off, max(depth, 0.0), _IN_CONTACT)
    return TipEquilibria(np.append(-pull_off, indentation), stiffness * np.append(0.0, indentation))


def _radii(tip: Tip, modulus: float, work: float, travel: float, compliance: float) -> np.ndarray:
    """Return contact radii from nearly zero to where d + F / k is a travel.

    Adhesion lowers d and F by at most the amounts of JKR, sqrt(2 pi w a / E*) and
    sqrt(8 pi w E* a^3), in states in which the spring is pressed.
    """
    a = _TRIED_RADII
    if np.isfinite(tip.largest_radius):
        a = tip.largest_radius * np.tanh(a / tip.largest_radius)
        a = a[a < tip.largest_radius * (1 - _NEXT_TO)]
    depths = tip.penetration(a)
    force = 2 * modulus * _pressure_integral(tip, a, depths) - np.sqrt(
        8 * np.pi * work * modulus * a**3
    )
    travel = (1 + _SPARE) * travel
    reached = depths - np.sqrt(2 * np.pi * work * a / modulus) + compliance * force
    place = int(np.argmax(reached > travel))
    top = a[-1]
    if place > 0:
        pair = slice(place - 1, place + 1)
        top = np.exp(np.interp(travel, reached[pair], np.log(a[pair])))
    return top * (np.arange(1, _IN_CONTACT + 1) / _IN_CONTACT) ** _POWER


def _pressure_integral(tip: Tip, radii: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """Return int_0^a (D(a) - D(t)) dt."""
    inside = tip.penetration(radii[:, None] * _NODES)
    return radii * (depths - inside @ _WEIGHTS)


def _log_zone(
    tip: Tip, radii: np.ndarray, depths: np.ndarray, length: float, ratio: float
) -> np.ndarray:
    """Return ln(N / a) at which the gap at the outer radius is the range of the attraction."""
    widest = np.full(len(radii), _WIDEST)
    if np.isfinite(tip.largest_radius):
        # The tip ends.
        reach = (1 - _NEXT_TO) * tip.largest_radius / radii
        widest = np.log(np.sqrt(np.maximum(reach**2 - 1, np.exp(2 * _NARROWEST))))

    def log_gap(zone: np.ndarray) -> np.ndarray:
        n = np.exp(zone)
        angle = np.arctan(n)
        outer = radii * np.hypot(1, n)
        # t = c cos(phi (1 - x)), from a to c.
        angles = angle[:, None] * (1 - _NODES)
        penetrations = tip.penetration(outer[:, None] * np.cos(angles)) - depths[:, None]
        lift = 2 / np.pi * angle * (penetrations @ _WEIGHTS)
        bulge = 4 * ratio / np.pi * radii * (n * angle - n**2 / (1 + np.hypot(1, n)))
        return np.log(np.maximum(lift + bulge, 1e-300))

    # Of a short range the tension bends the surface, of a long one the tip falls away.
    short = np.sqrt(np.pi * length / (2 * ratio * radii))
    share = length / depths
    long = np.where(share < 1, np.cbrt(2 * share), np.sqrt(2 * share))
    zone = np.clip(np.log(np.minimum(short, long)), _NARROWEST, widest)
    away = log_gap(zone) - np.log(length)
    slope = np.full(len(radii), _SLOPE)
    for _ in range(_STEPS):
        step = np.clip(zone - away / slope, _NARROWEST, widest) - zone
        zone = zone + step
        before, away = away, log_gap(zone) - np.log(length)
        if np.max(np.abs(away)) < _CLOSE:
            break
        secant = (away - before) / np.where(step == 0, 1, step)
        slope = np.where(np.abs(step) > _CLOSE, np.clip(secant, _FLATTEST, _STEEPEST), slope)
    return zone


def _first_touch(tip: Tip, length: float, ratio: float, largest: float) -> float:
    """Return c where the gap on the axis closes: f(c) + 2 s c / E* (1 - 2 / pi) = h."""

    def less(c: float) -> float:
        return float(tip.shape(np.asarray(c))) + 2 * ratio * c * (1 - 2 / np.pi) - length

    # Rounding of the outer radius in contact may leave it just below.
    if less(largest) <= 0:
        return largest
    return brentq(less, 0.0, largest, xtol=_CLOSE * largest)  # pyright: ignore[reportReturnType]

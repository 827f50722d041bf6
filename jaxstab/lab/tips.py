"""Axisymmetric tips, by their shape and Sneddon's penetration; lengths are in metres.

A tip of the shape f(r), f(0) = 0, penetrates an elastic half space without adhesion by

    D(a) = a int_0^a f'(r) / sqrt(a^2 - r^2) dr

where the contact has the radius a, under the force F = 2 E* int_0^a (D(a) - D(t)) dt (I. N.
Sneddon, Int. J. Eng. Sci. 3, 47 (1965)).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

# Radii of tips [m]: others are numbers in another unit.
_SMALLEST, _LARGEST = 1e-10, 0.1
# Half angles [degrees]: smaller ones are numbers in radians.
_SHARPEST, _BLUNTEST = 2.0, 89.5
# F = factor tan(half angle) E* d^2, by the number of faces (G. G. Bilodeau, J. Appl. Mech. 59, 519
# (1992)); for a cone the factor is 2 / pi.
_PYRAMIDS = {3: 0.8887, 4: 0.7453}


class Tip(ABC):
    """An axisymmetric tip.

    Example:
        >>> isinstance(js.lab.Paraboloid(5e-6), js.lab.Tip)
        True
    """

    @abstractmethod
    def shape(self, radii: np.ndarray) -> np.ndarray:
        """Return f(r), how far the tip is above its apex [m]."""

    @abstractmethod
    def penetration(self, radii: np.ndarray) -> np.ndarray:
        """Return D(a) at radii of the contact [m]."""

    @property
    def largest_radius(self) -> float:
        """The largest radius of a contact [m]."""
        return np.inf


class _Parabolic(Tip):
    """A tip f = r^2 / (2 R) of the radius R at its apex, with D = a^2 / R."""

    radius: float

    def shape(self, radii: np.ndarray) -> np.ndarray:
        """Return f(r) [m]."""
        return radii**2 / (2 * self.radius)

    def penetration(self, radii: np.ndarray) -> np.ndarray:
        """Return D(a) [m]."""
        return radii**2 / self.radius


@dataclass(frozen=True)
class Paraboloid(_Parabolic):
    """A paraboloid f = r^2 / (2 R), with D = a^2 / R: Hertz' sphere.

    Arguments:
        radius: R, the radius of curvature at the apex [m].

    Raises:
        ValueError: for a radius that is not between 0.1 nm and 0.1 m.

    Example:
        >>> tip = js.lab.Paraboloid(radius=5e-6)
        >>> f"{tip.penetration(np.array(1e-6)):.1e}"
        '2.0e-07'
    """

    radius: float

    def __post_init__(self) -> None:
        _require_radius(self.radius)


@dataclass(frozen=True)
class TwoSpheres(_Parabolic):
    """Two spheres, of the tip and of the sample: a paraboloid of 1 / R = 1 / R_tip + 1 / R_sample.

    The sample is held where it does not deform, as a sphere that is glued or half embedded. The
    modulus of the fit is that of the sample; `ElasticTip` makes the tip elastic too.

    Arguments:
        tip_radius: R_tip, infinity for a flat plate [m].
        sample_radius: R_sample [m].

    Raises:
        ValueError: for a radius that is not between 0.1 nm and 0.1 m, but for a plate.

    Example:
        >>> f"{js.lab.TwoSpheres(tip_radius=5e-6, sample_radius=20e-6).radius:.1e}"
        '4.0e-06'
    """

    tip_radius: float
    sample_radius: float

    def __post_init__(self) -> None:
        _require_radius(self.sample_radius)
        if self.tip_radius != np.inf:
            _require_radius(self.tip_radius)

    @property
    def radius(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The radius R of the paraboloid [m]."""
        return 1 / (1 / self.tip_radius + 1 / self.sample_radius)


@dataclass(frozen=True)
class SphereOnPlate(TwoSpheres):
    """A soft sphere that lies on a rigid plate and is pressed by a tip, without adhesion.

    The sphere deforms at both contacts under the same force F = 4 / 3 E* sqrt(R_i) d_i^(3/2), so
    that the sum of both depths is that of one paraboloid, R^(-1/3) = (1 / R_tip + 1 /
    R_sample)^(1/3) + R_sample^(-1/3) (M. Glaubitz et al., Soft Matter 10, 6732 (2014)).

    Arguments:
        tip_radius: R_tip, infinity for a flat plate [m].
        sample_radius: R_sample [m].

    Raises:
        ValueError: for a radius that is not between 0.1 nm and 0.1 m, but for a plate.

    Example:
        >>> js.lab.SphereOnPlate(tip_radius=5e-6, sample_radius=20e-6)
        SphereOnPlate(tip_radius=5e-06, sample_radius=2e-05)
    """

    @property
    def radius(self) -> float:
        """The radius R of the paraboloid [m]."""
        return (np.cbrt(1 / super().radius) + np.cbrt(1 / self.sample_radius)) ** -3


@dataclass(frozen=True)
class ElasticTip(Tip):
    """A tip of another shape that is elastic itself: 1 / E* = (1 - nu^2) / E + (1 - nu_t^2) / E_t.

    Both bodies are half spaces as far as their deformation goes. The modulus of the fit is that of
    the sample, E.

    Arguments:
        tip: its shape; a flat punch is rigid.
        youngs_modulus: E_t of the tip [Pa].
        poisson_ratio: nu_t of the tip.

    Raises:
        TypeError: for another shape.
        ValueError: for a modulus that is not positive, Poisson's ratio outside of (-1, 0.5], and
            a sphere on a plate, whose other contact has no tip.

    Example:
        >>> js.lab.ElasticTip(js.lab.Paraboloid(5e-6), youngs_modulus=70e9, poisson_ratio=0.2)
        ElasticTip(tip=Paraboloid(radius=5e-06), youngs_modulus=70000000000.0, poisson_ratio=0.2)
    """

    tip: Tip
    youngs_modulus: float
    poisson_ratio: float

    def __post_init__(self) -> None:
        if not isinstance(self.tip, Tip) or isinstance(self.tip, ElasticTip):
            raise TypeError(
                f"The shape is {self.tip!r}: give a Sphere, Paraboloid, Cone, Pyramid or "
                "TwoSpheres of jaxstab.lab."
            )
        if isinstance(self.tip, SphereOnPlate):
            raise ValueError(
                "A sphere on a plate has one contact with the tip and one without: the tip must be "
                "rigid. Give TwoSpheres for a sphere that is held otherwise."
            )
        if not self.youngs_modulus > 0:
            raise ValueError(f"The modulus of the tip is {self.youngs_modulus} Pa: give E > 0.")
        if not -1 < self.poisson_ratio <= 0.5:
            raise ValueError(
                f"Poisson's ratio of the tip is {self.poisson_ratio}: it lies in (-1, 0.5]."
            )

    @property
    def compliance(self) -> float:
        """(1 - nu_t^2) / E_t [1/Pa]."""
        return (1 - self.poisson_ratio**2) / self.youngs_modulus

    def shape(self, radii: np.ndarray) -> np.ndarray:
        """Return f(r) [m]."""
        return self.tip.shape(radii)

    def penetration(self, radii: np.ndarray) -> np.ndarray:
        """Return D(a) [m]."""
        return self.tip.penetration(radii)

    @property
    def largest_radius(self) -> float:
        """The largest radius of a contact [m]."""
        return self.tip.largest_radius


@dataclass(frozen=True)
class Sphere(Tip):
    """A sphere f = R - sqrt(R^2 - r^2), with D = (a / 2) ln((R + a) / (R - a)).

    Arguments:
        radius: R [m].

    Raises:
        ValueError: for a radius that is not between 0.1 nm and 0.1 m.

    Example:
        >>> sphere = js.lab.Sphere(radius=5e-6)
        >>> f"{sphere.penetration(np.array(1e-6)):.3e}"
        '2.027e-07'
    """

    radius: float

    def __post_init__(self) -> None:
        _require_radius(self.radius)

    def shape(self, radii: np.ndarray) -> np.ndarray:
        """Return f(r) [m]."""
        return radii**2 / (self.radius + np.sqrt(self.radius**2 - radii**2))

    def penetration(self, radii: np.ndarray) -> np.ndarray:
        """Return D(a) [m]."""
        return radii * np.arctanh(radii / self.radius)

    @property
    def largest_radius(self) -> float:
        """The radius of the sphere [m]."""
        return self.radius


@dataclass(frozen=True)
class Cone(Tip):
    """A cone f = r / tan(alpha), with D = pi a / (2 tan(alpha)).

    Arguments:
        half_angle: alpha, between axis and flank [degrees].

    Raises:
        ValueError: for an angle that is not between 2 and 89.5 degrees.

    Example:
        >>> cone = js.lab.Cone(half_angle=45.0)
        >>> f"{cone.shape(np.array(1e-6)):.1e}"
        '1.0e-06'
    """

    half_angle: float

    def __post_init__(self) -> None:
        _require_angle(self.half_angle)

    def shape(self, radii: np.ndarray) -> np.ndarray:
        """Return f(r) [m]."""
        return radii / np.tan(np.radians(self.half_angle))

    def penetration(self, radii: np.ndarray) -> np.ndarray:
        """Return D(a) [m]."""
        return np.pi / 2 * self.shape(radii)


@dataclass(frozen=True)
class Pyramid(Tip):
    """A regular pyramid, as the cone that takes the same force without adhesion.

    F = 0.7453 tan(alpha) E* d^2 for four faces and 0.8887 tan(alpha) E* d^2 for three (G. G.
    Bilodeau, J. Appl. Mech. 59, 519 (1992)).

    Arguments:
        half_angle: alpha, between axis and faces [degrees].
        faces: three or four.

    Raises:
        ValueError: for an angle that is not between 2 and 89.5 degrees, and another number of
            faces.

    Example:
        >>> pyramid = js.lab.Pyramid(half_angle=20.0)
        >>> f"{pyramid.cone.half_angle:.1f}"
        '23.1'
    """

    half_angle: float
    faces: int = 4

    def __post_init__(self) -> None:
        _require_angle(self.half_angle)
        if self.faces not in _PYRAMIDS:
            raise ValueError(f"The pyramid has {self.faces} faces: give three or four.")

    @property
    def cone(self) -> Cone:
        """The equivalent cone."""
        slope = np.pi / 2 * _PYRAMIDS[self.faces] * np.tan(np.radians(self.half_angle))
        return Cone(float(np.degrees(np.arctan(slope))))

    def shape(self, radii: np.ndarray) -> np.ndarray:
        """Return f(r) of the equivalent cone [m]."""
        return self.cone.shape(radii)

    def penetration(self, radii: np.ndarray) -> np.ndarray:
        """Return D(a) of the equivalent cone [m]."""
        return self.cone.penetration(radii)


@dataclass(frozen=True)
class FlatPunch:
    """A flat punch: F = 2 E* A d, and with adhesion a pull-off of sqrt(8 pi w E* A^3).

    K. Kendall, J. Phys. D: Appl. Phys. 4, 1186 (1971). The range of the attraction does not follow
    from such a contact, and the work of adhesion from its retraction alone.

    Arguments:
        radius: A [m].

    Raises:
        ValueError: for a radius that is not between 0.1 nm and 0.1 m.

    Example:
        >>> js.lab.FlatPunch(radius=1e-6)
        FlatPunch(radius=1e-06)
    """

    radius: float

    def __post_init__(self) -> None:
        _require_radius(self.radius)


def paraboloid_radius(tip: Tip, depth: float) -> float:
    """Return the radius of the paraboloid that has a tip's contact at a depth [m]."""
    radii = np.geomspace(1e-12, min(1.0, 0.99 * tip.largest_radius), 600)
    return float(np.interp(depth, tip.penetration(radii), radii)) ** 2 / depth


def _require_radius(radius: float) -> None:
    if isinstance(radius, str):
        raise TypeError(f"The radius is {radius!r}: give a number in metres, as 5e-6 for 5 µm.")
    if not _SMALLEST <= radius <= _LARGEST:
        raise ValueError(f"The radius is {radius} m: give it in metres, as 5e-6 for 5 µm.")


def _require_angle(angle: float) -> None:
    if isinstance(angle, str):
        raise TypeError(f"The half angle is {angle!r}: give a number in degrees, as 18.0.")
    if not _SHARPEST <= angle <= _BLUNTEST:
        raise ValueError(
            f"The half angle is {angle} degrees: give the angle between axis and flank in degrees, "
            "as 18.0."
        )

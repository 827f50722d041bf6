"""The contact from which the fit of a force curve starts, by a fit of a closed form."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxstab.calibration.advice import FitWarning
from jaxstab.calibration.least_squares import FARTHEST
from jaxstab.calibration.measured_curve import Parts, columns_of
from jaxstab.contact import Contact
from jaxstab.contact.resolution import FOR_STATES, resolved_range
from jaxstab.core.accuracy import ROUGH, SIGNIFICANT
from jaxstab.core.checks import (
    integer,
    positive_scalar,
    require,
    require_kind,
    require_one_of,
    scalar_parameter,
)
from jaxstab.core.compile import own_conventions
from jaxstab.core.grid import Grid
from jaxstab.core.types import ArrayLike
from jaxstab.core.units import LENGTHS, PRESSURES, shown_unit
from jaxstab.core.warn import warn
from jaxstab.force_curves import ForceCurve
from jaxstab.potentials import Exponential, NoAdhesion, Potential
from jaxstab.references import jkr, maugis, regime
from jaxstab.solids import FreeHalfSpace
from jaxstab.surfaces import paraboloid

# The prior's standard deviation of the logarithm of Tabor's parameter: a factor of three.
_PRIOR = np.log(3.0)
# The points of the closed form, with and without contact.
_POINTS = 300
# The tip ends where its undeformed gap is so many ranges at the deepest position.
_RANGES = 5.0
# A tip is not lighter than water [kg/m^3], and on the earth [m/s^2].
_DENSITY = 1000.0
_GRAVITY = 9.81
# The resolution of a range that replaces a shorter one: a little more than states need.
_RESOLUTION = 1.01 * FOR_STATES


class _Sphere(NamedTuple):
    """The parameters of Maugis' sphere, in SI units."""

    contact_modulus: float
    work: float
    range: float
    contact_point: float

    def tabor(self, radius: float) -> float:
        """Return Tabor's parameter, one between JKR and DMT."""
        return float(np.cbrt(radius * (self.work / self.contact_modulus) ** 2)) / self.range

    def changed(self, values: np.ndarray, unit: float) -> _Sphere:
        """Return the sphere with changed logarithms, and a contact point so many units further.

        All changes are of the order of one, as the finite differences of a fit assume.
        """
        modulus, work, length = map(float, np.exp(values[:3]))
        return _Sphere(
            self.contact_modulus * modulus,
            self.work * work,
            self.range * length,
            self.contact_point + unit * float(values[3]),
        )


@own_conventions()
def first_guess(
    curve: ForceCurve,
    radius: ArrayLike,
    poisson_ratio: ArrayLike,
    *,
    law: Callable[..., Potential] = Exponential,
    segment: Parts = "retraction",
    points: int = 32,
    pressure_unit: str = "MPa",
) -> Contact:
    """Return a contact of a tip to start `calibrate` from: a paraboloid on an elastic half space.

    Modulus, work of adhesion, range and contact point are those of Maugis' closed form (J. Colloid
    Interface Sci. 150, 243, 1992), fitted to the curve. The grid holds the contact and the
    attraction around it. A range that the grid does not resolve is replaced by the shortest that it
    does. A curve that shows no attraction gives a contact without adhesion.

    Radius and Poisson's ratio are in no file, and no curve tells them: a force curve of a larger
    radius is that of a smaller modulus and work of adhesion.

    Arguments:
        curve: the curve, corrected first unless it is already.
        radius: R of the tip, in the curve's unit of length [length].
        poisson_ratio: nu of the sample, 0.5 of a rubber or a gel.
        law: a law of a work of adhesion and a range, one of `jaxstab.potentials`.
        segment: the part of the curve: "approach", "retraction" or "both", of which the retraction
            is taken.
        points: along a side of the grid.
        pressure_unit: the contact's unit of pressure. Its unit of length is that of the curve.

    Raises:
        TypeError: for something that is not a force curve.
        ValueError: if the radius is not positive, and for a curve without a spring constant, the
            segment or a contact.

    Warns:
        FitWarning: if the curve shows no attraction, if the grid does not resolve the range, and
            for a radius in another unit than the curve's: if the tip indents by more than its
            radius, or if a ball of the radius is too heavy for the cantilever.
    """
    require_kind(curve, ForceCurve, "no force curve: give one of jaxstab.force_curves.read.")
    require_one_of("the unit of pressure", pressure_unit, PRESSURES)
    require("points", integer("points", points), points >= 4, "give at least 4.")
    radius = float(positive_scalar(radius, "The radius"))
    poisson = float(scalar_parameter(poisson_ratio, "Poisson's ratio"))
    length = 10.0 ** LENGTHS[curve.unit]
    pressure = 10.0 ** PRESSURES[pressure_unit]
    part: Parts = segment
    if segment == "both":
        part = "retraction"
    (means,), constant, _ = columns_of(curve, part, 40, is_spring=False)
    is_there = means.weights > 0
    measured = -means.tips[is_there], means.forces[is_there], np.sqrt(means.weights[is_there])
    sphere = _fitted(*measured, radius * length, part)
    depth = max(float(np.max(measured[0])) - sphere.contact_point, 0.0)
    if unlikely := _unlikely(radius * length, depth, constant, curve.unit):
        warn(f"{unlikely}.", FitWarning)
    reach = depth + _RANGES * sphere.range
    if sphere.work > 0:
        # An adhesive contact is wider than Hertz' by up to some a0, where d0 = a0^2 / R.
        adhesive = jkr.units(radius * length, sphere.contact_modulus, sphere.work).displacement
        reach += 2 * float(adhesive)
    half = np.sqrt(2 * radius * length * reach)
    grid = Grid(points, (2 * half / length,) * 2)
    solid = FreeHalfSpace(grid, sphere.contact_modulus * (1 - poisson**2) / pressure, poisson)
    # The summit is where the tip touches, so that the zero of a fit starts near its end.
    heights = np.asarray(paraboloid(grid, radius)) - sphere.contact_point / length
    units = {"unit": curve.unit, "pressure_unit": pressure_unit}
    if sphere.work == 0:
        warn(
            f"the {part} shows no attraction, so that no work of adhesion follows: the contact has "
            "none, and its modulus is left to fit.",
            FitWarning,
        )
        return Contact(solid, heights, NoAdhesion(), **units)
    work = sphere.work / (length * pressure)

    def contact(size: float) -> Contact:
        return Contact(solid, heights, law(work, size), **units)

    found = contact(sphere.range / length)
    if found.resolution >= FOR_STATES:
        return found
    resolved = float(resolved_range(found, _RESOLUTION))
    states = [
        regime(radius * length, sphere.contact_modulus, sphere.work, size)
        for size in (sphere.range, resolved * length)
    ]
    off = abs(float(states[1].pull_off / states[0].pull_off) - 1)
    unit = shown_unit(curve.unit)
    warn(
        f"the curve shows a range of about {sphere.range / length:.3g} {unit}, and a grid of "
        f"{points} points a side resolves {resolved:.3g} {unit}, which the contact has. By the "
        f"closed form its pull-off is {off:.1%} off. Hold the range in the fit, by `where=lambda "
        "contact: (contact.potential.surface_energy, contact.solid.youngs_modulus)`, or give more "
        "points.",
        FitWarning,
    )
    return contact(resolved)


def _unlikely(radius: float, depth: float, constant: float, unit: str) -> str:
    """Return a sentence on a radius that cannot be the tip's, empty if it can.

    All numbers are in SI units. The curve itself does not tell: it is the same for a radius that is
    c times larger, if the work of adhesion is c and the modulus sqrt(c) times smaller.
    """
    bent = 4 / 3 * np.pi * radius**3 * _DENSITY * _GRAVITY / constant
    if max(depth, bent) <= radius:
        return ""
    r, d, x = (
        f"{size / 10.0 ** LENGTHS[unit]:.3g} {shown_unit(unit)}" for size in (radius, depth, bent)
    )
    cure = f"Give the radius in the curve's unit of length, {shown_unit(unit)}"
    if depth > radius:
        return (
            f"the indentation, {d}, exceeds the radius, {r}: the tip is no paraboloid there. "
            f"{cure}, or fit a contact with the tip's own shape, as `jaxstab.surfaces.tip`"
        )
    return (
        f"a ball of the radius, {r}, even one as light as water, would bend the cantilever of "
        f"{constant:.3g} N/m by {x} by its weight. {cure}, unless the tip is a flat lens"
    )


def _fitted(
    indentation: np.ndarray, force: np.ndarray, roots: np.ndarray, radius: float, part: str
) -> _Sphere:
    """Return the sphere of Maugis whose curve is near to means of forces over indentations.

    A longer range with a smaller work of adhesion often does as well, within the noise, since a
    cantilever that snaps off hides where the attraction ends. What the curve leaves open a prior
    decides for the middle of JKR and DMT, from where either is near. If no mean is below the noise,
    it is the sphere of Hertz.
    """
    from scipy.optimize import least_squares

    deepest = float(np.max(force))
    attraction = -float(np.min(force))
    if attraction <= SIGNIFICANT / float(roots[np.argmin(force)]):
        return _without_attraction(indentation, force, roots, radius, part)
    top = float(np.max(indentation))
    pull = float(indentation[np.argmin(force)])
    depth = max(top - pull, 1e-3 * np.ptp(indentation))
    modulus = 0.75 * (deepest + attraction) / np.sqrt(radius * depth**3)
    work = attraction / (1.75 * np.pi * radius)
    unit = float(jkr.units(radius, modulus, work).displacement)
    reach = np.array([np.log(FARTHEST)] * 3 + [np.ptp(indentation) / unit])

    # The fit starts in the middle of JKR and DMT.
    start = _Sphere(modulus, work, 1.0, pull)
    start = start._replace(range=start.tabor(radius))

    def misfit(values: np.ndarray) -> np.ndarray:
        sphere = start.changed(values, unit)
        computed = _force(indentation, radius, sphere, pull, part == "approach")
        return np.append(roots * (computed - force), np.log(sphere.tabor(radius)) / _PRIOR)

    fit = least_squares(misfit, np.zeros(4), bounds=(-reach, reach), ftol=ROUGH, xtol=ROUGH)
    return start.changed(fit.x, unit)


def _without_attraction(
    indentation: np.ndarray, force: np.ndarray, roots: np.ndarray, radius: float, part: str
) -> _Sphere:
    """Return the sphere of Hertz that is nearest to means of forces over indentations."""
    from scipy.optimize import least_squares

    deepest = np.max(force)
    # The weights are largest far from contact, where they are those of the forces alone.
    is_noise = force * np.max(roots) < SIGNIFICANT
    begin = np.max(indentation[is_noise], initial=np.min(indentation))
    unit = indentation[np.argmax(force)] - begin
    if unit <= 0:
        raise ValueError(
            f"The {part} shows no indentation: where its force is largest, {deepest:.3g} N, the "
            "tip is no deeper than where the force is within the noise. Press harder, or with "
            "a stiffer cantilever, and check the spring constant and the sensitivity."
        )
    modulus = 0.75 * deepest / np.sqrt(radius * unit**3)

    def misfit(values: np.ndarray) -> np.ndarray:
        depth = np.maximum(indentation - begin - unit * values[1], 0)
        computed = 4 / 3 * modulus * np.exp(values[0]) * np.sqrt(radius * depth**3)
        return roots * (computed - force)

    rise, shift = least_squares(misfit, [0.0, 0.0]).x
    return _Sphere(float(modulus * np.exp(rise)), 0.0, 0.0, float(begin + unit * shift))


def _force(
    indentation: np.ndarray, radius: float, sphere: _Sphere, pull: float, is_in: bool
) -> np.ndarray:
    """Return forces of the branch that ends at the pull-off, or on the way in at the first touch.

    Beyond its end no force acts. The branch goes on to where the measured force is least, so that
    no measurement in contact meets a step of the curve.
    """
    law = radius, sphere.contact_modulus, sphere.work, sphere.work / sphere.range
    touch = maugis.first_touch(*law)
    end = touch
    if not is_in:
        end = maugis.pull_off(*law, np.inf)
    unit = jkr.units(*law[:3])
    depth = max(float(np.max(indentation)) - sphere.contact_point, 0.0)
    # Of Hertz' sphere the depth is a^2 / R, of adhesive ones less.
    most = 2 * np.sqrt(radius * depth) + 4 * unit.contact_radius
    least = max(float(end.contact_radius), 1e-6 * unit.contact_radius)
    states = maugis.curve(np.linspace(least, most, _POINTS), *law)
    displacement, force = states.displacement, states.force
    if end.contact_radius == 0 and not is_in:
        outer = np.linspace(float(end.outer_radius), float(touch.outer_radius), _POINTS)
        before = maugis.without_contact(outer[:-1], *law)
        displacement = np.append(before.displacement, displacement)
        force = np.append(before.force, force)
    order = np.argsort(displacement)
    at = indentation - sphere.contact_point
    is_apart = (at < displacement[order[0]]) & (indentation < pull)
    return np.where(is_apart, 0.0, np.interp(at, displacement[order], force[order]))

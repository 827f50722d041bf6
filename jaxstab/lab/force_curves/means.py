"""Means over the points of a force curve, for fits that compute an equilibrium at each."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from jaxstab.lab.force_curves.correction import clocks_of
from jaxstab.lab.force_curves.force_curve import ForceCurve, curve_to_fit

# One mean where no force acts for so many in contact.
_FAR = 6
# A step of the tip is a jump if it exceeds the noise so many times, and the usual step of the
# height so many times.
_NOISES = 12.0
_STEPS = 5.0
# Fewer points between two jumps are a tip on its way.
_ON_ITS_WAY = 3


class Means(NamedTuple):
    """Means over points of a segment, in the order of the measurement, in the curve's units.

    Attributes:
        tip_position: of the tip [length].
        height: of the far end of the cantilever [length].
        force: positive in compression [force].
        weights: the number of points of each mean, in units of the largest.
        drift_error: how far one standard error of the drift that was removed moves each [length].

    Example:
        >>> part = js.lab.force_curves.means(curve, "approach")
        >>> bool(np.allclose(part.tip_position, part.height + part.force / 1.0))
        True
    """

    tip_position: np.ndarray
    height: np.ndarray
    force: np.ndarray
    weights: np.ndarray
    drift_error: np.ndarray


def means(
    curve: ForceCurve,
    segment: Literal["approach", "retraction"] = "retraction",
    points: int = 60,
) -> Means:
    """Return means over equal steps of the height of a segment of a force curve.

    As loads and forces of `jaxstab.calibrate`, with their weights, they do for all points of a
    curve, as long as it is straight within a step. No mean extends over a jump of the tip.

        part = means(curve)
        load = jaxstab.FarDisplacement(part.tip_position)
        jaxstab.calibrate(contact, load, forces=part.force, weights=part.weights,
            load_error=part.drift_error, offset=True, baseline="linear")

    Arguments:
        curve: the curve, with a spring constant; one that is not corrected is.
        segment: "approach" or "retraction".
        points: the number of means in contact; where no force acts there are a sixth as many, and
            jumps add some.

    Raises:
        TypeError: for anything but a force curve.
        ValueError: for another segment or one that the curve lacks, fewer than four points, no
            spring constant, and a curve that cannot be corrected.

    Example:
        >>> part = js.lab.force_curves.means(curve, "approach", points=30)
        >>> len(part.force)
        35
    """
    if points < 4:
        raise ValueError(f"The number of points is {points}: give at least 4.")
    curve = curve_to_fit(curve, segment)
    part, correction = getattr(curve, segment), curve.correction
    assert correction is not None and curve.spring_constant is not None
    line = getattr(correction, segment)
    present = part.is_present
    height, force, tip = part.height[present], part.force[present], part.tip_position[present]

    noise = line.noise / curve.spring_constant
    usual = np.median(np.abs(np.diff(height)))
    is_jump = np.abs(np.diff(tip)) > _NOISES * noise + _STEPS * usual
    runs = np.append(0, np.cumsum(is_jump))
    is_whole = np.bincount(runs)[runs] >= _ON_ITS_WAY

    # A retraction that has not detached has the baseline of the approach, and no such part.
    is_attached = segment == "retraction" and line == correction.approach
    top = float(height.max())
    limit = top if is_attached else float(np.sort(height)[-line.number])
    far = max(points // _FAR, 2)
    steps = np.where(
        height < limit,
        _steps(height, float(height.min()), limit, points),
        points + _steps(height, limit, top, far),
    )
    _, group = np.unique(np.stack([runs, steps])[:, is_whole], axis=1, return_inverse=True)
    number = np.bincount(group)
    error = 0.0
    if correction.removes_drift and correction.drift_error is not None:
        error = correction.drift_error
    drift = error * clocks_of(curve.segments)[segment][present]
    columns = np.stack([tip, height, force, drift, np.arange(len(tip))])[:, is_whole]
    tip, height, force, drift, place = (np.bincount(group, each) / number for each in columns)
    order = np.argsort(place)
    weights = number / number.max()
    return Means(*(each[order] for each in (tip, height, force, weights, drift)))


def _steps(height: np.ndarray, low: float, high: float, count: int) -> np.ndarray:
    """Return the number of the step that each height is in, of equal ones between two heights."""
    part = (height - low) / max(high - low, np.finfo(float).tiny)
    # Rounding decides for no height at the end of a step.
    return np.clip(np.floor(count * part + 1e-9), 0, count - 1).astype(int)

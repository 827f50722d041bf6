"""The loads, forces and weights of a fit to a measured force curve."""

from typing import Literal, NamedTuple

import numpy as np

from jaxstab.calibration.zeros import Zeros
from jaxstab.contact import Contact
from jaxstab.core.accuracy import SIGNIFICANT
from jaxstab.core.checks import array, in_words, integer, require, require_one_of
from jaxstab.core.units import LENGTHS, PRESSURES
from jaxstab.force_curves import Baseline, ForceCurve, Segment
from jaxstab.force_curves.correction import Correction, clocks_of, ends_of
from jaxstab.force_curves.segment import block_means, size_of_blocks
from jaxstab.loads import FarDisplacement, Load, Spring

Parts = Literal["approach", "retraction", "both"]
_PARTS = {
    "approach": ("approach",),
    "retraction": ("retraction",),
    "both": ("approach", "retraction"),
}
# One mean where no force acts for so many in contact.
_FAR = 6
# Where the force bends means are over fewer points, and jumps divide some: one more for so many.
_SPARE = 3
# A mean is divided if it exceeds the force at its middle by so many of its errors.
_BENT = 0.25
# Means over fewer points are not divided, a parabola through fewer would follow the noise, and as
# many are left beyond the reach of the forces.
_FEWEST = 8
# A step of the tip is a jump if it exceeds the noise so many times,
_NOISES = 12.0
# and besides the usual step of the cantilever so many times.
_STEPS = 5.0
# Fewer points between two jumps are a tip on its way.
_ON_ITS_WAY = 3
# The tip presses where the force exceeds this part of the largest.
_PRESSES = 0.1
# The least slope of the tip position over the height that counts in the weights.
_LEAST_SLOPE = 0.02


class Columns(NamedTuple):
    """Means over points of a segment, in the order of the measurement, in SI units.

    The weights are one over the variance of the forces. The clocks are times or numbers of points.
    """

    heights: np.ndarray
    tips: np.ndarray
    forces: np.ndarray
    weights: np.ndarray
    clocks: np.ndarray


class Means(NamedTuple):
    """Means over points of a curve, in the order of the measurement, in units of the contact.

    The noise is the standard error of a force of weight one.
    """

    load: Load
    forces: np.ndarray
    weights: np.ndarray
    zeros: Zeros
    noise: float


def means_of(
    contact: Contact, kind: Load | type[Load], curve: ForceCurve, parts: Parts, points: int
) -> Means:
    """Return what is fitted to a force curve, which is corrected first unless it is already.

    Means over equal steps of the height do for all of their points, as long as the curve is
    straight within a step; none extends over a jump of the tip. The weights follow from the noise
    of what is measured: e of the force by the deflection, and z of the height. Where the slope of
    the tip position over the height is s, the force falls by k (1 - s) over the height, so that the
    variance of a force at a height is e^2 + (k (1 - s) z)^2. Both errors move the tip position
    too, and the force of the contact with it: for a `FarDisplacement` the variance is 1 / s^2 times
    larger. What is left of a baseline moves the tip position as well, by the compliance of the
    cantilever.

    Each segment has a baseline of its own, unless the retraction has not detached. How far the
    heights drift between two segments follows from the fit to both, unless the correction has left
    it as hysteresis; the fit to one has the drift of the correction.

    Arguments:
        contact: the contact, with units.
        kind: `FarDisplacement`, over the tip position, or `Spring`, over the height.
        curve: the curve.
        parts: which segments to fit.
        points: the number of means in contact, of each segment.

    Raises:
        ValueError: for a contact without units or on a line, and a curve that lacks the segments or
            the spring constant.
        TypeError: for another load.
    """
    if kind not in (FarDisplacement, Spring):
        raise TypeError(
            f"The load is {in_words(kind)}: for a force curve give the class FarDisplacement or "
            "Spring, whose values follow from the curve."
        )
    units = contact.units
    if units.length is None or units.pressure is None:
        raise ValueError(
            "The contact has no units, but the curve has: give both to the contact, as in "
            'unit="nm", pressure_unit="GPa".'
        )
    if units.sides == 1:
        raise ValueError("The contact is a line, on which forces are per length: give a plane.")
    is_spring = kind is Spring
    found, constant, correction = columns_of(curve, parts, points, is_spring)
    heights, tips, forces, weights, clocks = map(np.concatenate, zip(*found, strict=True))
    length = 10.0 ** -LENGTHS[units.length]
    force = 10.0 ** -(PRESSURES[units.pressure] + 2 * LENGTHS[units.length])
    constant *= force / length
    compliance = 0.0
    if is_spring:
        load = Spring.cantilever(heights * length, constant, contact.grid)
    else:
        load = FarDisplacement(tips * length)
        compliance = 1 / constant
    segments = ()
    is_in = np.ones((1, len(forces)), bool)
    # A retraction that has not detached shares the baseline of the approach.
    if parts == "both" and correction.approach != correction.retraction:
        segments = _PARTS[parts]
        is_approach = np.arange(len(forces)) < len(found[0].forces)
        is_in = np.stack([is_approach, ~is_approach])
    span = float(np.ptp(clocks)) or 1.0
    drift_error = None
    is_hysteresis = correction.drift is not None and not correction.removes_drift
    if parts != "both" or is_hysteresis:
        drift_error = array(0.0)
        if correction.removes_drift and correction.drift_error is not None:
            drift_error = array(correction.drift_error * span * length)
    zeros = Zeros(
        heights=array(heights * length),
        is_in=array(is_in),
        clocks=array(clocks / span),
        compliance=array(compliance),
        drift_error=drift_error,
        segments=segments,
    )
    noise = force / np.sqrt(np.max(weights))
    return Means(load, forces * force, weights / np.max(weights), zeros, noise)


def columns_of(
    curve: ForceCurve, parts: Parts, points: int, is_spring: bool
) -> tuple[list[Columns], float, Correction]:
    """Return means over segments, the spring constant and the correction, all in SI units."""
    require_one_of("segment", parts, _PARTS)
    require("points", integer("points", points), points >= 4, "give at least 4.")
    ends = ends_of(curve.segments)
    for name in _PARTS[parts]:
        if name not in ends:
            (other,) = ends
            raise ValueError(
                f'The curve has no {name}, but {other}: fit that, as `segment="{other}"`.'
            )
    constant = curve.in_units("m", "N").spring_constant
    if constant is None:
        raise ValueError(
            "The curve has no spring constant, without which its tip positions are unknown: give "
            "it in N/m, as in js.force_curves.read(path, spring_constant=0.2)."
        )
    if not curve.correction:
        curve = curve.corrected()
    curve = curve.in_units("m", "N")
    correction = curve.correction
    assert correction is not None
    clocks = clocks_of(curve.segments)
    found = [
        _means(
            curve.segments[name],
            clocks[name],
            getattr(correction, name),
            points,
            is_spring,
            constant,
        )
        for name in _PARTS[parts]
    ]
    for name, columns in zip(_PARTS[parts], found, strict=True):
        _require_indentation(name, columns, constant, getattr(correction, name).noise)
    return found, constant, correction


def _require_indentation(name: str, means: Columns, constant: float, noise: float) -> None:
    """Raise `ValueError` unless the tip is deeper where the force is larger."""
    force = means.forces[means.weights > 0]
    tip = means.tips[means.weights > 0]
    presses = force > _PRESSES * force.max()
    slope = 0.0
    if np.sum(presses) > 1:
        slope = np.polyfit(force[presses], tip[presses], 1)[0]
    least = SIGNIFICANT * noise / constant
    depth = -slope * np.ptp(force[presses])
    if depth < -least:
        raise ValueError(
            f"The tip rises where the force of the {name} grows, by {-depth:.3g} m, while the "
            f"cantilever of {constant:.3g} N/m bends by {np.ptp(force[presses]) / constant:.3g} m: "
            "the spring constant is too small, or the sensitivity too large. A sample of any "
            f"stiffness needs more than {constant / (1 + slope * constant):.3g} N/m."
        )


def _means(
    segment: Segment,
    clocks: np.ndarray,
    line: Baseline,
    points: int,
    is_spring: bool,
    constant: float,
) -> Columns:
    """Return means over the points of a segment.

    A mean over points of a curved F exceeds F at their mean position by half its second derivative
    times the variance of the positions: that is subtracted. Where it is large the mean is divided.
    """
    present = np.flatnonzero(segment.is_present)
    is_down = segment.height[present[0]] > segment.height[present[-1]]
    # From the far end.
    numbers = present
    if not is_down:
        numbers = present[::-1]
    height = segment.height[numbers]
    tip = segment.tip_position[numbers]
    force = segment.force[numbers]

    # Of heights, and of tip positions.
    height_noise = _noise_of(height)
    noise = float(np.hypot(line.noise / constant, height_noise))
    steps = np.median(np.abs(np.diff(height)))
    is_jump = np.abs(np.diff(tip)) > _NOISES * noise + _STEPS * steps
    runs = np.append(0, np.cumsum(is_jump))
    sizes = np.bincount(runs)
    is_whole = sizes[runs] >= _ON_ITS_WAY
    is_far = height > _reach(height, force, line.noise)
    num_far = max(points // _FAR, 2)
    bins = np.where(
        is_far,
        _bins(height, height[is_far], num_far),
        points + _bins(height, height[~is_far], points),
    )
    keys = (runs * 3 * points + bins)[is_whole]
    run = runs[is_whole]
    columns = np.stack([height, tip, force, clocks[numbers]])[:, is_whole]
    groups = [np.flatnonzero(keys == key) for key in np.unique(keys)]
    most = points + num_far + points // _SPARE

    def corrected(place: int) -> tuple[np.ndarray, float]:
        """Return the means over a group, corrected, and the correction of the force."""
        inside = columns[:, groups[place]]
        # Differences are taken between jumps.
        beside = groups[max(place - 1, 0) : place + 2]
        same = [group for group in beside if run[group[0]] == run[groups[place][0]]]
        near = columns[:, np.concatenate(same)]
        middle = inside.mean(axis=1)
        # The height is singular where the tip is about to jump, the tip position is not.
        if not is_spring and np.std(near[1]) > SIGNIFICANT * noise:
            spread = max(np.var(inside[1]) - noise**2, 0.0)
            excess = float(_bend(near[1] - middle[1], near[2]) * spread / 2)
            return middle - [0, 0, excess, 0], excess
        excess = float(_bend(near[0] - middle[0], near[2]) * np.var(inside[0]) / 2)
        return middle - [0, excess / constant, excess, 0], excess

    while True:
        means, excess = zip(*map(corrected, range(len(groups))), strict=True)
        count = np.array([len(group) for group in groups])
        share = np.abs(excess) * np.sqrt(count) / line.noise
        worst = int(np.argmax(np.where(count < _FEWEST, 0, share)))
        if len(groups) >= most or count[worst] < _FEWEST or share[worst] <= _BENT:
            break
        groups[worst : worst + 1] = np.array_split(groups[worst], 2)
    run = run[[group[0] for group in groups]]
    heights, tips, forces, times = np.transpose(means)
    slope = np.ones_like(tips)
    for same in (run == number for number in np.unique(run)):
        if np.sum(same) > 1:
            slope[same] = np.gradient(tips[same], heights[same])
    slope = np.clip(slope, _LEAST_SLOPE, 1)
    weights = count / (line.noise**2 + (constant * (1 - slope) * height_noise) ** 2)
    if not is_spring:
        weights *= slope**2
    columns = np.stack([heights, tips, forces, weights, times])
    if not is_down:
        columns = columns[:, ::-1]
    # Curves of one number of means share compiled programs: the last is repeated without weight.
    repeated = np.repeat(columns[:, -1:], max(most - len(groups), 0), axis=1)
    repeated[3] = 0
    return Columns(*np.concatenate([columns, repeated], axis=1))


def _noise_of(height: np.ndarray) -> float:
    """Return the standard error of a height, from second differences, which a ramp has not.

    Their variance is six times that of the heights; the median is not that of missing points.
    """
    return float(1.4826 * np.median(np.abs(np.diff(height, 2))) / np.sqrt(6))


def _reach(height: np.ndarray, force: np.ndarray, noise: float) -> float:
    """Return the height up to which forces act, and half of that depth more, from the far end."""
    block = size_of_blocks(force)
    means = block_means(force, block)
    first = int(np.argmax(np.abs(means) > SIGNIFICANT * noise / np.sqrt(block))) * block
    lowest = float(height.min())
    depth = float(height[first]) - lowest
    return min(lowest + 1.5 * depth, float(height[_FEWEST]))


def _bend(position: np.ndarray, force: np.ndarray) -> float:
    """Return the second derivative of the force over the position, by a parabola."""
    if np.unique(position).size < _FEWEST:
        return 0.0
    scale = np.abs(position).max()
    return float(2 * np.polyfit(position / scale, force, 2)[0] / scale**2)


def _bins(height: np.ndarray, among: np.ndarray, count: int) -> np.ndarray:
    """Return the number of the step that each height is in, of equal ones from the far end."""
    top = among.max()
    part = (top - height) / max(top - among.min(), np.finfo(float).tiny)
    # Rounding decides for no height at the end of a step.
    return np.clip(np.floor(count * part + 1e-9), 0, count - 1).astype(int)

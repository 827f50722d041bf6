"""The baseline of a segment: a line through the forces of its far part."""

from dataclasses import dataclass

import numpy as np

from jaxstab.lab.force_curves.segment import (
    SIGNIFICANT,
    Segment,
    block_means,
    finite_values,
)

# The fewest points of a segment. A part of it needs a quarter of them.
FEWEST_POINTS = 50
# The blocks of points over which noise may be correlated.
_BLOCKS = 20
# The search for the part without force starts from one of these parts of the heights, at the far
# end, and goes on by this factor at most, so that it extrapolates little.
_STARTS = 0.1, 0.05, 0.025
_STEP = 1.25
# A line has a good length if it goes on beyond its start by this factor. The outer half of a
# shorter one must foretell the inner half.
_GOOD = 1.5
# A baseline over a smaller part of the heights may be the least force of a tip that still adheres.
SHORT = 0.15
# The part next to the first force is left out, since the force begins below the noise.
_MARGIN = 0.2
# A baseline that covers more of the points leaves no contact.
_MOST = 0.95


@dataclass(frozen=True)
class Baseline:
    """A line through the forces where no force acts, over the height.

    Attributes:
        force: at the contact point, or at the height zero if that is unknown [force].
        slope: its tilt [force/length].
        force_error, slope_error: standard errors.
        noise: the rms distance of the forces from it [force].
        number: the number of points that it is fitted to.

    Example:
        >>> approach = js.lab.force_curves.Segment(force + 3e-12, height)
        >>> curve = js.lab.force_curves.ForceCurve(approach, None, spring_constant=1.0)
        >>> baseline = curve.corrected().correction.approach
        >>> f"{baseline.force:.1e}"
        '3.0e-12'
    """

    force: float
    slope: float
    force_error: float
    slope_error: float
    noise: float
    number: int

    def scaled(self, length: float, force: float) -> "Baseline":
        """Return the baseline in other units, given factors."""
        return Baseline(
            force=self.force * force,
            slope=self.slope * force / length,
            force_error=self.force_error * force,
            slope_error=self.slope_error * force / length,
            noise=self.noise * force,
            number=self.number,
        )


@dataclass(frozen=True)
class Line:
    """A baseline by its force at a height, its slope, and their covariance.

    The length is the part of the heights of its segment, from the far end.
    """

    height: float
    coefficients: np.ndarray
    covariance: np.ndarray
    noise: float
    number: int
    length: float

    def forces(self, height: np.ndarray) -> np.ndarray:
        """Return the forces of the line at heights."""
        force, slope = self.coefficients
        return force + slope * (height - self.height)

    def at(self, height: float) -> Baseline:
        """Return the baseline with its force at a height."""
        away = np.array([1, height - self.height])
        return Baseline(
            force=float(away @ self.coefficients),
            slope=float(self.coefficients[1]),
            force_error=float(np.sqrt(away @ self.covariance @ away)),
            slope_error=float(np.sqrt(self.covariance[1, 1])),
            noise=self.noise,
            number=self.number,
        )


class _NoBaseline(ValueError):
    """A segment has no part that is free of force, or no other."""


def line_of(name: str, segment: Segment, is_tilted: bool) -> Line:
    """Return the baseline of a segment, which its own far part tells.

    From the far end, the part without force is extended as long as means over blocks of points stay
    on the line through it.
    """
    is_present = segment.is_present
    count = int(is_present.sum())
    if count < FEWEST_POINTS:
        raise ValueError(f"The {name} has {count} points: a baseline needs {FEWEST_POINTS}.")
    height = segment.height[is_present]
    force = segment.force[is_present]
    if height[0] < height[-1]:
        height, force = height[::-1], force[::-1]
    reason = ""
    for start in _STARTS:
        line = _line_from_far_end(height, force, start, is_tilted)
        if not (reason := _contradiction(line, height, force, start, is_tilted)):
            return line
    raise _NoBaseline(
        f"The {name} has no baseline or no contact: {reason}. It needs a part without force, at "
        "the far end, and a part in contact."
    )


def _line_from_far_end(
    height: np.ndarray, force: np.ndarray, start: float, is_tilted: bool
) -> Line:
    """Return the line through the far end that starts from a part of the heights."""
    block = min(max(len(force) // 100, 3), 200)
    is_far = height > height.max() - start * np.ptp(height)
    number = max(int(np.argmin(is_far)), FEWEST_POINTS // 4, 4 * block)
    line = _fit_line(height, force, number, is_tilted)
    while (end := _free_of_force(line, height, force, block)) > number:
        number = min(end, int(_STEP * number) + 1)
        line = _fit_line(height, force, number, is_tilted)
    return line


def _contradiction(
    line: Line, height: np.ndarray, force: np.ndarray, start: float, is_tilted: bool
) -> str:
    """Return why a line through the far end is no baseline, empty if it is one."""
    if line.number > _MOST * len(force):
        return "its forces lie on one line"
    deepest = int(np.argmin(height))
    rise = line.coefficients[1] * (height[line.number - 1] - height[deepest])
    # The farther a line is extrapolated, the flatter it must be.
    if abs(rise) > line.length * abs(force[deepest] - line.forces(height[deepest])):
        return "the forces of its far part rise as those in contact do"
    far = slice(line.number)
    if line.length < _GOOD * start and not _is_straight(height[far], force[far], is_tilted):
        return "the forces of its far part bend"
    return ""


def _is_straight(height: np.ndarray, force: np.ndarray, is_tilted: bool) -> bool:
    """Whether the line through the outer half of forces foretells the inner half."""
    half = len(force) // 2
    line = _fit_line(height, force, half, is_tilted)
    return _free_of_force(line, height, force, max(half // _BLOCKS, 1)) == len(force)


def _free_of_force(line: Line, height: np.ndarray, force: np.ndarray, block: int) -> int:
    """Return the number of points, from the far end, before means over blocks leave the line."""
    inside = line.number // block
    means = block_means(force - line.forces(height), block)
    noise = np.std(means[:inside])
    away = np.stack([np.ones(len(means)), block_means(height, block) - line.height])
    errors = np.sqrt(noise**2 + np.einsum("ij,ik,kj->j", away, line.covariance, away))
    is_force = np.abs(means) > SIGNIFICANT * errors
    is_force[:inside] = False
    if not is_force.any():
        return len(force)
    return int((1 - _MARGIN) * np.argmax(is_force) * block)


def _fit_line(heights: np.ndarray, forces: np.ndarray, number: int, is_tilted: bool) -> Line:
    """Return the line through so many points from the far end."""
    height = heights[:number]
    force = forces[:number]
    middle = height.mean()
    columns = np.stack([np.ones_like(height), height - middle], axis=1)[:, : 1 + is_tilted]
    found = np.zeros(2)
    covariance = np.zeros((2, 2))
    used = slice(0, 1 + is_tilted)
    found[used] = np.linalg.lstsq(columns, force, rcond=None)[0]
    misfit = force - columns @ found[used]
    covariance[used, used] = np.linalg.inv(columns.T @ columns) * mean_variance(
        misfit, 1 + is_tilted
    )
    length = float(np.ptp(height) / np.ptp(heights))
    # Digitised forces may all be equal where none acts.
    steps = np.diff(np.unique(forces))
    noise = max(float(np.std(misfit)), float(np.min(steps, initial=np.inf)) / np.sqrt(12))
    return Line(middle, found, covariance, noise, number, length)


def mean_variance(misfit: np.ndarray, freedom: int) -> float:
    """Return the variance of a misfit, raised for noise that is correlated over some points.

    Of white noise, means over blocks of b points have a variance b times smaller.
    """
    count = len(misfit)
    variance = float(np.sum(misfit**2)) / max(count - freedom, 1)
    block = max(count // _BLOCKS, 1)
    means = block_means(misfit, block)
    return max(variance, block * float(np.sum(means**2)) / max(len(means) - freedom, 1))


def line_of_retraction(segment: Segment, approach: Line, is_tilted: bool) -> Line:
    """Return the baseline of the retraction, or of the approach if it has not detached.

    It has not if its far part is no baseline. A force that is flat over a good length is one of no
    contact, however far the forces have drifted; over a shorter one it may be the pull-off.
    """
    try:
        line = line_of("retraction", segment, is_tilted)
    except _NoBaseline:
        return approach
    far = np.max(finite_values(segment.height))
    level = float(line.forces(far) - approach.forces(far))
    apart = segment.force - approach.forces(segment.height)
    is_lowest = level < min(-SIGNIFICANT * line.noise, np.nanmin(apart) / 2)
    if line.length < SHORT and is_lowest:
        return approach
    return line

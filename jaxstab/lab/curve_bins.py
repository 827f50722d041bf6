"""The points of a segment for its fit, and means over bins of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

import jaxstab as js

# Means over so many steps of the height in contact, and where no force acts. Steps are this part
# of the travel in contact at the contact point, and grow in proportion to the distance from there.
_NEAR, _FAR = 150, 30
_FINEST = 0.02
# A step of the force is a jump if it exceeds the noise so many times, and by so many times what the
# steps of so many points beside it exceed the noise by.
_JUMP, _STEEPER, _BESIDE = 6.0, 5.0, 21
# Means over so many points tell an attraction that exceeds so many times those where no force acts.
_BLOCKS, _ATTRACTION = (1, 4, 16, 64), 4.0
# So many blocks tell how means scatter.
_FEWEST_BLOCKS = 8


class TipJump(NamedTuple):
    """A jump into contact or out of it.

    Attributes:
        height: where the tip jumps [m].
        error: its standard error, by the distance of points [m].
        force: half way through the jump [N].
        clock: of the point before it.
    """

    height: float
    error: float
    force: float
    clock: float

    @classmethod
    def of(
        cls, height: np.ndarray, force: np.ndarray, clock: np.ndarray, is_jump: np.ndarray
    ) -> TipJump | None:
        """Return the largest jump to attraction, seen from the far end.

        Arguments:
            height, force, clock: of points from the far end on.
            is_jump: at which points the force has jumped.
        """
        steps = np.diff(force, prepend=force[0])
        place = int(np.argmin(np.where(is_jump & (force < 0), steps, 0.0)))
        if place == 0:
            return None
        first = last = place
        while steps[first - 1] < 0:
            first -= 1
        while last + 1 < len(steps) and steps[last + 1] < 0:
            last += 1
        ends = height[first - 1], height[last]
        middle = float(force[first - 1] + force[last]) / 2
        error = float(np.ptp(ends)) / np.sqrt(12)
        return cls(float(np.mean(ends)), error, middle, float(clock[first - 1]))


class Bins(NamedTuple):
    """Points of a segment from the far end on, and means over bins of them; in SI units.

    Attributes:
        height, force, clock: of each point; the clock is one at the far end and zero at the turn.
        group: the number of the bin of each point.
        heights, widths, forces, clocks: of each bin; the width is that of an even spread.
        errors: standard errors of the forces of bins, by white noise.
        is_near: which bins lie beyond the baseline.
        has_jump: which bins the tip jumps in.
        jump: into contact or out of it, None if the tip does neither.
        noise: the standard deviation of a force.
        stiffness: the spring constant.
        is_approach: whether the branch is followed towards contact.
        drift_error: of the heights from the first to the last point.
    """

    height: np.ndarray
    force: np.ndarray
    clock: np.ndarray
    group: np.ndarray
    heights: np.ndarray
    widths: np.ndarray
    forces: np.ndarray
    clocks: np.ndarray
    errors: np.ndarray
    is_near: np.ndarray
    has_jump: np.ndarray
    jump: TipJump | None
    noise: float
    stiffness: float
    is_approach: bool
    drift_error: float

    @classmethod
    def of(cls, curve: js.lab.force_curves.ForceCurve, name: str) -> Bins:
        """Return the data of a segment of a corrected curve in SI units."""
        segment = getattr(curve, name)
        correction = curve.correction
        assert correction is not None and curve.spring_constant is not None
        line = getattr(correction, name)
        assert line is not None
        numbers = np.flatnonzero(segment.is_present)
        height, force = segment.height[numbers], segment.force[numbers]
        clock = np.arange(len(numbers), dtype=float)
        if segment.time is not None and np.ptp(segment.time[numbers]) > 0:
            clock = segment.time[numbers] - segment.time[numbers[0]]
        drift_error = 0.0
        if correction.removes_drift and correction.drift_error is not None:
            drift_error = correction.drift_error * float(clock[-1])
        wobble = _noise_of_heights(height, clock)
        clock = clock / clock[-1]
        if height[0] < height[-1]:
            height, force, clock = height[::-1], force[::-1], clock[::-1]
        else:
            clock = 1 - clock
        count = len(height)
        far = int(np.clip(line.number, 1, count - 1))
        group = np.empty(count, int)
        group[:far] = np.arange(far) * min(_FAR, far) // far
        top = height[far]
        bottom = height[far:].min()
        # The contact point of a corrected curve is at zero.
        warped = np.arcsinh(np.array([*height[far:], bottom, top]) / (_FINEST * (top - bottom)))
        part = (warped[-1] - warped[:-2]) / (warped[-1] - warped[-2] or 1.0)
        group[far:] = _FAR + np.clip(part * _NEAR, 0, _NEAR - 1).astype(int)
        places, group, number = np.unique(group, return_inverse=True, return_counts=True)
        heights, forces, clocks = (
            np.bincount(group, values) / number for values in (height, force, clock)
        )
        spread = np.bincount(group, (height - heights[group]) ** 2) / number
        noise = line.noise
        step = np.abs(np.diff(force, prepend=force[0]))
        steep = np.maximum(median_filter(step, _BESIDE) - noise, 0.0)
        is_jump = step > _JUMP * noise + _STEEPER * steep
        # A jump is at one of two points, which may be of two bins.
        before = np.roll(group, 1)
        is_parted = is_jump & (before != group)
        jumps = np.bincount(group, step * is_jump) * (1 + np.bincount(group, is_jump))
        jumps += np.bincount(before, step * is_parted)
        slopes = np.zeros(len(forces))
        if len(forces) > 2:
            slopes = np.gradient(forces, heights)
        variance = (noise**2 + (slopes * wobble) ** 2) / number + (jumps / number) ** 2
        return cls(
            height,
            force,
            clock,
            group,
            heights,
            np.sqrt(12 * spread),
            forces,
            clocks,
            np.sqrt(variance),
            places >= _FAR,
            jumps > 0,
            TipJump.of(height, force, clock, is_jump & (np.arange(count) >= far)),
            noise,
            curve.spring_constant,
            name == "approach",
            drift_error,
        )

    @property
    def tips(self) -> np.ndarray:
        """Positions of the tip [m]."""
        return self.heights + self.forces / self.stiffness

    @property
    def attract(self) -> bool:
        """Whether the mean force over some points in contact is negative beyond its error."""
        is_far = ~self.is_near[self.group]
        for size in _BLOCKS:
            if is_far.sum() < _FEWEST_BLOCKS * size or (~is_far).sum() < size:
                break
            far, near = (
                np.convolve(self.force[part], np.full(size, 1 / size), "valid")
                for part in (is_far, ~is_far)
            )
            if near.min() < -_ATTRACTION * np.std(far):
                return True
        return False


def _noise_of_heights(height: np.ndarray, clock: np.ndarray) -> float:
    """Return the standard deviation of white noise of heights, by lines through two points."""
    before, after = np.diff(clock)[:-1], np.diff(clock)[1:]
    share = np.divide(
        after, before + after, out=np.full(len(before), 0.5), where=before + after > 0
    )
    away = height[1:-1] - share * height[:-2] - (1 - share) * height[2:]
    away = away / np.sqrt(1 + share**2 + (1 - share) ** 2)
    return float(1.4826 * np.median(np.abs(away)))

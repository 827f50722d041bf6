"""Means of a force curve over steps of the time, for its fit in time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import jaxstab as js
from jaxstab.lab.force_curves.correction import clocks_of

# Means over so many steps of the time in each segment, near contact and where no force acts.
_NEAR, _FAR = 40, 5
# A model on rings is right within this part of the largest force, which errors are no less than.
_LEAST_ERROR = 1e-4
# The fewest points of a mean; the forces of one scatter by this part of the variance of the noise.
_FEWEST, _JUMP = 3, 4.0
# In a pause the last step is longer than the first one by this: the sample relaxes fast at first.
_GROWTH = 30.0


class TimeMeans(NamedTuple):
    """Means over steps of the time, in SI units, with the turns between segments.

    Attributes:
        times, heights: of means and turns.
        variances: of the times of a step, zero at turns.
        forces, errors: with infinite errors at turns.
        is_apart: which times are of a retraction with a baseline of its own.
        depth, force: the largest ones.
        duration: of the approach near contact.
        stiffness: of the cantilever.
    """

    times: np.ndarray
    heights: np.ndarray
    variances: np.ndarray
    forces: np.ndarray
    errors: np.ndarray
    is_apart: np.ndarray
    depth: float
    force: float
    duration: float
    stiffness: float

    @classmethod
    def of(cls, curve: js.lab.force_curves.ForceCurve) -> TimeMeans:
        """Return the history of a corrected curve in SI units."""
        correction = curve.correction
        assert correction is not None and correction.approach is not None
        assert curve.spring_constant is not None
        clocks = clocks_of(curve.segments)
        drift = 0.0
        if correction.removes_drift and correction.drift is not None:
            drift = correction.drift
        rows: list[tuple[float, float, float, float, float]] = []
        is_apart: list[bool] = []
        duration = 0.0
        for name in sorted(curve.segments, key=lambda name: float(np.nanmin(clocks[name]))):
            segment = curve.segments[name]
            present = segment.is_present
            time, force = clocks[name][present], segment.force[present]
            height = segment.height[present] + drift * time
            # A pause, and a retraction that has not detached, have no part without force.
            line = getattr(correction, name, None)
            has_far = line is not None and (name == "approach" or line != correction.approach)
            far = line.number if has_far and line is not None else 0
            points = np.arange(len(time))
            parts = [(points[:far], _FAR), (points[far:], _NEAR)]
            if name == "retraction":
                parts = [(points[: len(time) - far], _NEAR), (points[len(time) - far :], _FAR)]
            if name == "approach":
                duration = float(np.ptp(time[far:]))
            pieces = [
                piece
                for part, count in parts
                if len(part) > 1
                for piece in _steps(part, count, grow=name.startswith("pause"))
            ]
            noise = correction.approach.noise
            means = [_mean(time[one], height[one], force[one], noise) for one in pieces]
            ends = [
                (time[place], _line_at(time[one], height[one], time[place]), 0.0, np.nan, np.inf)
                for one, place in ((pieces[0], 0), (pieces[-1], -1))
            ]
            rows += [ends[0], *means, ends[1]]
            is_apart += [has_far and name == "retraction"] * (len(means) + 2)
        columns = np.array(rows).T
        # A segment may begin at the time at which the one before has ended.
        is_later = np.append(True, np.diff(np.maximum.accumulate(columns[0])) > 0)
        times, heights, variances, forces, errors = columns[:, is_later]
        largest = float(np.nanmax(forces))
        errors = np.maximum(errors, _LEAST_ERROR * largest)
        tips = heights + np.nan_to_num(forces) / curve.spring_constant
        return cls(
            times,
            heights,
            variances,
            forces,
            errors,
            np.array(is_apart)[is_later],
            float(-np.min(tips)),
            largest,
            duration,
            curve.spring_constant,
        )


def mean_forces(forces: np.ndarray, times: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Return means over steps of forces that are known at their mean times and at turns.

    To second order a mean is f + f'' var(t) / 2, with f'' by the times before and after.
    """
    before, after = np.diff(times)[:-1], np.diff(times)[1:]
    slopes = np.diff(forces) / np.diff(times)
    curvatures = np.zeros(len(forces))
    curvatures[1:-1] = 2 * np.diff(slopes) / (before + after)
    return forces + curvatures * variances / 2


def _steps(points: np.ndarray, count: int, grow: bool) -> list[np.ndarray]:
    """Return points in steps, of equal numbers or of numbers that grow from the first step on."""
    count = max(min(count, len(points) // _FEWEST), 1)
    if not grow:
        return np.array_split(points, count)
    ends = np.expm1(np.linspace(0, np.log1p(_GROWTH), count + 1)) / _GROWTH * len(points)
    ends = np.maximum(np.round(ends), _FEWEST * np.arange(count + 1)).astype(int)
    return np.split(points, ends[1:-1])


def _mean(
    time: np.ndarray, height: np.ndarray, force: np.ndarray, noise: float
) -> tuple[float, float, float, float, float]:
    """Return means of time and height, the variance of the times, and the force with its error.

    Forces that scatter by more than the noise about a line are of a jump, which is at one place.
    """
    count = len(time)
    away = force - np.polyval(np.polyfit(time - time[0], force, 1), time - time[0])
    excess = max(float(np.mean(away**2)) - _JUMP * noise**2, 0.0)
    error = np.sqrt(noise**2 / count + excess)
    spread = float(np.var(time))
    return float(time.mean()), float(height.mean()), spread, float(force.mean()), float(error)


def _line_at(time: np.ndarray, height: np.ndarray, place: float) -> float:
    """Return the height of a line through points at a time."""
    return float(np.polyval(np.polyfit(time - place, height, 1), 0.0))

"""Checks of a surface, before anything is computed with it."""

import math
from dataclasses import dataclass

import numpy as np

from jaxstab.core.display import times
from jaxstab.core.warn import warn_once
from jaxstab.surfaces.processing import trend

# Jumps across an edge above so many rms steps between neighbours are none of a periodic surface.
_JUMP = 4.0
# A tilt above the roughness jumps by more than this, since it does by sqrt(7) on white noise.
_TILT_JUMP = 2.5
# The steepest flank of a clean surface may lie at its edge, but is not so much steeper there.
_ABOVE_LARGEST = 1.5
# Of fewer points along a side nothing can be told.
_FEWEST = 32
_SLOPES = 1e-5, 10.0
# Over the range of the others: how far off a number is that stands for missing points.
_FAR_OFF = 100.0


class SurfaceWarning(UserWarning):
    """Heights look as if a contact of them would not be the one that was meant."""


def warn(sentences: list[str]) -> None:
    """Warn of suspicious heights, once for each sentence."""
    for sentence in sentences:
        warn_once(sentence, SurfaceWarning)


def looks_wrong(heights: np.ndarray) -> list[str]:
    """Return the faults of heights on a periodic grid, a sentence for each: tilt and edges.

    The edges of a surface with a tilt above the roughness do not meet. They are checked again
    without the tilt.
    """
    if min(heights.shape) < _FEWEST:
        return []
    sentences, tilt = [], _tilt(heights)
    if tilt is not None:
        heights = heights - tilt
        sentences.append(
            f"the surface is tilted: the rms of its best plane is {rms(tilt):.3g}, that of the "
            f"roughness left {rms(heights):.3g}. `Topography.detrended()` takes the tilt off."
        )
    for axis, name in enumerate("xy"[: heights.ndim]):
        steps = Steps.along(heights, axis)
        if steps.jump_over(_JUMP):
            sentences.append(
                f"opposite edges do not meet along {name}: the rms jump across the periodic edge "
                f"is {steps.jump:.3g}, {steps.jump / steps.rms:.3g} times that between neighbours "
                f"({steps.rms:.3g}). Make it periodic by "
                '`Topography.periodic("window")` or "mirror".'
            )
    return sentences


def has_wrong_scale(heights: np.ndarray, lengths: np.ndarray) -> list[str]:
    """Return a sentence if heights and lengths are in scales that cannot belong together."""
    slope = rms_slope(heights, lengths)
    if slope == 0 or _SLOPES[0] <= slope <= _SLOPES[1]:
        return []
    return marks_missing(heights, lengths) or [
        f"the rms slope is {slope:.3g}: heights of rms {rms(heights):.3g} on sides of "
        f"{times(lengths, '.4g')} are hardly in one unit. Give `lengths` in the unit of the "
        "heights."
    ]


def marks_missing(heights: np.ndarray, lengths: np.ndarray) -> list[str]:
    """Return a sentence if the least or the largest height looks like a mark of missing points."""
    heights = heights.astype(float)
    present = heights[np.isfinite(heights)]
    for mark in (present.min(), present.max()):
        others = present[present != mark]
        count = present.size - others.size
        if 0 < count < others.size:
            extent = np.ptp(others)
            is_far = np.abs(others - mark).min() > _FAR_OFF * extent > 0
            if is_far and rms_slope(heights, lengths) > _SLOPES[1]:
                return [
                    f"{count} of {heights.size} heights are {mark:.6g}, while all others lie "
                    f"within {extent:.3g}: where this number marks missing points, write nan for "
                    "it, and fill them by `Topography.filled()`."
                ]
    return []


def rms_slope(heights: np.ndarray, lengths: np.ndarray) -> float:
    """Return the rms slope between neighbours that are both there, none across an edge."""
    spacing = lengths / heights.shape
    squares = [(Steps.along(heights, axis).rms / dx) ** 2 for axis, dx in enumerate(spacing)]
    return float(np.sqrt(sum(squares)))


@dataclass(frozen=True)
class Steps:
    """Steps between neighbours along a side.

    Attributes:
        rms, largest: that of all steps inside, and of one line across the side.
        jump: the rms across the periodic edge.
        rounding: what a step of nothing may be.
    """

    rms: float
    largest: float
    jump: float
    rounding: float

    @classmethod
    def along(cls, heights: np.ndarray, axis: int) -> "Steps":
        """Return those along an axis."""
        lines = np.moveaxis(heights, axis, 0).reshape(heights.shape[axis], -1)
        squares, counts = _squares(np.diff(lines, axis=0))
        jump, present = _squares(lines[:1] - lines[-1:])
        return cls(
            rms=float(np.sqrt(squares.sum() / max(counts.sum(), 1))),
            largest=float(np.sqrt(np.max(squares / np.maximum(counts, 1)))),
            jump=float(np.sqrt(jump[0] / max(present[0], 1))),
            rounding=_rounding(heights),
        )

    def jump_over(self, ratio: float) -> bool:
        """Whether the edge is a step above the others: by a ratio, and above all of them.

        A pattern with steep walls may have one of them at the edge.
        """
        return self.jump > max(ratio * self.rms, _ABOVE_LARGEST * self.largest, self.rounding)


def _squares(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sum of squares of each line, and of how many steps that are there."""
    is_there = np.isfinite(steps)
    if is_there.all():
        return np.einsum("ij,ij->i", steps, steps), np.full(len(steps), steps.shape[1])
    steps = np.where(is_there, steps, 0)
    return np.einsum("ij,ij->i", steps, steps), is_there.sum(axis=1)


def _tilt(heights: np.ndarray) -> np.ndarray | None:
    """Return the best plane about its mean if it is a tilt above the roughness."""
    plane = trend(heights, 1)
    plane -= plane.mean()
    if rms(plane) <= max(rms(heights - plane), _rounding(heights)):
        return None
    # A single long wave fits a plane as well, but meets itself at the edge.
    rises = [np.take(plane, -1, axis).flat[0] - plane.flat[0] for axis in range(plane.ndim)]
    axis = int(np.argmax(np.abs(rises)))
    return plane if Steps.along(heights, axis).jump_over(_TILT_JUMP) else None


def rms(heights: np.ndarray) -> float:
    """Return the rms about the mean of the points there are."""
    present = heights[np.isfinite(heights)] if np.isnan(heights).any() else heights.ravel()
    about_mean = present - present.mean()
    return math.sqrt(about_mean @ about_mean / present.size)


def _rounding(heights: np.ndarray) -> float:
    return 100 * float(np.finfo(heights.dtype).eps * np.nanmax(np.abs(heights)))

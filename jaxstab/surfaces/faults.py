"""Checks of a surface, before anything is computed with it."""

import numpy as np

from jaxstab.core.display import times
from jaxstab.core.warn import warn as warn_caller
from jaxstab.surfaces.processing import trend

# Edges do not meet if the rms jump across them exceeds so many rms increments inside.
_JUMP = 4.0
# A tilt above the roughness exceeds this ratio; on white noise it is sqrt(7).
_TILT_JUMP = 2.5
# The steepest flank of a periodic surface may lie at its edge, but no steeper by this factor.
_ABOVE_LARGEST = 1.5
# The least number of points along a side for these checks.
_FEWEST = 32
_SLOPES = 1e-5, 10.0
# A lone point differs from the median of so many around by so many times as much as most points do,
# and leaves the range of all others by this share of it.
_AROUND = 5
_LONE = 20.0
_BEYOND_OTHERS = 0.5
# A mark of missing points is farther from the heights than so many times their range.
_FAR_OFF = 100.0


class SurfaceWarning(UserWarning):
    """The heights of a surface look wrong: tilted, not periodic, or in another unit.

    Example:
        Heights in another unit than the sides of the grid:

        >>> import warnings
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     wrong = js.Contact(solid, 1e6 * heights, law)
        >>> caught[0].category.__name__
        'SurfaceWarning'
    """


def warn(sentences: list[str]) -> None:
    """Warn of suspicious heights, once for each sentence."""
    for sentence in sentences:
        warn_caller(sentence, SurfaceWarning)


def looks_wrong(heights: np.ndarray) -> list[str]:
    """Return a sentence for each fault of heights on a periodic grid: tilt, and edges.

    The edges are checked without a tilt above the roughness, which would part them.
    """
    if min(heights.shape) < _FEWEST:
        return []
    sentences = []
    tilt = _tilt(heights)
    if tilt is not None:
        heights = heights - tilt
        sentences.append(
            f"the surface is tilted: the rms of its best plane is {rms(tilt):.3g}, the rms of the "
            f"remaining roughness {rms(heights):.3g}. Use `Topography.detrended()`."
        )
    for axis, name in enumerate("xy"[: heights.ndim]):
        if _has_edge_jump(heights, axis, _JUMP):
            inside, _, jump = _increments(heights, axis)
            sentences.append(
                f"opposite edges do not meet along {name}: the rms jump across the periodic edge "
                f"is {jump:.3g}, {jump / inside:.3g} times the rms "
                f"increment between neighbours ({inside:.3g}). Make it periodic by "
                '`Topography.periodic("mirror")`, which keeps its statistics, or '
                '`Topography.periodic("window")`, which keeps its size.'
            )
    return sentences


def has_wrong_scale(heights: np.ndarray, lengths: np.ndarray) -> list[str]:
    """Return a sentence if the slopes show that heights and lengths differ in unit.

    Steep walls between flats, as of a punch, make a large rms slope but few large slopes.
    """
    slope = rms_slope(heights, lengths)
    if slope == 0 or _SLOPES[0] <= slope <= _SLOPES[1]:
        return []
    if slope > _SLOPES[1]:
        if marks := _marks_missing(heights):
            return marks
        if _median_slope(heights, lengths) < _SLOPES[1] / 2:
            return []
    return [
        f"the rms slope is {slope:.3g}: heights of rms {rms(heights):.3g} on sides of "
        f"{times(lengths, '.4g')} are hardly in one unit. Give `lengths` in the unit of the "
        "heights."
    ]


def edges_meet(heights: np.ndarray) -> bool:
    """Whether heights go on across each periodic edge as they do between neighbours."""
    return not any(
        _has_edge_jump(heights, axis, _ABOVE_LARGEST) or _is_rough_across(heights, axis)
        for axis in range(heights.ndim)
    )


def _is_rough_across(heights: np.ndarray, axis: int) -> bool:
    """Whether heights at the edge differ more from a cubic through their neighbours than others.

    Waves of a few points rise as much between neighbours as across a cut; the cubic follows them.
    """
    squares, counts = _squares(_off_cubic(heights, axis))
    rms = np.sqrt(squares / np.maximum(counts, 1))
    inside = rms[2:-2].max(initial=0)
    return max(rms[0], rms[-1]) > max(_ABOVE_LARGEST * inside, _rounding(heights))


def _off_cubic(heights: np.ndarray, axis: int) -> np.ndarray:
    """Return heights less the cubic through the two neighbours on either side, as lines."""
    lines = np.moveaxis(heights, axis, 0).reshape(heights.shape[axis], -1)
    near, far = (np.roll(lines, n, 0) + np.roll(lines, -n, 0) for n in (1, 2))
    return lines - (4 * near - far) / 6


def joining_plane(heights: np.ndarray) -> np.ndarray:
    """Return the plane of zero mean without which heights go on best across their edges.

    The tilt of a periodic surface: the best plane would take a part of its waves.
    """
    plane = np.zeros_like(heights)
    for axis, n in enumerate(heights.shape):
        ramp = np.linspace(-1, 1, n)
        edge = [-2, -1, 0, 1]
        off, unit = _off_cubic(heights, axis)[edge], _off_cubic(ramp, 0)[edge]
        is_there = np.isfinite(off)
        slope = np.sum(np.where(is_there, off, 0) * unit) / np.sum(is_there * unit**2)
        plane += slope * np.expand_dims(ramp, [i for i in range(heights.ndim) if i != axis])
    return plane


def lone_points(heights: np.ndarray) -> list[str]:
    """Return a sentence if a few heights stand out alone, as dust and errors of a sensor do.

    A summit of several points is none, nor are the tops of a pattern, which share a height.
    """
    from scipy.ndimage import median_filter

    apart = np.abs(heights - median_filter(heights, _AROUND, mode="nearest"))
    is_lone = apart > _LONE * np.median(apart)
    others = heights[~is_lone]
    margin = _BEYOND_OTHERS * np.ptp(others)
    is_lone &= (heights > others.max() + margin) | (heights < others.min() - margin)
    if not is_lone.any():
        return []
    farthest = heights[is_lone][np.argmax(apart[is_lone])]
    return [
        f"{is_lone.sum()} of {heights.size} heights stand out alone, the farthest at "
        f"{farthest:.3g}, while all others lie from {others.min():.3g} to {others.max():.3g}: if "
        "this is dust or an error of the instrument, replace it by nan in the file, to be filled."
    ]


def _marks_missing(heights: np.ndarray) -> list[str]:
    """Return a sentence if the least or the largest height seems to mark missing points."""
    heights = heights.astype(float)
    present = heights[np.isfinite(heights)]
    for mark in (present.min(), present.max()):
        others = present[present != mark]
        count = present.size - others.size
        if 0 < count < others.size:
            extent = np.ptp(others)
            if np.abs(others - mark).min() > _FAR_OFF * extent > 0:
                return [
                    f"{count} of {heights.size} heights are {mark:.6g}, while all others lie "
                    f"within {extent:.3g}: if this number marks missing points, replace it by nan, "
                    "which `Topography.filled()` then fills."
                ]
    return []


def rms_slope(heights: np.ndarray, lengths: np.ndarray) -> float:
    """Return the rms slope between neighbours inside of the map, missing points left out."""
    spacing = lengths / heights.shape
    squares = [(_increments(heights, axis)[0] / dx) ** 2 for axis, dx in enumerate(spacing)]
    return float(np.sqrt(sum(squares)))


def _median_slope(heights: np.ndarray, lengths: np.ndarray) -> float:
    """Return the largest of the median slopes along the sides."""
    spacing = lengths / heights.shape
    steps = (np.diff(heights, axis=axis) / dx for axis, dx in enumerate(spacing))
    return max(float(np.nanmedian(np.abs(step))) for step in steps)


def _increments(heights: np.ndarray, axis: int) -> tuple[float, float, float]:
    """Return rms increments between neighbours along a side.

    The three are taken over all neighbours inside, over the line across on which they are largest,
    and over the periodic edge.
    """
    lines = np.moveaxis(heights, axis, 0).reshape(heights.shape[axis], -1)
    squares, counts = _squares(np.diff(lines, axis=0))
    jump, present = _squares(lines[:1] - lines[-1:])
    inside = np.sqrt(squares.sum() / max(counts.sum(), 1))
    largest = np.sqrt(np.max(squares / np.maximum(counts, 1)))
    return float(inside), float(largest), float(np.sqrt(jump[0] / max(present[0], 1)))


def _has_edge_jump(heights: np.ndarray, axis: int, ratio: float) -> bool:
    """Whether the jump at the edge exceeds the rms by a ratio, and the largest increment.

    A pattern with steep walls may have one of them at the edge.
    """
    inside, largest, jump = _increments(heights, axis)
    return jump > max(ratio * inside, _ABOVE_LARGEST * largest, _rounding(heights))


def _squares(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sum of squares of each line, missing points left out, and the number of terms."""
    is_there = np.isfinite(steps)
    if is_there.all():
        return np.einsum("ij,ij->i", steps, steps), np.full(len(steps), steps.shape[1])
    steps = np.where(is_there, steps, 0)
    return np.einsum("ij,ij->i", steps, steps), is_there.sum(axis=1)


def _tilt(heights: np.ndarray) -> np.ndarray | None:
    """Return the best plane less its mean if it is a tilt above the roughness."""
    plane = trend(heights, 1)
    plane -= plane.mean()
    if rms(plane) <= max(rms(heights - plane), _rounding(heights)):
        return None
    # A single long wave fits a plane as well, but meets itself at the edge.
    rises = [np.take(plane, -1, axis).flat[0] - plane.flat[0] for axis in range(plane.ndim)]
    axis = int(np.argmax(np.abs(rises)))
    if not _has_edge_jump(heights, axis, _TILT_JUMP):
        return None
    return plane


def rms(heights: np.ndarray) -> float:
    """Return the rms about the mean, missing points left out."""
    return float(np.nanstd(heights))


def _rounding(heights: np.ndarray) -> float:
    return 100 * float(np.finfo(heights.dtype).eps * np.nanmax(np.abs(heights)))

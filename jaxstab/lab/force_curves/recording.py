"""The content of a file for one curve, and the curve made of it."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from jaxstab.lab.force_curves.force_curve import ForceCurve
from jaxstab.lab.force_curves.segment import Segment, tip_from_height

# A segment moves the cantilever by at least this part of the range of heights.
_MOVE = 0.05
# The names of segments in files.
APPROACH = {"approach", "extend", "extension", "trace", "load", "loading", "forward"}
RETRACTION = {"retraction", "retract", "withdraw", "retrace", "unload", "unloading", "backward"}


@dataclass(frozen=True)
class Recording:
    """The columns of one curve in SI units, in the order of the measurement.

    Attributes:
        force: positive in compression, NaN where missing.
        height: growing away from the sample, NaN where missing.
        tip: the position of the tip, if the file holds it.
        time: if the file holds it.
        labels: a number or a name of the segment at each point, if the file holds them.
        speeds: the speeds of approach and retraction that the file states.
    """

    force: np.ndarray
    height: np.ndarray
    tip: np.ndarray | None = None
    time: np.ndarray | None = None
    labels: np.ndarray | None = None
    speeds: tuple[float | None, float | None] = (None, None)
    spring_constant: float | None = None
    sensitivity: float | None = None
    signal_unit: str = "V"
    position: tuple[float, float] | None = None
    pixel: tuple[int, int] | None = None
    source: str = ""
    instrument: str = ""
    remarks: tuple[str, ...] = ()

    def curve(self) -> ForceCurve:
        """Return the curve, with its segments told apart.

        The approach is the segment that moves farthest down, the retraction the one that moves
        farthest up. Without labels the curve is divided where its height is least.

        Raises:
            ValueError: if there are too few points, or if heights grow towards the sample.
        """
        is_known = np.isfinite(self.height) & np.isfinite(self.force)
        if is_known.sum() < 3:
            raise ValueError(f"only {is_known.sum()} of its points have a force and a height.")
        extent = np.ptp(self.height[is_known])
        if extent == 0:
            raise ValueError("its height is the same at all points.")
        runs, remarks = self._runs(extent)
        time, remark = self._clock()
        remarks += remark
        moves = [self._move(run) for run in runs]
        down = None
        if min(moves) < -_MOVE * extent:
            down = int(np.argmin(moves))
        up = None
        if max(moves) > _MOVE * extent:
            up = int(np.argmax(moves))
        self._require_direction(runs, down, up)
        segments = [self._segment(run, time) for run in runs]
        ends: dict[str, Any] = {"approach": None, "retraction": None}
        for name, number, speed in zip(
            ("approach", "retraction"), (down, up), self.speeds, strict=True
        ):
            if number is not None:
                ends[name] = replace(segments[number], stated_speed=speed)
        return ForceCurve(
            **ends,
            pauses=tuple(part for i, part in enumerate(segments) if i not in (down, up)),
            spring_constant=self.spring_constant,
            sensitivity=self.sensitivity,
            signal_unit=self.signal_unit,
            position=self.position,
            pixel=self.pixel,
            source=self.source,
            instrument=self.instrument,
            remarks=(*self.remarks, *remarks),
        )

    def _clock(self) -> tuple[np.ndarray | None, tuple[str, ...]]:
        """Return the times on one clock, and a remark if the file has none or several.

        Times that begin anew at zero go on from the end of those before, by one step.
        """
        if self.time is None:
            return None, ()
        known = self.time[np.isfinite(self.time)]
        if known.size and np.ptp(known) == 0:
            return None, (f"times not used: all are {known[0]:.6g} s",)
        steps = np.diff(self.time)
        step = np.median(np.abs(steps[np.isfinite(steps)]))
        is_anew = (steps < -2 * step) & (np.abs(self.time[1:]) <= step)
        if not is_anew.any():
            return self.time, ()
        ends = np.cumsum(np.where(is_anew, step - steps, 0))
        remark = "times that begin anew at zero joined to one clock"
        return self.time + np.append(0, ends), (remark,)

    def _segment(self, run: slice, time: np.ndarray | None) -> Segment:
        """Return the points of a segment."""
        force = self.force[run]
        height = self.height[run]
        tip = tip_from_height(height, force, self.spring_constant)
        if self.tip is not None:
            tip = self.tip[run]
        if time is not None:
            time = time[run]
        return Segment(force=force, height=height, tip=tip, time=time)

    def _runs(self, extent: float) -> tuple[list[slice], tuple[str, ...]]:
        """Return the slices of the segments, and a remark if the file does not tell them apart."""
        count = len(self.force)
        if self.labels is not None and np.any(self.labels[1:] != self.labels[:-1]):
            cuts = np.flatnonzero(self.labels[1:] != self.labels[:-1]) + 1
            ends = [0, *cuts.tolist(), count]
            return [slice(*pair) for pair in pairwise(ends)], ()
        height = np.where(np.isfinite(self.height), self.height, np.nan)
        first, last = height[np.isfinite(height)][[0, -1]]
        lowest, highest = int(np.nanargmin(height)), int(np.nanargmax(height))
        if min(first, last) - height[lowest] > _MOVE * extent:
            remark = "approach and retraction divided where the height is least"
            return [slice(0, lowest + 1), slice(lowest + 1, count)], (remark,)
        if height[highest] - max(first, last) > _MOVE * extent:
            return [slice(0, highest + 1), slice(highest + 1, count)], ()
        return [slice(0, count)], ()

    def _move(self, run: slice) -> float:
        """Return the change of the height from the first to the last point that is known."""
        height = self.height[run]
        known = height[np.isfinite(height)]
        if not known.size:
            return 0.0
        return float(known[-1] - known[0])

    def _require_direction(self, runs: list[slice], down: int | None, up: int | None) -> None:
        """Raise `ValueError` if the height grows in the approach, or falls in the retraction."""
        is_first_up = down is not None and up is not None and up < down
        if self.labels is not None and self.labels.dtype.kind in "US":
            names = [str(self.labels[run][0]).strip().lower() for run in runs]
            is_first_up = (up is not None and names[up] in APPROACH) or (
                down is not None and names[down] in RETRACTION
            )
        if is_first_up:
            raise ValueError(
                "its height grows during the approach: heights grow away from the sample. Name a "
                "column that grows towards it `extension`."
            )

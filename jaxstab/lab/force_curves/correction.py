"""The correction of a force curve: its baseline, contact point and drift."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from jaxstab.lab.force_curves.baseline import (
    FEWEST_POINTS,
    SHORT,
    Baseline,
    Line,
    line_of,
    line_of_retraction,
    mean_variance,
)
from jaxstab.lab.force_curves.segment import (
    SIGNIFICANT,
    Segment,
    block_means,
    finite_values,
    scaled,
    size_of_blocks,
    tip_from_height,
)

# The fits of the contact point, each weighed by the one before.
_WEIGHINGS = 10
# The least force is F_0 of the contact within this part of it.
_FACTOR_ERROR = 0.25
# The parts of the largest force, above the least, from which the contact point follows; and two
# other lower ones, from which it would follow as well if the theory held.
_LOWER, _UPPER = 0.03, 0.6
_OTHERS = 0.1, 0.2
# The contact lies beyond all of these parts: what moves their zeros moves it so many times as far.
_BEYOND = 2.0
# A drift is slower than this part of the speed of the cantilever: more is hysteresis.
_SLOW = 0.01


@dataclass(frozen=True)
class Correction:
    """The numbers that `ForceCurve.corrected` has fitted and removed.

    Attributes:
        approach, retraction: the baselines; None for a missing segment.
        contact_point: the tip position at contact; None without a spring constant [length].
        contact_error: its standard error.
        drift: the speed at which heights of equal force grow from approach to retraction, None if
            that is unknown [length/s], or [length/point] without times.
        drift_error: its standard error.
        removes_drift: whether the drift was removed, and not left as hysteresis.
        has_times: whether the drift is per second.

    Example:
        >>> correction = curve.corrected().correction
        >>> bool(abs(correction.contact_point) < 1e-8)
        True
        >>> print(correction.drift)
        None
    """

    approach: Baseline | None = None
    retraction: Baseline | None = None
    contact_point: float | None = None
    contact_error: float | None = None
    drift: float | None = None
    drift_error: float | None = None
    removes_drift: bool = False
    has_times: bool = True

    def scaled(self, length: float, force: float) -> "Correction":
        """Return the correction in other units, given factors."""
        lengths = ("contact_point", "contact_error", "drift", "drift_error")
        changed: dict[str, Any] = {name: scaled(getattr(self, name), length) for name in lengths}
        changed |= {name: line.scaled(length, force) for name, line in self._baselines()}
        return replace(self, **changed)

    def _baselines(self) -> Iterator[tuple[str, Baseline]]:
        if self.approach is not None:
            yield "approach", self.approach
        if self.retraction is not None:
            yield "retraction", self.retraction

    def rows(self, unit: str, force_unit: str) -> Iterator[tuple[str, str]]:
        """Yield a name and a text for each number, with its error and its unit."""
        slope = f"{force_unit}/{unit}"
        for name, line in self._baselines():
            force = _with_error(line.force, line.force_error)
            tilt = _with_error(line.slope, line.slope_error)
            yield (
                "baseline",
                f"{name}: {force} {force_unit} at contact, tilt {tilt} {slope}, noise "
                f"{line.noise:.3g} {force_unit}, {line.number} points",
            )
        if self.contact_point is not None and self.contact_error is not None:
            yield "contact point", f"{_with_error(self.contact_point, self.contact_error)} {unit}"
        if self.drift is not None and self.drift_error is not None:
            per_time = f"{unit}/s"
            if not self.has_times:
                per_time = f"{unit}/point"
            yield "drift", f"{_with_error(self.drift, self.drift_error)} {per_time}"


class _TooFew(ValueError):
    """Too few points tell the contact point."""


def correct(
    segments: Mapping[str, Segment], constant: float | None, is_tilted: bool
) -> tuple[dict[str, Segment], Correction, tuple[str, ...]]:
    """Return the segments without baseline and drift, what was removed, and remarks.

    Arguments:
        segments: by name, "approach" or "retraction" or both among them.
        constant: the spring constant, if it is known.
        is_tilted: whether the baseline has a slope.
    """
    ends = ends_of(segments)
    segments, remarks = _within_range(segments)
    main = line_of(ends[0], segments[ends[0]], is_tilted)
    lines = {ends[0]: main}
    if len(ends) == 2:
        lines["retraction"] = line_of_retraction(segments["retraction"], main, is_tilted)
        if lines["retraction"] is main:
            remarks.append("retraction not detached: corrected by the baseline of the approach")
    elif ends[0] == "retraction" and main.length < SHORT:
        remarks.append(
            f"retraction flat over the far {main.length:.0%} of its heights alone, taken as the "
            "baseline: a tip that still adheres there would look alike"
        )
    flat = {
        name: _shift_heights(
            replace(segment, force=segment.force - lines.get(name, main).forces(segment.height)),
            constant,
        )
        for name, segment in segments.items()
    }
    _require_contact(ends[0], flat[ends[0]], main.noise)
    if constant is None:
        remarks.append("contact point unknown, since the spring constant is")
        return flat, _baselines_alone(lines, 0.0), tuple(remarks)
    clocks = clocks_of(segments)
    drift = drift_error = None
    removes_drift = False
    if len(ends) == 2:
        slow = _SLOW * _speed(segments[ends[0]], clocks[ends[0]])
        found = _with_zeros(lambda shifted: _drift(shifted, clocks), flat, lines, constant)
        if np.isnan(found[0]):
            remarks.append(
                "drift unknown: approach and retraction have too few forces or times in common"
            )
        else:
            drift, drift_error = found
        removes_drift = drift is not None and abs(drift) <= slow
        if drift is not None and not removes_drift:
            remarks.append(
                "drift left: it is no slower than hysteresis, at 1 % of the speed of the approach"
            )
        elif drift is not None:
            flat = {
                name: _shift_heights(segment, constant, drift * clocks[name])
                for name, segment in flat.items()
            }
    contact, contact_error = _with_zeros(
        lambda shifted: _contact(shifted[ends[0]], constant, main.noise), flat, lines, constant
    )
    misfit = _misfit_of_theory(flat[ends[0]], constant, main.noise, contact)
    contact_error = float(np.hypot(contact_error, misfit))
    flat = {name: _shift_heights(segment, constant, contact) for name, segment in flat.items()}
    correction = replace(
        _baselines_alone(lines, contact),
        contact_point=contact,
        contact_error=contact_error,
        drift=drift,
        drift_error=drift_error,
        removes_drift=removes_drift,
        has_times=all(segment.time is not None for segment in segments.values()),
    )
    return flat, correction, tuple(remarks)


def _within_range(segments: Mapping[str, Segment]) -> tuple[dict[str, Segment], list[str]]:
    """Return the segments without clipped forces, which are missing then, and a remark on each."""
    found = dict(segments)
    remarks = []
    for name, segment in segments.items():
        number = int(np.sum(segment.is_clipped))
        if number:
            force = np.where(segment.is_clipped, np.nan, segment.force)
            found[name] = replace(segment, force=force)
            remarks.append(
                f"{name}: {number} points left out, whose forces are at the end of the range of "
                "the detector"
            )
    return found, remarks


def ends_of(segments: Mapping[str, Segment]) -> list[str]:
    """Return which of approach and retraction are there.

    Raises:
        ValueError: if neither is.
    """
    ends = [name for name in ("approach", "retraction") if name in segments]
    if not ends:
        raise ValueError(
            "The curve has neither an approach nor a retraction: the tip does not move in it, or "
            "both were left out."
        )
    return ends


def _baselines_alone(lines: Mapping[str, Line], height: float) -> Correction:
    """Return the correction by baselines alone, with their forces at a height."""
    baselines = {name: line.at(height) for name, line in lines.items()}
    return Correction(baselines.get("approach"), baselines.get("retraction"))


def _shift_heights(
    segment: Segment, constant: float | None, by: np.ndarray | float = 0.0
) -> Segment:
    """Return a segment from other heights, its tip position by the spring constant."""
    height = segment.height - by
    tip = tip_from_height(height, segment.force, constant)
    return replace(segment, height=height, tip=tip)


def clocks_of(segments: Mapping[str, Segment]) -> dict[str, np.ndarray]:
    """Return the time of each point from the end of the approach, or its number.

    Without times a pause has a constant clock, since its duration is unknown.

    Raises:
        ValueError: for times that do not grow from point to point, or from approach to retraction.
    """
    if all(segment.time is not None for segment in segments.values()):
        times = {name: np.asarray(segment.time) for name, segment in segments.items()}
        _require_clock(segments)
        # Where a point is missing its time may be missing too.
        if "approach" in times:
            turn = times["approach"][segments["approach"].is_present][-1]
        else:
            turn = times["retraction"][segments["retraction"].is_present][0]
        return {name: time - turn for name, time in times.items()}
    clocks = {name: np.zeros(len(segment)) for name, segment in segments.items()}
    if "approach" in clocks:
        clocks["approach"] = np.arange(1.0 - len(segments["approach"]), 1)
    if "retraction" in clocks:
        clocks["retraction"] = np.arange(float(len(segments["retraction"])))
    return clocks


def _require_clock(segments: Mapping[str, Segment]) -> None:
    """Raise `ValueError` unless the times of approach and retraction are those of one clock."""
    last = -np.inf
    before = ""
    cure = "The drift follows from times: give those of one clock, or `time=None` in each segment."
    for name in ends_of(segments):
        segment = segments[name]
        assert segment.time is not None
        time = segment.time[segment.is_present]
        if not np.isfinite(time).all():
            raise ValueError(f"The {name} has points without a finite time. {cure}")
        if time.size == 0:
            continue
        falls = np.flatnonzero(np.diff(time) < 0)
        if falls.size:
            pair = time[falls[0] : falls[0] + 2]
            raise ValueError(
                f"The times of the {name} fall, first from {pair[0]:.6g} to {pair[1]:.6g} s. {cure}"
            )
        if time[0] == time[-1]:
            raise ValueError(f"The times of the {name} are all {time[0]:.6g} s. {cure}")
        if time[0] < last:
            raise ValueError(
                f"The {name} begins at {time[0]:.6g} s, before the {before} ends, at {last:.6g} s. "
                f"{cure}"
            )
        last = time[-1]
        before = name


def _with_zeros(
    estimate: Callable[[Mapping[str, Segment]], tuple[float, float]],
    segments: Mapping[str, Segment],
    lines: Mapping[str, Line],
    constant: float,
) -> tuple[float, float]:
    """Return an estimate with its error, which includes the errors of the baselines at contact."""
    found, own_error = estimate(segments)
    variance = own_error**2
    for name, line in lines.items():
        segment = segments[name]
        error = line.at(np.min(finite_values(segment.height))).force_error
        raised = _shift_heights(replace(segment, force=segment.force + error), constant)
        variance += (estimate({**segments, name: raised})[0] - found) ** 2
    return found, float(np.sqrt(variance))


def _speed(segment: Segment, clock: np.ndarray) -> float:
    """Return the mean speed of the height, by a clock."""
    height = segment.height[segment.is_present]
    return float(abs(height[-1] - height[0]) / np.ptp(clock[segment.is_present]))


def _require_contact(name: str, segment: Segment, noise: float) -> None:
    """Raise `ValueError` unless the deepest points push."""
    is_present = segment.is_present
    order = np.argsort(segment.height[is_present])
    deepest = np.mean(segment.force[is_present][order[:5]])
    if deepest < -SIGNIFICANT * noise:
        raise ValueError(
            f"The {name} pulls where it is deepest, by {-deepest:.3g}: if attraction is positive "
            "in the file, reverse the forces by `-curve`."
        )
    if deepest < SIGNIFICANT * noise:
        raise ValueError(
            f"The {name} has no contact: where it is deepest its force is {deepest:.3g}, with a "
            f"noise of {noise:.3g}."
        )


class _ContactPart(NamedTuple):
    """The points of a segment in contact, from a small to a large force, and their numbers.

    The largest attraction is a mean over a block of points, with its standard error.
    """

    force: np.ndarray
    tip: np.ndarray
    numbers: np.ndarray
    attraction: float
    error: float


def _contact_part(segment: Segment, least: float, most: float, noise: float) -> _ContactPart:
    """Return the points in contact with forces between parts of the largest, above the least.

    They lie between the points where means over blocks pass these forces, so that the noise does
    not choose.
    """
    numbers = np.flatnonzero(segment.is_present)
    if segment.height[numbers[0]] < segment.height[numbers[-1]]:
        numbers = numbers[::-1]
    force = segment.force[numbers]
    block = size_of_blocks(force)
    means = block_means(force, block)
    lowest = int(np.argmin(means))
    attraction = max(-float(means[lowest]), 0.0)
    above = means + attraction
    # Beyond the least force on the way in, the force rises.
    is_low = above < least * above.max()
    is_low[:lowest] = True
    start = len(means) - int(np.argmax(is_low[::-1]))
    is_high = above >= most * above.max()
    is_high[:start] = False
    end = len(means)
    if is_high.any():
        end = int(np.argmax(is_high))
    chosen = slice(start * block, end * block)
    return _ContactPart(
        force=force[chosen],
        tip=segment.tip_position[numbers][chosen],
        numbers=numbers[chosen],
        attraction=attraction,
        error=noise / np.sqrt(block),
    )


def _drift(
    segments: Mapping[str, Segment], clocks: Mapping[str, np.ndarray]
) -> tuple[float, float]:
    """Return the speed at which tip positions of equal force grow, with its error, NaN if unknown.

    The tip position is a cubic polynomial of (F + F_0)^(2/3), the same in both segments, plus the
    drift times the time from the end of the approach.
    """
    parts = {
        name: _contact_part(segments[name], _LOWER, 1.0, 0.0) for name in ("approach", "retraction")
    }
    if min(len(part.force) for part in parts.values()) < FEWEST_POINTS // 2:
        return np.nan, np.nan
    top = min(part.force.max() for part in parts.values())
    force = np.concatenate([part.force for part in parts.values()])
    tip = np.concatenate([part.tip for part in parts.values()])
    clock = np.concatenate([clocks[name][part.numbers] for name, part in parts.items()])
    is_common = (force > 0) & (force < top)
    if is_common.sum() < FEWEST_POINTS:
        return np.nan, np.nan
    attraction = parts["approach"].attraction
    reduced = ((force[is_common] + attraction) / (top + attraction)) ** (2 / 3)
    unit = np.ptp(clock[is_common])
    if unit == 0:
        return np.nan, np.nan
    columns = np.stack([reduced**0, reduced, reduced**2, reduced**3, clock[is_common] / unit], 1)
    found = np.linalg.lstsq(columns, tip[is_common], rcond=None)[0]
    misfit = tip[is_common] - columns @ found
    covariance = np.linalg.inv(columns.T @ columns) * mean_variance(misfit, 5)
    return float(found[-1] / unit), float(np.sqrt(covariance[-1, -1]) / unit)


def _contact(
    segment: Segment, constant: float, noise: float, lower: float = _LOWER
) -> tuple[float, float]:
    """Return the contact point d of F = K (d - tip)^(3/2) - F_0, with its error.

    The tip position is fitted by d - ((F + F_0) / K)^(2/3), with F_0 near the least force. An error
    of the force moves the tip position by 1 / spring constant, and the curve by 1 / its slope: the
    weights allow for both.
    """
    force, tip, _, attraction, error = _contact_part(segment, lower, _UPPER, noise)
    if len(force) < FEWEST_POINTS // 4:
        raise _TooFew(
            f"Only {len(force)} points lie in the lower part of the contact, from which its zero "
            "follows: measure more slowly, or with more points."
        )
    # The block means of a force that is nowhere negative scatter about zero.
    if attraction <= SIGNIFICANT * error:
        attraction = 0.0
    # The variables are d, K^(-2/3), and a factor of the attraction, which is about one.
    found = np.array([0.0, 0.0, 1.0])
    prior = noise / _FACTOR_ERROR
    rows = np.zeros((len(force) + 1, 3))
    values = np.zeros(len(force) + 1)
    for _ in range(_WEIGHINGS):
        pushing = np.maximum(force + found[2] * attraction, _LOWER / 2 * np.ptp(force))
        slopes = pushing ** (-1 / 3) * 2 / 3
        weights = 1 / (1 / constant + max(found[1], 0) * slopes)
        moved = -found[1] * attraction * slopes
        columns = np.stack([np.ones_like(force), -(pushing ** (2 / 3)), moved], axis=1)
        rows = np.vstack([weights[:, None] * columns, [0, 0, prior]])
        values = np.append(weights * (tip + moved * found[2]), prior)
        found = np.linalg.lstsq(rows, values, rcond=None)[0]
        # A misfit beyond the noise makes the factor no better known.
        prior = max(noise, float(np.std((values - rows @ found)[:-1]))) / _FACTOR_ERROR
    misfit = (values - rows @ found)[:-1]
    variance = np.linalg.inv(rows.T @ rows)[0, 0] * mean_variance(misfit, 3)
    return float(found[0]), float(np.sqrt(variance))


def _misfit_of_theory(segment: Segment, constant: float, noise: float, contact: float) -> float:
    """Return how far other parts of the curve move the contact point, beyond chance.

    A long attraction or repulsion, or another shape of the tip, bends the lowest part.
    """
    away = 0.0
    for lower in _OTHERS:
        try:
            other, error = _contact(segment, constant, noise, lower)
        except _TooFew:
            continue
        # Fits to a part and to the whole differ by chance by less than the error of the first.
        away = max(away, (other - contact) ** 2 - error**2)
    return _BEYOND * float(np.sqrt(away))


def _with_error(value: float, error: float) -> str:
    """Return a number and its error, to two digits of the error."""
    return f"{value:.6g} ± {error:.2g}"

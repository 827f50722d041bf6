"""The fit of one measured force curve, by the exact contact of an axisymmetric tip."""

from __future__ import annotations

import warnings
from copy import copy
from typing import Literal, NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import OptimizeResult, least_squares

import jaxstab as js
from jaxstab.lab import dugdale
from jaxstab.lab.fit import FitErrors, ForceCurveFit
from jaxstab.lab.tips import FlatPunch, Tip

Part = Literal["approach", "retraction"]

# Means over so many steps of the height in contact, and where no force acts.
_NEAR, _FAR = 150, 30
# A step of the force is a jump if it exceeds the noise so many times, and the steps of so many
# points beside it so many times.
_JUMP, _STEEPER, _BESIDE = 8.0, 5.0, 21
# An attraction that exceeds its error so many times is fitted, and kept if the sum of squares falls
# by this much, in units of its scatter.
_ATTRACTION, _GAIN = 4.0, 20.0
# Ranges from which a fit starts, over Tabor's length (w / E*)^(2/3) R^(1/3), and the bounds.
_STARTS = (0.1, 0.5, 2.0, 8.0)
_RANGES = 1e-3, 300.0
# An attraction acts over no less than the distance of atoms [m].
_ATOM = 1e-10
# The pull-off is between 1.5 and 2 times pi w R.
_PULL_OFF = 1.7
# The steps of finite differences; evaluations of a first and of a last fit.
_DIFFERENCE = 1e-4
_FIRST, _LAST = 15, 40
# A modulus is within this factor of the start, and a contact point this part of the travel above
# the deepest point.
_FAR_OFF = 100.0
_NO_DRIFT = 1e-6
_NEXT_TO = 1e-3
# Contact points among which a fit starts.
_CONTACTS = 120
# Autocorrelations are summed up to a lag of so many correlation lengths (A. Sokal).
_WINDOW = 5
# The model does not describe a curve whose misfit in contact is so many times the noise, and this
# part of the force that the indentation makes.
_MISFIT, _SEEN = 3.0, 0.02
# Steps of the logarithm of the range that are tried for its error, and the number of them. Their
# sums of squares are right within this part.
_STEPS, _TRIED = (0.01, 1.0), 12
_ROUGH, _FINE = 1e-4, 1e-6
# So many standard errors of the range are measured.
_ERRORS = 2.0
# A better fit has half a sum of squares that is lower by this much; so many times it is sought.
_BETTER, _SEARCHES = 0.5, 3
# A start is inside of its bounds by this much.
_INNER = 1e-9
# Which numbers are fitted: all, all but the range, and modulus and contact point.
_ALL, _BUT_RANGE, _MECHANICS = slice(None), slice(-1), slice(2)
# Errors of the bins follow from so many fits.
_WEIGHINGS = 2


def fit_curve(
    curve: js.lab.force_curves.ForceCurve,
    tip: Tip | FlatPunch,
    poisson_ratio: float = 0.5,
    segment: Part = "approach",
) -> ForceCurveFit:
    """Fit modulus, adhesion and contact point to one segment of a measured force curve.

    The model is the contact of a rigid axisymmetric tip with an elastic half space under Dugdale's
    attraction, exact between the limits of JKR and DMT (D. Maugis, J. Colloid Interface Sci. 150,
    243 (1992)), on the cantilever that has measured it. Forces over the height are fitted by least
    squares, in which jumps into and out of contact are those of the model; the rest of the baseline
    is fitted too. A curve that shows no attraction is fitted without (I. N. Sneddon, Int. J. Eng.
    Sci. 3, 47 (1965)).

    Standard errors include noise that is correlated over some points, and a misfit of the model.
    They do not include errors of the spring constant, the tip, Poisson's ratio and the law: between
    JKR and DMT another law makes another curve.

    Arguments:
        curve: the curve, with a spring constant; one that is not corrected is.
        tip: a `Sphere`, `Paraboloid`, `Cone`, `Pyramid` or `FlatPunch`.
        poisson_ratio: nu of the sample.
        segment: "approach" or "retraction".

    Raises:
        ValueError: for Poisson's ratio outside of (-1, 0.5], another segment or one that the curve
            lacks, no spring constant, and a curve that cannot be corrected.
        TypeError: for something that is no force curve or no tip.

    Warns:
        FitWarning: if the result is not `successful`; the message has the reason.
    """
    if not isinstance(curve, js.lab.force_curves.ForceCurve):
        raise TypeError(
            f"The curve is a {type(curve)}: give a ForceCurve, as "
            "jaxstab.lab.force_curves.read returns it, one of several by its number."
        )
    if not isinstance(tip, Tip | FlatPunch):
        raise TypeError(
            f"The tip is {tip!r}: give a Sphere, Paraboloid, Cone, Pyramid or FlatPunch of "
            "jaxstab.lab."
        )
    if not -1 < poisson_ratio <= 0.5:
        raise ValueError(f"Poisson's ratio is {poisson_ratio}: it lies in (-1, 0.5].")
    if segment not in ("approach", "retraction"):
        raise ValueError(f"The segment is {segment!r}: choose approach or retraction.")
    if getattr(curve, segment) is None:
        raise ValueError(f"The curve has no {segment}: fit another segment.")
    if curve.spring_constant is None:
        raise ValueError(
            "The curve has no spring constant, without which indentations are unknown: give it in "
            "N/m, as in js.lab.force_curves.read(path, spring_constant=0.2)."
        )
    if curve.correction is None:
        curve = curve.corrected()
    data = _Data.of(curve.in_units("m", "N"), segment)
    model, found = _without_adhesion(data, tip)
    ranges = None
    if _attracts(data) and not (segment == "approach" and isinstance(tip, FlatPunch)):
        sticky, other, bounds = _with_adhesion(data, tip)
        bare = model.with_errors(sticky.errors).fit(found.x, _ALL, _LAST)
        if 2 * (bare.cost - other.cost) > _GAIN:
            model, found, ranges = sticky, other, bounds
    return _finished(curve, model, found, ranges, poisson_ratio, segment)


class _Data(NamedTuple):
    """Points of a segment from the far end on, and means over bins of them; in SI units.

    Attributes:
        height, force, clock: of each point; the clock is one at the far end and zero at the turn.
        group: the number of the bin of each point.
        heights, widths, forces, clocks: of each bin; the width is that of an even spread.
        errors: standard errors of the forces of bins, by white noise.
        is_near: which bins lie beyond the baseline.
        has_jump: which bins the tip jumps in.
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
    noise: float
    stiffness: float
    is_approach: bool
    drift_error: float

    @classmethod
    def of(cls, curve: js.lab.force_curves.ForceCurve, name: Part) -> _Data:
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
        part = (top - height[far:]) / (top - height[far:].min() or 1.0)
        group[far:] = _FAR + np.clip(part * _NEAR, 0, _NEAR - 1).astype(int)
        places, group, number = np.unique(group, return_inverse=True, return_counts=True)
        heights, forces, clocks = (
            np.bincount(group, values) / number for values in (height, force, clock)
        )
        spread = np.bincount(group, (height - heights[group]) ** 2) / number
        noise = line.noise
        step = np.abs(np.diff(force, prepend=force[0]))
        is_jump = step > _JUMP * noise + _STEEPER * median_filter(step, _BESIDE)
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
            noise,
            curve.spring_constant,
            name == "approach",
            drift_error,
        )

    @property
    def tips(self) -> np.ndarray:
        """Positions of the tip [m]."""
        return self.heights + self.forces / self.stiffness


class _Model:
    """Forces over heights as a function of numbers, of the order of one.

    The numbers are ln E*, contact point, baseline, tilt, drift, and with adhesion ln w and, but for
    a punch, ln h.
    """

    def __init__(self, data: _Data, tip: Tip | FlatPunch, is_sticky: bool):
        self.data = data
        self.errors = data.errors
        self.tip = tip
        self.is_sticky = is_sticky
        depth = float(np.ptp(data.tips[data.is_near]))
        window = float(np.ptp(data.heights))
        scatter = data.noise / np.sqrt(len(data.force))
        # Where no drift was removed there is none to fit.
        drift = data.drift_error or _NO_DRIFT * depth
        self.units = np.array([1.0, depth, scatter, scatter / window, drift, 1.0, 1.0])
        self.count = 5
        if is_sticky:
            self.count = 6 if isinstance(tip, FlatPunch) else 7
        self.units = self.units[: self.count]

    def with_errors(self, errors: np.ndarray) -> _Model:
        """Return the model with other errors of the bins."""
        other = copy(self)
        other.errors = errors
        return other

    def branch(self, numbers: np.ndarray) -> dugdale.Branch:
        """Return the equilibria at numbers in their units."""
        modulus, contact = np.exp(numbers[0]), numbers[1]
        data = self.data
        travel = contact - data.height.min() + abs(numbers[4])
        compliance = 1 / data.stiffness
        if not self.is_sticky:
            return dugdale.without_adhesion(self.tip, modulus, travel, compliance)
        work, length = np.exp(numbers[5]), np.exp(numbers[-1])
        return dugdale.with_adhesion(self.tip, modulus, work, length, travel, compliance)

    def forces(
        self, x: np.ndarray, heights: np.ndarray, widths: np.ndarray, clocks: np.ndarray
    ) -> np.ndarray:
        """Return the mean force over each interval of heights."""
        numbers = x * self.units
        branch = self.branch(numbers)
        data = self.data
        path = numbers[1] - branch.indentation - branch.force / data.stiffness
        force = branch.force
        # The state jumps at a limit of the height.
        if data.is_approach:
            path, force = np.minimum.accumulate(path)[::-1], force[::-1]
        else:
            path, force = np.maximum.accumulate(path[::-1]), force[::-1]
        path, force = np.append(path, path[-1]), np.append(force, 0.0)
        below = heights - numbers[4] * clocks
        found = _means(path, force, below - widths / 2, below + widths / 2)
        middle = data.heights.mean()
        return found + numbers[2] + numbers[3] * (heights - middle)

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return the misfit of bins over their errors, and of the drift over its own."""
        data = self.data
        found = self.forces(x, data.heights, data.widths, data.clocks)
        return np.append((found - data.forces) / self.errors, x[4])

    def jacobian(self, x: np.ndarray, free: slice = _ALL) -> np.ndarray:
        """Return the derivatives of the residuals, by differences where they are not straight."""
        data = self.data
        start = self.residuals(x)
        columns = np.zeros((len(start), self.count))
        columns[:-1, 2] = self.units[2] / self.errors
        columns[:-1, 3] = self.units[3] * (data.heights - data.heights.mean()) / self.errors
        for number in {*range(self.count)[free]} - {2, 3}:
            moved = x.copy()
            moved[number] += _DIFFERENCE
            columns[:, number] = (self.residuals(moved) - start) / _DIFFERENCE
        return columns

    def fit(
        self, x: np.ndarray, free: slice, most: int, ranges: tuple[float, float] | None = None
    ) -> OptimizeResult:
        """Return the least squares over free numbers, from a modulus right within a factor."""
        data = self.data
        lowest, highest = np.full(self.count, -np.inf), np.full(self.count, np.inf)
        lowest[0], highest[0] = x[0] - np.log(_FAR_OFF), x[0] + np.log(_FAR_OFF)
        # The contact point is a place of the tip.
        span = float(np.ptp(data.tips))
        lowest[1] = (data.tips.min() + _NEXT_TO * span) / self.units[1]
        highest[1] = (data.tips.max() + span) / self.units[1]
        if ranges is not None:
            lowest[-1], highest[-1] = np.log(ranges)
        inner = _INNER * (1 + np.abs(x))
        start = np.clip(x, lowest + inner, highest - inner)

        def whole(part: np.ndarray) -> np.ndarray:
            x = start.copy()
            x[free] = part
            return x

        found = least_squares(
            lambda part: self.residuals(whole(part)),
            start[free],
            jac=lambda part: self.jacobian(whole(part), free)[:, free],  # pyright: ignore[reportArgumentType]
            bounds=(lowest[free], highest[free]),
            x_scale="jac",
            max_nfev=most,
            ftol=_ROUGH if most == _FIRST else _FINE,
        )
        found.x = whole(found.x)
        return found


def _means(path: np.ndarray, force: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the means over intervals of a force that is straight between ascending places.

    Beyond the last place there is no force.
    """
    areas = np.append(0.0, np.cumsum(np.diff(path) * (force[1:] + force[:-1]) / 2))

    def area(at: np.ndarray) -> np.ndarray:
        place = np.clip(np.searchsorted(path, at, "right") - 1, 0, len(path) - 2)
        away = np.minimum(at, path[-1]) - path[place]
        width = path[place + 1] - path[place]
        slope = np.where(
            width > 0, (force[place + 1] - force[place]) / np.where(width > 0, width, 1), 0
        )
        return areas[place] + away * (force[place] + slope * away / 2)

    wide = np.maximum(high - low, 1e-9 * np.ptp(path))
    middle = (low + high) / 2
    return (area(middle + wide / 2) - area(middle - wide / 2)) / wide


def _noise_of_heights(height: np.ndarray, clock: np.ndarray) -> float:
    """Return the standard deviation of white noise of heights, by lines through two points."""
    before, after = np.diff(clock)[:-1], np.diff(clock)[1:]
    share = np.divide(
        after, before + after, out=np.full(len(before), 0.5), where=before + after > 0
    )
    away = height[1:-1] - share * height[:-2] - (1 - share) * height[2:]
    away = away / np.sqrt(1 + share**2 + (1 - share) ** 2)
    return float(1.4826 * np.median(np.abs(away)))


def _attracts(data: _Data) -> bool:
    """Whether the mean force of some bin in contact is negative beyond its error."""
    far = data.forces[~data.is_near]
    number = np.bincount(data.group)
    correlated = np.std(far) if len(far) > 3 else 0.0
    errors = np.hypot(data.noise / np.sqrt(number), correlated)
    return bool(np.any((data.forces < -_ATTRACTION * errors)[data.is_near]))


def _start(data: _Data, tip: Tip | FlatPunch, attraction: float) -> tuple[float, float]:
    """Return E* and contact point of the best fit to tip positions, with a constant attraction."""
    lowest = 0
    if attraction > 0:
        lowest = int(np.argmin(data.forces))
    is_used = np.arange(len(data.forces)) >= lowest
    tips, forces = data.tips[is_used], data.forces[is_used] + attraction
    deep, high = tips.min(), data.tips[data.is_near].max()
    unit = dugdale.without_adhesion(tip, 1.0, 1.1 * (high - deep), 0.0)
    best = (np.inf, 1.0, 0.0)
    for contact in np.linspace(high, deep, _CONTACTS, endpoint=False):
        shape = np.interp(contact - tips, unit.indentation, unit.force / unit.force[-1])
        columns = shape[:, None]
        if attraction == 0:
            columns = np.stack([shape, np.ones_like(shape)], 1)
        found, *_ = np.linalg.lstsq(columns, forces, rcond=None)
        squares = float(np.sum((columns @ found - forces) ** 2))
        if found[0] > 0 and squares < best[0]:
            best = (squares, float(found[0] / unit.force[-1]), float(contact))
    return best[1], best[2]


def _without_adhesion(data: _Data, tip: Tip | FlatPunch) -> tuple[_Model, OptimizeResult]:
    """Return the fit without adhesion, with the errors of bins that it shows."""
    model = _Model(data, tip, False)
    modulus, contact = _start(data, tip, 0.0)
    start = np.array([np.log(modulus), contact, 0.0, 0.0, 0.0]) / model.units
    return _weighted(model, model.fit(start, _MECHANICS, _LAST))


def _weighted(
    model: _Model, found: OptimizeResult, ranges: tuple[float, float] | None = None
) -> tuple[_Model, OptimizeResult]:
    """Return fits of all numbers with the errors of bins that the fits before show."""
    for _ in range(_WEIGHINGS):
        model = model.with_errors(model.data.errors * np.sqrt(_scatter(model, found)))
        found = model.fit(found.x, _ALL, _LAST, ranges)
    return model, found


def _with_adhesion(
    data: _Data, tip: Tip | FlatPunch
) -> tuple[_Model, OptimizeResult, tuple[float, float] | None]:
    """Return the best of the fits that start from some ranges, and the bounds of the range."""
    model = _Model(data, tip, True)
    attraction = -float(data.forces[data.is_near].min())
    modulus, contact = _start(data, tip, attraction)
    zeros = [contact, 0.0, 0.0, 0.0]
    if isinstance(tip, FlatPunch):
        work = attraction**2 / (8 * np.pi * modulus * tip.radius**3)
        start = np.array([np.log(modulus), *zeros, np.log(work)])
        return *_weighted(model, model.fit(start / model.units, _ALL, _LAST)), None
    # The curvature of the tip where it takes as much force as the attraction.
    branch = dugdale.without_adhesion(tip, modulus, float(np.ptp(data.tips)), 0.0)
    depth = np.interp(attraction, branch.force, branch.indentation)
    radii = np.geomspace(1e-12, min(1.0, 0.99 * tip.largest_radius), 600)
    radius = np.interp(depth, tip.penetration(radii), radii) ** 2 / depth
    work = attraction / (_PULL_OFF * np.pi * radius)
    length = (work / modulus) ** (2 / 3) * radius ** (1 / 3)
    lowest = max(_RANGES[0] * length, _ATOM)
    bounds = lowest, max(_RANGES[1] * length, 2 * lowest)
    found = []
    for start in _STARTS:
        numbers = [np.log(modulus), *zeros, np.log(work), np.log(start * length)]
        found.append(model.fit(np.array(numbers) / model.units, _ALL, _FIRST, bounds))
    best = min(found, key=lambda one: one.cost)
    # Errors of bins would hide a fit that has not ended.
    best = model.fit(best.x, _ALL, _LAST, bounds)
    return *_weighted(model, best, bounds), bounds


def _scatter(model: _Model, found: OptimizeResult) -> np.ndarray:
    """Return the variance of each bin over the variance by white noise.

    Deviations of points from the model are taken together where no force acts, and in contact. With
    the autocorrelation r_k the mean of many points has the variance (1 + 2 sum r_k) sigma^2 / n.
    """
    data = model.data
    misfit = _misfit(model, found.x)
    scatter = np.ones(len(data.forces))
    for is_part in (data.is_near, ~data.is_near):
        inside = misfit[is_part[data.group]]
        if inside.size > 3:
            scatter[is_part] = max(_long_variance(inside, model.count) / data.noise**2, 1.0)
    return scatter


def _misfit(model: _Model, x: np.ndarray) -> np.ndarray:
    """Return the deviation of each point, without points of bins with a jump."""
    data = model.data
    found = model.forces(x, data.height, np.zeros(len(data.height)), data.clock)
    return np.where(data.has_jump[data.group], 0.0, data.force - found)


def _long_variance(values: np.ndarray, freedom: int) -> float:
    """Return the variance of the mean of many values, times their number."""
    count = len(values)
    size = 2 ** int(np.ceil(np.log2(2 * count)))
    power = np.abs(np.fft.rfft(values, size)) ** 2
    products = np.fft.irfft(power, size)[:count] / count
    if products[0] == 0:
        return 0.0
    lengths = 1 + 2 * np.cumsum(products[1:] / products[0])
    is_enough = np.arange(1, count) >= _WINDOW * lengths
    length = 1.0
    if is_enough.any():
        length = max(float(lengths[np.argmax(is_enough)]), 1.0)
    length = min(length, count / (2 * freedom))
    return float(products[0]) * length * count / (count - freedom * length)


def _finished(
    curve: js.lab.force_curves.ForceCurve,
    model: _Model,
    found: OptimizeResult,
    ranges: tuple[float, float] | None,
    poisson_ratio: float,
    segment: Part,
) -> ForceCurveFit:
    data = model.data
    length = length_error = np.nan
    if ranges is None:
        variances = np.diag(_inverse(model.jacobian(found.x)))
    else:
        model, found, variances, length_error = _searched(model, found, ranges)
        length = float(np.exp(found.x[-1]))
    errors = np.sqrt(variances) * model.units
    numbers = found.x * model.units
    modulus = float(np.exp(numbers[0])) * (1 - poisson_ratio**2)
    work, work_error = 0.0, np.nan
    if model.is_sticky:
        work = float(np.exp(numbers[5]))
        work_error = work * float(errors[5])
    points = getattr(curve.in_units("m", "N"), segment)
    forces = model.forces(found.x, data.height, np.zeros(len(data.height)), data.clock)
    if points.height[points.is_present][0] < points.height[points.is_present][-1]:
        forces = forces[::-1]
    fitted = np.full(len(points), np.nan)
    fitted[points.is_present] = forces
    own = js.lab.force_curves.ForceCurve(js.lab.force_curves.Segment(fitted, points.height), None)
    own = own.in_units(curve.unit, curve.force_unit).approach
    assert own is not None
    inside = _misfit(model, found.x)[data.height + data.force / data.stiffness < numbers[1]]
    rms = float(np.sqrt(np.mean(inside**2))) if inside.size else np.nan
    # On a stiff sample the force is hardly more than that on a rigid one, which tells nothing.
    bending = data.force.max() / data.stiffness
    depth = float(numbers[1] - data.tips.min())
    told = float(data.force.max()) * depth / (depth + bending)
    result = js.RESULTS.successful
    if found.status == 0:
        result = js.RESULTS.max_steps_reached
    elif not rms <= max(_MISFIT * data.noise, _SEEN * told):
        result = js.RESULTS.misfit
    fit = ForceCurveFit(
        youngs_modulus=modulus,
        work_of_adhesion=work,
        range=length,
        contact_point=float(numbers[1]),
        errors=FitErrors(
            youngs_modulus=modulus * float(errors[0]),
            work_of_adhesion=work_error,
            range=length_error,
            contact_point=float(errors[1]),
        ),
        result=result,
        misfit=rms,
        noise=data.noise,
        curve=curve,
        segment=segment,
        tip=model.tip,
        poisson_ratio=poisson_ratio,
        forces=own.force,
    )
    if result != js.RESULTS.successful:
        numbers = f"the misfit is {rms / data.noise:.2g} times the noise"
        warnings.warn(f"{fit.status}: {numbers}.", js.exceptions.FitWarning, stacklevel=3)
    return fit


def _inverse(jacobian: np.ndarray) -> np.ndarray:
    """Return the inverse of J^T J, of columns that may have any size."""
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1.0
    scaled = jacobian / size
    return np.linalg.pinv(scaled.T @ scaled) / np.outer(size, size)


def _searched(
    model: _Model, found: OptimizeResult, ranges: tuple[float, float]
) -> tuple[_Model, OptimizeResult, np.ndarray, float]:
    """Return the fit from which none at other ranges is better, its variances and range error."""
    profile = _profile(model, found, ranges)
    for _ in range(_SEARCHES):
        if profile.least.cost > found.cost - _BETTER:
            # A narrow valley may take more steps than there are, and has been followed.
            found = OptimizeResult(profile.least, status=1)
            break
        model, found = _weighted(model, profile.least, ranges)
        profile = _profile(model, found, ranges)
    return model, found, profile.variances, profile.range_error


class _Profile(NamedTuple):
    """The best fit of those at many ranges, and how well all numbers are known.

    Attributes:
        least: the best fit, the lowest of all that were tried.
        variances: of the numbers.
        range_error: of the range [m].
    """

    least: OptimizeResult
    variances: np.ndarray
    range_error: float


def _profile(model: _Model, found: OptimizeResult, ranges: tuple[float, float]) -> _Profile:
    """Return how far all numbers are known, by fits of the others at longer and shorter ranges.

    The misfit is no parabola over the range: one that is short beside the deformation hardly
    changes the curve. Two standard errors reach to where the sum of squares has grown by four, on
    the farther side, or as far as derivatives tell.
    """
    variances = np.diag(_inverse(model.jacobian(found.x)))
    first = float(np.clip(np.sqrt(variances[-1]), *_STEPS))
    best, sides = found, []
    for sign in (1, -1):
        step, grown, at = first, 0.0, found.x
        last, before = at, grown
        for _ in range(_TRIED):
            last, before = at, grown
            length = np.clip(at[-1] + sign * step, *np.log(ranges))
            refit = model.fit(np.append(at[:-1], length), _BUT_RANGE, _FIRST)
            at = refit.x
            if refit.cost < best.cost:
                best = OptimizeResult(found, x=at, cost=refit.cost)
            # The distance in standard errors.
            grown = float(np.sqrt(max(2 * (refit.cost - found.cost), 0.0)))
            if grown >= _ERRORS or length in np.log(ranges):
                break
            step = min(2 * step, _STEPS[1])
        if grown > _ERRORS:
            at = last + (_ERRORS - before) / (grown - before) * (at - last)
        sides.append(at)
    away = np.max(np.abs(np.array(sides) - best.x), axis=0) / _ERRORS
    jacobian = model.jacobian(best.x)
    along = away**2
    along[:-1] += np.diag(_inverse(jacobian[:, :-1]))
    variances = np.maximum(np.diag(_inverse(jacobian)), along)
    length = np.exp(best.x[-1])
    lengths = np.exp([side[-1] for side in sides])
    # Far from the fit derivatives tell nothing of the range.
    straight = length * min(np.sqrt(variances[-1]), 1.0)
    return _Profile(best, variances, float(max(straight, *np.abs(lengths - length) / _ERRORS)))

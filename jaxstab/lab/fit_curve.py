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
from jaxstab.lab.force_curves.force_curve import curve_to_fit
from jaxstab.lab.tips import FlatPunch, Tip

Part = Literal["approach", "retraction"]

# Means over so many steps of the height in contact, and where no force acts. Steps are this part
# of the travel in contact at the contact point, and grow in proportion to the distance from there.
_NEAR, _FAR = 150, 30
_FINEST = 0.02
# A step of the force is a jump if it exceeds the noise so many times, and by so many times what the
# steps of so many points beside it exceed the noise by.
_JUMP, _STEEPER, _BESIDE = 6.0, 5.0, 21
# An attraction is fitted if means over so many points exceed so many times those where no force
# acts, and kept if the sum of squares falls by this much, in units of its scatter.
_BLOCKS, _ATTRACTION, _GAIN = (1, 4, 16, 64), 4.0, 14.0
# So many blocks tell how means scatter.
_FEWEST_BLOCKS = 8
# Bounds of the range over Tabor's length (w / E*)^(2/3) R^(1/3), and the numbers of ranges in
# between at which the others are fitted, and from which a search begins. Ranges are left out beyond
# one whose half sum of squares is so much larger.
_RANGES = 1e-3, 300.0
_TRIED, _STARTS = 19, 9
# Works over the best one at which the others are fitted, as logarithms.
_WORKS = np.array([-2.4, -1.6, -0.8, -0.4, -0.2, 0.2, 0.4, 0.8, 1.6, 2.4])
_MUCH_WORSE = 50.0
# An attraction acts over no less than the distance of atoms [m].
_ATOM = 1e-10
# The pull-off is between 1.5 and 2 times pi w R.
_PULL_OFF = 1.7
# The steps of finite differences; evaluations of a first and of a last fit.
_DIFFERENCE = 3e-4
_FIRST, _LAST = 30, 60
# Modulus and work are within this factor of the start, and a contact point this part of the travel
# above the deepest point.
_FAR_OFF = 100.0
_NO_DRIFT = 1e-6
_NEXT_TO = 1e-3
# Contact points among which a fit starts.
_CONTACTS = 120
# Autocorrelations are summed up to a lag of so many correlation lengths (A. Sokal).
_WINDOW = 5
# The model does not describe a curve whose misfit in contact is so many times the noise, and this
# part of the force that the indentation makes: a sphere's curve fitted by a cone misses it by 1.5 %
# and has five times the modulus. Before contact the misfit is so many times the noise, and this
# part of the largest attraction.
_MISFIT, _OF_FORCE, _OF_ATTRACTION = 3.0, 0.01, 0.03
# A sum of squares is right within this part, as a first and as a last one.
_ROUGH, _FINE = 1e-4, 1e-9
# A better fit has half a sum of squares that is lower by this much.
_BETTER = 0.1
# So many standard errors reach to where the sum of squares has grown by the square of the other
# number: the joint regions of work and range in which both lie in 95.4 and 99.7 of 100 cases.
_ERRORS = (2.0, 2.48), (3.0, 3.44)
# A start is inside of its bounds by this much.
_INNER = 1e-9
# The narrowest interval of a mean, over the length of the path.
_NARROWEST = 1e-5
# Which numbers are fitted: all, all but the range, and modulus and contact point.
_ALL, _BUT_RANGE, _MECHANICS = slice(None), slice(-1), slice(2)
# The place of the work of adhesion among the numbers.
_WORK = 5
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

    Standard errors include noise that is correlated over some points, a misfit of the model, and
    all ranges of the attraction that the curve allows. They do not include errors of the spring
    constant, the tip and Poisson's ratio. Another law of attraction than Dugdale's is a misfit
    where the attraction shows.

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
    if not isinstance(tip, Tip | FlatPunch):
        raise TypeError(
            f"The tip is {tip!r}: give a Sphere, Paraboloid, Cone, Pyramid or FlatPunch of "
            "jaxstab.lab."
        )
    if not -1 < poisson_ratio <= 0.5:
        raise ValueError(f"Poisson's ratio is {poisson_ratio}: it lies in (-1, 0.5].")
    curve = curve_to_fit(curve, segment)
    data = _Data.of(curve.in_units("m", "N"), segment)
    fit = _without_adhesion(data, tip)
    if _attracts(data) and not (segment == "approach" and isinstance(tip, FlatPunch)):
        fit = _better(fit, _with_adhesion(data, tip))
    return _finished(curve, fit, poisson_ratio, segment)


class _Jump(NamedTuple):
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
    ) -> _Jump | None:
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


class _Data(NamedTuple):
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
    jump: _Jump | None
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
            _Jump.of(height, force, clock, is_jump & (np.arange(count) >= far)),
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
        self.scatter = np.ones(len(data.forces))
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

    @property
    def is_logarithm(self) -> np.ndarray:
        """Which numbers are logarithms."""
        return np.isin(np.arange(self.count), (0, 5, 6))

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the numbers in SI units, and no logarithms."""
        numbers = x * self.units
        return np.where(self.is_logarithm, np.exp(np.where(self.is_logarithm, numbers, 0)), numbers)

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the values by the numbers in their units."""
        return np.where(self.is_logarithm, self.values(x), 1.0)

    def with_scatter(self, scatter: np.ndarray) -> _Model:
        """Return the model with other variances of bins, over the variances by white noise."""
        other = copy(self)
        other.scatter = scatter
        return other

    @property
    def errors(self) -> np.ndarray:
        """The errors of bins [N]."""
        return self.data.errors * np.sqrt(self.scatter)

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
        return self._on_path(numbers, *self._path(numbers), heights, widths, clocks)

    def _on_path(
        self,
        numbers: np.ndarray,
        path: np.ndarray,
        force: np.ndarray,
        heights: np.ndarray,
        widths: np.ndarray,
        clocks: np.ndarray,
    ) -> np.ndarray:
        below = heights - numbers[4] * clocks
        found = _means(path, force, below - widths / 2, below + widths / 2)
        middle = self.data.heights.mean()
        return found + numbers[2] + numbers[3] * (heights - middle)

    def _path(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ascending heights of the far end and forces on the way of the measurement."""
        branch = self.branch(numbers)
        path = numbers[1] - branch.indentation - branch.force / self.data.stiffness
        force = branch.force
        # The state jumps at a limit of the height.
        if self.data.is_approach:
            path, force = np.minimum.accumulate(path)[::-1], force[::-1]
        else:
            path, force = np.maximum.accumulate(path[::-1]), force[::-1]
        return np.append(path, path[-1]), np.append(force, 0.0)

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return the misfit of bins, of the drift and of the height of a jump over their errors.

        A jump at another height changes the forces of bins there by all of it, or not at all, which
        tells a search nothing: its height is compared itself.
        """
        numbers = x * self.units
        return self._compared(numbers, *self._path(numbers))

    def _compared(self, numbers: np.ndarray, path: np.ndarray, force: np.ndarray) -> np.ndarray:
        data = self.data
        found = self._on_path(numbers, path, force, data.heights, data.widths, data.clocks)
        residuals = np.append((found - data.forces) / self.errors, numbers[4] / self.units[4])
        if data.jump is None or not self.is_sticky:
            return residuals
        # The outermost height at which the model has the force of the jump.
        level = max(data.jump.force, force.min() / 2)
        height = path[-1]
        below = np.flatnonzero(force < level)
        if below.size:
            pair = slice(below[-1], below[-1] + 2)
            height = np.interp(level, force[pair], path[pair])
        height += numbers[4] * data.jump.clock
        error = data.jump.error * np.sqrt(self.scatter.max())
        return np.append(residuals, (height - data.jump.height) / error)

    def jacobian(self, x: np.ndarray, free: slice | np.ndarray = _ALL) -> np.ndarray:
        """Return the derivatives of the residuals, by differences where they are not straight."""
        data = self.data
        numbers = x * self.units
        path, force = self._path(numbers)
        start = self._compared(numbers, path, force)
        columns = np.zeros((len(start), self.count))
        bins = slice(len(data.forces))
        # The contact point moves the path, the drift by the part that has passed of the time.
        shift = _DIFFERENCE * self.units[1]
        columns[:, 1] = (self._compared(numbers, path + shift, force) - start) / _DIFFERENCE
        columns[bins, 2] = self.units[2] / self.errors
        columns[bins, 3] = self.units[3] * (data.heights - data.heights.mean()) / self.errors
        clocks = np.append(data.clocks, [0.0, data.jump.clock if data.jump else 0.0])
        columns[:, 4] = columns[:, 1] * clocks[: len(start)] * self.units[4] / self.units[1]
        columns[len(data.forces), 4] = 1.0
        for number in {*np.arange(self.count)[free].tolist()} & {0, 5, 6}:
            moved = x.copy()
            moved[number] += _DIFFERENCE
            columns[:, number] = (self.residuals(moved) - start) / _DIFFERENCE
        return columns

    def variances(self, x: np.ndarray, free: slice | np.ndarray = _ALL) -> np.ndarray:
        """Return the variances of free numbers, zero of the others.

        A jump is at one height: the bins beside it, whose forces it changes in steps, tell nothing
        by their derivatives.
        """
        data = self.data
        jacobian = self.jacobian(x, free)[:, free]
        beside = np.convolve(data.has_jump, np.ones(3), "same") > 0
        jacobian[: len(beside)][beside] = 0.0
        variances = np.zeros(self.count)
        variances[free] = np.diag(_inverse(jacobian))
        return variances

    def fit(
        self,
        x: np.ndarray,
        free: slice | np.ndarray,
        most: int,
        ranges: tuple[float, float] | None = None,
    ) -> OptimizeResult:
        """Return the least squares over free numbers, modulus and work being right in order."""
        data = self.data
        lowest, highest = np.full(self.count, -np.inf), np.full(self.count, np.inf)
        mechanics = [0, 5] if self.is_sticky else [0]
        lowest[mechanics] = x[mechanics] - np.log(_FAR_OFF)
        highest[mechanics] = x[mechanics] + np.log(_FAR_OFF)
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

    # Rounding of areas blurs the mean over a narrower interval.
    wide = np.maximum(high - low, _NARROWEST * np.ptp(path))
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
    """Whether the mean force over some points in contact is negative beyond its error."""
    is_far = ~data.is_near[data.group]
    for size in _BLOCKS:
        if is_far.sum() < _FEWEST_BLOCKS * size or (~is_far).sum() < size:
            break
        far, near = (
            np.convolve(data.force[part], np.full(size, 1 / size), "valid")
            for part in (is_far, ~is_far)
        )
        if near.min() < -_ATTRACTION * np.std(far):
            return True
    return False


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


class _Fit(NamedTuple):
    """A fit of the numbers of a model.

    Attributes:
        model: with the errors of bins that the fit shows.
        found: the numbers.
        errors: of the numbers in SI units, not of logarithms.
    """

    model: _Model
    found: OptimizeResult
    errors: np.ndarray

    @classmethod
    def straight(cls, model: _Model, found: OptimizeResult) -> _Fit:
        """Return the fit with the errors of a model that is straight near it."""
        errors = np.sqrt(model.variances(found.x)) * model.units
        return cls(model, found, errors * model.slopes(found.x))


def _better(bare: _Fit, sticky: _Fit) -> _Fit:
    """Return the fit with adhesion if the curve needs it, otherwise the fit without.

    Adhesion that does not show still moves modulus and contact point, by as much as the fits
    differ.
    """
    other = bare.model.with_scatter(sticky.model.scatter).fit(bare.found.x, _ALL, _LAST)
    if 2 * (other.cost - sticky.found.cost) > _GAIN:
        return sticky
    moved = sticky.model.values(sticky.found.x)[: bare.model.count]
    moved = moved - bare.model.values(bare.found.x)
    return _Fit(bare.model, bare.found, np.hypot(bare.errors, moved))


def _without_adhesion(data: _Data, tip: Tip | FlatPunch) -> _Fit:
    """Return the fit without adhesion, with the errors of bins that it shows."""
    model = _Model(data, tip, False)
    modulus, contact = _start(data, tip, 0.0)
    start = np.array([np.log(modulus), contact, 0.0, 0.0, 0.0]) / model.units
    return _Fit.straight(*_weighted(model, model.fit(start, _MECHANICS, _LAST)))


def _weighted(
    model: _Model, found: OptimizeResult, ranges: tuple[float, float] | None = None
) -> tuple[_Model, OptimizeResult]:
    """Return fits of all numbers with the errors of bins that the fits before show."""
    for _ in range(_WEIGHINGS):
        model = model.with_scatter(_scatter(model, found))
        found = model.fit(found.x, _ALL, _LAST, ranges)
    return model, found


def _with_adhesion(data: _Data, tip: Tip | FlatPunch) -> _Fit:
    """Return the best of the fits at all ranges, with the errors that these show."""
    model = _Model(data, tip, True)
    attraction = -float(data.forces[data.is_near].min())
    modulus, contact = _start(data, tip, attraction)
    zeros = [contact, 0.0, 0.0, 0.0]
    if isinstance(tip, FlatPunch):
        work = attraction**2 / (8 * np.pi * modulus * tip.radius**3)
        start = np.array([np.log(modulus), *zeros, np.log(work)])
        return _Fit.straight(*_weighted(model, model.fit(start / model.units, _ALL, _LAST)))
    # The curvature of the tip where it takes as much force as the attraction.
    branch = dugdale.without_adhesion(tip, modulus, float(np.ptp(data.tips)), 0.0)
    depth = np.interp(attraction, branch.force, branch.indentation)
    radii = np.geomspace(1e-12, min(1.0, 0.99 * tip.largest_radius), 600)
    radius = np.interp(depth, tip.penetration(radii), radii) ** 2 / depth
    work = attraction / (_PULL_OFF * np.pi * radius)
    length = (work / modulus) ** (2 / 3) * radius ** (1 / 3)
    lowest = max(_RANGES[0] * length, _ATOM)
    ranges = lowest, max(_RANGES[1] * length, 2 * lowest)
    lengths = np.linspace(np.log(ranges[0]), np.log(ranges[1]), _TRIED)
    numbers = [np.log(modulus), *zeros, np.log(work)]
    found = [
        model.fit(np.append(numbers, start) / model.units, _ALL, _FIRST, ranges)
        for start in lengths[:: _TRIED // _STARTS]
    ]
    best = min(found, key=lambda one: one.cost)
    # Errors of bins would hide a fit that has not ended.
    model, best = _weighted(model, model.fit(best.x, _ALL, _LAST, ranges), ranges)
    profile = _profiles(model, best, lengths, ranges)
    # There may be other minima, of other works and moduli at the same range.
    profile += [
        model.fit(one.x, _ALL, _FIRST, ranges)
        for one in found
        if one.cost < min(other.cost for other in found) + _MUCH_WORSE
    ]
    least = min(profile, key=lambda one: one.cost)
    if least.cost < best.cost - _BETTER:
        model, best = _weighted(model, model.fit(least.x, _ALL, _LAST, ranges), ranges)
        minima = [model.fit(one.x, _ALL, _FIRST, ranges) for one in profile]
        profile = _profiles(model, best, lengths, ranges) + minima
    return _with_errors(model, best, profile, ranges)


def _profiles(
    model: _Model, best: OptimizeResult, lengths: np.ndarray, ranges: tuple[float, float]
) -> list[OptimizeResult]:
    """Return the fits of all other numbers at ranges, and at works."""
    works = best.x[_WORK] + _WORKS
    return [
        *_profile(model, best, model.count - 1, lengths, ranges),
        *_profile(model, best, _WORK, works, ranges),
    ]


def _profile(
    model: _Model,
    best: OptimizeResult,
    number: int,
    values: np.ndarray,
    ranges: tuple[float, float],
) -> list[OptimizeResult]:
    """Return the fits of all others at values of a number, from the best one outwards.

    On either side it ends where a fit is much worse.
    """
    found = []
    others = np.delete(np.arange(model.count), number)
    for side in (values[values > best.x[number]], values[values <= best.x[number]][::-1]):
        x = best.x
        for value in side:
            start = x.copy()
            start[number] = value
            fit = model.fit(start, others, _FIRST, ranges)
            found.append(fit)
            x = fit.x
            if fit.cost > best.cost + _MUCH_WORSE:
                break
    return found


def _with_errors(
    model: _Model,
    best: OptimizeResult,
    profile: list[OptimizeResult],
    ranges: tuple[float, float],
) -> _Fit:
    """Return a fit with its errors, by fits at other ranges and works, and from other starts.

    The misfit is no parabola over the range: one that is short beside the deformation hardly
    changes the curve. Errors reach to the farther side of the joint regions of work and range, or
    as far as derivatives tell.
    """
    step = min(float(np.sqrt(model.variances(best.x)[-1])), 1.0)
    middle = best.x[-1]
    first = best.cost
    growths = [growth for _, growth in _ERRORS]
    for away in (*growths, *(-growth for growth in growths)):
        length = np.clip(middle + away * step, *np.log(ranges))
        found = model.fit(np.append(best.x[:-1], length), _BUT_RANGE, _FIRST)
        profile = [*profile, found]
        if found.cost < best.cost:
            best = OptimizeResult(best, x=found.x, cost=found.cost)
    if best.cost > first - _BETTER:
        # A narrow valley may take more steps than there are, and has been followed.
        best = OptimizeResult(best, status=1)
    profile = sorted([*profile, best], key=lambda one: one.x[-1])
    # The distance in standard errors.
    away = np.array([np.sqrt(2 * max(one.cost - best.cost, 0.0)) for one in profile])
    value = model.values(best.x)
    along = []
    for errors, growth in _ERRORS:
        inside = np.flatnonzero(away <= growth)
        along += [np.abs(model.values(profile[one].x) - value) / errors for one in inside]
        for last, beyond in ((inside[0], inside[0] - 1), (inside[-1], inside[-1] + 1)):
            side = profile[last].x
            if 0 <= beyond < len(profile):
                part = (growth - away[last]) / (away[beyond] - away[last])
                side = side + part * (profile[beyond].x - side)
            along.append(np.abs(model.values(side) - value) / errors)
    slopes = model.units * model.slopes(best.x)
    # Far from the fit derivatives tell nothing of logarithms.
    most = np.where(model.is_logarithm, 1.0, np.inf)
    straight, across = (
        np.minimum(np.sqrt(model.variances(best.x, free)), most) * slopes
        for free in (_ALL, _BUT_RANGE)
    )
    return _Fit(model, best, np.maximum(straight, np.hypot(across, np.max(along, axis=0))))


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


def _rms(values: np.ndarray) -> float:
    """Return the root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else np.nan


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
    fit: _Fit,
    poisson_ratio: float,
    segment: Part,
) -> ForceCurveFit:
    model, found, errors = fit
    data = model.data
    values = model.values(found.x)
    per_plane = 1 - poisson_ratio**2
    work, work_error = 0.0, np.nan
    if model.is_sticky:
        work, work_error = float(values[5]), float(errors[5])
    length = length_error = np.nan
    if model.count == 7:
        length, length_error = float(values[6]), float(errors[6])
    points = getattr(curve.in_units("m", "N"), segment)
    forces = model.forces(found.x, data.height, np.zeros(len(data.height)), data.clock)
    if points.height[points.is_present][0] < points.height[points.is_present][-1]:
        forces = forces[::-1]
    fitted = np.full(len(points), np.nan)
    fitted[points.is_present] = forces
    own = js.lab.force_curves.ForceCurve(js.lab.force_curves.Segment(fitted, points.height), None)
    own = own.in_units(curve.unit, curve.force_unit).approach
    assert own is not None
    misfit = _misfit(model, found.x)
    is_inside = data.height + data.force / data.stiffness < values[1]
    rms = _rms(misfit[is_inside])
    # On a stiff sample the force is hardly more than that on a rigid one, which tells nothing.
    bending = data.force.max() / data.stiffness
    depth = float(values[1] - data.tips.min())
    told = float(data.force.max()) * depth / (depth + bending)
    is_described = rms <= max(_MISFIT * data.noise, _OF_FORCE * told)
    if model.is_sticky:
        outside = _rms(misfit[data.is_near[data.group] & ~is_inside])
        attraction = -float(np.min(forces))
        is_described &= not outside > max(_MISFIT * data.noise, _OF_ATTRACTION * attraction)
        rms = float(np.fmax(rms, outside))
    result = js.RESULTS.successful
    if found.status == 0:
        result = js.RESULTS.max_steps_reached
    elif not is_described:
        result = js.RESULTS.misfit
    finished = ForceCurveFit(
        youngs_modulus=float(values[0]) * per_plane,
        work_of_adhesion=work,
        range=length,
        contact_point=float(values[1]),
        errors=FitErrors(
            youngs_modulus=float(errors[0]) * per_plane,
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
        warnings.warn(f"{finished.status}: {numbers}.", js.exceptions.FitWarning, stacklevel=3)
    return finished


def _inverse(jacobian: np.ndarray) -> np.ndarray:
    """Return the inverse of J^T J, of columns that may have any size."""
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1.0
    scaled = jacobian / size
    return np.linalg.pinv(scaled.T @ scaled) / np.outer(size, size)

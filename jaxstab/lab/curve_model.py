"""Forces of a tip on a cantilever over the height, with their derivatives and least squares."""

from __future__ import annotations

from copy import copy

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from jaxstab.lab import dugdale
from jaxstab.lab.curve_bins import Bins
from jaxstab.lab.tips import FlatPunch, Tip

# The steps of finite differences; evaluations of a first and of a last fit.
_DIFFERENCE = 3e-4
FIRST, LAST = 30, 60
# Modulus and work are within this factor of the start, and a contact point this part of the travel
# above the deepest point.
_FAR_OFF = 100.0
_NEXT_TO = 1e-3
# The error of a drift of which nothing is known, as a part of the depth.
_NO_DRIFT = 1e-6
# A sum of squares is right within this part, as a first and as a last one.
_ROUGH, _FINE = 1e-4, 1e-9
# A start is inside of its bounds by this much.
_INNER = 1e-9
# The narrowest interval of a mean, over the length of the path.
_NARROWEST = 1e-5
# Which numbers are fitted: all, all but the range, and modulus and contact point.
ALL, BUT_RANGE, MECHANICS = slice(None), slice(-1), slice(2)


class CurveModel:
    """Forces over heights as a function of numbers, of the order of one.

    The numbers are ln E*, contact point, baseline, tilt, drift, and with adhesion ln w and, but for
    a punch, ln h.
    """

    def __init__(self, data: Bins, tip: Tip | FlatPunch, is_sticky: bool):
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

    def with_scatter(self, scatter: np.ndarray) -> CurveModel:
        """Return the model with other variances of bins, over the variances by white noise."""
        other = copy(self)
        other.scatter = scatter
        return other

    @property
    def errors(self) -> np.ndarray:
        """The errors of bins [N]."""
        return self.data.errors * np.sqrt(self.scatter)

    def branch(self, numbers: np.ndarray) -> dugdale.TipEquilibria:
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
        return self._residuals_on_path(numbers, *self._path(numbers))

    def _residuals_on_path(
        self, numbers: np.ndarray, path: np.ndarray, force: np.ndarray
    ) -> np.ndarray:
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

    def jacobian(self, x: np.ndarray, free: slice | np.ndarray = ALL) -> np.ndarray:
        """Return the derivatives of the residuals, by differences where they are not straight."""
        data = self.data
        numbers = x * self.units
        path, force = self._path(numbers)
        start = self._residuals_on_path(numbers, path, force)
        columns = np.zeros((len(start), self.count))
        bins = slice(len(data.forces))
        # The contact point moves the path, the drift by the part that has passed of the time.
        shift = _DIFFERENCE * self.units[1]
        columns[:, 1] = (
            self._residuals_on_path(numbers, path + shift, force) - start
        ) / _DIFFERENCE
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

    def variances(self, x: np.ndarray, free: slice | np.ndarray = ALL) -> np.ndarray:
        """Return the variances of free numbers, zero of the others.

        A jump is at one height: the bins beside it, whose forces it changes in steps, tell nothing
        by their derivatives.
        """
        data = self.data
        jacobian = self.jacobian(x, free)[:, free]
        beside = np.convolve(data.has_jump, np.ones(3), "same") > 0
        jacobian[: len(beside)][beside] = 0.0
        variances = np.zeros(self.count)
        variances[free] = np.diag(inverse(jacobian))
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
            ftol=_ROUGH if most == FIRST else _FINE,
        )
        found.x = whole(found.x)
        return found

    def misfit(self, x: np.ndarray) -> np.ndarray:
        """Return the deviation of each point, without points of bins with a jump."""
        data = self.data
        found = self.forces(x, data.height, np.zeros(len(data.height)), data.clock)
        return np.where(data.has_jump[data.group], 0.0, data.force - found)


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


def inverse(jacobian: np.ndarray) -> np.ndarray:
    """Return the inverse of J^T J, of columns that may have any size."""
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1.0
    scaled = jacobian / size
    return np.linalg.pinv(scaled.T @ scaled) / np.outer(size, size)

"""The contact point of an approach by published methods, beside that of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

import jaxstab as js
from jaxstab.lab.figures import axes_or_new
from jaxstab.lab.fit import ForceCurveFit, own_units, write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A force deviates from the baseline if it exceeds its noise so many times.
_DEVIATION = 5.0
# Variances are of windows of this part of the points, and of so many points at least.
_WINDOW, _FEWEST = 0.02, 20
# The noise in a window is this part of that of the baseline at least.
_LEAST = 0.3
# The start of a fit: the slope of a line, or the roots of the numbers of the polynomial, where
# lengths and forces are parts of the whole curve; and its evaluations.
_LINE, _POLYNOMIAL, _MOST = [1.0], [0.3, 0.3, 0.1], 500
# A figure shows this part of the depth beyond the contact points; the depth is no less than the
# other part of the approach.
_BESIDE, _NARROWEST = 0.3, 0.02


@dataclass(frozen=True, eq=False, repr=False)
class ContactPoints:
    """The contact point of one approach by several methods.

    Attributes:
        points: the tip position at contact by the name of each method, NaN for one that finds
            none, from the zero of `curve` [m].
        curve: the corrected curve, in its own units.

    Example:
        >>> len(js.lab.contact_points(curve).points)
        4
    """

    points: Mapping[str, float]
    curve: js.lab.force_curves.ForceCurve

    @property
    def scatter(self) -> float:
        """The standard deviation of the contact points: an error that no method shows [m].

        It is NaN if fewer than two methods find a point.
        """
        found = np.array([*self._finite_points.values()])
        return float(np.std(found, ddof=1)) if found.size > 1 else np.nan

    @property
    def _finite_points(self) -> dict[str, float]:
        return {name: point for name, point in self.points.items() if np.isfinite(point)}

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the approach near the contact, with each contact point.

        If no method finds a point the whole approach is drawn.

        Arguments:
            axes: the axes to draw on; new ones by default.
        """
        axes = axes_or_new(axes)
        curve = self.curve.readable
        approach = curve.approach
        assert approach is not None
        length = own_units(curve)[0]
        tips, forces = (x[approach.is_present] for x in (approach.tip_position, approach.force))
        axes.plot(tips, forces, ".", color="0.7", markersize=3)
        axes.set_xlabel(f"tip position [{curve.unit}]")
        axes.set_ylabel(f"force [{curve.force_unit}]")
        found = {name: x * length for name, x in self._finite_points.items()}
        if not found:
            axes.set_title("no contact point found")
            return axes
        for number, (name, point) in enumerate(found.items()):
            axes.axvline(point, color=f"C{number}", label=name.replace("_", " "))
        first, last = min(found.values()), max(found.values())
        # Points all at the deepest place would leave a figure of no width.
        beside = _BESIDE * max(last - tips.min(), _NARROWEST * np.ptp(tips))
        axes.set_xlim(first - beside, last + beside)
        shown = forces[(tips > first - beside) & (tips < last + beside)]
        if shown.size:
            margin = 0.1 * np.ptp(shown)
            axes.set_ylim(shown.min() - margin, shown.max() + margin)
        axes.legend(frameon=False)
        return axes

    def to_csv(self, path: str | Path) -> Path:
        """Write the contact point of each method as text in UTF-8, and return its path.

        Arguments:
            path: the file; it must not exist yet.

        Raises:
            FileExistsError: if the file exists.
        """
        comments = [
            ("contact points", "tip positions from the zero of the corrected curve"),
            ("source", self.curve.source),
            ("scatter", f"{self.scatter:.9g} m"),
        ]
        columns = {
            "method": [*self.points],
            "contact point [m]": [*self.points.values()],
        }
        return write_table(path, comments, columns)

    def __repr__(self) -> str:
        curve = self.curve.readable
        unit, length = curve.unit, own_units(curve)[0]
        rows = {name.replace("_", " "): x * length for name, x in self.points.items()}
        rows["scatter"] = self.scatter * length
        width = max(map(len, rows))
        lines = [
            f"  {name:<{width}}  " + ("none" if np.isnan(value) else f"{value:10.4g} {unit}")
            for name, value in rows.items()
        ]
        return "\n".join([type(self).__name__, *lines])


def contact_points(
    curve: js.lab.force_curves.ForceCurve, fit: ForceCurveFit | None = None
) -> ContactPoints:
    """Return the contact point of an approach by four published methods, and by a fit.

    - `deviation_from_baseline`: the first point from the far end on whose force exceeds the
      baseline by five times the noise.
    - `ratio_of_variances`: where the variance of the next points over the variance of as many
      points before is largest (N. Gavara, Sci. Rep. 6, 21267 (2016)).
    - `line_and_line`: the kink of the least squares fit of two lines, F = F_0 + m (h - z) +
      s max(z - h, 0) over the height h.
    - `line_and_polynomial`: with x = max(z - h, 0) the z of the fit of F = F_0 + m (h - z) +
      x^3 / (a x^2 + b x + c), as in the package nanite.

    They need no model of the contact, and no tip. Where an attraction acts before contact they find
    its beginning or its end, and no point at which undeformed surfaces would touch.

    Arguments:
        curve: the curve, with a spring constant; one that is not corrected is.
        fit: a fit of the approach of this curve, whose contact point is added as `fit`.

    Raises:
        ValueError: without an approach or a spring constant, for a curve that cannot be corrected,
            and for a fit to another curve or to the retraction.
        TypeError: for something that is no force curve.

    Example:
        >>> points = js.lab.contact_points(curve)
        >>> sorted(points.points)
        ['deviation_from_baseline', 'line_and_line', 'line_and_polynomial', 'ratio_of_variances']
    """
    if not isinstance(curve, js.lab.force_curves.ForceCurve):
        raise TypeError(f"The curve is a {type(curve).__name__}: give one ForceCurve.")
    if curve.approach is None:
        raise ValueError("The curve has no approach: contact points are those of an approach.")
    if curve.correction is None:
        curve = curve.corrected()
    assert curve.approach is not None and curve.correction is not None
    if fit is not None and not _is_of(fit, curve):
        raise ValueError("The fit is not one of the approach of this curve: give `fit.curve`.")
    in_metres = curve.in_units("m", "N")
    approach, correction = in_metres.approach, in_metres.correction
    assert approach is not None and correction is not None and correction.approach is not None
    tips = approach.tip_position[approach.is_present]
    heights, forces = approach.height[approach.is_present], approach.force[approach.is_present]
    if heights[0] < heights[-1]:
        tips, heights, forces = tips[::-1], heights[::-1], forces[::-1]
    noise = correction.approach.noise
    points = {
        "deviation_from_baseline": _deviation(tips, forces, noise),
        "ratio_of_variances": _ratio_of_variances(tips, forces, noise),
        # No force acts at the contact, so that its height is its tip position.
        "line_and_line": _kink(heights, forces, noise, False),
        "line_and_polynomial": _kink(heights, forces, noise, True),
    }
    if fit is not None:
        points["fit"] = fit.contact_point
    return ContactPoints(points, curve)


def _is_of(fit: ForceCurveFit, curve: js.lab.force_curves.ForceCurve) -> bool:
    """Return whether a fit is one of the approach of a corrected curve."""
    approach = curve.in_units(fit.curve.unit, fit.curve.force_unit).approach
    assert approach is not None
    return fit.segment == "approach" and np.allclose(
        fit.points.height, approach.height, equal_nan=True
    )


def _deviation(tips: np.ndarray, forces: np.ndarray, noise: float) -> float:
    """Return the first tip position with a force beyond the noise."""
    is_force = forces > _DEVIATION * noise
    return float(tips[np.argmax(is_force)]) if is_force.any() else np.nan


def _ratio_of_variances(tips: np.ndarray, forces: np.ndarray, noise: float) -> float:
    """Return where the variance of a window over that of the window before is largest."""
    window = max(int(_WINDOW * len(forces)), _FEWEST)
    if len(forces) < 2 * window + 1:
        return np.nan
    variances = np.var(np.lib.stride_tricks.sliding_window_view(forces, window), axis=1)
    # Digitised forces may all be equal.
    before = np.maximum(variances[: -window - 1], (_LEAST * noise) ** 2)
    return float(tips[window + np.argmax(variances[window + 1 :] / before)])


def _kink(heights: np.ndarray, forces: np.ndarray, noise: float, is_polynomial: bool) -> float:
    """Return the height at which a line goes over into a steeper line, or into a polynomial.

    The numbers are contact point, baseline and tilt, and the slope, or the roots of a, b and c,
    which are positive so that the force rises.
    """
    begin = heights[np.argmin(np.abs(forces - forces.max() / 10))]
    length, force = float(np.ptp(heights)), float(forces.max())

    def residuals(numbers: np.ndarray) -> np.ndarray:
        depth = np.maximum(numbers[0] - heights / length, 0.0)
        found = numbers[1] + numbers[2] * (heights / length - numbers[0])
        if is_polynomial:
            a, b, c = numbers[3:] ** 2
            found += depth**3 / (a * depth**2 + b * depth + c + np.finfo(float).tiny)
        else:
            found += numbers[3] * depth
        return (found - forces / force) * force / noise

    start = [begin / length, 0.0, 0.0, *(_POLYNOMIAL if is_polynomial else _LINE)]
    found = least_squares(residuals, start, x_scale="jac", max_nfev=_MOST)
    return float(found.x[0]) * length if found.success else np.nan

"""The fit of a force curve in time, of a viscoelastic sample on rings."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np
from scipy.optimize import OptimizeResult, least_squares

import jaxstab as js
from jaxstab.lab import dugdale
from jaxstab.lab.curve_model import inverse
from jaxstab.lab.curve_search import correlated_variance
from jaxstab.lab.figures import axes_or_new
from jaxstab.lab.fit import write_table
from jaxstab.lab.fit_curve import fit_curve
from jaxstab.lab.force_curves.correction import clocks_of
from jaxstab.lab.tips import ElasticTip, Tip, paraboloid_radius

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Means over so many steps of the time in each segment, near contact and where no force acts.
_NEAR, _FAR = 40, 5
# Starts: times over the duration of the approach, and ratios of the moduli.
_TIMES, _RATIOS = np.array([0.1, 0.5, 2.0]), np.array([0.5, 2.0])
# Times, ratios, modulus and work are within these factors of the start.
_FAR_OFF = 1e3
# Steps of finite differences of logarithms; a sum of squares is right within this part.
_STEP, _EXACT = 0.01, 1e-4
# The fewest points of a mean; the forces of one scatter by this part of the variance of the noise.
_FEWEST, _JUMP = 3, 4.0
# The place of the work among the numbers, and how near a contact comes to the edge of a tip.
_STICKY, _NEXT_TO = 6, 1e-6
# Evaluations of the first fit, and of the second one on rings that are chosen anew.
_FIRST, _LAST = 40, 20
# Rings are chosen anew if their radius has moved by this part.
_MOVED = 0.15
# The least range of the law, as a part of the first guess: a shorter one takes more rings.
_SHORTEST = 0.3
# The model does not describe a curve whose misfit is so many times the noise of the means, and this
# part of the largest force.
_MISFIT, _OF_FORCE = 3.0, 0.01
_SYMBOLS = {
    "relaxed_modulus": "Pa",
    "instantaneous_modulus": "Pa",
    "ratio": "1",
    "time": "s",
    "work_of_adhesion": "J/m²",
    "range": "m",
    "contact_point": "m",
}


@dataclass(frozen=True)
class ViscoelasticErrors:
    """Standard errors of a fit in time, by the names of its numbers; NaN where nothing is known.

    Attributes:
        relaxed_modulus, instantaneous_modulus: of the moduli [Pa].
        ratio: of their difference over the relaxed one.
        time: of the relaxation time [s].
        work_of_adhesion: of w [J/m^2].
        range: of the range of the law [m].
        contact_point: of the contact point [m].
    """

    relaxed_modulus: float
    instantaneous_modulus: float
    ratio: float
    time: float
    work_of_adhesion: float
    range: float
    contact_point: float


@dataclass(frozen=True, eq=False, repr=False)
class ViscoelasticFit:
    """The fit of approach, pauses and retraction by a standard linear solid, in SI units.

    Attributes:
        relaxed_modulus: E at long times [Pa].
        instantaneous_modulus: E at once, relaxed_modulus (1 + ratio) [Pa].
        ratio: r in E(t) = E (1 + r exp(-t / time)).
        time: the relaxation time [s].
        work_of_adhesion: w, zero for a curve without attraction [J/m^2].
        range: of the exponential law -w exp(-g / range), NaN without adhesion [m].
        contact_point: the tip position at which the undeformed surfaces would touch, from the zero
            of `curve` [m].
        errors: standard errors by the same names.
        result: a member of `jaxstab.RESULTS`: `misfit` if the model does not describe the curve.
        misfit: the rms deviation of means of the force from the model [N].
        noise: the typical standard error of these means [N].
        curve: the corrected curve, in its own units.
        tip: the tip.
        poisson_ratio: nu.
        times: of each mean [s].
        measured: the mean forces at these times [N].
        forces: the fitted ones [N].
    """

    relaxed_modulus: float
    instantaneous_modulus: float
    ratio: float
    time: float
    work_of_adhesion: float
    range: float
    contact_point: float
    errors: ViscoelasticErrors
    result: js.RESULTS
    misfit: float
    noise: float
    curve: js.lab.force_curves.ForceCurve
    tip: Tip
    poisson_ratio: float
    times: np.ndarray
    measured: np.ndarray
    forces: np.ndarray

    @property
    def status(self) -> str:
        """The result as a sentence, with its cause and cure."""
        return str(js.RESULTS[self.result])

    def to_csv(self, path: str | Path) -> Path:
        """Write numbers, errors, measured and fitted forces as text in UTF-8; return its path.

        Arguments:
            path: the file; it must not exist yet.

        Raises:
            FileExistsError: if the file exists.
        """
        comments = [
            ("fit of a force curve in time", self.result.name),
            ("source", self.curve.source),
            ("tip", str(self.tip)),
            ("poisson ratio", f"{self.poisson_ratio:.6g}"),
        ]
        for name, symbol in _SYMBOLS.items():
            value, error = getattr(self, name), getattr(self.errors, name)
            comments.append((name, f"{value:.9g} {symbol}, standard error {error:.3g} {symbol}"))
        columns = {
            "time [s]": self.times,
            "force [N]": self.measured,
            "fitted force [N]": self.forces,
        }
        return write_table(path, comments, columns)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the measured and the fitted forces over the time.

        Arguments:
            axes: the axes to draw on; new ones by default.
        """
        axes = axes_or_new(axes)
        by, unit = js.units.prefixed(float(np.max(np.abs(self.measured))), "N")
        axes.plot(self.times, self.measured / by, ".", color="0.6", label="measured")
        axes.plot(self.times, self.forces / by, color="black", linewidth=1, label="fit")
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"force [{unit}]")
        axes.legend(frameon=False)
        return axes

    def __repr__(self) -> str:
        return "\n".join([*self._rows()])

    def _rows(self) -> Iterator[str]:
        times = f"{self.misfit / self.noise:.2g} times the noise of the means"
        yield f"ViscoelasticFit: {self.result.name}, {self.tip}, misfit {times}"
        for name, symbol in _SYMBOLS.items():
            value, error = getattr(self, name), getattr(self.errors, name)
            by, unit = 1.0, ""
            if symbol != "1":
                by, unit = js.units.prefixed(np.nanmax([abs(value), error, 0.0]), symbol)
            numbers = "-" if np.isnan(value) else f"{value / by:.5g} ± {error / by:.2g} {unit}"
            yield f"  {name:<21}  {numbers}".rstrip()


def fit_viscoelastic(
    curve: js.lab.force_curves.ForceCurve, tip: Tip, poisson_ratio: float = 0.5
) -> ViscoelasticFit:
    """Fit a standard linear solid to approach, pauses and retraction at their measured times.

    The model is the contact of a rigid tip with a viscoelastic half space on `Rings`, whose stress
    relaxes as E(t) = E (1 + r exp(-t / T)), on the cantilever that has measured the curve: the
    history that `jaxstab.evolve` returns for the measured heights. Forces are fitted by least
    squares, with the contact point, the rest of the baseline and, for a curve that shows an
    attraction, an exponential law. Relaxation times far beyond the duration of the curve, or below
    the time of a few points, are not told by it, as their errors show.

    What `ForceCurve.corrected` removes as a drift is given back: the sample may have caused it.

    Arguments:
        curve: the curve, with times and a spring constant; one that is not corrected is.
        tip: a `Sphere`, `Paraboloid`, `Cone` or `Pyramid`.
        poisson_ratio: nu of the sample, the same at all times.

    Raises:
        ValueError: for a curve without times or approach, and as `fit_curve` does.
        TypeError: for something that is no force curve or no such tip.

    Warns:
        FitWarning: if the result is not `successful`; the message has the reason.
    """
    if not isinstance(tip, Tip) or isinstance(tip, ElasticTip):
        raise TypeError(f"The tip is {tip!r}: give a rigid Sphere, Paraboloid, Cone or Pyramid.")
    if jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        raise ValueError(
            "Single precision leaves no derivatives for this fit: first of all, call "
            'jax.config.update("jax_enable_x64", True).'
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", js.exceptions.FitWarning)
        elastic = fit_curve(curve, tip, poisson_ratio)
        sticky = elastic
        if elastic.curve.retraction is not None:
            sticky = fit_curve(elastic.curve, tip, poisson_ratio, "retraction")
    lacking = [name for name, part in elastic.curve.segments.items() if part.time is None]
    if lacking:
        raise ValueError(
            f"The {lacking[0]} has no times, without which no relaxation is told: read a file that "
            "holds them, or fit an elastic sample by fit_curve."
        )
    history = _History.of(elastic.curve.in_units("m", "N"))
    start = [np.log(elastic.youngs_modulus), 0.0, 0.0, elastic.contact_point / history.depth]
    start += [0.0, 0.0]
    if sticky.work_of_adhesion > 0:
        # Ranges of Dugdale's and of the exponential law are alike in the pressure that they make.
        shortest = _SHORTEST * sticky.work_of_adhesion ** (2 / 3)
        shortest *= paraboloid_radius(tip, history.depth) ** (1 / 3)
        shortest /= (elastic.youngs_modulus / (1 - poisson_ratio**2)) ** (2 / 3)
        start += [
            np.log(sticky.work_of_adhesion),
            np.log(max(np.nan_to_num(sticky.range), 2 * shortest)),
        ]
    model = _Model.at(history, tip, poisson_ratio, np.array(start))
    tried = []
    for time in _TIMES * history.duration:
        for ratio in _RATIOS:
            # The modulus of the approach is the one after about its duration.
            own = np.array(start)
            own[0] -= np.log(1 + ratio * np.exp(-history.duration / time / 2))
            own[1:3] = np.log(ratio), np.log(time)
            tried.append((float(np.sum(model.residuals(own) ** 2)), own))
    x = min(tried, key=lambda one: one[0])[1]
    found = model.fit(x, _FIRST)
    # The contact may be larger than that of the start.
    again = _Model.at(history, tip, poisson_ratio, found.x)
    if not np.isclose(float(again.rings.radius), float(model.rings.radius), rtol=_MOVED):
        model, found = again, again.fit(found.x, _LAST)
    return _finished(elastic.curve, model, found)


class _History(NamedTuple):
    """Means over steps of the time, in SI units, with the turns between segments.

    Attributes:
        times, heights: of means and turns.
        forces, errors: with infinite errors at turns.
        depth, force: the largest ones.
        duration: of the approach near contact.
        stiffness: of the cantilever.
    """

    times: np.ndarray
    heights: np.ndarray
    forces: np.ndarray
    errors: np.ndarray
    depth: float
    force: float
    duration: float
    stiffness: float

    @classmethod
    def of(cls, curve: js.lab.force_curves.ForceCurve) -> _History:
        """Return the history of a corrected curve in SI units."""
        correction = curve.correction
        assert correction is not None and correction.approach is not None
        assert curve.spring_constant is not None
        clocks = clocks_of(curve.segments)
        drift = 0.0
        if correction.removes_drift and correction.drift is not None:
            drift = correction.drift
        rows: list[tuple[float, float, float, float]] = []
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
                for piece in np.array_split(part, max(min(count, len(part) // _FEWEST), 1))
            ]
            noise = correction.approach.noise
            means = [_mean(time[one], height[one], force[one], noise) for one in pieces]
            ends = [
                (time[place], _line_at(time[one], height[one], time[place]), np.nan, np.inf)
                for one, place in ((pieces[0], 0), (pieces[-1], -1))
            ]
            rows += [ends[0], *means, ends[1]]
        columns = np.array(rows).T
        # A segment may begin at the time at which the one before has ended.
        is_later = np.append(True, np.diff(np.maximum.accumulate(columns[0])) > 0)
        times, heights, forces, errors = columns[:, is_later]
        tips = heights + np.nan_to_num(forces) / curve.spring_constant
        return cls(
            times,
            heights,
            forces,
            errors,
            float(-np.min(tips)),
            float(np.nanmax(forces)),
            duration,
            curve.spring_constant,
        )


def _mean(
    time: np.ndarray, height: np.ndarray, force: np.ndarray, noise: float
) -> tuple[float, float, float, float]:
    """Return the means over points, with the standard error of the force.

    Forces that scatter by more than the noise about a line are of a jump, which is at one place.
    """
    count = len(time)
    away = force - np.polyval(np.polyfit(time - time[0], force, 1), time - time[0])
    excess = max(float(np.mean(away**2)) - _JUMP * noise**2, 0.0)
    error = np.sqrt(noise**2 / count + excess)
    return float(time.mean()), float(height.mean()), float(force.mean()), float(error)


def _line_at(time: np.ndarray, height: np.ndarray, place: float) -> float:
    """Return the height of a line through points at a time."""
    return float(np.polyval(np.polyfit(time - place, height, 1), 0.0))


class _Model(NamedTuple):
    """Forces in time as a function of numbers of the order of one.

    The numbers are ln E, ln r, ln T, the contact point over the depth, baseline and tilt in units
    of the noise, and with adhesion ln w and the logarithm of the range.
    """

    history: _History
    tip: Tip
    poisson_ratio: float
    rings: js.Rings

    @classmethod
    def at(cls, history: _History, tip: Tip, poisson_ratio: float, x: np.ndarray) -> _Model:
        """Return the model on rings for the contact at some numbers."""
        modulus = np.exp(x[0]) / (1 - poisson_ratio**2)
        branch = dugdale.without_adhesion(tip, modulus, history.depth, 0.0)
        adhesion = {}
        if len(x) > _STICKY:
            work, length = np.exp(x[_STICKY:])
            adhesion = {"work_of_adhesion": float(work), "length": float(length)}
        rings = js.Rings.for_contact(
            lambda radii: -_shape(tip, radii), modulus, force=float(branch.force[-1]), **adhesion
        )
        return cls(history, tip, poisson_ratio, js.Rings(rings.num_points // 2, rings.radius))

    def forces(self, x: np.ndarray) -> np.ndarray:
        """Return the forces at all times, NaN if there is no equilibrium."""
        modulus, ratio, time = np.exp(x[:3])
        rings, history = self.rings, self.history
        law = js.potentials.NoAdhesion()
        if len(x) > _STICKY:
            law = js.potentials.Exponential(*np.exp(x[_STICKY:]))
        half_space = js.solids.AxisymmetricHalfSpace(rings, modulus, self.poisson_ratio)
        solid = js.Viscoelastic(half_space, np.array([ratio]), np.array([time]))
        contact = js.Contact(solid, -_shape(self.tip, np.asarray(rings.radii)), law)
        heights = history.heights - x[3] * history.depth
        load = js.Spring.cantilever(heights, history.stiffness, rings)
        with warnings.catch_warnings():
            # A warning of a trial on the way tells nothing of the end.
            warnings.simplefilter("ignore")
            evolution = js.evolve(contact, load, history.times, progress=False, throw=False)
        return np.asarray(evolution.force) + self._baseline(x)

    def _baseline(self, x: np.ndarray) -> np.ndarray:
        heights = self.history.heights
        away = (heights - heights.mean()) / np.ptp(heights)
        return (x[4] + x[5] * away) * self.noise

    @property
    def is_mean(self) -> np.ndarray:
        """Which times are those of means, and not turns."""
        return np.isfinite(self.history.errors)

    @property
    def noise(self) -> float:
        """The typical standard error of a mean [N]."""
        return float(np.median(self.history.errors[self.is_mean]))

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return the misfit of the means over their errors."""
        away = self.forces(x) - self.history.forces
        return (away / self.history.errors)[self.is_mean]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals by differences."""
        steps = np.array([_STEP, _STEP, _STEP, _STEP / 10, 1.0, 1.0, _STEP, _STEP])[: len(x)]
        start = self.residuals(x)
        columns = []
        for number, step in enumerate(steps):
            moved = x.copy()
            moved[number] += step
            if number in (4, 5):
                away = (self._baseline(moved) - self._baseline(x)) / self.history.errors
                columns.append(away[self.is_mean])
            else:
                columns.append((self.residuals(moved) - start) / step)
        return np.stack(columns, 1)

    def fit(self, x: np.ndarray, most: int) -> OptimizeResult:
        """Return the least squares over all numbers from a start."""
        far = np.array([*np.full(3, np.log(_FAR_OFF)), 1.0, np.inf, np.inf, *np.full(2, 7.0)])
        low, high = x - far[: len(x)], x + far[: len(x)]
        if len(x) > _STICKY:
            low[-1] = x[-1] + np.log(_SHORTEST)
        return least_squares(
            self.residuals,
            x,
            jac=self.jacobian,  # pyright: ignore[reportArgumentType]
            bounds=(low, high),
            x_scale="jac",
            max_nfev=most,
            ftol=_EXACT,
            xtol=_EXACT,
        )


def _shape(tip: Tip, radii: np.ndarray) -> np.ndarray:
    """Return how far a tip is above its apex, and beyond its largest radius as far as there."""
    return tip.shape(np.minimum(radii, (1 - _NEXT_TO) * tip.largest_radius))


def _finished(
    curve: js.lab.force_curves.ForceCurve, model: _Model, found: OptimizeResult
) -> ViscoelasticFit:
    x = found.x
    history = model.history
    residuals = found.fun
    # Means that deviate alike at neighbouring times count as fewer.
    scatter = max(correlated_variance(residuals, len(x)), 1.0)
    covariance = scatter * inverse(found.jac)
    modulus, ratio, time = np.exp(x[:3])
    errors = np.sqrt(np.diag(covariance))
    # d ln(E (1 + r)) = d ln E + r / (1 + r) d ln r.
    slopes = np.array([1.0, ratio / (1 + ratio)])
    glassy_error = float(np.sqrt(slopes @ covariance[:2, :2] @ slopes))
    work, work_error, length, length_error = 0.0, np.nan, np.nan, np.nan
    if len(x) > _STICKY:
        work, length = map(float, np.exp(x[_STICKY:]))
        work_error, length_error = work * errors[_STICKY], length * errors[_STICKY + 1]
    forces = model.forces(x)
    used = model.is_mean
    rms = float(np.sqrt(np.mean((residuals * model.noise) ** 2)))
    result = js.RESULTS.successful
    if found.status == 0:
        result = js.RESULTS.max_steps_reached
    elif rms > max(_MISFIT * model.noise, _OF_FORCE * history.force):
        result = js.RESULTS.misfit
    glassy = modulus * (1 + ratio)
    fit = ViscoelasticFit(
        relaxed_modulus=float(modulus),
        instantaneous_modulus=float(glassy),
        ratio=float(ratio),
        time=float(time),
        work_of_adhesion=work,
        range=length,
        contact_point=float(x[3]) * history.depth,
        errors=ViscoelasticErrors(
            relaxed_modulus=float(modulus * errors[0]),
            instantaneous_modulus=float(glassy * glassy_error),
            ratio=float(ratio * errors[1]),
            time=float(time * errors[2]),
            work_of_adhesion=float(work_error),
            range=float(length_error),
            contact_point=float(errors[3]) * history.depth,
        ),
        result=result,
        misfit=rms,
        noise=model.noise,
        curve=curve,
        tip=model.tip,
        poisson_ratio=model.poisson_ratio,
        times=history.times[used],
        measured=history.forces[used],
        forces=forces[used],
    )
    if result != js.RESULTS.successful:
        numbers = f"the misfit is {rms / model.noise:.2g} times the noise of the means"
        warnings.warn(f"{fit.status}: {numbers}.", js.exceptions.FitWarning, stacklevel=3)
    return fit

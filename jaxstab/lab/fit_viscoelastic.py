"""The fit of a force curve in time, of a viscoelastic sample on rings."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from operator import index
from typing import NamedTuple

import jax
import numpy as np
from scipy.optimize import OptimizeResult, least_squares

import jaxstab as js
from jaxstab.lab import dugdale
from jaxstab.lab.curve_model import inverse
from jaxstab.lab.curve_search import correlated_variance
from jaxstab.lab.fit import ForceCurveFit
from jaxstab.lab.fit_curve import fit_curve
from jaxstab.lab.time_means import TimeMeans, mean_forces
from jaxstab.lab.tips import ElasticTip, Tip, paraboloid_radius
from jaxstab.lab.viscoelastic_fit import ViscoelasticErrors, ViscoelasticFit

# The places of the baselines and of the law among the numbers.
_LINES, _LAW = slice(2, 6), slice(6, 8)
# Starts: times over the duration of the approach, and sums of the ratios.
_TIMES, _RATIOS = np.array([0.1, 0.5, 2.0]), np.array([0.5, 2.0])
# Times, modulus and work are within these factors of the start, and ratios between these bounds: a
# mode of the least one is none.
_FAR_OFF = 1e3
_LEAST_RATIO, _LARGEST_RATIO = 1e-4, 1e3
# A further mode is tried at so many times, from two steps of the means to the length of the curve,
# and begins with a ratio of no less than this.
_TRIED, _FIRST_RATIO = 8, 0.03
# The most modes that a curve is fitted by.
_MOST_MODES = 5
# Steps of finite differences: of logarithms and ratios, and of the contact point over the depth. A
# sum of squares is right within this part.
_STEP, _CONTACT_STEP, _EXACT = 0.01, 1e-3, 1e-4
# How near a contact comes to the edge of a tip.
_NEXT_TO = 1e-6
# Evaluations of the first fit, and of the second one on rings that are chosen anew.
_FIRST, _LAST = 40, 20
# Rings are chosen anew if their radius has moved by this part.
_MOVED = 0.15
# The least range of the law, as a part of the first guess: a shorter one takes more rings.
_SHORTEST = 0.3
# The model does not describe a curve whose misfit is so many times the noise of the means, and this
# part of the largest force.
_MISFIT, _OF_FORCE = 3.0, 0.01
# A mode is told if the sum of squares falls by this much, in units of its scatter, and if neither
# its ratio nor its time may be off by this part of itself.
_GAIN, _UNTOLD = 14.0, 1.0


def fit_viscoelastic(
    curve: js.lab.force_curves.ForceCurve,
    tip: Tip,
    poisson_ratio: float = 0.5,
    relaxation_times: int | Sequence[float] | np.ndarray = 1,
) -> ViscoelasticFit:
    """Fit a Prony series to approach, pauses and retraction at their measured times.

    The model is the contact of a rigid tip with a viscoelastic half space on `Rings`, whose stress
    relaxes as E(t) = E (1 + sum r_k exp(-t / T_k)), on the cantilever that has measured the curve:
    the history that `jaxstab.evolve` returns for the measured heights. Forces are fitted by least
    squares, with the contact point, the rest of the baseline and, for a curve that shows an
    attraction, an exponential law. Relaxation times far beyond the duration of the curve, or below
    the time of a few points, are not told by it, as their errors show. Of several times each is
    added to the fit with one less; if the last one hardly lowers the misfit, or one has an error as
    large as itself, the result is `undetermined`, and the parameters are given all the same.

    What `ForceCurve.corrected` removes as a drift is given back: the sample may have caused it.

    Arguments:
        curve: the curve, with times and a spring constant; one that is not corrected is.
        tip: a `Sphere`, `Paraboloid`, `Cone` or `Pyramid`.
        poisson_ratio: nu of the sample, the same at all times.
        relaxation_times: the number of times that are fitted, or the times themselves, whose ratios
            alone are fitted [s].

    Raises:
        ValueError: for a curve without times or approach, times that are not positive and rising,
            another number of them than 1 to 5, single precision, and as `fit_curve` does.
        TypeError: for something that is no force curve, no such tip or no number of times.

    Warns:
        FitWarning: if the result is not `successful`; the message has the reason.

    Example:
        >>> time = np.linspace(0, 1, 1000)  # [s]
        >>> tip = 1e-6 - 2e-6 * time  # [m], at the surface after 0.5 s
        >>> moduli = 1e3 * (1 + 1.5 * np.exp(-(time + 5e-4) / 0.1))
        >>> growth = np.diff(np.maximum(-tip, 0) ** 1.5, prepend=0)
        >>> force = 4 / 3 * np.sqrt(5e-6) / 0.75 * np.convolve(moduli, growth)[:1000]
        >>> approach = js.lab.force_curves.Segment(force, tip - force / 0.05, tip, time)
        >>> curve = js.lab.force_curves.ForceCurve(approach, None, spring_constant=0.05)
        >>> fit = js.lab.fit_viscoelastic(curve, js.lab.Paraboloid(radius=5e-6))
        >>> f"{fit.relaxed_modulus:.0f} Pa, {fit.ratios[0]:.2f}, {fit.relaxation_times[0]:.3f} s"
        '1000 Pa, 1.50, 0.100 s'
    """
    if not isinstance(tip, Tip) or isinstance(tip, ElasticTip):
        raise TypeError(f"The tip is {tip!r}: give a rigid Sphere, Paraboloid, Cone or Pyramid.")
    if jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        raise ValueError(
            "Single precision leaves no derivatives for this fit: first of all, call "
            'jax.config.update("jax_enable_x64", True).'
        )
    number, held = _modes_asked_for(relaxation_times)
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
    means = TimeMeans.of(elastic.curve.in_units("m", "N"))
    model, x = _start(means, elastic, sticky, held)
    model, found = _fit_on_its_rings(model, x)
    gain = np.inf
    for _ in range(0 if held is not None else number - 1):
        before = found.cost
        model, found = _fit_on_its_rings(model, _with_another_mode(model, found))
        gain = 2 * (before - found.cost) / _scatter(found)
    return _result_of(elastic.curve, model, found, gain)


def _modes_asked_for(
    relaxation_times: int | Sequence[float] | np.ndarray,
) -> tuple[int, np.ndarray | None]:
    """Return the number of modes, and their times if these are given."""
    if np.ndim(relaxation_times) == 0:
        try:
            number = index(relaxation_times)  # pyright: ignore[reportArgumentType]
        except TypeError:
            raise TypeError(
                f"The number of relaxation times is {relaxation_times!r}: give an integer, or the "
                "times in s as a list."
            ) from None
        if not 1 <= number <= _MOST_MODES:
            raise ValueError(
                f"The number of relaxation times is {number}: it is between 1 and {_MOST_MODES}."
            )
        return number, None
    times = np.asarray(relaxation_times, float)
    is_rising = times.ndim == 1 and times.size > 0 and np.all(np.diff(times) > 0)
    if not (is_rising and times[0] > 0 and np.isfinite(times[-1])):
        raise ValueError(
            f"The relaxation times are {relaxation_times}: give positive times in s, in rising "
            "order."
        )
    return len(times), times


class _ViscoelasticModel(NamedTuple):
    """Forces in time as a function of numbers of the order of one.

    The numbers are ln E, the contact point over the depth, baseline and tilt of approach and pauses
    and of a retraction with its own in units of the noise, with adhesion ln w and the logarithm of
    the range, then the ratio of each mode and, unless times are held, the logarithm of its time.
    """

    means: TimeMeans
    tip: Tip
    poisson_ratio: float
    is_sticky: bool
    held: np.ndarray | None
    rings: js.Rings

    @classmethod
    def at(
        cls,
        means: TimeMeans,
        tip: Tip,
        poisson_ratio: float,
        is_sticky: bool,
        held: np.ndarray | None,
        x: np.ndarray,
    ) -> _ViscoelasticModel:
        """Return the model on rings for the contact at some numbers."""
        modulus = np.exp(x[0]) / (1 - poisson_ratio**2)
        branch = dugdale.without_adhesion(tip, modulus, means.depth, 0.0)
        adhesion = {}
        if is_sticky:
            work, length = np.exp(x[_LAW])
            adhesion = {"work_of_adhesion": float(work), "length": float(length)}
        rings = js.Rings.for_contact(
            lambda radii: -_shape(tip, radii), modulus, force=float(branch.force[-1]), **adhesion
        )
        rings = js.Rings(rings.num_points // 2, rings.radius)
        return cls(means, tip, poisson_ratio, is_sticky, held, rings)

    def with_rings_at(self, x: np.ndarray) -> _ViscoelasticModel:
        """Return the model on rings for the contact at other numbers."""
        return self.at(self.means, self.tip, self.poisson_ratio, self.is_sticky, self.held, x)

    @property
    def first_ratio(self) -> int:
        """The place of the first ratio among the numbers."""
        return _LAW.stop if self.is_sticky else _LAW.start

    def num_modes(self, x: np.ndarray) -> int:
        """Return the number of modes of some numbers."""
        left = len(x) - self.first_ratio
        return left if self.held is not None else left // 2

    def ratios(self, x: np.ndarray) -> np.ndarray:
        """Return the ratio of each mode."""
        return x[self.first_ratio : self.first_ratio + self.num_modes(x)]

    def relaxation_times(self, x: np.ndarray) -> np.ndarray:
        """Return the relaxation time of each mode [s]."""
        if self.held is not None:
            return self.held
        return np.exp(x[self.first_ratio + self.num_modes(x) :])

    def forces(self, x: np.ndarray) -> np.ndarray:
        """Return the mean forces of all steps, NaN if there is no equilibrium."""
        rings, means = self.rings, self.means
        law = js.potentials.NoAdhesion()
        if self.is_sticky:
            law = js.potentials.Exponential(*np.exp(x[_LAW]))
        half_space = js.solids.AxisymmetricHalfSpace(rings, np.exp(x[0]), self.poisson_ratio)
        times = self.relaxation_times(x)
        order = np.argsort(times)
        solid = js.Viscoelastic(half_space, self.ratios(x)[order], times[order])
        contact = js.Contact(solid, -_shape(self.tip, np.asarray(rings.radii)), law)
        heights = means.heights - x[1] * means.depth
        load = js.Spring.cantilever(heights, means.stiffness, rings)
        with warnings.catch_warnings():
            # A warning of a trial on the way tells nothing of the end.
            warnings.simplefilter("ignore")
            evolution = js.evolve(contact, load, means.times, progress=False, throw=False)
        forces = mean_forces(np.asarray(evolution.force), means.times, means.variances)
        return forces + self._baseline(x)

    def _baseline(self, x: np.ndarray) -> np.ndarray:
        heights = self.means.heights
        away = (heights - heights.mean()) / np.ptp(heights)
        lines = np.where(self.means.is_apart, x[4] + x[5] * away, x[2] + x[3] * away)
        return lines * self.noise

    @property
    def is_mean(self) -> np.ndarray:
        """Which times are those of means, and not turns."""
        return np.isfinite(self.means.errors)

    @property
    def noise(self) -> float:
        """The typical standard error of a mean [N]."""
        return float(np.median(self.means.errors[self.is_mean]))

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return the misfit of the means over their errors."""
        away = self.forces(x) - self.means.forces
        return (away / self.means.errors)[self.is_mean]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals by differences."""
        steps = np.full(len(x), _STEP)
        steps[1] = _CONTACT_STEP
        start = self.residuals(x)
        columns = []
        for number, step in enumerate(steps):
            moved = x.copy()
            moved[number] += step
            if number in range(_LINES.start, _LINES.stop):
                away = (self._baseline(moved) - self._baseline(x)) / self.means.errors
                columns.append(away[self.is_mean] / step)
            else:
                columns.append((self.residuals(moved) - start) / step)
        return np.stack(columns, 1)

    def fit(self, x: np.ndarray, most: int) -> OptimizeResult:
        """Return the least squares over all numbers from a start."""
        low, high = x - np.log(_FAR_OFF), x + np.log(_FAR_OFF)
        low[1], high[1] = x[1] - 1, x[1] + 1
        low[_LINES], high[_LINES] = -np.inf, np.inf
        if self.is_sticky:
            low[_LAW.stop - 1] = x[_LAW.stop - 1] + np.log(_SHORTEST)
        modes = slice(self.first_ratio, self.first_ratio + self.num_modes(x))
        low[modes], high[modes] = _LEAST_RATIO, _LARGEST_RATIO
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


def _start(
    means: TimeMeans, elastic: ForceCurveFit, sticky: ForceCurveFit, held: np.ndarray | None
) -> tuple[_ViscoelasticModel, np.ndarray]:
    """Return the best of some starts with one mode, or with all modes whose times are held."""
    tip, poisson_ratio = elastic.tip, elastic.poisson_ratio
    assert isinstance(tip, Tip)
    first = [np.log(elastic.youngs_modulus), elastic.contact_point / means.depth, *np.zeros(4)]
    is_sticky = sticky.work_of_adhesion > 0
    if is_sticky:
        # Ranges of Dugdale's and of the exponential law are alike in the pressure that they make.
        shortest = _SHORTEST * sticky.work_of_adhesion ** (2 / 3)
        shortest *= paraboloid_radius(tip, means.depth) ** (1 / 3)
        shortest /= (elastic.youngs_modulus / (1 - poisson_ratio**2)) ** (2 / 3)
        first += [
            np.log(sticky.work_of_adhesion),
            np.log(max(np.nan_to_num(sticky.range), 2 * shortest)),
        ]
    model = _ViscoelasticModel.at(means, tip, poisson_ratio, is_sticky, held, np.array(first))
    starts = held[None] if held is not None else (_TIMES * means.duration)[:, None]
    tried = []
    for times in starts:
        for ratio in _RATIOS:
            ratios = np.full(len(times), ratio / len(times))
            x = np.array([*first, *ratios, *(np.log(times) if held is None else ())])
            # The modulus of the approach is the one after about its duration.
            x[0] -= np.log(1 + ratios @ np.exp(-means.duration / times / 2))
            tried.append((float(np.sum(model.residuals(x) ** 2)), x))
    return model, min(tried, key=lambda one: one[0])[1]


def _fit_on_its_rings(
    model: _ViscoelasticModel, x: np.ndarray
) -> tuple[_ViscoelasticModel, OptimizeResult]:
    """Return the fit on rings that suit it, since a contact may be larger than at the start."""
    found = model.fit(x, _FIRST)
    again = model.with_rings_at(found.x)
    if np.isclose(float(again.rings.radius), float(model.rings.radius), rtol=_MOVED):
        return model, found
    return again, again.fit(found.x, _LAST)


def _with_another_mode(model: _ViscoelasticModel, found: OptimizeResult) -> np.ndarray:
    """Return numbers with one mode more, at the time that lowers the sum of squares most.

    To first order in its ratio a mode changes the residuals along one direction, of which the part
    beyond all other numbers counts.
    """
    basis = np.linalg.qr(found.jac)[0]

    def beyond(values: np.ndarray) -> np.ndarray:
        return values - basis @ (basis.T @ values)

    times = model.means.times[model.is_mean]
    step = float(np.median(np.diff(times)))
    left = beyond(found.fun)
    # The ratio stands behind the others, the time at the end.
    place = model.first_ratio + model.num_modes(found.x)
    tried = []
    for time in np.geomspace(2 * step, float(np.ptp(times)), _TRIED):
        x = np.insert(np.append(found.x, np.log(time)), place, _FIRST_RATIO)
        direction = beyond(model.residuals(x) - found.fun) / _FIRST_RATIO
        size = float(direction @ direction)
        ratio = -float(direction @ left) / max(size, np.finfo(float).tiny)
        tried.append((np.sign(ratio) * ratio**2 * size, ratio, x))
    _, ratio, x = max(tried, key=lambda one: one[0])
    x[place] = max(ratio, _FIRST_RATIO)
    return x


def _shape(tip: Tip, radii: np.ndarray) -> np.ndarray:
    """Return how far a tip is above its apex, and beyond its largest radius as far as there."""
    return tip.shape(np.minimum(radii, (1 - _NEXT_TO) * tip.largest_radius))


def _scatter(found: OptimizeResult) -> float:
    """Return the variance of the residuals, larger where neighbouring ones are alike."""
    return max(correlated_variance(found.fun, len(found.x)), 1.0)


def _result_of(
    curve: js.lab.force_curves.ForceCurve,
    model: _ViscoelasticModel,
    found: OptimizeResult,
    gain: float,
) -> ViscoelasticFit:
    x, means = found.x, model.means
    covariance = _scatter(found) * inverse(found.jac)
    # A line that no mean tells has a variance of zero, or by rounding a negative one.
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.diag(covariance))
    modulus = float(np.exp(x[0]))
    ratios, times = model.ratios(x), model.relaxation_times(x)
    modes = slice(model.first_ratio, model.first_ratio + len(ratios))
    times_errors = np.zeros(len(times))
    if model.held is None:
        # The farther side of an error of the logarithm.
        times_errors = times * np.expm1(errors[modes.stop :])
    # d ln(E (1 + sum r)) = d ln E + sum d r / (1 + sum r).
    slopes = np.zeros(len(x))
    slopes[0] = 1.0
    slopes[modes] = 1 / (1 + ratios.sum())
    glassy = modulus * float(1 + ratios.sum())
    work, work_error, length, length_error = 0.0, np.nan, np.nan, np.nan
    if model.is_sticky:
        work, length = map(float, np.exp(x[_LAW]))
        work_error, length_error = np.array([work, length]) * errors[_LAW]
    order = np.argsort(times)
    forces = model.forces(x)
    used = model.is_mean
    rms = float(np.sqrt(np.mean((found.fun * model.noise) ** 2)))
    told = np.all(errors[modes] < _UNTOLD * ratios) and np.all(times_errors < _UNTOLD * times)
    result = js.RESULTS.successful
    numbers = f"the misfit is {rms / model.noise:.2g} times the noise of the means"
    if found.status == 0:
        result = js.RESULTS.max_steps_reached
    elif rms > max(_MISFIT * model.noise, _OF_FORCE * means.force):
        result = js.RESULTS.misfit
    elif gain < _GAIN or not told:
        result = js.RESULTS.undetermined
        numbers = (
            f"the curve does not tell all of the {len(times)} relaxation times and ratios: give "
            "fewer, or the times themselves"
        )
    fit = ViscoelasticFit(
        relaxed_modulus=modulus,
        instantaneous_modulus=glassy,
        ratios=ratios[order],
        relaxation_times=times[order],
        work_of_adhesion=work,
        range=length,
        contact_point=float(x[1]) * means.depth,
        errors=ViscoelasticErrors(
            relaxed_modulus=float(modulus * errors[0]),
            instantaneous_modulus=glassy * float(np.sqrt(slopes @ covariance @ slopes)),
            ratios=errors[modes][order],
            relaxation_times=times_errors[order],
            work_of_adhesion=float(work_error),
            range=float(length_error),
            contact_point=float(errors[1]) * means.depth,
        ),
        result=result,
        misfit=rms,
        noise=model.noise,
        curve=curve,
        tip=model.tip,
        poisson_ratio=model.poisson_ratio,
        times=means.times[used],
        measured=means.forces[used],
        forces=forces[used],
    )
    if result != js.RESULTS.successful:
        warnings.warn(f"{fit.status}: {numbers}.", js.exceptions.FitWarning, stacklevel=3)
    return fit

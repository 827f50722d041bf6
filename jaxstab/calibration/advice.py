"""Advice on a fit: outliers, a wrong sign, a drift, an offset or a baseline that was not fitted."""

from typing import NamedTuple

import numpy as np
from scipy.special import betainc

from jaxstab.calibration.least_squares import FARTHEST, Curve, Measured
from jaxstab.core.warn import warn

# The chance of a normal error, or of a lower misfit by chance, below which a warning is given.
_CHANCE = 1e-4
# A misfit below this fraction of the measurements is rounding.
_SMALLEST = 1e-5
# A measurement is an outlier if leaving it out takes this part of the sum of squares away.
_MOST = 0.9
# A drift, an offset or a baseline is named if it would remove such a part of the sum of squares.
_REMOVED = 0.5
# Above this misfit a warning is given if the guess's curve runs the other way.
_POOR = 0.1


class FitWarning(UserWarning):
    """A fit converged, but the measurements show an outlier, an offset or a baseline.

    Example:
        A fit to an approach with a sphere, taken for one with a cone:

        >>> import warnings
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     fit = js.lab.fit_curve(curve, js.lab.Cone(half_angle=35.0))
        >>> caught[0].category.__name__, fit.result.name
        ('FitWarning', 'misfit')
    """


class Hints(NamedTuple):
    """Numbers of a fit that hint at the cause of a misfit.

    Attributes:
        guess: the curve at the start [pressure].
        zeros: offset and baseline that a Gauss-Newton step from the fit would give, zero for the
            fitted ones [length, unit of the measurements].
        drop: the fraction of the loss that this step would remove.
        relief: the fraction of the sum of squares that leaving out each measurement would remove,
            to first order r^2 / (1 - h), with h its leverage J (J^T J)^-1 J^T.
        drift: the fraction of the sum of squares that a drift of the measurements, proportional to
            their number, would remove beside a Gauss-Newton step.
    """

    guess: Curve
    zeros: np.ndarray
    drop: float
    relief: Curve
    drift: float


def warn_of_misfit(measured: Measured, fitted: Curve, count: int, hints: Hints) -> None:
    """Warn of an outlier, a wrong sign, a drift, an offset or a baseline."""
    if outlier := outlier_of(measured, fitted, count, hints.relief):
        # What else the misfit hints at may be due to it.
        warn(f"{outlier}.", FitWarning)
        return
    misfit = np.linalg.norm(_misfit(measured, fitted)) / np.linalg.norm(measured.deviation)
    if misfit > _POOR and (sign := wrong_sign(measured, hints.guess)):
        warn(f"{sign}. The misfit is {misfit:.0%} of the curve.", FitWarning)
    weighed = measured.count
    if _is_exact(measured, fitted):
        return
    if hints.drift > hints.drop and (drift := drift_of(hints, weighed - count - 1)):
        warn(f"{drift}.", FitWarning)
        return
    missing = [name for name, zero in zip(("offset", "baseline"), hints.zeros, strict=True) if zero]
    freedom = weighed - count - len(missing)
    if not missing or freedom < 1:
        return
    chance = betainc(freedom / 2, len(missing) / 2, 1 - hints.drop)
    if chance < _CHANCE and hints.drop > _REMOVED:
        offset, baseline = hints.zeros
        said = {
            "offset": f"the loads had an offset of about {offset:.3g}",
            "baseline": f"the measurements had a baseline of about {baseline:.3g}",
        }
        warn(
            f"the misfit would fall by {hints.drop:.0%} if "
            f"{' and '.join(said[name] for name in missing)}: give "
            f"{', '.join(f'{name}=True' for name in missing)}.",
            FitWarning,
        )


def wrong_sign(measured: Measured, guess: Curve) -> str:
    """Return a sentence on a sign that is likely to be wrong, empty if none is."""
    weights = np.asarray(measured.weights)
    pressure = np.asarray(measured.mean_pressure)
    weights = np.where(np.isfinite(guess), weights, 0)
    known = np.where(weights > 0, guess, 0)
    largest = np.max(np.abs(np.where(weights > 0, pressure, 0)))
    # No fit makes up for such a factor.
    if FARTHEST * np.max(np.abs(known)) < largest:
        return (
            "loads or forces in other units than those of the contact: at these loads the "
            f"pressures of the guess are at most {float(np.max(np.abs(known)) / largest):.1g} of "
            "those measured"
        )
    if np.sum(weights * known * pressure) < 0 and not measured.has_baseline:
        return (
            "the measurements have the opposite sign of the guess's curve: forces are positive in "
            "compression, negative where the surfaces attract"
        )
    away = known - np.sum(weights * known) / np.sum(weights)
    if np.sum(weights * away * pressure) < 0:
        return (
            "the measurements fall where the guess's curve rises: change the sign of the loads or "
            "of the forces. Displacements are positive away from the surface, forces in compression"
        )
    return ""


def drift_of(hints: Hints, freedom: int) -> str:
    """Return a sentence on a drift of the measurements, empty if chance explains what they show."""
    drift = hints.drift
    if freedom < 1 or not drift > _REMOVED or betainc(freedom / 2, 0.5, 1 - drift) > _CHANCE:
        return ""
    return (
        f"the sum of squares would fall by {drift:.0%} if the measurements drifted steadily from "
        "the first to the last. A drift of the forces is not fitted: subtract the line through "
        "those far from contact, before and after it"
    )


def _misfit(measured: Measured, fitted: Curve) -> np.ndarray:
    misfit = np.asarray(fitted - measured.mean_pressure)
    return np.where(measured.weights > 0, np.sqrt(measured.weights) * misfit, 0)


def _is_exact(measured: Measured, fitted: Curve) -> bool:
    misfit = np.linalg.norm(_misfit(measured, fitted))
    return bool(misfit < _SMALLEST * np.linalg.norm(measured.deviation))


def outlier_of(measured: Measured, fitted: Curve, count: int, relief: Curve | None = None) -> str:
    """Return a sentence on the measurement whose lack helps most, if noise is not the cause.

    Without the relief of a fit that others follow from, that is the one of the largest misfit.
    """
    squares = _misfit(measured, fitted) ** 2
    if relief is None:
        relief = squares / squares.sum()
    without = np.asarray(relief)
    number = int(np.argmax(without))
    weighed = int(np.sum(squares > 0))
    freedom = weighed - count - 1
    if freedom < 1 or _is_exact(measured, fitted) or not np.isfinite(squares).all():
        return ""
    share = min(float(without[number]), 1.0)
    # The chance of such a fraction of a sum of squares, times the number of terms (Bonferroni).
    if share < _MOST and weighed * betainc(freedom / 2, 0.5, 1 - share) > _CHANCE:
        return ""
    return (
        f"measurement number {number}, at a load of {measured.load.value[number]:.6g}, makes "
        f"{share:.0%} of the sum of squares. It looks like an outlier, or lies at a jump: mask it "
        "with `numpy.ma.masked_array`, or give it weight 0"
    )

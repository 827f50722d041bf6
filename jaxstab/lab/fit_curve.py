"""The fit of one measured force curve, by the exact contact of an axisymmetric tip."""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np

import jaxstab as js
from jaxstab.lab import curve_search
from jaxstab.lab.curve_bins import Bins
from jaxstab.lab.fit import FitErrors, ForceCurveFit
from jaxstab.lab.force_curves.force_curve import curve_to_fit
from jaxstab.lab.tips import ElasticTip, FlatPunch, SphereOnPlate, Tip

Part = Literal["approach", "retraction"]

# The model does not describe a curve whose misfit in contact is so many times the noise, and this
# part of the force that the indentation makes: a sphere's curve fitted by a cone misses it by 1.5 %
# and has five times the modulus. Before contact the misfit is so many times the noise, and this
# part of the largest attraction.
_MISFIT, _OF_FORCE, _OF_ATTRACTION = 3.0, 0.01, 0.03
# Adhesion is tried though no point shows an attraction if fewer points than these lie near contact,
# between which it may act, or if the cantilever bends by so many times the indentation: it may jump
# over the attraction into contact.
_FEW, _SOFT = 250, 10.0


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
        tip: a `Sphere`, `Paraboloid`, `Cone`, `Pyramid` or `FlatPunch`; `TwoSpheres` or
            `SphereOnPlate` for a sample that is a sphere, `ElasticTip` for an elastic tip.
        poisson_ratio: nu of the sample.
        segment: "approach" or "retraction".

    Raises:
        ValueError: for Poisson's ratio outside of (-1, 0.5], another segment or one that the curve
            lacks, no spring constant, a curve that cannot be corrected, an attraction of a sphere
            on a plate, and a contact that is stiffer than an elastic tip allows.
        TypeError: for something that is no force curve or no tip.

    Warns:
        FitWarning: if the result is not `successful`; the message has the reason.

    Example:
        >>> fit = js.lab.fit_curve(curve, js.lab.Paraboloid(radius=5e-6))
        >>> f"{fit.youngs_modulus:.3g}, {fit.result.name}"
        '2.52, successful'
    """
    if not isinstance(tip, Tip | FlatPunch):
        raise TypeError(
            f"The tip is {tip!r}: give a Sphere, Paraboloid, Cone, Pyramid or FlatPunch of "
            "jaxstab.lab."
        )
    if not -1 < poisson_ratio <= 0.5:
        raise ValueError(f"Poisson's ratio is {poisson_ratio}: it lies in (-1, 0.5].")
    curve = curve_to_fit(curve, segment)
    data = Bins.of(curve.in_units("m", "N"), segment)
    fit = curve_search.without_adhesion(data, tip)
    if data.attract and isinstance(tip, SphereOnPlate):
        raise ValueError(
            f"The {segment} shows an attraction, and a sphere on a plate is fitted without: fit a "
            "segment without attraction, or TwoSpheres if the plate holds the sphere."
        )
    # A punch shows no attraction before contact.
    if isinstance(tip, FlatPunch):
        may_stick = data.attract and segment == "retraction"
    else:
        is_sparse = np.sum(data.is_near[data.group]) < _FEW
        depth = fit.model.values(fit.found.x)[1] - data.tips.min()
        is_soft = data.force.max() / data.stiffness > _SOFT * depth
        may_hide = (is_sparse or is_soft) and not isinstance(tip, SphereOnPlate)
        may_stick = data.attract or may_hide
    if may_stick:
        fit = curve_search.better(fit, curve_search.with_adhesion(data, tip))
    return _result_of(curve, fit, poisson_ratio, segment)


def _result_of(
    curve: js.lab.force_curves.ForceCurve,
    fit: curve_search.BestFit,
    poisson_ratio: float,
    segment: Part,
) -> ForceCurveFit:
    model, found, errors = fit
    data = model.data
    values = model.values(found.x)
    # 1 / E* = (1 - nu^2) / E + (1 - nu_t^2) / E_t.
    compliance = 1 / float(values[0])
    if isinstance(model.tip, ElasticTip):
        compliance -= model.tip.compliance
        if compliance <= 0:
            raise ValueError(
                f"The contact is stiffer, E* = {values[0]:.3g} Pa, than the tip on a rigid sample, "
                f"{1 / model.tip.compliance:.3g} Pa: give a tip of a larger modulus."
            )
    modulus = (1 - poisson_ratio**2) / compliance
    modulus_error = modulus * float(errors[0]) / (float(values[0]) ** 2 * compliance)
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
    misfit = model.misfit(found.x)
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
        youngs_modulus=modulus,
        work_of_adhesion=work,
        range=length,
        contact_point=float(values[1]),
        errors=FitErrors(
            youngs_modulus=modulus_error,
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


def _rms(values: np.ndarray) -> float:
    """Return the root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else np.nan

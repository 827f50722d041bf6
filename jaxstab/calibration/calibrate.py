"""The fit of an interaction law and a modulus to a measured curve of force over distance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, PyTree

from jaxstab.calibration.advice import FitWarning, Hints, warn_of_misfit, wrong_sign
from jaxstab.calibration.least_squares import (
    FARTHEST,
    Curve,
    Evaluation,
    FitProblem,
    Measured,
    Rows,
    Values,
    directions,
)
from jaxstab.calibration.model import ZEROS, Model, Order, Pick, Where, values_of, with_values
from jaxstab.calibration.result import Calibration, describe, profile_of
from jaxstab.calibration.search import Search, fits, num_fits
from jaxstab.contact import Contact, require_contact, require_elastic
from jaxstab.contact.resolution import warn_if_coarse
from jaxstab.core.checks import (
    array,
    integer,
    parameter,
    require,
    require_finite,
    require_known,
    require_one_of,
    require_positive,
)
from jaxstab.core.interrupts import early_ends
from jaxstab.core.loop import optional_parameter
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.types import ArrayLike
from jaxstab.core.units import FORCE, NUMBER, PRESSURE, SPRING_CONSTANT, STIFFNESS
from jaxstab.core.warn import warn
from jaxstab.loads import Load, MeanPressure, require_load

# A fit with a larger loss does not describe the measurements; a zero curve has a loss of 1/2.
_LARGEST_LOSS = 0.25
_PRECISION = np.finfo(float)


def potential_and_modulus(contact: Contact) -> PyTree:
    """Pick the parameters of the potential, and Young's modulus where there is one."""
    modulus = getattr(contact.solid, "youngs_modulus", None)
    if modulus is None:
        return contact.potential
    return contact.potential, modulus


def calibrate(
    contact: Contact,
    load: Load,
    mean_pressure: ArrayLike | None = None,
    *,
    forces: ArrayLike | None = None,
    offset: bool = False,
    baseline: bool | Literal["linear"] = False,
    weights: ArrayLike | None = None,
    load_error: ArrayLike | None = None,
    where: Where = potential_and_modulus,
    order: Order = "continuation",
    starts: int | None = None,
    tolerance: ArrayLike | None = None,
    max_steps: int = 200,
    progress: bool | None = None,
    throw: bool = True,
) -> Calibration:
    """Fit the parameters of a contact to measured forces or mean pressures.

    Minimises sum_i w_i (p0(load_i - offset) + baseline + tilt load_i - m_i)^2 by the
    Levenberg-Marquardt method (J. SIAM 11, 431, 1963).

    Work of adhesion and range nearly compensate each other, so the misfit can have several minima.
    Therefore the worst determined parameter is fixed at values up to a factor of four away, the
    others are fitted at each, and all parameters again from each minimum of this profile. The fit
    with the least misfit is returned.

    Contacts with hysteresis jump, and so does the curve as parameters change: the least misfit may
    lie at a jump, where no method converges. It is accepted if two fits agree on it within a
    quarter. A load without a derivative, such as one beside a jump, contributes to the misfit but
    not to the direction of a step.

    A parameter that starts positive is fitted by its logarithm, and stays positive.
    Only floating-point arrays are parameters, not integers or Python numbers in a function.

    It works outside of JAX transformations only.

    Arguments:
        contact: the contact with the parameters to start from.
        load: one value for each measurement, in their order: a displacement, a gap, the position of
            a tip (`jaxstab.FarDisplacement`) or of a spring. A load without an equilibrium fails
            the fit, unless its weight is zero.
        mean_pressure: m, the measured mean pressures, positive in compression [pressure]. Masked
            values of a masked array have no weight.
        forces: measured forces instead, positive in compression: m times the area of the cell
            [pressure length^2].
        offset: fit the zero of the loads, the contact point of a measured curve.
        baseline: fit the zero of the measurements: a constant force or pressure, or "linear" for
            one with a tilt over the load.
        weights: w, one over the variance of each measurement up to a common factor; all equal by
            default.
        load_error: how far one standard error moves each load, of an error that all of them have in
            common, such as a drift: errors of the parameters include it [length].
        where: selects the parameters to fit from a contact, as in `equinox.tree_at`; by default all
            of the potential and Young's modulus.
        order: as in `sweep`: "continuation" starts each load from the one before, as a
            measurement does; "independent" starts all alike, without hysteresis.
        starts: how many starts: the contact's own parameters, and others within a factor of two of
            them. The best fit wins. By default as many as it takes until one converges, up to 5. If
            the first ends far from the measurements, and the guess has another sign or unit, no
            others are made.
        tolerance: the relative change of every parameter, that a step of Gauss and Newton's method
            would make, to reach; by default a hundredth of its standard error, and at least 1e-6.
            For a parameter that does not start positive, the change is relative to one that would
            change the curve by its own size.
        max_steps: the step limit of each fit.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        throw: raise an error if the fit fails; otherwise look at `result`.

    Returns:
        The fit. Ctrl-C ends the search after the current one of its fits, with a warning; the best
        one is returned, with the result `interrupted`. Standard errors follow from the misfit's
        variance times the inverse of J^T W J, with the Jacobian J of the curve. They are raised if
        the loss of the profile rises by less.

    Raises:
        ValueError: for measurements that do not match the loads, are not finite, or are not more
            than the parameters. For negative weights, an unknown order, and `starts` below 1.
        TypeError: for a load that prescribes the pressure, a contact in single precision, and in a
            JAX transformation.
        SolverError: if `throw` and the fit did not converge, or does not describe the measurements:
            a parameter ran to its bound or is not determined, or a zero or a constant curve fits
            hardly worse. The message names the likely cause, such as a wrong sign or an outlier.

    Warns:
        FitWarning: for an outlier or a drift, and for an offset or a baseline that is not fitted
            although the measurements have one; for an interrupt.

    Example:
        >>> loads = js.MeanGap(jnp.linspace(0.08, 0.2, 6))
        >>> measured = js.sweep(contact, loads, stability=False).equilibrium.mean_pressure
        >>> guess = js.Contact(solid, heights, js.potentials.Exponential(0.02, 0.06))
        >>> fit = js.calibrate(guess, loads, measured, where=lambda c: c.potential.surface_energy)
        >>> f"{fit.contact.potential.surface_energy:.4f}"
        '0.0300'
    """
    require_contact(contact)
    require_elastic(contact, "calibrate")
    require_load(load)
    if isinstance(load, MeanPressure):
        raise TypeError("The load is a MeanPressure: fit a curve over a mean displacement or gap.")
    arrays = mean_pressure, forces, weights, load_error, tolerance
    require_known((contact, load, arrays), "calibrate")
    require_one_of("order", order, Order.__args__)
    require_one_of("baseline", baseline, (False, True, "linear"))
    if contact.heights.dtype != np.float64:
        raise TypeError(
            f"The heights are {contact.heights.dtype}: a fit needs float64, since near contact "
            "edges single precision leaves too many loads without a derivative. Call "
            'jax.config.update("jax_enable_x64", True) before you make the contact.'
        )
    if starts is not None:
        require("starts", integer("starts", starts), starts > 0, "give at least 1.")
    require("max_steps", integer("max_steps", max_steps), max_steps > 0, "give at least 1.")
    tolerance = optional_parameter(tolerance)
    if tolerance is not None:
        require_positive("The tolerance", tolerance)
        tolerance = float(tolerance)
    if (mean_pressure is None) == (forces is None):
        raise ValueError("Give the measurements once: as `forces`, or as mean pressures.")
    given, area = mean_pressure, 1.0
    of_baseline, of_tilt = PRESSURE, STIFFNESS
    if forces is not None:
        given, area = forces, float(contact.area)
        of_baseline, of_tilt = FORCE, SPRING_CONSTANT
    measured = Measured.of(load, given, weights, area, bool(baseline))
    dimensions = {}
    if offset:
        dimensions["offset"] = load.unit or NUMBER
    if baseline:
        dimensions["baseline"] = of_baseline
    if baseline == "linear":
        dimensions["tilt"] = of_tilt
    pick = Pick.of(where, contact)
    shift = np.zeros(load.value.shape)
    if load_error is not None:
        shift = np.asarray(parameter(load_error, "The error of the loads"))
        require_finite("The error of the loads", shift)
        if shift.shape != load.value.shape:
            raise ValueError(f"The error of the loads has shape {shift.shape}: give one for each.")
    _require_fewer(len(pick.names) + len(dimensions), measured)
    cure = "one with a weight must differ from zero."
    if baseline:
        cure = "one with a weight must differ from the others, beside a baseline."
    w = measured.weights
    norm = np.linalg.norm(np.sqrt(w) * measured.mean_pressure)
    # The mean of equal numbers is rounded.
    differs = np.linalg.norm(measured.deviation) > _PRECISION.eps * w.size * norm
    require("The norm of the measurements", norm, differs, cure)
    warn_if_coarse(contact)

    model = Model(contact, load, array(area), pick, order)
    values = values_of(pick(contact))
    start = np.append(values, np.zeros(len(ZEROS)))
    held = np.array([False] * values.size + [name not in dimensions for name in ZEROS])

    def curve(values: Values) -> tuple[Curve, Rows]:
        pressures, jacobian = model.curve(values)
        return np.asarray(pressures), np.asarray(jacobian)

    problem = FitProblem(curve, start, measured, held, tolerance)
    search = Search(problem, (start > 0) & ~held)
    is_interrupted = _run(search, starts, max_steps, progress)
    fit = _calibration_of(search, model, dimensions, shift)
    hints = _hints_of(search)
    if fit.result == RESULTS.successful:
        if is_interrupted:
            fit = replace(fit, result=RESULTS.interrupted)
        else:
            warn_of_misfit(measured, search.best.point.mean_pressure, len(fit.names), hints)
    return throw_failure(fit.result, fit, lambda: describe(fit, measured, hints), throw)


def _require_fewer(count: int, measured: Measured) -> None:
    """Raise `ValueError` unless there are parameters, and fewer than measurements."""
    for number in (measured.weights.size, measured.count):
        if not 0 < count < number:
            raise ValueError(
                f"There are {count} parameters for {number} measurements of any weight: take more "
                "of these, or pick other parameters with `where`."
            )


def _run(search: Search, starts: int | None, max_steps: int, progress: bool | None) -> bool:
    """Run the fits of a search, and return whether they were interrupted."""
    with progress_bar("fit", num_fits(starts), "fit", shown=progress) as bar:
        try:
            for _ in fits(search, starts, max_steps, bar):
                if len(search.starts) == 1 and starts is None and _is_hopeless(search):
                    break
        except early_ends():
            if not search.starts:
                raise
            done = len(search.starts) + len(search.profile) + len(search.refits)
            warn(
                f"The search was interrupted: {done} fits are done, the best of which is returned.",
                FitWarning,
            )
            return True
    return False


def _is_hopeless(search: Search) -> bool:
    """Return whether a wrong sign or unit explains the first fit, so that starts near it fail."""
    is_far = search.best.point.loss > _LARGEST_LOSS
    return is_far and bool(wrong_sign(search.problem.measured, search.guess))


def _calibration_of(
    search: Search, model: Model, dimensions: dict[str, Any], shift: Curve
) -> Calibration:
    """Return the best fit of a search with its errors, refused if it is none.

    Arguments:
        search: the search.
        model: the curve of the contact.
        dimensions: those of the zeros that are fitted, by name.
        shift: the error of the loads that they have in common.
    """
    problem = search.problem
    best = search.best.point
    values = problem.values(best.free)
    errors = _errors_of(search, shift)
    is_fitted = ~problem.held
    result = search.result
    if np.isfinite(best.loss) and _is_unfit(problem, best, errors):
        result = RESULTS.no_fit
    number = len(ZEROS)
    zeros = dict(zip(ZEROS, values[-number:], strict=True))
    zero_errors = {
        f"{name}_error": error for name, error in zip(ZEROS, errors.standard[-number:], strict=True)
    }
    picked = model.where(model.contact)
    return Calibration(
        contact=model.contact_at(values),
        parameters=with_values(picked, values[:-number]),
        standard_errors=with_values(picked, errors.standard[:-number]),
        **{name: array(value) for name, value in (zeros | zero_errors).items()},
        covariance=array(errors.covariance[is_fitted][:, is_fitted]),
        mean_pressure=array(best.mean_pressure),
        load=model.loads,
        measured=array(problem.measured.mean_pressure),
        area=model.contact.area,
        loss=array(best.loss),
        residual=array(search.best.residual),
        num_steps=array(search.num_steps),
        num_minima=array(search.num_minima),
        profile=profile_of(search),
        result=result,
        losses=array([fit.point.loss for fit in search.starts]),
        results=RESULTS(array([fit.result.code for fit in search.starts])),
        names=(*model.where.names, *dimensions),
        dimensions=(*model.where.dimensions, *dimensions.values()),
    )


class _Errors(NamedTuple):
    """The errors of the parameters, zero for those that are not fitted.

    Attributes:
        standard: the standard errors.
        relative: those of the variables, from the slopes of the curve alone.
        covariance: of the parameters.
    """

    standard: Values
    relative: Values
    covariance: Float[np.ndarray, "parameters parameters"]


def _errors_of(search: Search, shift: Curve) -> _Errors:
    """Return the errors of the parameters.

    They are those of the slopes of the curve, raised to those of the profile, and added to them is
    the effect of an error that all loads have in common.
    """
    problem = search.problem
    best = search.best.point
    slopes = problem.slopes(best.free)
    of_slopes = directions(problem, best)
    relative = of_slopes.errors
    of_profile = search.errors(relative * slopes)
    factors = np.sign(relative)
    np.divide(of_profile, relative, out=factors, where=(relative > 0) & np.isfinite(relative))
    # An offset moves all loads alike.
    moved = best._replace(misfit=best.jacobian[:, -len(ZEROS)] * shift)
    in_common = directions(problem, moved).newton * slopes
    return _Errors(
        standard=np.hypot(of_profile, in_common),
        relative=relative,
        covariance=factors[:, None] * of_slopes.covariance * factors
        + np.outer(in_common, in_common),
    )


def _is_unfit(problem: FitProblem, best: Evaluation, errors: _Errors) -> bool:
    """Return whether a fit is none: worse than a constant, or with parameters at their bounds."""
    is_fitted = ~problem.held
    # What remains of the measurements beside a constant.
    constant = replace(problem.measured, has_baseline=True).deviation
    remains = np.sum(constant**2) / np.sum(problem.measured.deviation**2) / 2
    is_far = best.loss > min(_LARGEST_LOSS, remains)
    bound = np.log(FARTHEST)
    is_at_bound = (np.abs(best.free) > bound) | ~(errors.relative < bound)
    is_known = np.all(np.isfinite(errors.standard[is_fitted]))
    return bool(is_far or np.any(is_at_bound & problem.is_log & is_fitted) or not is_known)


def _hints_of(search: Search) -> Hints:
    """Return what a Gauss-Newton step of all variables, offset and baseline too, hints at."""
    problem = search.problem
    best = search.best.point
    # A tilt is not advised: what looks like one may be the far end of an attraction.
    held = problem.held.copy()
    held[-len(ZEROS) : -1] = False
    step = directions(problem.holding(held), best).newton
    left = best.misfit - best.jacobian @ step
    basis = _basis(best, ~problem.held)
    return Hints(
        guess=search.guess,
        zeros=-(step * problem.held)[-len(ZEROS) : -1],
        drop=1 - float(np.sum(left**2) / max(np.sum(best.misfit**2), _PRECISION.tiny)),
        relief=_relief(best, basis),
        drift=_drift(best, basis, problem.measured.roots),
    )


def _basis(best: Evaluation, is_fitted: Any) -> Rows:
    """Return an orthonormal basis of the changes of the curve, zero where there are fewer."""
    rows = best.jacobian[:, is_fitted]
    norms = np.linalg.norm(rows, axis=0)
    axes, sizes, _ = np.linalg.svd(rows / np.where(norms > 0, norms, 1), full_matrices=False)
    return axes * (sizes > _PRECISION.eps * len(rows) * np.max(sizes))


def _relief(best: Evaluation, basis: Rows) -> Curve:
    """Return the fraction of the sum of squares that each measurement takes with it, left out."""
    leverage = np.sum(basis**2, axis=1)
    squares = best.misfit**2
    alone = np.maximum(1 - leverage, _PRECISION.eps**0.5)
    return squares / alone / max(np.sum(squares), _PRECISION.tiny)


def _drift(best: Evaluation, basis: Rows, roots: Curve) -> float:
    """Return the fraction of the sum of squares that a drift would remove."""
    line = roots * np.linspace(-1, 1, roots.size)
    line -= basis @ (basis.T @ line)
    left = best.misfit - basis @ (basis.T @ best.misfit)
    both = np.sum(line**2) * np.sum(left**2)
    return float(np.sum(line * left) ** 2 / max(both, _PRECISION.tiny))

"""The fit of an interaction law and a modulus to a measured curve of force over distance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from jaxstab.calibration.advice import (
    FitWarning,
    Hints,
    warn_above_noise,
    warn_of_misfit,
    wrong_sign,
)
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
from jaxstab.calibration.measured_curve import Parts, means_of
from jaxstab.calibration.model import Model, Order, Pick, Where, values_of
from jaxstab.calibration.result import Calibration, describe, profile_of
from jaxstab.calibration.search import Plan, Search, num_fits
from jaxstab.calibration.zeros import Zeros
from jaxstab.contact import Contact, require_contact
from jaxstab.contact.resolution import warn_if_coarse
from jaxstab.core.checks import (
    concrete,
    integer,
    is_transformed,
    require,
    require_one_of,
    require_positive,
    where_known,
)
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.implicit import refuse_derivatives
from jaxstab.core.interrupts import early_ends
from jaxstab.core.loop import optional_parameter
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.types import ArrayLike, Flag, Scalar
from jaxstab.core.units import FORCE, NUMBER, PRESSURE, SPRING_CONSTANT, STIFFNESS
from jaxstab.core.warn import warn
from jaxstab.force_curves import ForceCurve, ForceCurves
from jaxstab.loads import Load, MeanPressure, require_load

# A fit with a larger loss does not describe the measurements; a zero curve has a loss of 1/2.
_LARGEST_LOSS = 0.25
# Rounding of a mean, over the norm and the number of measurements.
_ROUNDING = np.finfo(float).eps


def potential_and_modulus(contact: Contact) -> PyTree:
    """Pick the parameters of the potential, and Young's modulus where there is one."""
    modulus = getattr(contact.solid, "youngs_modulus", None)
    if modulus is None:
        return contact.potential
    return contact.potential, modulus


# Curves without an equilibrium are NaN.
@own_conventions()
def calibrate(
    contact: Contact,
    load: Load | type[Load],
    mean_pressure: ArrayLike | ForceCurve | None = None,
    *,
    forces: ArrayLike | None = None,
    segment: Parts = "retraction",
    points: int = 40,
    offset: bool | None = None,
    baseline: bool | Literal["linear"] | None = None,
    weights: ArrayLike | None = None,
    where: Where = potential_and_modulus,
    order: Order = "continuation",
    starts: int | None = None,
    tolerance: ArrayLike | None = None,
    max_steps: int = 200,
    progress: bool | None = None,
    throw: bool = True,
) -> Calibration:
    """Fit the parameters of a contact to measured forces or mean pressures.

    Minimises sum_i w_i (p0(load_i - offset) + baseline - m_i)^2 by the Levenberg-Marquardt method
    (J. SIAM 11, 431, 1963).

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

    Of a `jaxstab.force_curves.ForceCurve`, corrected first unless it is already, means over short
    steps of the height are fitted, in the units of the contact, with weights from their numbers of
    points and the noise of force and height; the contact point, the baseline and its tilt over the
    height are parameters too. Both segments have a baseline each, unless the retraction has not
    detached, and the drift of the heights is another parameter, unless the correction has left it
    as hysteresis. As `jaxstab.FarDisplacement` the load is the tip position, so that the fit passes
    jumps that a soft cantilever makes; as `jaxstab.Spring` it is the height, and the contact must
    jump where the curve does. An error of the baseline moves the tip position as well.

    Arguments:
        contact: the contact with the parameters to start from.
        load: one value for each measurement, in their order: a displacement, a gap, or the position
            of a spring. A load without an equilibrium fails the fit, unless its weight is zero. For
            a force curve one of the classes `FarDisplacement` and `Spring`.
        mean_pressure: m, the measured mean pressures, positive in compression [pressure]. Masked
            values of a masked array have no weight. Or a force curve.
        forces: measured forces instead, positive in compression: m times the area of the cell
            [pressure length^2].
        segment: which part of a force curve to fit: "approach", "retraction" or "both".
        points: the number of means over a segment of a force curve, in contact; far from it there
            are a sixth as many.
        offset: fit the zero of the loads, the contact point of a measured curve; by default only of
            a force curve.
        baseline: fit the zero of the measurements: a constant force or pressure, or "linear" for
            one with a tilt, baseline + tilt load, of a force curve over the height in place of the
            load. By default "linear" for a force curve, else none.
        weights: w, one over the variance of each measurement up to a common factor; all equal by
            default.
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
        TypeError: for a load that prescribes the pressure, a contact in single precision, or
            several force curves.
        SolverError: if `throw` and the fit did not converge, or does not describe the measurements:
            a parameter ran to its bound or is not determined, or a zero or a constant curve fits
            hardly worse. The message names the likely cause, such as a wrong sign or an outlier.

    Warns:
        FitWarning: for an outlier or a drift, and for an offset or a baseline that is not fitted
            although the measurements have one; for a force curve if the misfit exceeds its noise,
            so that another contact made it; for an interrupt.
    """
    require_contact(contact)
    loads: Any = load
    given = mean_pressure
    zeros = None
    noise = None
    if isinstance(given, ForceCurves):
        raise TypeError(f"There are {len(given)} force curves: fit them by `calibrate_each`.")
    is_curve = isinstance(given, ForceCurve)
    if is_curve:
        if forces is not None or weights is not None:
            raise ValueError("A force curve brings its own forces and weights: leave these out.")
        loads, forces, weights, zeros, noise = means_of(contact, load, given, segment, points)
        given = None
    if offset is None:
        offset = is_curve
    if baseline is None:
        baseline = is_curve and "linear"
    require_load(loads)
    if isinstance(loads, MeanPressure):
        raise TypeError("The load is a MeanPressure: fit a curve over a mean displacement or gap.")
    require_one_of("order", order, Order.__args__)
    require_one_of("baseline", baseline, (False, True, "linear"))
    is_tilted = baseline == "linear"
    if contact.heights.dtype != jnp.float64:
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
    if (given is None) == (forces is None):
        raise ValueError("Give the measurements once: as `forces`, or as mean pressures.")
    of_baseline = FORCE
    of_tilt = SPRING_CONSTANT
    area = contact.area
    if forces is None:
        of_baseline = PRESSURE
        of_tilt = STIFFNESS
        area = jnp.ones(())
    else:
        given = forces
    measured = Measured.of(loads, given, weights, area, bool(baseline))
    if zeros is None:
        zeros = Zeros.over(loads)
    of_load = loads.unit or NUMBER
    dimensions = {}
    if offset:
        dimensions["offset"] = of_load
    if baseline:
        dimensions["baseline"] = of_baseline
    if is_tilted:
        dimensions["tilt"] = of_tilt
    if zeros.drift_error is None:
        dimensions["drift"] = of_load
    fitted = {
        name: dimensions[kind]
        for name, kind in zip(zeros.names, zeros.kinds, strict=True)
        if kind in dimensions
    }
    pick = Pick.of(where, contact)
    w = measured.weights
    count = len(pick.names) + len(fitted)
    # Where JAX traces the weights, their number is known.
    for number in (w.size, (concrete(w) > 0).sum()):
        _require_fewer(count, number)
    cure = "one with a weight must differ from zero."
    if baseline:
        cure = "one with a weight must differ from the others, beside a baseline."
    norm = jnp.linalg.norm(jnp.sqrt(w) * measured.mean_pressure)
    differs = jnp.linalg.norm(measured.deviation) > _ROUNDING * w.size * norm
    require("The norm of the measurements", norm, differs, cure)
    warn_if_coarse(contact)
    inputs = _Inputs(
        contact,
        measured,
        area,
        tolerance,
        max_steps,
        zeros,
        where=pick,
        fitted=tuple(fitted.items()),
        order=order,
        starts=starts,
    )
    if is_transformed(inputs):
        fit, hints = _answer(inputs)
    else:
        fit, hints = _watched(inputs, progress)
        if fit.result == RESULTS.successful:
            warn_of_misfit(measured, fit.mean_pressure, len(fit.names), hints)
            if noise is not None:
                warn_above_noise(measured, fit.mean_pressure, len(fit.names), noise / contact.area)
    return throw_failure(fit.result, fit, lambda: describe(fit, measured, hints), throw)


@where_known
def _require_fewer(count: int, number: int) -> None:
    """Raise `ValueError` unless there are parameters, and fewer than measurements."""
    if not 0 < count < number:
        raise ValueError(
            f"There are {count} parameters for {number} measurements of any weight: take more of "
            "these, or pick other parameters with `where`."
        )


class _Inputs(eqx.Module):
    """All that a fit depends on.

    Attributes:
        fitted: the names of the zeros that are fitted, with their dimensions.
    """

    contact: Contact
    measured: Measured
    area: Scalar
    tolerance: Scalar | None
    max_steps: ArrayLike
    zeros: Zeros
    where: Pick = eqx.field(static=True)
    fitted: tuple[tuple[str, str], ...] = eqx.field(static=True)
    order: Order = eqx.field(static=True)
    starts: int | None = eqx.field(static=True)

    def fits(self) -> tuple[Model, Plan]:
        """Return the contact as a function of its parameters, and the fits to make."""
        inputs: Any = refuse_derivatives(self)
        values, unravel = values_of(self.where(inputs.contact))
        zeros = inputs.zeros
        model = Model(
            contact=inputs.contact,
            where=self.where,
            unravel=unravel,
            loads=inputs.measured.load,
            zeros=zeros,
            area=inputs.area,
            order=self.order,
        )
        start = jnp.concatenate([values, jnp.zeros(len(zeros.names))])
        known = dict(self.fitted)
        is_fitted = np.array([True] * values.size + [name in known for name in zeros.names])
        problem = FitProblem(model.curve, start, inputs.measured, inputs.tolerance)
        is_profiled = (start > 0) & is_fitted
        return model, Plan(problem, ~is_fitted, is_profiled, self.starts, inputs.max_steps)


@program
def _answer(inputs: _Inputs) -> tuple[Calibration, Hints]:
    _, plan = inputs.fits()
    found = jax.lax.fori_loop(0, num_fits(inputs.starts), plan.attempt, plan.begin())
    return _finish(inputs, found)


def _watched(inputs: _Inputs, progress: bool | None) -> tuple[Calibration, Hints]:
    """Return the result fit by fit, so that these can be watched, and interrupted."""
    number = num_fits(inputs.starts)
    found = _begin(inputs)
    with progress_bar("fit", number, "fit", shown=progress) as bar:
        for i in range(number):
            try:
                found = jax.block_until_ready(one_more_fit(inputs, i, found))
            except early_ends():
                if i == 0:
                    raise
                done = f"{i} of {number} fits are done, the best of which is returned"
                warn(f"The search was interrupted: {done}.", FitWarning)
                fit, hints = _finish(inputs, found)
                has_ended = fit.result == RESULTS.successful
                result = RESULTS.where(has_ended, RESULTS.interrupted, fit.result)
                return replace(fit, result=result), hints
            bar.update()
            if i == 0 and _is_hopeless(inputs, found):
                break
    return _finish(inputs, found)


def _is_hopeless(inputs: _Inputs, found: Search) -> bool:
    """Return whether a wrong sign or unit explains the first fit, so that starts near it fail."""
    is_far = not found.best.point.loss <= _LARGEST_LOSS
    return inputs.starts is None and is_far and bool(wrong_sign(inputs.measured, found.guess))


@program
def _begin(inputs: _Inputs) -> Search:
    return inputs.fits()[1].begin()


@program
def one_more_fit(inputs: _Inputs, number: int, so_far: Search) -> Search:
    """Run a fit of the search, and return the search with what it found."""
    return inputs.fits()[1].attempt(number, so_far)


@program
def _finish(inputs: _Inputs, found: Search) -> tuple[Calibration, Hints]:
    """Return the fit of a search, and hints at what it lacks.

    1. Take the parameters of the best fit and their errors.
    2. Refuse a fit that does not describe the measurements, or that they do not determine.
    3. Look for a cause of what the misfit has left.
    """
    model, plan = inputs.fits()
    problem = plan.problem
    best = found.best.point
    is_fitted = ~plan.held
    values = problem.values(best.free)
    parameters, zeros = model.parts(values)
    errors = _errors_of(plan, found, inputs.zeros)
    standard_errors, zero_errors = model.parts(errors.standard)
    by_kind = inputs.zeros.by_kind
    result = RESULTS.where(
        _is_unfit(plan, best, errors) & jnp.isfinite(best.loss), RESULTS.no_fit, found.result
    )
    fitted = dict(inputs.fitted)
    fit = Calibration(
        contact=model.contact_at(values),
        parameters=model.unravel(parameters),
        standard_errors=model.unravel(standard_errors),
        **by_kind(zeros),
        **{f"{kind}_error": error for kind, error in by_kind(zero_errors).items()},
        covariance=errors.covariance[is_fitted][:, is_fitted],
        mean_pressure=best.mean_pressure,
        load=problem.measured.load,
        measured=problem.measured.mean_pressure,
        area=inputs.contact.area,
        loss=best.loss,
        residual=found.best.residual,
        num_steps=found.num_steps,
        num_minima=found.num_minima,
        profile=profile_of(found, problem),
        result=result,
        losses=found.starts.losses,
        results=found.starts.results,
        names=(*inputs.where.names, *fitted),
        dimensions=(*inputs.where.dimensions, *fitted.values()),
    )
    return fit, _hints_of(plan, found, inputs.zeros)


class _Errors(NamedTuple):
    """The errors of the parameters, zero for those that are not fitted.

    Attributes:
        standard: the standard errors.
        relative: those of the variables, from the slopes of the curve alone.
        covariance: of the parameters.
    """

    standard: Values
    relative: Values
    covariance: Float[Array, "parameters parameters"]


def _errors_of(plan: Plan, found: Search, zeros: Zeros) -> _Errors:
    """Return the errors of the parameters.

    They are those of the slopes of the curve, raised to those of the profile, and added to them is
    the effect of the error of a drift that is not fitted, which the loads have in common.
    """
    problem = plan.problem
    best = found.best.point
    slopes = problem.slopes(best.free)
    of_slopes = directions(problem, best, plan.held).covariance
    relative = jnp.sqrt(jnp.diag(of_slopes))
    of_profile = found.errors(problem, plan.held, relative * slopes)
    factors = jnp.where(relative > 0, of_profile / relative, 0)
    in_common = jnp.zeros_like(relative)
    if zeros.drift_error is not None:
        # The drift is the last of the zeros.
        shifted = replace(best, misfit=best.jacobian[:, -1] * zeros.drift_error)
        in_common = directions(problem, shifted, plan.held).newton * slopes
    return _Errors(
        standard=jnp.hypot(of_profile, in_common),
        relative=relative,
        covariance=factors[:, None] * of_slopes * factors + jnp.outer(in_common, in_common),
    )


def _is_unfit(plan: Plan, best: Evaluation, errors: _Errors) -> Flag:
    """Return whether a fit is none: worse than a constant, or with parameters at their bounds."""
    problem = plan.problem
    is_fitted = ~plan.held
    # What remains of the measurements beside a constant.
    constant = replace(problem.measured, has_baseline=True).deviation
    remains = jnp.sum(constant**2) / jnp.sum(problem.measured.deviation**2) / 2
    is_far = best.loss > jnp.minimum(_LARGEST_LOSS, remains)
    bound = np.log(FARTHEST)
    is_at_bound = (jnp.abs(best.free) > bound) | ~(errors.relative < bound)
    is_known = jnp.all(jnp.isfinite(jnp.where(is_fitted, errors.standard, 0)))
    return is_far | jnp.any(is_at_bound & problem.is_log & is_fitted) | ~is_known


def _hints_of(plan: Plan, found: Search, zeros: Zeros) -> Hints:
    """Return what a Gauss-Newton step of all variables, offset and baseline too, hints at."""
    best = found.best.point
    # A tilt is not advised: what looks like one may be the far end of an attraction.
    kinds = np.array(zeros.kinds)
    advised = ("offset", "baseline")
    is_held = plan.held.copy()
    is_held[-len(kinds) :] &= ~np.isin(kinds, advised)
    step = directions(plan.problem, best, is_held).newton
    left = best.misfit - best.jacobian @ step
    missing = (step * plan.held)[-len(kinds) :]
    basis = _basis(best, ~plan.held)
    return Hints(
        guess=found.guess,
        zeros=-jnp.stack([jnp.mean(missing[kinds == kind]) for kind in advised]),
        drop=1 - jnp.sum(left**2) / (2 * best.loss),
        relief=_relief(best, basis),
        drift=_drift(best, basis, plan.problem.measured.roots),
    )


def _basis(best: Evaluation, is_fitted: Any) -> Rows:
    """Return an orthonormal basis of the changes of the curve, zero where there are fewer."""
    rows = best.jacobian[:, is_fitted]
    norms = jnp.linalg.norm(rows, axis=0)
    axes, sizes, _ = jnp.linalg.svd(rows / jnp.where(norms > 0, norms, 1), False)
    is_there = sizes > jnp.finfo(sizes.dtype).eps * len(rows) * jnp.max(sizes)
    return axes * is_there


def _relief(best: Evaluation, basis: Rows) -> Curve:
    """Return the fraction of the sum of squares that each measurement takes with it, left out."""
    leverage = jnp.sum(basis**2, axis=1)
    squares = best.misfit**2
    alone = jnp.maximum(1 - leverage, jnp.finfo(leverage.dtype).eps ** 0.5)
    return squares / alone / jnp.maximum(jnp.sum(squares), jnp.finfo(squares.dtype).tiny)


def _drift(best: Evaluation, basis: Rows, roots: Curve) -> Scalar:
    """Return the fraction of the sum of squares that a drift would remove."""
    line = roots * jnp.linspace(-1, 1, roots.size)
    line -= basis @ (basis.T @ line)
    left = best.misfit - basis @ (basis.T @ best.misfit)
    both = jnp.sum(line**2) * jnp.sum(left**2)
    return jnp.sum(line * left) ** 2 / jnp.maximum(both, jnp.finfo(both.dtype).tiny)

"""The result of a fit, its table, and the message of a fit that failed."""

from dataclasses import replace
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from jaxstab.calibration.advice import Hints, drift_of, outlier_of, wrong_sign
from jaxstab.calibration.least_squares import Curve, FitProblem, Measured
from jaxstab.calibration.model import values_of
from jaxstab.calibration.search import Search
from jaxstab.calibration.zeros import KINDS, kind_of
from jaxstab.contact import Contact
from jaxstab.core.checks import require_kind
from jaxstab.core.compile import program
from jaxstab.core.display import number, readable, several, table
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Scalar
from jaxstab.core.units import AREA, PRESSURE, chosen_unit, shown_unit
from jaxstab.loads import Load


class LossProfile(eqx.Module):
    """The profile of the loss: its minimum at fixed values of the worst determined parameter.

    Attributes:
        number: the index of the parameter among the leaves of `parameters`.
        values: of this parameter, ascending; NaN if the fit has no positive parameter.
        losses: the loss with all others fitted; infinite without an equilibrium.
    """

    number: Int[Array, ""]
    values: Float[Array, " values"]
    losses: Float[Array, " values"]


class Calibration(eqx.Module):
    """A contact fitted to a measured curve.

    Attributes:
        contact: the contact with the parameters found.
        parameters: these parameters, as selected by `where`.
        standard_errors: their standard errors, in the same structure, from the slopes of the
            curve, or larger ones from the profile if it is wider.
        offset: the zero of the loads: the contact is at load - offset, of a force curve less what
            the drift adds, and to a tip position the baseline [length].
        offset_error: its standard error; zero if it was not fitted.
        baseline: the zero of the measurements, in their unit; of both segments of a force curve
            two, of the approach and of the retraction, unless that has not detached.
        baseline_error: its standard error; zero if it was not fitted.
        tilt: the slope of the baseline, which is baseline + tilt load, over the length of the load;
            of a force curve over the height, baseline + tilt height, and as many as baselines.
        tilt_error: its standard error; zero if it was not fitted.
        drift: how far the zero of the loads moves from the first measurement to the last, fitted to
            both segments of a force curve [length].
        drift_error: its standard error; zero if it was not fitted.
        covariance: of the parameters, in the order of their leaves, then of offset, baseline, tilt
            and drift where they are fitted.
        mean_pressure: the fitted curve, with the baseline [pressure].
        load: the loads, one for each measurement.
        measured: the measured mean pressures [pressure].
        area: the area of the cell [length^2].
        loss: half the weighted sum of squared misfits over the sum of squared measurements, or,
            with a baseline, of squared deviations from their mean.
        residual: the largest remaining Gauss-Newton step, relative to each parameter.
        num_steps: steps of all fits.
        num_minima: the number of minima of the misfit that were found.
        profile: the least loss over the worst determined parameter.
        result: a member of `RESULTS`: how the fit ended.
        losses: the final loss of each start, infinite if there is none.
        results: how each start ended; `not_computed` if it was not needed.
        names: the names of the parameters, in the order of `covariance`.
        dimensions: their dimensions, as "energy/area"; "1" for those whose field declares none.
    """

    contact: Contact
    parameters: PyTree
    standard_errors: PyTree
    offset: Scalar
    offset_error: Scalar
    baseline: Float[Array, "*segments"]
    baseline_error: Float[Array, "*segments"]
    tilt: Float[Array, "*segments"]
    tilt_error: Float[Array, "*segments"]
    drift: Scalar
    drift_error: Scalar
    covariance: Float[Array, "parameters parameters"]
    mean_pressure: Annotated[Curve, PRESSURE]
    load: Load
    measured: Annotated[Curve, PRESSURE]
    area: Annotated[Scalar, AREA]
    loss: Scalar
    residual: Scalar
    num_steps: Int[Array, ""]
    num_minima: Int[Array, ""]
    profile: LossProfile
    result: RESULTS
    losses: Float[Array, " starts"]
    results: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    dimensions: tuple[str, ...] = eqx.field(static=True)

    @property
    def force(self) -> Curve:
        """The fitted curve, the mean pressure times the area [pressure length^2]."""
        return self.mean_pressure * self.area

    @property
    def residuals(self) -> Curve:
        """The misfit, measured less fitted forces [pressure length^2]."""
        return (self.measured - self.mean_pressure) * self.area

    def with_error_of_grid(self, other: "Calibration") -> "Calibration":
        """Return this fit, with its distance from the same fit on another grid among its errors.

        The error of a grid is smaller than this distance if the other has half as many points a
        side. Variances are added.

        Arguments:
            other: the fit of the same contact on the other grid to the same curve.

        Raises:
            TypeError: for something that is not a fit.
            ValueError: for a fit of other parameters.
        """
        require_kind(other, Calibration, "no fit: give a result of jaxstab.calibrate.")
        if self.names != other.names:
            raise ValueError(
                f"The other fit has the parameters {', '.join(other.names)}, this one "
                f"{', '.join(self.names)}: fit the same."
            )
        return _with_distance(self, other)

    @readable
    def __repr__(self) -> str:
        found = _found(self)
        divisors = np.array([divisor for _, _, divisor, _ in found])
        errors = numbers_of(self)[1] / divisors
        rows = {
            "parameter": self.names,
            "value": [number(value) for _, value, _, _ in found],
            "standard error": [f"{error:.2g}" for error in errors],
        }
        units = [unit for *_, unit in found]
        if any(units):
            rows["unit"] = units
        seen = several(int(self.num_minima), "minimum", "minima")
        head = f"Calibration: {self.result.name}, loss {float(self.loss):.3g}, {seen} seen"
        return f"{head}\n{table(rows)}"


@program
def _with_distance(fit: Calibration, other: Calibration) -> Calibration:
    errors, unravel = values_of(fit.standard_errors)
    away = values_of(fit.parameters)[0] - values_of(other.parameters)[0]
    zeros = {kind: getattr(fit, kind) - getattr(other, kind) for kind in _fitted_kinds(fit)}
    every = jnp.concatenate([away, *map(jnp.ravel, zeros.values())])
    raised = {
        f"{kind}_error": jnp.hypot(getattr(fit, f"{kind}_error"), zero)
        for kind, zero in zeros.items()
    }
    return replace(
        fit,
        standard_errors=unravel(jnp.hypot(errors, away)),
        covariance=fit.covariance + jnp.outer(every, every),
        **raised,
    )


def profile_of(found: Search, problem: FitProblem) -> LossProfile:
    """Return the profile, with the best fit among its values."""
    free = jnp.concatenate([found.profile.free, found.best.point.free[None]])
    at = jax.vmap(problem.values)(free)[:, found.weakest]
    losses = jnp.append(found.profile.losses, found.best.point.loss)
    order = jnp.argsort(at)
    has_any = found.profile.results.code[0] != RESULTS.not_computed.code
    return LossProfile(found.weakest, jnp.where(has_any, at[order], jnp.nan), losses[order])


def describe(fit: Calibration, measured: Measured, hints: Hints) -> str:
    """Describe the failure of a fit, with its cause and the cure."""
    values = ", ".join(
        f"{name} {value:.6g} {unit}".rstrip() for name, value, _, unit in _found(fit)
    )
    missing = jnp.isnan(fit.mean_pressure)
    if missing.any():
        return (
            f"The fit stopped at {values}: {int(missing.sum())} of {missing.size} loads "
            "have no equilibrium there, the first of them number "
            f"{int(jnp.argmax(missing))} (look at the unit, the sign and the zero of the loads, "
            "give these no weight, or start elsewhere)"
        )
    known = measured, fit.mean_pressure, len(fit.names)
    cause = outlier_of(*known) or wrong_sign(measured, hints.guess)
    # On the way to a fit little follows from derivatives.
    if not cause and fit.result != RESULTS.max_steps_reached:
        cause = outlier_of(*known, hints.relief) or drift_of(
            hints, int((measured.weights > 0).sum()) - len(fit.names) - 1
        )
    if cause or fit.result == RESULTS.no_fit:
        cause = cause or (
            "the guess is far from the measurements: compare its curve with them by `sweep`. Look "
            "at the units, the order of the loads and their zero, and start nearer"
        )
        return f"The fit ended at {values}, with a loss of {float(fit.loss):.3g}. Likely {cause}"
    tried = several(int(jnp.sum(fit.results != RESULTS.not_computed)), "start")
    return (
        f"The fit did not converge in {int(fit.num_steps)} steps from {tried}: at {values} they "
        f"would still change by a part of {float(fit.residual):.3g}. Jumps of the contact are the "
        "usual reason: give the loads in the order of the measurement, with "
        'order="continuation", start from parameters whose contact jumps at nearly the same loads, '
        "or give more `starts`"
    )


def numbers_of(fit: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Return the fitted numbers and their standard errors, in the order of the names."""
    zeros = [np.ravel(getattr(fit, kind)) for kind in _fitted_kinds(fit)]
    values = np.concatenate([values_of(fit.parameters)[0], *zeros])
    return values, np.sqrt(np.diag(fit.covariance))


def _fitted_kinds(fit: Calibration) -> list[str]:
    """Return the kinds of the zeros that are fitted, in the order of the names."""
    number = values_of(fit.parameters)[0].size
    fitted = set(map(kind_of, fit.names[number:]))
    return [kind for kind in KINDS if kind in fitted]


def units_of(fit: Calibration) -> list[tuple[float, str]]:
    """Return for each fitted number the divisor that brings it into a unit, and this unit."""
    chosen = [chosen_unit(fit.contact.units, dimension) for dimension in fit.dimensions]
    return [(divisor, shown_unit(unit)) for divisor, unit in chosen]


def _found(fit: Calibration) -> list[tuple[str, float, float, str]]:
    """Return for each fitted number its name, its value, the divisor of the value, and its unit."""
    columns = zip(fit.names, numbers_of(fit)[0], units_of(fit), strict=True)
    return [(name, float(value) / by, by, unit) for name, value, (by, unit) in columns]

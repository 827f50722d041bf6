"""The result of a fit, its table, and the message of a fit that failed."""

from typing import Annotated

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from jaxstab.calibration.advice import Hints, drift_of, outlier_of, wrong_sign
from jaxstab.calibration.least_squares import Measured
from jaxstab.calibration.model import ZEROS, values_of
from jaxstab.calibration.search import Search
from jaxstab.contact import Contact
from jaxstab.core.checks import array
from jaxstab.core.display import number, readable, several, table
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Scalar
from jaxstab.core.units import AREA, PRESSURE, chosen_unit, shown_unit
from jaxstab.loads import Load


class LossProfile(eqx.Module):
    """The profile of the loss: its minimum at fixed values of the worst determined parameter.

    Attributes:
        number: the index of the parameter among the leaves of `parameters`.
        values: of this parameter, ascending; the fitted one alone if no profile was needed.
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
        offset: the zero of the loads: the contact is at load - offset [length].
        offset_error: its standard error; zero if it was not fitted.
        baseline: the zero of the measurements, in their unit.
        baseline_error: its standard error; zero if it was not fitted.
        tilt: the slope of the baseline, which is baseline + tilt load, over the length of the load.
        tilt_error: its standard error; zero if it was not fitted.
        covariance: of the parameters, in the order of their leaves, then of offset, baseline and
            tilt where they are fitted.
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
        losses: the final loss of each start that was needed, infinite without an equilibrium.
        results: how each of them ended.
        names: the names of the parameters, in the order of `covariance`.
        dimensions: their dimensions, as "energy/area"; "1" for those whose field declares none.

    Example:
        >>> loads = js.MeanGap(jnp.linspace(0.08, 0.2, 6))
        >>> measured = js.sweep(contact, loads, stability=False).equilibrium.mean_pressure
        >>> fit = js.calibrate(contact, loads, measured, where=lambda c: c.potential.surface_energy)
        >>> fit.result.name
        'successful'
    """

    contact: Contact
    parameters: PyTree
    standard_errors: PyTree
    offset: Scalar
    offset_error: Scalar
    baseline: Scalar
    baseline_error: Scalar
    tilt: Scalar
    tilt_error: Scalar
    covariance: Float[Array, "parameters parameters"]
    mean_pressure: Annotated[Float[Array, " loads"], PRESSURE]
    load: Load
    measured: Annotated[Float[Array, " loads"], PRESSURE]
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
    def force(self) -> Float[Array, " loads"]:
        """The fitted curve, the mean pressure times the area [pressure length^2]."""
        return self.mean_pressure * self.area

    @property
    def residuals(self) -> Float[Array, " loads"]:
        """The misfit, measured less fitted forces [pressure length^2]."""
        return (self.measured - self.mean_pressure) * self.area

    @readable
    def __repr__(self) -> str:
        found = _rows_of(self)
        divisors = np.array([divisor for _, _, divisor, _ in found])
        errors = np.sqrt(np.diag(self.covariance)) / divisors
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


def profile_of(search: Search) -> LossProfile:
    """Return the profile, with the best fit among its values."""
    number = search.weakest
    points = [search.best.point, *(fit.point for fit in search.profile)]
    values = np.array([search.problem.values(point.free)[number] for point in points])
    order = np.argsort(values)
    losses = np.array([point.loss for point in points])
    return LossProfile(array(number), array(values[order]), array(losses[order]))


def describe(fit: Calibration, measured: Measured, hints: Hints) -> str:
    """Describe the failure of a fit, with its cause and the cure."""
    values = ", ".join(
        f"{name} {value:.6g} {unit}".rstrip() for name, value, _, unit in _rows_of(fit)
    )
    fitted = np.asarray(fit.mean_pressure)
    missing = np.isnan(fitted)
    if missing.any():
        return (
            f"The fit stopped at {values}: {int(missing.sum())} of {missing.size} loads "
            "have no equilibrium there, the first of them number "
            f"{int(np.argmax(missing))} (look at the unit, the sign and the zero of the loads, "
            "give these no weight, or start elsewhere)"
        )
    known = measured, fitted, len(fit.names)
    cause = outlier_of(*known) or wrong_sign(measured, hints.guess)
    # On the way to a fit little follows from derivatives.
    if not cause and fit.result != RESULTS.max_steps_reached:
        cause = outlier_of(*known, hints.relief) or drift_of(
            hints, measured.count - len(fit.names) - 1
        )
    if cause or fit.result == RESULTS.no_fit:
        cause = cause or (
            "the guess is far from the measurements: compare its curve with them by `sweep`. Look "
            "at the units, the order of the loads and their zero, and start nearer"
        )
        return f"The fit ended at {values}, with a loss of {float(fit.loss):.3g}. Likely {cause}"
    tried = several(len(fit.losses), "start")
    return (
        f"The fit did not converge in {int(fit.num_steps)} steps from {tried}: at {values} they "
        f"would still change by a part of {float(fit.residual):.3g}. Jumps of the contact are the "
        "usual reason: give the loads in the order of the measurement, with "
        'order="continuation", start from parameters whose contact jumps at nearly the same loads, '
        "or give more `starts`"
    )


def _rows_of(fit: Calibration) -> list[tuple[str, float, float, str]]:
    """Return for each fitted number its name, its value, the divisor of the value, and its unit."""
    zeros = [getattr(fit, name) for name in ZEROS if name in fit.names]
    values = np.append(values_of(fit.parameters), zeros)
    rows = []
    for name, value, dimension in zip(fit.names, values, fit.dimensions, strict=True):
        by, unit = chosen_unit(fit.contact.units, dimension)
        rows.append((name, float(value) / by, by, shown_unit(unit)))
    return rows

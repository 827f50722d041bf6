"""The fit of an interaction law and a modulus to a measured curve of pressure over load."""

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from jaxstab.calibration.least_squares import (
    Curve,
    Fit,
    LeastSquares,
    Measured,
    Order,
    Scale,
    Slopes,
    Values,
)
from jaxstab.calibration.model import Model, Pick, Where, values_of
from jaxstab.calibration.starts import best_of
from jaxstab.contact import Contact, require_contact
from jaxstab.contact.resolution import warn_if_coarse
from jaxstab.core.checks import integer, is_traced, parameter, require, require_finite
from jaxstab.core.compile import program
from jaxstab.core.display import block
from jaxstab.core.history import History
from jaxstab.core.implicit import refuse_derivatives
from jaxstab.core.loop import optional_parameter
from jaxstab.core.progress import advance, is_watched, progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.types import Scalar
from jaxstab.core.units import PRESSURE
from jaxstab.loads import Load, MeanPressure, require_load

# Imported where it is used, since that takes a while.
if TYPE_CHECKING:
    import optax


class Calibration(eqx.Module):
    """A contact fitted to a measured curve.

    Attributes:
        contact: the contact with the parameters found.
        parameters: these parameters, as `where` picks them.
        standard_errors: theirs, in the same structure, from the Jacobian and the misfit. NaN where
            the misfit does not rise around the fit as these say.
        covariance: that of the parameters, in the order of the leaves of `parameters`.
        mean_pressure: the fitted curve [pressure].
        loss: half the weighted sum of squared misfits, over that of the measured pressures.
        residual: the largest step of Gauss and Newton's method that is left, relative to each
            parameter.
        num_steps: steps of the optimiser, from all starts.
        result: a member of `RESULTS`: how the fit ended.
        history: the "residual" as it went.
        losses: the loss that each start came to, infinite where there is none.
        results: how each start ended; `not_computed` for those that were not needed.
    """

    contact: Contact
    parameters: Any
    standard_errors: Any
    covariance: Float[Array, "parameters parameters"]
    mean_pressure: Annotated[Curve, PRESSURE]
    loss: Scalar
    residual: Scalar
    num_steps: Int[Array, ""]
    result: RESULTS
    history: History
    losses: Float[Array, " starts"] | None = None
    results: RESULTS | None = None

    __repr__ = block


def potential_and_modulus(contact: Contact) -> Any:
    """Pick the parameters of the potential, and Young's modulus where there is one."""
    modulus = getattr(contact.solid, "youngs_modulus", None)
    return contact.potential if modulus is None else (contact.potential, modulus)


def calibrate(
    contact: Contact,
    load: Load,
    mean_pressure: ArrayLike,
    *,
    weights: ArrayLike | None = None,
    where: Where = potential_and_modulus,
    optimizer: "optax.GradientTransformation | None" = None,
    order: Order = "continuation",
    starts: int | None = None,
    tolerance: ArrayLike | None = None,
    max_steps: int = 200,
    progress: bool | None = None,
    throw: bool = True,
) -> Calibration:
    """Return the contact whose mean pressures are nearest to measured ones.

    It minimises sum_i w_i (p0_i - m_i)^2. Contacts with hysteresis jump, and so does the curve as
    parameters change: the least misfit may lie at a jump, where no method converges. It counts as
    found if two starts agree on it within a quarter.

    A parameter that starts positive is fitted by its logarithm and stays so; others by themselves.
    Only floating-point arrays are parameters: not integers, nor Python numbers written into a
    function.

    Arguments:
        contact: the contact with the parameters to start from.
        load: a mean displacement or gap with one value for each measurement, in their order. A load
            without an equilibrium fails the fit, unless its weight is zero.
        mean_pressure: m, the measured mean pressures, positive in compression [pressure].
        weights: w, one over the variance of each measurement up to a common factor; all equal by
            default.
        where: picks the parameters to fit from a contact, as in `equinox.tree_at`; by default all
            of the potential and Young's modulus.
        optimizer: any of Optax; by default Levenberg and Marquardt's method (J. SIAM 11, 431,
            1963).
        order: as in `sweep`: "continuation" starts each load from the one before, as a
            measurement does; "independent" starts all alike, without hysteresis.
        starts: how many starts: the contact's own parameters, others within a factor of two of
            them, and as many near the best fit so far. The best fit wins. By default as many as
            it takes until one converges, up to 8.
        tolerance: the relative change of every parameter, that a step of Gauss and Newton's method
            would make, to reach; 1e-6 by default. Of a parameter that does not start positive,
            the change over that which would change the curve by its own size.
        max_steps: the step limit.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        throw: raise an error if the fit does not converge; otherwise look at `result`.

    Returns:
        The fit. Standard errors are those of least squares: the misfit's variance times the
        inverse of J^T W J, J being the Jacobian of the curve. The misfit is then looked at three
        and five of them away. If it rises by far less than they say, the fit lies in one of many
        small minima: it has stagnated, and its standard errors are NaN.

    Raises:
        ValueError: for measurements that do not match the loads, are not finite, or are not more
            than the parameters. For negative weights, an unknown order, and `starts` below 1.
        TypeError: for a load that prescribes the pressure, or a contact in single precision.
        SolverError: if `throw` and the fit did not converge.
    """
    _require_problem(contact, load, order)
    starts = None if starts is None else integer("starts", starts)
    if starts is not None and starts < 1:
        raise ValueError(f"starts is {starts}: give at least 1.")
    curve = _measured(load, mean_pressure, weights)
    _require_determined(curve, values_of(where(contact))[0].size)
    warn_if_coarse(contact)
    solver = LeastSquares(optional_parameter(tolerance), max_steps, optimizer, order)
    # Compiled code reports its steps only where somebody sees them.
    is_seen = is_watched() if progress is None else progress
    bar = progress_bar(max_steps * (starts or 1), "step", shown=progress if is_seen else False)
    # Histories end in NaN, and what was not found is NaN.
    with bar, jax.debug_nans(False):
        fit = _fit(contact, curve, solver, Pick.of(where, contact), starts, is_seen)
    return throw_failure(fit.result, fit, lambda: _describe(fit), throw)


def _require_problem(contact: Contact, load: Load, order: Order) -> None:
    require_contact(contact)
    require_load(load)
    if isinstance(load, MeanPressure):
        raise TypeError("The load is a MeanPressure: fit a curve over a mean displacement or gap.")
    if order not in ("independent", "continuation"):
        raise ValueError(f'order is {order!r}: choose "independent" or "continuation".')
    if contact.heights.dtype != jnp.float64:
        raise TypeError(
            f"The heights are {contact.heights.dtype}: a fit needs float64, since near contact "
            "edges single precision leaves too many loads without a derivative."
        )


def _measured(load: Load, mean_pressure: ArrayLike, weights: ArrayLike | None) -> Measured:
    measured = parameter(mean_pressure)
    if load.value.ndim != 1 or measured.shape != load.value.shape:
        raise ValueError(
            f"There are loads of shape {load.value.shape} and mean pressures of shape "
            f"{measured.shape}: give as many of one as of the other, in one dimension."
        )
    require_finite("The measured pressure", measured)
    w = jnp.ones_like(measured) if weights is None else parameter(weights)
    if w.shape != measured.shape:
        raise ValueError(f"The weights have shape {w.shape}, the pressures {measured.shape}.")
    require("A weight", w, (w >= 0) & jnp.isfinite(w), "all must be finite and not negative.")
    return Measured(load, measured, w)


def _require_determined(curve: Measured, count: int) -> None:
    """Require more measurements with a weight than parameters, not all of them zero."""
    measured, w = curve.mean_pressure, curve.weights
    weighed = measured.size if is_traced(w) else int(jnp.sum(w > 0))
    if not 0 < count < weighed:
        raise ValueError(
            f"There are {count} parameters for {weighed} measurements of any weight: take more of "
            "these, or pick other parameters with `where`."
        )
    cure = "one with a weight must differ from zero."
    require("The measured pressure", measured, jnp.any(w * measured != 0), cure)


@partial(program, static_argnames=("where", "starts", "progress"))
def _fit(
    contact: Contact,
    measured: Measured,
    solver: LeastSquares,
    where: Pick,
    starts: int | None,
    progress: bool,
) -> Calibration:
    contact, measured = refuse_derivatives((contact, measured))
    values, unravel = values_of(where(contact))
    model = Model(contact, where, unravel)
    pressures, jacobian = model.curve(values, measured.load, solver.order)
    scale = Scale.of(values, measured.roots[:, None] * jacobian)
    zero = jnp.zeros_like(values)
    first = pressures, jacobian * scale.slopes(zero)

    def curve(free: Values) -> Slopes:
        values = scale.to_values(free)
        pressures, jacobian = model.curve(values, measured.load, solver.order)
        return pressures, jacobian * scale.slopes(free)

    def pressures_at(free: Values) -> Curve:
        return model.pressures(scale.to_values(free), measured.load, solver.order)

    report = advance if progress else lambda after: None
    fit = Fit(curve, pressures_at, measured.mean_pressure, measured.roots, first, report)
    tried = best_of(partial(solver.run, fit), starts, zero)
    state = tried.best.state
    found = scale.to_values(state.free)
    slopes = scale.slopes(state.free)
    # Derivatives at a small minimum say nothing about the width of the valley that it lies in.
    is_unsure = (tried.result == RESULTS.successful) & fit.is_flat(state)
    spread = slopes[:, None] * jnp.where(is_unsure, jnp.nan, fit.covariance(state)) * slopes
    return Calibration(
        contact=model.contact_at(found),
        parameters=unravel(found),
        standard_errors=unravel(jnp.sqrt(jnp.diag(spread))),
        covariance=spread,
        mean_pressure=state.mean_pressure,
        loss=state.loss,
        residual=tried.best.residual,
        num_steps=tried.num_steps,
        result=RESULTS.where(is_unsure, RESULTS.stagnated, tried.result),
        losses=tried.losses,
        results=tried.results,
        history=tried.best.history,
    )


def _describe(fit: Calibration) -> str:
    values = ", ".join(f"{value:.6g}" for value in values_of(fit.parameters)[0])
    missing = jnp.isnan(fit.mean_pressure)
    if missing.any():
        return (
            f"The fit stopped at parameters {values}: {int(missing.sum())} of {missing.size} loads "
            f"have no equilibrium or no derivative there, the first of them number "
            f"{int(jnp.argmax(missing))} (give them no weight, or start elsewhere)"
        )
    if jnp.isnan(fit.covariance).any():
        return (
            f"The fit ended at parameters {values}, in one of many small minima of the misfit: it "
            "has no standard errors. The curve does not determine all of them: fit fewer "
            "parameters with `where`, hold the others at several values and compare the `loss`, "
            "or take a finer grid"
        )
    tried = int(jnp.sum(fit.results != RESULTS.not_computed))
    return (
        f"The fit did not converge in {int(fit.num_steps)} steps from {tried} start"
        f"{'s' if tried > 1 else ''}: at parameters {values} they would still change by a part of "
        f"{float(fit.residual):.3g}. Jumps of the contact are the usual reason: give the loads in "
        'the order of the measurement, with order="continuation", start from parameters whose '
        "contact jumps at nearly the same loads, or give more `starts`"
    )

"""The fit of an interaction law and a modulus to a measured curve of pressure over load."""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from functools import partial
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxstab.checks import parameter, require, require_finite
from jaxstab.contact import Contact
from jaxstab.elasticity import HalfSpace
from jaxstab.equilibrium import PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find_equilibrium
from jaxstab.iterate import History, Indicators, Iteration, IterativeSolver, refuse_derivatives
from jaxstab.loads import Load, MeanPressure, require_load
from jaxstab.progress import advance, progress_bar
from jaxstab.results import RESULTS, throw_failure

Order = Literal["independent", "continuation"]
Values = Float[Array, " parameters"]
Curve = Float[Array, " loads"]
Where = Callable[[Contact], Any]

# Made once, since a new one would compile anew.
_LBFGS = optax.lbfgs()


class Calibration(eqx.Module):
    """A contact fitted to a measured curve.

    Attributes:
        contact: the contact with the parameters found.
        parameters: these parameters, as `where` picks them.
        standard_errors: theirs, in the same structure, from the Jacobian and the misfit.
        covariance: that of the parameters, in the order of the leaves of `parameters`.
        mean_pressure: the fitted curve [pressure].
        loss: half the weighted sum of squared misfits, over that of the measured pressures.
        residual: the largest step of Gauss and Newton's method that is left, relative to each
            parameter.
        num_steps: steps of the optimiser.
        result: a member of `RESULTS`: how the fit ended.
        history: the "residual" as it went.
    """

    contact: Contact
    parameters: Any
    standard_errors: Any
    covariance: Float[Array, "parameters parameters"]
    mean_pressure: Curve
    loss: Float[Array, ""]
    residual: Float[Array, ""]
    num_steps: Int[Array, ""]
    result: RESULTS
    history: History


def potential_and_modulus(contact: Contact) -> Any:
    """Pick the parameters of the potential, and Young's modulus where there is one."""
    if isinstance(contact.solid, HalfSpace):
        return contact.potential, contact.solid.youngs_modulus
    return contact.potential


def calibrate(
    contact: Contact,
    load: Load,
    mean_pressure: ArrayLike,
    *,
    weights: ArrayLike | None = None,
    where: Where = potential_and_modulus,
    optimizer: optax.GradientTransformation | None = None,
    order: Order = "independent",
    tolerance: ArrayLike = 1e-6,
    max_steps: int = 200,
    progress: bool = False,
    throw: bool = True,
) -> Calibration:
    """Return the contact whose mean pressures are nearest to measured ones.

    It minimises sum_i w_i (p0_i - m_i)^2. A parameter that starts positive is fitted by its
    logarithm and stays so; others by themselves.

    Arguments:
        contact: the contact with the parameters to start from.
        load: a mean displacement or gap with one value for each measurement.
        mean_pressure: m, the measured mean pressures, positive in compression [pressure].
        weights: w, one over the variance of each measurement up to a common factor; all equal by
            default.
        where: picks the parameters to fit from a contact, as in `equinox.tree_at`; by default all
            of the potential and Young's modulus.
        optimizer: any of Optax; `optax.lbfgs()` by default.
        order: as in `sweep`: whether all loads start alike, or each from the one before, as along
            a measured branch.
        tolerance: the relative change of every parameter, that a step of Gauss and Newton's method
            would make, to reach.
        max_steps: the step limit.
        progress: show a progress bar.
        throw: raise where the fit does not converge; otherwise look at `result`.

    Returns:
        The fit. Standard errors are those of least squares: the misfit's variance times the
        inverse of J^T W J, J being the Jacobian of the curve.

    Raises:
        ValueError: for measurements that do not match the loads or are not finite, not more of
            them than parameters, weights that are negative, or an order that does not exist.
        TypeError: for a load that prescribes the pressure.
        SolverError: if `throw` and the fit did not converge.
    """
    require_load(load)
    if isinstance(load, MeanPressure):
        raise TypeError("The load is a MeanPressure: fit a curve over a mean displacement or gap.")
    if order not in ("independent", "continuation"):
        raise ValueError(f'order is {order!r}: choose "independent" or "continuation".')
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
    count = ravel_pytree(where(contact))[0].size
    if not 0 < count < measured.size:
        raise ValueError(
            f"There are {count} parameters for {measured.size} measurements: take more of these, "
            "or pick other parameters with `where`."
        )
    solver = _LeastSquares(parameter(tolerance), max_steps, optimizer or _LBFGS, order)
    curve = _Measured(load, measured, w)
    with progress_bar(max_steps, "step") if progress else nullcontext():
        fit = _fit(contact, curve, solver, where, progress)
    if not throw:
        return fit
    return throw_failure(fit.result, fit, lambda: _describe(fit))


class _Measured(eqx.Module):
    load: Load
    mean_pressure: Curve
    weights: Curve


class _Scale(eqx.Module):
    """The map between parameters and the numbers that are optimised: logarithms, or the same."""

    is_positive: Bool[Array, " parameters"]

    def to_free(self, values: Values) -> Values:
        return jnp.where(self.is_positive, jnp.log(jnp.where(self.is_positive, values, 1)), values)

    def to_values(self, free: Values) -> Values:
        return jnp.where(self.is_positive, jnp.exp(jnp.where(self.is_positive, free, 0)), free)


class _State(eqx.Module):
    free: Values
    optimizer: optax.OptState
    mean_pressure: Curve
    misfit: Curve
    jacobian: Float[Array, "loads parameters"]


class _LeastSquares(IterativeSolver):
    """Steps of an optimiser of Optax, until Gauss and Newton's method would change little."""

    tolerance: Float[Array, ""] | None
    max_steps: Int[Array, ""] = eqx.field(converter=jnp.asarray)
    optimizer: optax.GradientTransformation = eqx.field(static=True)
    order: Order = eqx.field(static=True)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-6}
    patience: ClassVar[int] = 100

    def solve(
        self,
        curve: Callable[[Values], tuple[Curve, Float[Array, "loads parameters"]]],
        measured: _Measured,
        free: Values,
        advance: Callable[[Array], None],
    ) -> Iteration[_State]:
        """Minimise the misfit between a curve, given with its Jacobian, and measurements."""
        root = jnp.sqrt(measured.weights)
        root = root / jnp.linalg.norm(root * measured.mean_pressure)
        optimizer = optax.with_extra_args_support(self.optimizer)

        def at(free: Any, optimizer_state: Any = None) -> _State:
            pressure, jacobian = curve(free)
            misfit = root * (pressure - measured.mean_pressure)
            return _State(free, optimizer_state, pressure, misfit, root[:, None] * jacobian)

        @jax.custom_jvp
        def loss(free: Values) -> Float[Array, ""]:
            return jnp.sum(at(free).misfit ** 2) / 2

        @loss.defjvp
        def _(primals: tuple[Values], tangents: tuple[Values]) -> tuple[Array, Array]:
            # All of the Jacobian costs one adjoint solve for each load.
            state = at(*primals)
            gradient = state.misfit @ state.jacobian
            return jnp.sum(state.misfit**2) / 2, jnp.sum(gradient * tangents[0])

        def step(state: _State) -> _State:
            gradient = state.misfit @ state.jacobian
            updates, optimizer_state = optimizer.update(
                gradient,
                state.optimizer,
                state.free,
                value=jnp.sum(state.misfit**2) / 2,
                grad=gradient,
                value_fn=loss,
            )
            advance(gradient)
            return at(optax.apply_updates(state.free, updates), optimizer_state)

        def measure(state: _State) -> Indicators:
            change = -jnp.linalg.lstsq(state.jacobian, state.misfit)[0]
            errors = jnp.sqrt(jnp.diag(covariance(state)))
            # Of a parameter that is not determined, no more than its error is asked.
            return {"residual": jnp.max(jnp.abs(change) / jnp.maximum(1, errors))}

        return self.iterate(step, measure, at(free, optimizer.init(free)))


def covariance(state: _State) -> Float[Array, "parameters parameters"]:
    """Return the covariance of what is optimised, |r|^2 / (n - p) (J^T J)^-1."""
    _, sizes, axes = jnp.linalg.svd(state.jacobian, full_matrices=False)
    smallest = jnp.finfo(sizes.dtype).eps * jnp.max(sizes)
    scaled = axes / jnp.maximum(sizes, smallest)[:, None]
    count = jnp.sum(jnp.any(state.jacobian != 0, axis=1)) - len(sizes)
    return jnp.sum(state.misfit**2) / jnp.maximum(count, 1) * (scaled.T @ scaled)


@partial(jax.jit, static_argnames=("where", "progress"))
def _fit(
    contact: Contact, measured: _Measured, solver: _LeastSquares, where: Where, progress: bool
) -> Calibration:
    contact, measured = refuse_derivatives((contact, measured))
    values, unravel = ravel_pytree(where(contact))
    scale = _Scale(values > 0)

    def contact_at(free: Values) -> Contact:
        return eqx.tree_at(where, contact, unravel(scale.to_values(free)))

    def pressure(free: Values, load: Load, start: Array | None) -> tuple[Array, Array]:
        method = PreconditionedConjugateGradient()
        found = find_equilibrium(contact_at(free), load, method, start)
        is_found = found.result == RESULTS.successful
        return jnp.where(is_found, found.mean_pressure, jnp.nan), found.gap

    one_load = jax.value_and_grad(pressure, has_aux=True)

    def together(free: Values) -> tuple[Curve, Array]:
        (pressures, _), jacobian = jax.vmap(lambda load: one_load(free, load, None))(measured.load)
        return pressures, jacobian

    def in_turn(free: Values) -> tuple[Curve, Array]:
        def follow(start: Array, load: Load) -> tuple[Array, tuple[Array, Array]]:
            (value, gap), row = one_load(free, load, start)
            return jnp.where(jnp.isnan(value), start, gap), (value, row)

        first = jax.tree.map(lambda leaf: leaf[0], measured.load)
        start = first.control(contact.heights).starting_gap(contact.heights)
        return jax.lax.scan(follow, start, measured.load)[1]

    curve = together if solver.order == "independent" else in_turn
    report = advance if progress else lambda after: None
    iteration = solver.solve(curve, measured, scale.to_free(values), report)
    state = iteration.state
    found = scale.to_values(state.free)
    slopes = jnp.where(scale.is_positive, found, 1)
    spread = slopes[:, None] * covariance(state) * slopes
    return Calibration(
        contact=contact_at(state.free),
        parameters=unravel(found),
        standard_errors=unravel(jnp.sqrt(jnp.diag(spread))),
        covariance=spread,
        mean_pressure=state.mean_pressure,
        loss=jnp.sum(state.misfit**2) / 2,
        residual=iteration.residual,
        num_steps=iteration.num_steps,
        result=iteration.result,
        history=iteration.history,
    )


def _describe(fit: Calibration) -> str:
    values = ", ".join(f"{value:.6g}" for value in ravel_pytree(fit.parameters)[0])
    return (
        f"The fit did not converge in {int(fit.num_steps)} steps: at parameters {values} they "
        f"would still change by a part of {float(fit.residual):.3g}"
    )

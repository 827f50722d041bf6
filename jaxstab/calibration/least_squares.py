"""Nonlinear least squares: steps of a method, until a Gauss-Newton step would be small."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.core.history import Indicators
from jaxstab.core.loop import IterativeSolver, Loop, integer_parameter
from jaxstab.core.types import Flag, Scalar
from jaxstab.loads import Load

# Imported where it is used, since that takes a while.
if TYPE_CHECKING:
    import optax

Order = Literal["continuation", "independent"]
Values = Float[Array, " parameters"]
Curve = Float[Array, " loads"]
# A curve and its Jacobian.
Slopes = tuple[Curve, Float[Array, "loads parameters"]]

# Marquardt's damping: the first, and by what it falls after a step that helps and grows after one
# that does not.
_DAMPING = 1e-2
_FALL, _GROWTH = 0.1, 5.0
# The misfit is looked at so many standard errors away, and no farther than this in variables of the
# fit. It must rise by these parts of what the derivatives say, unless the error is smaller than
# that. A jump beside a good fit lowers it by a constant, which counts for more nearer to it.
_CHECKED_AT, _FARTHEST = (3.0, 5.0), 0.5
_LEAST_RISE, _SMALLEST = (0.25, 0.4), 1e-3


class Measured(eqx.Module):
    """A measured curve: loads, mean pressures and their weights."""

    load: Load
    mean_pressure: Curve
    weights: Curve

    @property
    def roots(self) -> Curve:
        """Roots of the weights, such that the measurements have a norm of 1."""
        roots = jnp.sqrt(self.weights)
        return roots / jnp.linalg.norm(roots * self.mean_pressure)


class Scale(eqx.Module):
    """The map from fit variables to parameters, zero at the start: logarithms, or multiples."""

    start: Values
    unit: Values

    @classmethod
    def of(cls, start: Values, jacobian: Float[Array, "loads parameters"]) -> "Scale":
        """Return the map from a start, in multiples that change the curve by its own size."""
        sizes = jnp.linalg.norm(jacobian, axis=0)
        return cls(start, 1 / jnp.where(sizes > 0, sizes, 1))

    def to_values(self, free: Values) -> Values:
        """Return the parameters."""
        is_positive = self.start > 0
        grown = self.start * jnp.exp(jnp.where(is_positive, free, 0))
        return jnp.where(is_positive, grown, self.start + self.unit * free)

    def slopes(self, free: Values) -> Values:
        """Return the derivatives of the parameters by the variables of the fit."""
        return jnp.where(self.start > 0, self.to_values(free), self.unit)


class FitState(eqx.Module):
    """Where a fit is."""

    free: Values
    # What the method remembers: its damping, or the state of an optimiser.
    memory: Any
    mean_pressure: Curve
    misfit: Curve
    jacobian: Float[Array, "loads parameters"]
    # The largest change by the last step, if it was not taken; otherwise infinite.
    reach: Scalar

    @property
    def loss(self) -> Scalar:
        """Half the sum of squared misfits."""
        return jnp.sum(self.misfit**2) / 2

    @property
    def gradient(self) -> Values:
        """That of the loss."""
        return self.misfit @ self.jacobian

    def principal(self) -> tuple[Values, Float[Array, "parameters parameters"]]:
        """Return the slope of the curve along each principal axis of the variables, and these."""
        _, sizes, axes = jnp.linalg.svd(self.jacobian, full_matrices=False)
        return jnp.maximum(sizes, jnp.finfo(sizes.dtype).eps * jnp.max(sizes)), axes


StateAt = Callable[[Values, Any], FitState]
Move = Callable[[FitState], FitState]


@dataclass(frozen=True)
class Fit:
    """The misfit between a curve and measurements.

    Attributes:
        curve: the curve and its Jacobian.
        pressures: the curve alone.
        mean_pressure: the measurements.
        roots: of their weights.
        first: the curve at zero, which need not be evaluated again.
        report: called at each step.
        memory, move: the first memory of a method, and its step.
    """

    curve: Callable[[Values], Slopes]
    pressures: Callable[[Values], Curve]
    mean_pressure: Curve
    roots: Curve
    first: Slopes
    report: Callable[[Array], None]
    memory: Any = None
    move: Move = lambda state: state

    def state_of(self, free: Any, memory: Any, evaluated: Slopes) -> FitState:
        """Return where a fit is, whose curve is known."""
        pressure, jacobian = evaluated
        rows = jnp.where(self.roots[:, None] > 0, self.roots[:, None] * jacobian, 0)
        return FitState(free, memory, pressure, self.misfit(pressure), rows, jnp.array(jnp.inf))

    def misfit(self, pressure: Curve) -> Curve:
        """Return the weighted misfit of a curve; without weight it need not even be finite."""
        return jnp.where(self.roots > 0, self.roots * (pressure - self.mean_pressure), 0)

    def variance(self, state: FitState) -> Scalar:
        """Return that of a measurement, |r|^2 / (n - p), n the loads of weight."""
        count = jnp.sum(self.roots > 0) - len(state.free)
        return 2 * state.loss / jnp.maximum(count, 1)

    def is_flat(self, state: FitState) -> Flag:
        """Return whether the misfit rises far less around a point than its derivatives say.

        Contact points that come and go one by one make a curve with kinks. Its misfit has many
        small minima, each narrower than the noise allows. Errors below a limit are not looked at.
        """
        variance, (sizes, axes) = self.variance(state), state.principal()
        errors = jnp.sqrt(variance) / sizes
        distances = jnp.asarray(_CHECKED_AT)[:, None]
        reach = jnp.minimum(distances * errors, _FARTHEST)
        moves = reach[:, :, None] * axes
        ends = state.free + jnp.stack([moves, -moves])
        pressures = jax.lax.map(self.pressures, ends.reshape(-1, len(state.free)))
        misfits = jax.vmap(self.misfit)(pressures).reshape(*ends.shape[:3], -1)
        rise = jnp.sum(misfits**2, axis=-1) / 2 - state.loss
        # Without an equilibrium there is no misfit: that is no low one.
        least = jnp.asarray(_LEAST_RISE)[:, None]
        is_low = rise < least * (reach * sizes) ** 2 / 2
        return jnp.any(is_low & (errors > _SMALLEST))

    def covariance(self, state: FitState) -> Float[Array, "parameters parameters"]:
        """Return that of the variables, the variance of a measurement times (J^T J)^-1."""
        sizes, axes = state.principal()
        scaled = axes / sizes[:, None]
        return self.variance(state) * (scaled.T @ scaled)

    def state_at(self, free: Any, memory: Any) -> FitState:
        """Return where a fit is."""
        return self.state_of(free, memory, self.curve(free))


class LeastSquares(IterativeSolver):
    """Levenberg and Marquardt's method, until that of Gauss and Newton would change little.

    Or the steps of an optimiser of Optax, if one is given. Where the curve jumps as parameters
    change, the least misfit may lie at the jump. It is reached where no step larger than the
    tolerance lowers it.
    """

    tolerance: Scalar | None
    max_steps: Int[Array, ""] = eqx.field(converter=integer_parameter)
    optimizer: "optax.GradientTransformation | None" = eqx.field(static=True)
    order: Order = eqx.field(static=True)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-6}
    patience: ClassVar[int] = 100

    def prepared(self, problem: "Fit", start: Values) -> "Fit":
        """Return the problem with the method's step."""
        method = _marquardt if self.optimizer is None else partial(_optimised, self.optimizer)
        memory, move = method(problem.state_at, jnp.zeros_like(start))
        return replace(problem, memory=memory, move=move)

    def init(self, problem: "Fit", start: Values) -> FitState:
        """Return where a fit begins."""
        zero = jnp.zeros_like(start)
        return jax.lax.cond(
            jnp.any(start != zero),
            lambda: problem.state_at(start, problem.memory),
            lambda: problem.state_of(zero, problem.memory, problem.first),
        )

    def step(self, problem: "Fit", state: FitState) -> FitState:
        """Return where a step of the method leads."""
        problem.report(state.misfit)
        return problem.move(state)

    def measure(self, problem: "Fit", state: FitState) -> Indicators:
        """Return the largest change by a step of Gauss and Newton's method."""
        # Of combinations that are not determined, nothing is asked.
        change = jnp.linalg.lstsq(state.jacobian, state.misfit)[0]
        return {"residual": jnp.max(jnp.abs(change))}

    def _is_stalled(self, loop: Loop[FitState]) -> Flag:
        return super()._is_stalled(loop) | (loop.state.reach < self._goal(loop))


def _marquardt(state_at: StateAt, free: Values) -> tuple[Any, Move]:
    """Return the first damping, and a step of Levenberg and Marquardt's method.

    A step that does not lower the misfit, or leads to where there is none, is not taken: the next
    one is shorter.
    """

    def move(state: FitState) -> FitState:
        sizes = jnp.linalg.norm(state.jacobian, axis=0)
        rows = jnp.concatenate([state.jacobian, jnp.diag(jnp.sqrt(state.memory) * sizes)])
        aims = jnp.concatenate([state.misfit, jnp.zeros_like(sizes)])
        change = jnp.linalg.lstsq(rows, aims)[0]
        tried = state_at(state.free - change, _FALL * state.memory)
        reach = jnp.max(jnp.abs(change))
        stays = replace(state, memory=_GROWTH * state.memory, reach=reach)
        # Beside an event of the contact there may be no derivative to go on by.
        is_lower = (tried.loss <= state.loss) & jnp.all(jnp.isfinite(tried.jacobian))
        return jax.tree.map(lambda new, old: jnp.where(is_lower, new, old), tried, stays)

    return jnp.asarray(_DAMPING, free.dtype), move


def _optimised(
    optimizer: "optax.GradientTransformation", state_at: StateAt, free: Values
) -> tuple[Any, Move]:
    """Return the first state of an optimiser of Optax, and a step of it."""
    import optax

    optimizer = optax.with_extra_args_support(optimizer)

    @jax.custom_jvp
    def loss(free: Values) -> Scalar:
        return state_at(free, None).loss

    @loss.defjvp
    def _(primals: tuple[Values], tangents: tuple[Values]) -> tuple[Array, Array]:
        # All of the Jacobian costs one adjoint solve for each load.
        state = state_at(*primals, None)
        return state.loss, jnp.sum(state.gradient * tangents[0])

    def move(state: FitState) -> FitState:
        updates, memory = optimizer.update(
            state.gradient,
            state.memory,
            state.free,
            value=state.loss,
            grad=state.gradient,
            value_fn=loss,
        )
        moved: Any = optax.apply_updates(state.free, updates)
        return state_at(moved, memory)

    return optimizer.init(free), move

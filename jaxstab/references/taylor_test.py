"""A Taylor test of derivatives: do the remainders fall as Taylor's theorem says?

As `taylor_test` of pyadjoint (Farrell, Ham, Funke and Rognes 2013) does, with steps of both signs,
whose second differences tell a wrong derivative from a kink and from noise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from jaxstab.core import display
from jaxstab.core.checks import require_known, require_one_of

_NUM_STEPS = 12
# Remainders fall with rates 1 and 2 along a line of steps: a rate of 2 is at least this.
_LEAST_RATE = 1.8
# Remainders count where they are so many times the noise, and the fewest steps that give a rate.
_ABOVE_NOISE = 5
_FEWEST = 3
# A rate is taken from the last so many of them.
_WINDOW = 4
# Where too few count, the remainders of a linear function are this part of its differences.
_LINEAR = 1e-4
# The rates of second differences below which these are noise, and the rates of a kink.
_FLAT = 0.5
_SMOOTH = 1.7
# A rounding unit above this is not of double precision; a smaller error has another cause.
_DOUBLE = 1e-12
_SMALL_ERROR = 0.005

_NONFINITE_VALUE = (
    "The function is NaN or infinite at the point or near it: choose a point inside of its domain, "
    "or give a smaller direction."
)
_NONFINITE_DERIVATIVE = (
    "The derivative is NaN or infinite: it does not exist at the point, as where a state has not "
    "converged, or a branch that jnp.where does not take is not finite."
)
_KINK = (
    "The function has a kink at or near the point: its slopes to both sides differ, or its "
    "curvature is infinite."
)
_SINGLE = "single precision is not enough, use float64."
_LOOSE = "set a tighter tolerance in the solver behind them, or give a larger direction."
_INEXACT = "it is inexact, as if a solver behind it stops at a loose tolerance."
_WRONG = "its rule is wrong."


@dataclass(frozen=True)
class TaylorTest:
    """The remainders of a Taylor test, and whether they fall at the right rates.

    Norms are Euclidean, and the larger one of steps forwards and backwards. In brackets are the
    powers of the step with which they fall if the derivative is right.

    Attributes:
        steps: h, multiples of the direction, from the largest.
        differences: |f(x + h v) - f(x)|, at each step (1).
        remainders: |f(x + h v) - f(x) - h f'(x) v|, at each step (2).
        rates: the two powers, over the smallest steps above the noise; NaN where there are too few.
        noise: the size of rounding, or of other jumps of the function from step to step.
        success: whether the derivative is right to within the noise.
        message: the likely cause of a failure, else an empty text.

    Example:
        >>> test = js.check_derivative(lambda gap: law(gap), 0.1)
        >>> [f"{rate:.0f}" for rate in test.rates]
        ['1', '2']
    """

    steps: np.ndarray
    differences: np.ndarray
    remainders: np.ndarray
    rates: tuple[float, float]
    noise: float
    success: bool
    message: str

    def __repr__(self) -> str:
        sizes = {"step": self.steps, "difference": self.differences, "remainder": self.remainders}
        columns = {name: display.column(x, "{:.2e}".format) for name, x in sizes.items()}
        text = self.message
        if self.success:
            text = "The derivative passes."
        rates = f"rates {self.rates[0]:.2f} and {self.rates[1]:.2f}, noise {self.noise:.1e}"
        return f"{display.table(columns)}\n{rates}. {text}"


def check_derivative(
    function: Callable[[PyTree], PyTree],
    point: PyTree,
    direction: PyTree = None,
    *,
    mode: Literal["fwd", "rev"] = "rev",
) -> TaylorTest:
    """Test the derivative of a function along a direction, by its Taylor remainders.

    By Taylor's theorem |f(x + h v) - f(x)| = O(h) and |f(x + h v) - f(x) - h f'(x) v| = O(h^2).
    Where the derivative is wrong, or the function is not smooth, the second falls more slowly.

    Arguments:
        function: maps a pytree to one array, or a scalar. A law, the pressure of a solid, a result.
        point: x, a pytree with floating-point leaves; other leaves are kept fixed.
        direction: v, a pytree like `point`. By default a random one: to each entry of a leaf a
            normal number, times the leaf's rms value. Twelve steps h are tried, from eps^(1/8) to
            eps^(2/5), with eps the rounding unit.
        mode: the derivative to test, by reverse mode ("rev", as `jax.grad`) or forward mode
            ("fwd", as `jax.jvp`). Reverse mode tests the product of an array with a random one.

    Returns:
        A `TaylorTest`: print it for the table. Nothing is raised if the derivative is wrong.

    Raises:
        ValueError: if a leaf is zero everywhere, so that its scale is unknown: give a direction;
            for another mode.
        TypeError: under a JAX transformation, or if the point has no floating-point leaf.

    Example:
        >>> def pressure(gap):
        ...     return js.equilibrate(contact, js.MeanGap(gap)).mean_pressure
        >>> js.check_derivative(pressure, 0.05).success
        True
    """
    require_known(point, "check_derivative")
    require_one_of("mode", mode, ("fwd", "rev"))
    moving, held = eqx.partition(point, eqx.is_inexact_array_like)
    moving = jax.tree.map(jnp.asarray, moving)
    leaves = jax.tree.leaves(moving)
    if not leaves:
        raise TypeError(f"The point is {point!r}: give at least one floating-point number.")
    if direction is None:
        direction = _random_direction(moving)
    else:
        direction, _ = eqx.partition(direction, eqx.is_inexact_array_like)
        direction = jax.tree.map(lambda v, x: jnp.asarray(v, x.dtype), direction, moving)

    def objective(moved: PyTree) -> PyTree:
        return jnp.asarray(function(eqx.combine(moved, held)))

    if mode == "rev":
        image = objective(moving)
        if image.ndim:
            weights = jax.random.normal(jax.random.key(1), image.shape, image.dtype)
            array, objective = objective, lambda moved: jnp.vdot(weights, array(moved))
        value, gradient = jax.value_and_grad(objective)(moving)
        products = jax.tree.map(jnp.vdot, gradient, direction)
        tangent = sum(jax.tree.leaves(products))
    else:
        value, tangent = jax.jvp(objective, (moving,), (direction,))

    def change(step: float) -> np.ndarray:
        moved = jax.tree.map(lambda x, v: x + jnp.asarray(step, x.dtype) * v, moving, direction)
        return np.asarray(objective(moved), np.float64) - np.asarray(value, np.float64)

    eps = max(float(jnp.finfo(x.dtype).eps) for x in (*leaves, value))
    steps = np.geomspace(eps ** (1 / 8), eps ** (2 / 5), _NUM_STEPS)
    forward, backward = (np.array([change(sign * h) for h in steps]) for sign in (1, -1))
    return _assess(steps, np.asarray(value), np.asarray(tangent), forward, backward, eps)


def _random_direction(point: PyTree) -> PyTree:
    leaves, structure = jax.tree.flatten_with_path(point)
    keys = jax.random.split(jax.random.key(0), len(leaves))
    moves = []
    for key, (path, leaf) in zip(keys, leaves, strict=True):
        scale = jnp.sqrt(jnp.mean(leaf**2))
        if scale == 0:
            name = jax.tree_util.keystr(path) or "The point"
            raise ValueError(
                f"{name} is 0, {leaf.shape}: give a direction, for its scale is unknown."
            )
        moves.append(scale * jax.random.normal(key, leaf.shape, leaf.dtype))
    return jax.tree.unflatten(structure, moves)


def _assess(
    steps: np.ndarray,
    value: np.ndarray,
    tangent: np.ndarray,
    forward: np.ndarray,
    backward: np.ndarray,
    eps: float,
) -> TaylorTest:
    """Return the test, from the changes of the value at steps forwards and backwards."""

    def norms(fields: np.ndarray) -> np.ndarray:
        return np.linalg.norm(fields.reshape(len(fields), -1), axis=1)

    h = steps.reshape(-1, *[1] * value.ndim)
    differences = np.maximum(norms(forward), norms(backward))
    remainders = np.maximum(norms(forward - h * tangent), norms(backward + h * tangent))
    # The derivative cancels in these: they tell how smooth the function is.
    curvatures = forward + backward
    seconds = norms(curvatures)
    rounding = 8 * eps * float(np.linalg.norm(value) + np.linalg.norm(tangent))
    # Smooth ones shrink as the squares of the steps.
    rough = norms(curvatures[1:] / h[1:] ** 2 - curvatures[:-1] / h[:-1] ** 2)
    noise = max(rounding, *(rough * steps[1:] ** 2)[-3:].tolist())
    first, second, bend = (_rate(steps, x, noise) for x in (differences, remainders, seconds))
    is_constant = differences.max() <= rounding and not tangent.any()
    is_hidden = noise > _LINEAR * differences[0] and not is_constant
    if np.isnan(second):
        success = not is_hidden and remainders[0] <= max(_LINEAR * differences[0], rounding)
    else:
        success = second > _LEAST_RATE
    is_noise = bend < _FLAT or (is_hidden and (np.isnan(bend) or np.isnan(second)))
    message = ""
    if not (np.isfinite(value).all() and np.isfinite(differences).all()):
        message = _NONFINITE_VALUE
    elif not np.isfinite(tangent).all():
        message = _NONFINITE_DERIVATIVE
    elif not success and is_noise:
        message = f"The values jump by {noise:.1e} from step to step: "
        if eps > _DOUBLE:
            message += _SINGLE
        else:
            message += _LOOSE
    elif not success and bend < _SMOOTH:
        message = _KINK
    elif not success:
        quotients = (forward - backward) / (2 * h)
        error = float(np.min(norms(quotients - tangent) / norms(quotients)))
        message = f"The derivative differs from central differences by {100 * error:.2g} %: "
        if error < _SMALL_ERROR:
            message += _INEXACT
        else:
            message += _WRONG
    rates = first, second
    return TaylorTest(steps, differences, remainders, rates, noise, not message, message)


def _rate(steps: np.ndarray, sizes: np.ndarray, noise: float) -> float:
    """Return the power with which sizes fall, over the smallest steps where they count."""
    counts = np.flatnonzero(sizes > _ABOVE_NOISE * noise)[-_WINDOW:]
    if counts.size < _FEWEST:
        return np.nan
    return float(np.polyfit(np.log(steps[counts]), np.log(sizes[counts]), 1)[0])

"""Generated rough surfaces: waves and self-affine surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Int, PRNGKeyArray

from jaxstab.core.checks import (
    concrete,
    integer,
    possible,
    require,
    require_key,
    require_one_of,
    require_positive,
    scalar_parameter,
)
from jaxstab.core.compile import program
from jaxstab.core.grid import Grid, require_grid
from jaxstab.core.types import ArrayLike, Field, Scalar
from jaxstab.surfaces.arguments import ROUNDING
from jaxstab.surfaces.statistics import nyquist, rms_derivative


def sinusoid(grid: Grid, amplitude: ArrayLike, waves: int | tuple[int, ...] | None = None) -> Field:
    """Return h = A cos(2 pi k.x / L), a wavy surface (Westergaard, 1939).

    Arguments:
        grid: the grid.
        amplitude: A, half the height from trough to summit [length].
        waves: k, the number of waves along each side; one along the first by default.

    Returns:
        Heights [length], of zero mean.

    Raises:
        ValueError: if there is not one number of waves for each side, all are zero, the grid does
            not resolve them, or the amplitude is an array.
        TypeError: if a number of waves is not an integer.

    Example:
        >>> wave = js.surfaces.sinusoid(grid, amplitude=0.1, waves=(2, 0))
        >>> f"{wave[0, 0]:.1f}, {wave[4, 0]:.1f}"
        '0.1, -0.1'
    """
    require_grid(grid)
    if waves is None:
        waves = (1,) + (0,) * (len(grid.shape) - 1)
    elif isinstance(waves, int | float | np.integer):
        waves = (waves,)
    if len(waves) != len(grid.shape) or not any(waves):
        raise ValueError(f"waves are {waves}: give one number for each side, not all zero.")
    numbers = np.array([integer("A number of waves", k) for k in waves])
    cure = f"it must not exceed half of the points, {grid.shape}."
    require("A number of waves", numbers, 2 * np.abs(numbers) <= grid.shape, cure)
    return _sinusoid(grid, scalar_parameter(amplitude, "The amplitude"), numbers)


@program
def _sinusoid(grid: Grid, amplitude: Scalar, waves: Int[np.ndarray, " sides"]) -> Field:
    sides = zip(waves, grid.coordinates, grid.lengths, strict=True)
    phase = sum(2 * jnp.pi * k * x / length for k, x, length in sides)
    return amplitude * jnp.cos(phase)


def self_affine(
    grid: Grid,
    key: PRNGKeyArray,
    *,
    hurst: ArrayLike = 0.8,
    k_low: ArrayLike = 2.0,
    k_rolloff: ArrayLike | None = None,
    k_high: ArrayLike = 32.0,
    rms_height: ArrayLike | None = None,
    rms_slope: ArrayLike | None = None,
    exponent: str = "field",
) -> Field:
    """Return a Gaussian self-affine surface by Fourier filtering (Rey & Bleyer, eq. 43).

    White noise is filtered by the square root of the power spectrum Phi(k) = C for
    k_low <= k <= k_rolloff, C (k / k_rolloff)^-s up to k_high, and 0 elsewhere. k is the number of
    waves per longest side of the cell. C follows from the given one of `rms_height` and
    `rms_slope`, which this surface has exactly. The noise belongs to the waves, not to the
    points: one key gives the same surface on every grid that resolves more than `k_high` waves.
    JAX's random numbers differ in single precision, and so does the surface: to use one surface in
    both precisions, draw it in double precision and cast it, `heights.astype(jnp.float32)`.

    Arguments:
        grid: the grid.
        key: the random key.
        hurst: H, the Hurst exponent, in [0, 1].
        k_low, k_rolloff, k_high: cut-offs of the spectrum [waves per side]; `k_rolloff` is `k_low`
            by default.
        rms_height: root mean square height [length].
        rms_slope: root mean square slope.
        exponent: "field" for the field's s = 2 H + d on a d-dimensional grid (2 + 2 H on a
            surface), or "paper" for s = 2 + H as eq. 43 is printed.

    Returns:
        Heights [length], of zero mean.

    Raises:
        ValueError: unless exactly one of `rms_height` and `rms_slope` is given. If cut-offs are not
            ordered or too fine for the grid, or no wave lies between them. For arrays in place of
            numbers.
        TypeError: for anything but a random key.

    Example:
        >>> rough = js.surfaces.self_affine(grid, jax.random.key(1), k_high=8, rms_slope=0.1)
        >>> f"{js.surfaces.rms_slope(grid, rough):.3f}"
        '0.100'
    """
    require_grid(grid)
    require_key(key)
    targets = [x for x in (rms_height, rms_slope) if x is not None]
    if len(targets) != 1:
        raise ValueError("Give exactly one of rms_height and rms_slope: it sets the amplitude.")
    target = scalar_parameter(targets[0], "The rms height or slope")
    require_positive("The rms height or slope", target)
    require_one_of("exponent", exponent, ("field", "paper"))
    if k_rolloff is None:
        k_rolloff = k_low
    named = {"hurst": hurst, "k_low": k_low, "k_rolloff": k_rolloff, "k_high": k_high}
    hurst, *cutoffs = (scalar_parameter(value, name) for name, value in named.items())
    given, low, rolloff, high = map(concrete, (hurst, *cutoffs))
    is_exponent = (given >= 0) & (given <= 1)
    require("The Hurst exponent", given, is_exponent, "it must lie in [0, 1].")
    is_ordered = (low > 0) & (low <= rolloff) & (rolloff <= high)
    cure = "they must be positive and ascend."
    require("[k_low, k_rolloff, k_high]", [low, rolloff, high], is_ordered, cure)
    resolved = nyquist(grid.shape, concrete(grid.lengths)).min()
    cure = f"the grid resolves {resolved} waves per longest side; refine it or lower k_high."
    is_resolved = high <= resolved * (1 + ROUNDING)
    require("k_high", high, is_resolved, cure)
    target = possible(target, (concrete(target) > 0) & is_exponent & is_ordered & is_resolved)
    order = 0
    if rms_slope is not None:
        order = 1
    heights, num_waves = _filtered_noise(grid, key, hurst, cutoffs, target, exponent, order)
    name = "The number of waves between k_low and k_high"
    require(name, num_waves, concrete(num_waves) > 0, "widen the cut-offs.")
    return heights


@partial(program, static_argnames=("exponent", "order"))
def _filtered_noise(
    grid: Grid,
    key: PRNGKeyArray,
    hurst: Scalar,
    cutoffs: Sequence[Scalar],
    target: Scalar,
    exponent: str,
    order: int,
) -> tuple[Field, Int[Array, ""]]:
    """Return a surface with a target rms of its derivative of an order, and its number of waves."""
    k_low, k_rolloff, k_high = cutoffs
    k = grid.wavenumbers * jnp.max(grid.lengths) / (2 * jnp.pi)
    passes = (k >= k_low * (1 - ROUNDING)) & (k <= k_high * (1 + ROUNDING))
    power = {"field": 2 * hurst + len(grid.shape), "paper": hurst + 2}[exponent]
    spectrum = jnp.maximum(jnp.where(passes, k, k_rolloff), k_rolloff) ** -power
    modes = jnp.where(passes, jnp.sqrt(spectrum), 0) * _wave_noise(grid, key)
    heights = grid.inverse_transform(modes)
    return heights * (target / rms_derivative(grid, heights, order)), jnp.sum(passes)


def _wave_noise(grid: Grid, key: PRNGKeyArray) -> Complex[Array, " *modes"]:
    """Return complex normal noise on the half spectrum, equal for a wave on every grid."""
    *across, along = (jnp.asarray(k, jnp.int32) for k in grid.waves)
    if across:
        k = across[0]
        rest = 0
    else:
        k = jnp.zeros_like(along)
        # On a line the high bits of a wave take the place of the wave across.
        rest = along >> 16
    # The half spectrum keeps both of the waves k and -k only if `along` is zero.
    is_conjugate = (along == 0) & (k < 0)
    label = grid.device_put((jnp.where(is_conjugate, -k, k) & 0xFFFF) | (along << 16) | rest)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(key, label.ravel().astype(jnp.uint32))
    real, imaginary = jax.vmap(lambda key: jax.random.normal(key, (2,)))(keys).T
    noise = (real + 1j * jnp.where(is_conjugate.ravel(), -imaginary, imaginary)) * grid.size
    return grid.device_put(noise.reshape(label.shape))

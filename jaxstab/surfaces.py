"""Rough surfaces and their statistics, all of them exact in Fourier space.

A surface is an array of heights on a grid [length]; summits point towards the elastic solid.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float, PRNGKeyArray

from jaxstab.checks import parameter, require, require_positive
from jaxstab.grid import Grid


def paraboloid(grid: Grid, radius: ArrayLike) -> Float[Array, " *grid"]:
    """Return h = -r^2 / (2 R), its summit in the middle of the cell (Rey & Bleyer, eq. 40).

    Arguments:
        grid: the grid; on a line the summit is that of a parabolic cylinder.
        radius: R, the radius of curvature at the summit [length].

    Returns:
        Heights [length], zero at the summit.

    Raises:
        ValueError: if the radius is not positive.
    """
    radius = parameter(radius)
    require_positive("The radius", radius)
    distances = zip(grid.coordinates, grid.lengths, strict=True)
    return -sum((x - length / 2) ** 2 for x, length in distances) / (2 * radius)


def sinusoid(
    grid: Grid, amplitude: ArrayLike, waves: tuple[int, ...] | None = None
) -> Float[Array, " *grid"]:
    """Return h = A cos(2 pi k.x / L), a wavy surface (Westergaard, 1939).

    Arguments:
        grid: the grid.
        amplitude: A, half the height from trough to summit [length].
        waves: k, the number of waves along each side; one along the first by default.

    Returns:
        Heights [length], of zero mean.

    Raises:
        ValueError: if there is not one number of waves for each side, or all are zero.
    """
    waves = (1,) + (0,) * (len(grid.shape) - 1) if waves is None else waves
    if len(waves) != len(grid.shape) or not any(waves):
        raise ValueError(f"waves are {waves}: give one number for each side, not all zero.")
    sides = zip(waves, grid.coordinates, grid.lengths, strict=True)
    phase = sum(2 * jnp.pi * k * x / length for k, x, length in sides)
    return parameter(amplitude) * jnp.cos(phase)


def self_affine(
    grid: Grid,
    key: PRNGKeyArray,
    *,
    hurst: ArrayLike = 0.8,
    k_low: ArrayLike = 2.0,
    k_rolloff: ArrayLike = 2.0,
    k_high: ArrayLike = 32.0,
    rms_height: ArrayLike | None = None,
    rms_slope: ArrayLike | None = None,
    exponent: str = "field",
) -> Float[Array, " *grid"]:
    """Return a Gaussian self-affine surface by Fourier filtering (Rey & Bleyer, eq. 43).

    White noise is filtered by the square root of the power spectrum Phi(k) = C for
    k_low <= k <= k_rolloff, C (k / k_rolloff)^-s up to k_high, and 0 elsewhere, with k the number
    of waves per longest side of the cell; C is set by the one of `rms_height` and `rms_slope`
    that is given, which this very surface has exactly. The noise belongs to the waves, not to the
    points: one key gives one surface in each precision, on every grid that resolves it.

    Arguments:
        grid: the grid.
        key: the random key that decides the surface.
        hurst: H, the Hurst exponent, in [0, 1].
        k_low, k_rolloff, k_high: cut-offs of the spectrum [waves per side].
        rms_height: root mean square height [length].
        rms_slope: root mean square slope.
        exponent: "field" for the field's s = 2 H + d on a d-dimensional grid (2 + 2 H on a
            surface), or "paper" for s = 2 + H as eq. 43 is printed.

    Returns:
        Heights [length], of zero mean.

    Raises:
        ValueError: unless exactly one of `rms_height` and `rms_slope` is given, if cut-offs are
            not ordered, or too fine for the grid, or no wave lies between them.
    """
    targets = [x for x in (rms_height, rms_slope) if x is not None]
    if len(targets) != 1:
        raise ValueError("Give exactly one of rms_height and rms_slope: it sets the amplitude.")
    target = parameter(targets[0])
    require_positive("The rms height or slope", target)
    if exponent not in ("field", "paper"):
        raise ValueError(f'exponent is {exponent!r}: choose "field" or "paper".')
    hurst, k_low, k_rolloff, k_high = map(parameter, (hurst, k_low, k_rolloff, k_high))
    require("The Hurst exponent", hurst, (hurst >= 0) & (hurst <= 1), "it must lie in [0, 1].")
    cutoffs = jnp.stack([k_low, k_rolloff, k_high])
    ordered = (k_low > 0) & (k_low <= k_rolloff) & (k_rolloff <= k_high)
    require("[k_low, k_rolloff, k_high]", cutoffs, ordered, "they must be positive and ascend.")

    side = jnp.max(grid.lengths)
    nyquist = jnp.min(side / (2 * grid.spacing))
    cure = f"the grid resolves {nyquist} waves per longest side; refine it or lower k_high."
    require("k_high", k_high, k_high <= nyquist * (1 + _ROUNDING), cure)
    k = grid.wavenumbers * side / (2 * jnp.pi)
    passes = (k >= k_low * (1 - _ROUNDING)) & (k <= k_high * (1 + _ROUNDING))
    cure = "widen the cut-offs."
    require("The number of waves between k_low and k_high", jnp.sum(passes), passes.any(), cure)

    power = 2 * hurst + len(grid.shape) if exponent == "field" else hurst + 2
    spectrum = jnp.maximum(jnp.where(passes, k, k_rolloff), k_rolloff) ** -power
    modes = jnp.where(passes, jnp.sqrt(spectrum), 0) * _wave_noise(grid, key)
    heights = jnp.fft.irfftn(modes, s=grid.shape)
    order = 0 if rms_slope is None else 1
    return heights * (target / _rms_derivative(grid, heights, order))


def rms_height(heights: Float[Array, " *grid"]) -> Float[Array, ""]:
    """Return the root mean square height about the mean [length]."""
    return jnp.std(heights)


def rms_slope(grid: Grid, heights: Float[Array, " *grid"]) -> Float[Array, ""]:
    """Return the root mean square of |grad h|."""
    return _rms_derivative(grid, heights, 1)


def rms_curvature(grid: Grid, heights: Float[Array, " *grid"]) -> Float[Array, ""]:
    """Return the root mean square of the mean curvature, lap h / d in d dimensions [1/length]."""
    return _rms_derivative(grid, heights, 2) / len(grid.shape)


class PowerSpectrum(eqx.Module):
    """The radial average of a surface's power spectral density.

    Attributes:
        wavenumber: the middle q of each ring, a multiple of 2 pi over the longest side [1/length].
        density: mean of |h(q)|^2 over the waves of the ring, with h(q) the Fourier transform over
            the cell divided by the root of its area, so that the mean square height is the sum
            over all waves of density / area [length^4 on a surface, length^3 on a line].
        num_waves: how many waves the ring holds; density is zero where there are none.
    """

    wavenumber: Float[Array, " rings"]
    density: Float[Array, " rings"]
    num_waves: Float[Array, " rings"]


def power_spectrum(grid: Grid, heights: Float[Array, " *grid"]) -> PowerSpectrum:
    """Return the radial power spectrum of a surface, up to the corner of its spectrum.

    Arguments:
        grid: the grid; its lengths must be known, since they decide the number of rings.
        heights: the surface [length].
    """
    longest = np.max(np.asarray(grid.lengths))
    fundamental = 2 * np.pi / longest
    finest = np.linalg.norm(longest / (2 * np.asarray(grid.spacing)))
    num_rings = int(finest) + 2
    ring = jnp.round(grid.wavenumbers / fundamental).astype(int)
    multiplicity = jnp.asarray(grid.mode_multiplicity)
    power = multiplicity * jnp.abs(jnp.fft.rfftn(heights)) ** 2 * grid.cell_area / grid.size
    num_waves = jnp.zeros(num_rings).at[ring].add(multiplicity)
    density = jnp.zeros(num_rings).at[ring].add(power) / jnp.maximum(num_waves, 1)
    return PowerSpectrum(fundamental * jnp.arange(1, num_rings), density[1:], num_waves[1:])


# Rounding must not decide whether a wave at a cut-off belongs to the spectrum.
_ROUNDING = 1e-5


def _rms_derivative(grid: Grid, heights: Float[Array, " *grid"], order: int) -> Float[Array, ""]:
    """Return the rms of |q|^order h(q), by Parseval's theorem."""
    q = grid.wavenumbers
    squares = jnp.where(q > 0, (q**order * jnp.abs(jnp.fft.rfftn(heights))) ** 2, 0)
    return jnp.sqrt(jnp.sum(grid.mode_multiplicity * squares)) / grid.size


def _wave_noise(grid: Grid, key: PRNGKeyArray) -> Complex[Array, " *modes"]:
    """Return complex normal noise that each wave of `rfftn` has on every grid alike."""
    *across, along = (k.astype(np.int32) for k in grid.waves)
    k = across[0] if across else np.zeros_like(along)
    # Of the waves k and -k the half spectrum keeps both only where `along` is zero.
    is_conjugate = (along == 0) & (k < 0)
    label = (np.where(is_conjugate, -k, k) & 0xFFFF) | (along << 16)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.asarray(label.ravel(), jnp.uint32))
    real, imaginary = jax.vmap(lambda key: jax.random.normal(key, (2,)))(keys).T
    noise = (real + 1j * jnp.where(is_conjugate.ravel(), -imaginary, imaginary)) * grid.size
    return noise.reshape(along.shape)

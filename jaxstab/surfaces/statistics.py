"""Statistics of surfaces, computed in Fourier space, where the surface is periodic.

Heights are an array, or a `Topography` with its own grid. All statistics but `rms_height` give a
`SurfaceWarning` for heights that look wrong, as `jaxstab.Contact` does: a tilt, or opposite edges
that do not meet, change slopes, spectra and energies. Remove a tilt by `Topography.detrended()`,
and make edges meet by `Topography.periodic("mirror")`, which changes statistics least.
"""

from functools import partial
from typing import Any, ClassVar, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core.checks import (
    array,
    concrete,
    numbers,
    parameter,
    require,
    require_finite,
    require_shape,
    where_known,
)
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.grid import Grid, require_grid
from jaxstab.core.types import ArrayLike, Field, Scalar
from jaxstab.surfaces.topography import FILL, Topography, as_topography, warn_of_faults

# Rounding must not decide which ring a point at its edge belongs to.
_ROUNDING = 1e-3


class Elastic(Protocol):
    """The attributes of a solid that statistics need."""

    is_window: ClassVar[bool]

    @property
    def grid(self) -> Grid: ...  # noqa: D102
    def apply(self, displacement: Array, /) -> Array: ...  # noqa: D102
    def with_uniform_stiffness(self, stiffness: ArrayLike, /) -> Any: ...  # noqa: D102


def rms_height(heights: Field | Topography) -> Scalar:
    """Return the root mean square height about the mean [length].

    Example:
        >>> f"{js.surfaces.rms_height(heights):.3f}"
        '0.050'
    """
    return _standard_deviation(_complete(heights))


_standard_deviation = jax.jit(jnp.std)


def rms_slope(grid: Grid, heights: Field | Topography) -> Scalar:
    """Return the root mean square of |grad h|.

    Example:
        >>> wave = js.surfaces.sinusoid(grid, amplitude=0.1, waves=(1, 0))
        >>> f"{js.surfaces.rms_slope(grid, wave):.4f}"
        '0.4443'
    """
    return rms_derivative(grid, _heights_on(grid, heights), 1)


def rms_curvature(grid: Grid, heights: Field | Topography) -> Scalar:
    """Return the root mean square of the mean curvature, lap h / d in d dimensions [1/length].

    Example:
        >>> wave = js.surfaces.sinusoid(grid, amplitude=0.1, waves=(1, 0))
        >>> f"{js.surfaces.rms_curvature(grid, wave):.4f}"
        '1.3958'
    """
    return rms_derivative(grid, _heights_on(grid, heights), 2) / len(grid.shape)


class PowerSpectrum(eqx.Module):
    """The radial average of a surface's power spectral density.

    Attributes:
        wavenumber: the middle q of each ring, a multiple of 2 pi over the longest side [1/length].
        density: mean of |h(q)|^2 over the waves of the ring [length^4 on a surface, length^3 on a
            line]. h(q) is the Fourier transform over the cell divided by the root of its area. So
            the mean square height is the sum over all waves of density / area.
        num_waves: how many waves the ring holds; density is zero where there are none.

    Example:
        >>> spectrum = js.surfaces.power_spectrum(grid, heights)
        >>> [f"{q / (2 * np.pi):.0f}" for q in spectrum.wavenumber[:3]]
        ['1', '2', '3']
    """

    wavenumber: Float[Array, " rings"]
    density: Float[Array, " rings"]
    num_waves: Float[Array, " rings"]


@own_conventions()
def power_spectrum(grid: Grid, heights: Field | Topography) -> PowerSpectrum:
    """Return the radial power spectrum of a surface, up to the corner of its spectrum.

    The spectrum of a `Topography` is computed in double precision in any case: in single precision
    densities of small surfaces in metres underflow.

    Arguments:
        grid: the grid; its lengths must be known, since they decide the number of rings.
        heights: the surface [length].

    Raises:
        ValueError: for heights of another shape than the grid, or not finite, and for densities
            that underflow.
        TypeError: for anything but a grid.

    Example:
        >>> spectrum = js.surfaces.power_spectrum(grid, heights)
        >>> bool(spectrum.density[1] > spectrum.density[5])
        True
    """
    if isinstance(heights, Topography) and not jax.config.values["jax_enable_x64"]:
        with jax.ensure_compile_time_eval(), jax.enable_x64(True):
            return jax.tree.map(np.asarray, power_spectrum(grid, heights))
    heights = _heights_on(grid, heights)
    lengths = np.asarray(grid.lengths)
    fundamental = 2 * np.pi / lengths.max()
    num_rings = int(np.linalg.norm(nyquist(grid.shape, lengths))) + 2
    spectrum, power = _spectrum_of_rings(num_rings, grid, heights, array(fundamental))
    _require_range(power, heights)
    return spectrum


@partial(program, static_argnums=0)
def _spectrum_of_rings(
    num_rings: int, grid: Grid, heights: Field, fundamental: Scalar
) -> tuple[PowerSpectrum, Float[Array, " *modes"]]:
    """Return the spectrum, averaged over rings, and the power of each mode."""
    ring = jnp.round(grid.wavenumbers / fundamental).astype(int)
    multiplicity = grid.mode_multiplicity
    power = multiplicity * jnp.abs(grid.transform(heights)) ** 2 * grid.cell_area / grid.size
    num_waves = jnp.zeros(num_rings).at[ring].add(multiplicity)
    density = jnp.zeros(num_rings).at[ring].add(power) / jnp.maximum(num_waves, 1)
    wavenumber = fundamental * jnp.arange(1, num_rings)
    return PowerSpectrum(wavenumber, density[1:], num_waves[1:]), power


@where_known
def _require_range(power: Float[Array, " *modes"], heights: Field) -> None:
    """Raise `ValueError` if densities underflow, or many of the smaller ones do."""
    limits = np.finfo(power.dtype)
    largest = np.max(concrete(power).ravel()[1:])
    has_range = (largest >= limits.tiny / limits.eps) | (np.ptp(concrete(heights)) == 0)
    cure = (
        f"smaller ones underflow in {power.dtype}. Give heights and lengths in a smaller unit, as "
        "nm, or enable float64."
    )
    require("The largest density of the spectrum", largest, has_range, cure)


class Autocorrelation(eqx.Module):
    """The radial average of a surface's autocorrelation.

    Attributes:
        distance: mean |r| of the points of each ring, the first zero alone, up to half
            the longest side [length].
        value: mean of <h(x) h(x + r)> over them, the mean square height at zero [length^2].

    Example:
        >>> found = js.surfaces.autocorrelation(grid, heights)
        >>> f"{found.value[0] / js.surfaces.rms_height(heights) ** 2:.3f}"
        '1.000'
    """

    distance: Float[Array, " rings"]
    value: Float[Array, " rings"]


@own_conventions()
def autocorrelation(grid: Grid, heights: Field | Topography) -> Autocorrelation:
    """Return the radial autocorrelation <h(x) h(x + r)> of heights about their mean.

    It is the Fourier transform of |h(q)|^2 (Wiener and Khinchin), averaged over rings as wide as
    the larger spacing.

    Arguments:
        grid: the grid; its lengths must be known, since they decide the number of rings.
        heights: the surface [length].

    Raises:
        ValueError: for heights of another shape than the grid, or not finite.
        TypeError: for anything but a grid.

    Example:
        >>> found = js.surfaces.autocorrelation(grid, heights)
        >>> [f"{c / found.value[0]:.2f}" for c in found.value[:3]]
        ['1.00', '0.75', '0.39']
    """
    heights = _heights_on(grid, heights)
    lengths = np.asarray(grid.lengths)
    width = (lengths / grid.shape).max()
    num_rings = int(lengths.max() / (2 * width) + _ROUNDING) + 1
    sides = zip(grid.coordinates, grid.lengths, strict=True)
    distance = jnp.sqrt(sum(jnp.minimum(x, length - x) ** 2 for x, length in sides))
    # JAX drops indices beyond the last ring.
    ring = jnp.ceil(distance / width - _ROUNDING).astype(int)
    power = jnp.abs(grid.transform(heights - jnp.mean(heights))) ** 2
    value = grid.inverse_transform(power) / grid.size

    def average(field: Field) -> Float[Array, " rings"]:
        return jnp.zeros(num_rings, field.dtype).at[ring].add(field, mode="drop")

    num_points = average(jnp.ones_like(distance))
    return Autocorrelation(average(distance) / num_points, average(value) / num_points)


@own_conventions()
def full_contact_energy(solid: Elastic, heights: Field | Topography) -> Scalar:
    """Return the elastic energy of full contact per area of the cell [energy/area].

    The energy is u.Ku / 2 with u = h, for a half space E*/4 sum |q| |h(q)|^2 (Persson & Tosatti, J.
    Chem. Phys. 115, 2001), less the energy of the solid in a rigid displacement.

    Arguments:
        solid: the solid, of any kind.
        heights: the surface on its grid [length].

    Raises:
        ValueError: for heights of another shape than the grid, or not finite.
        TypeError: for anything but a solid.

    Example:
        >>> f"{js.surfaces.full_contact_energy(solid, heights):.5f}"
        '0.01013'
    """
    return _energy(solid, _heights_on(_grid_of(solid), heights, solid.is_window))


def _energy(solid: Elastic, heights: Field) -> Scalar:
    if solid.is_window:
        # A rigid displacement stores the least energy if it takes no force.
        pressure = solid.apply(heights)
        level = solid.apply(jnp.ones_like(heights))
        rigid = jnp.sum(pressure) / jnp.sum(level)
        return jnp.mean((heights - rigid) * (pressure - rigid * level)) / 2
    return solid.with_uniform_stiffness(0).energy(heights - jnp.mean(heights)) / solid.grid.area


@own_conventions()
def effective_work_of_adhesion(
    solid: Elastic, heights: Field | Topography, work: ArrayLike
) -> Scalar:
    """Return the effective work of adhesion w A / A0 - U / A0 [energy/area].

    Persson & Tosatti, J. Chem. Phys. 115 (2001). A / A0 is the mean of sqrt(1 + |grad h|^2), with
    the gradient of the Fourier series, on a window of the mirrored surface, and U the energy of
    full contact. If it is negative, the surfaces do not stay in full contact.

    A `Contact` counts the energy of its law per projected area, without the factor A / A0: in full
    contact it gains w - U / A0, with U / A0 from `full_contact_energy`.

    Arguments:
        solid: the solid, of any kind.
        heights: the surface on its grid [length].
        work: w, the work of adhesion between flat surfaces [energy/area].

    Raises:
        ValueError: for heights of another shape than the grid, or not finite, and for work that is
            negative or not finite.
        TypeError: for anything but a solid.

    Example:
        >>> f"{js.surfaces.effective_work_of_adhesion(solid, heights, work=0.03):.4f}"
        '0.0284'
    """
    grid = _grid_of(solid)
    heights = _heights_on(grid, heights, solid.is_window)
    given = concrete(parameter(work, "The work of adhesion"))
    is_possible = (given >= 0) & (given < np.inf)
    require("The work of adhesion", given, is_possible, "it must be finite, and not negative.")
    energy = _energy(solid, heights)
    if solid.is_window:
        # The edges of a window need not meet, but those of its mirror images do.
        heights = jnp.pad(heights, [(0, n) for n in grid.shape], mode="symmetric")
        grid = Grid(heights.shape, 2 * grid.lengths, sharding=grid.sharding)
    squared_slope = sum(slope**2 for slope in _gradient(grid, heights))
    true_area = jnp.mean(jnp.sqrt(1 + squared_slope))
    return true_area * work - energy


def _grid_of(solid: Elastic) -> Grid:
    grid = getattr(solid, "grid", None)
    if isinstance(solid, Topography) or not isinstance(grid, Grid):
        raise TypeError(
            f"The solid is a {type(solid).__name__}: give the solid first, then the heights."
        )
    return grid


def _heights_on(grid: Grid, heights: object, is_window: bool = False) -> Field:
    """Return heights as an array, which must be on the grid; warn if they look wrong there."""
    require_grid(grid)
    topography = as_topography(heights, grid)
    if topography:
        heights = topography.on(grid)
    heights = _complete(heights)
    require_shape("The array of heights", heights.shape, grid.shape, "they must agree.")
    warn_of_faults(heights, topography, grid.lengths, is_window)
    return grid.device_put(heights)


def _complete(heights: object) -> Float[Array | np.ndarray, " *grid"]:
    """Return heights as an array, which must be finite if known."""
    if isinstance(heights, Topography):
        heights = heights.heights
    complete = numbers(heights, "The array of heights")
    require_finite("A height", complete, FILL)
    if isinstance(complete, np.ndarray):
        # No statistic depends on a constant, which would cost digits in single precision.
        complete = complete - complete.mean()
    return complete


def _gradient(grid: Grid, heights: Field) -> list[Field]:
    modes = grid.transform(heights)
    sides = zip(grid.waves, grid.shape, grid.lengths, strict=True)
    # The Nyquist wave is a cosine on the points, where its slope is zero.
    factors = [2j * jnp.pi / L * np.where(2 * abs(k) == n, 0, k) for k, n, L in sides]
    return [grid.inverse_transform(factor * modes) for factor in factors]


def nyquist(shape: tuple[int, ...], lengths: Array | np.ndarray) -> Array | np.ndarray:
    """Return the Nyquist wavenumber along each side, in waves per longest side."""
    return lengths.max() * np.array(shape) / (2 * lengths)


@partial(program, static_argnums=2)
def rms_derivative(grid: Grid, heights: Field, order: int) -> Scalar:
    """Return the rms of |q|^order h(q), by Parseval's theorem."""
    q = grid.wavenumbers
    squares = jnp.where(q > 0, (q**order * jnp.abs(grid.transform(heights))) ** 2, 0)
    return jnp.sqrt(jnp.sum(grid.mode_multiplicity * squares)) / grid.size

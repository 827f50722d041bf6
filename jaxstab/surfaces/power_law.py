"""The power law of a measured spectrum."""

from dataclasses import dataclass

import numpy as np

from jaxstab.core.checks import require_kind
from jaxstab.surfaces import faults
from jaxstab.surfaces.statistics import PowerSpectrum

# Rings below this fraction of the largest density hold rounding and no waves.
_NOTHING = 1e-20
# The spectral leakage of a taper, below the first wave and beyond a cut-off, is less than this
# fraction.
_LEAKAGE = 0.1
# The systematic deviation of a ring's logarithm from the law, beside its statistical error.
_OFF_THE_LAW = 0.1
# The cost of a ring outside of the band, in squared standard deviations.
_COST_OUTSIDE = 3.0
# A self-affine band has at least so many rings, such a factor between its ends, an error of H and a
# scatter or misfit below these, and H at most so far outside of [0, 1], farther during the search.
_FEWEST_RINGS = 3
_LEAST_SPAN = 2.5
_LARGEST_ERROR = 0.25
_LARGEST_EXCESS = 2.5
_LARGEST_MISFIT = 0.2
_OUTSIDE = 0.1
_OUTSIDE_SOUGHT = 0.2
_MAX_STEPS = 50


@dataclass(frozen=True)
class PowerLaw:
    """A spectrum that is flat up to a roll-off and falls with a power up to a cut-off.

    Attributes:
        hurst: H of the power -(d + 2 H) on a d-dimensional grid, as fitted, also outside of [0, 1].
        rolloff: q_r, the ring where the plateau ends [1/length]; without a plateau, the lowest
            ring with waves.
        cutoff: the last ring that holds waves of the power law [1/length].
        density: C, the density at the roll-off [length^4 on a surface, length^3 on a line].
        hurst_error: standard error of H, by chance and by the scatter about the law. The treatment
            of a surface that is not periodic adds a bias, of up to 0.02 for `periodic("mirror")`
            and 0.1 for `periodic("window")`.
        density_error: standard error of C, in the unit of the density.

    Example:
        >>> fine = js.Grid(128)
        >>> key = jax.random.key(0)
        >>> rough = js.surfaces.self_affine(fine, key, k_low=1, k_high=64, rms_height=0.1)
        >>> found = js.surfaces.power_law(js.surfaces.power_spectrum(fine, rough))
        >>> f"{found.rolloff / (2 * np.pi):.0f}, {found.cutoff / (2 * np.pi):.0f}"
        '1, 64'
    """

    hurst: float
    rolloff: float
    cutoff: float
    density: float
    hurst_error: float = np.nan
    density_error: float = np.nan


def power_law(spectrum: PowerSpectrum) -> PowerLaw:
    """Fit C up to q_r and C (q / q_r)^-(d + 2 H) from there to a cut-off to a spectrum.

    Beyond the cut-off the spectrum may be anything, for instance the leakage of a taper. Roll-off
    and cut-off are the ends of the band that agrees best with the law, by least squares of the
    logarithm. H and C then follow by maximum likelihood from the rings between them: on a Gaussian
    surface each wave is exponentially distributed about the spectrum (Whittle, 1953). Noise of the
    instrument flattens the spectrum at large wavenumbers.

    Arguments:
        spectrum: a result of `power_spectrum`.

    Raises:
        TypeError: for anything but a spectrum.
        ValueError: if the spectrum is not finite, or has fewer than five rings with waves.

    Warns:
        SurfaceWarning: if no band of the spectrum is self-affine: with H in [0, 1], known to 0.25,
            over a factor of 2.5 of wavenumbers.

    Example:
        >>> fine = js.Grid(128)
        >>> key = jax.random.key(0)
        >>> rough = js.surfaces.self_affine(fine, key, hurst=0.8, k_high=64, rms_height=0.1)
        >>> f"{js.surfaces.power_law(js.surfaces.power_spectrum(fine, rough)).hurst:.1f}"
        '0.8'
    """
    cure = "give a result of jaxstab.surfaces.power_spectrum."
    require_kind(spectrum, PowerSpectrum, f"no spectrum: {cure}")
    parts = spectrum.wavenumber, spectrum.density, spectrum.num_waves
    q, density, count = (np.asarray(part, float) for part in parts)
    if not all(np.isfinite(part).all() for part in (q, density, count)):
        raise ValueError("The spectrum is NaN or infinite: compute it of heights that are finite.")
    num_held = np.sum((count > 0) & (density > _NOTHING * density.max()))
    if num_held < _FEWEST_RINGS + 2:
        raise ValueError(f"The spectrum has {num_held} rings with waves: give 5 or more.")
    dimension = 2
    if count.max() <= 2:
        dimension = 1
    largest = density.max()
    first = int(np.argmax((count > 0) & (density > _LEAKAGE * largest)))
    used = np.flatnonzero(count[first:] > 0) + first
    # A real field's waves q and -q are complex conjugates.
    q = q[used]
    pairs = count[used] / 2
    x = np.log(q)
    y = np.log(np.maximum(density[used] / largest, _NOTHING))
    (start, end), likely = _bands(x, y, pairs, dimension)
    line = _PowerLine.fit(x, y, pairs, start, end)
    if not line.is_straight and likely:
        # Beyond a cut-off leakage alone may look like a law, of many rings.
        start, end = likely
        line = _PowerLine.fit(x, y, pairs, start, end)
    hurst = (line.power - dimension) / 2
    hurst_error = line.power_error / 2
    spread = np.hypot(line.height_error, line.power_error * (x[start] - line.middle))
    cutoff = end
    if end + 1 < x.size and np.log(_LEAKAGE) < y[end + 1] - line.at(x[end + 1]) < 0:
        # The cut-off lies inside of a ring, part of which is left.
        cutoff += 1
    law = PowerLaw(
        hurst=float(hurst),
        rolloff=float(q[start]),
        cutoff=float(q[cutoff]),
        density=float(largest * np.exp(line.at(x[start]))),
        hurst_error=float(hurst_error),
        density_error=float(largest * np.exp(line.at(x[start])) * spread),
    )
    is_outside = max(-hurst, hurst - 1) > max(3 * hurst_error, _OUTSIDE)
    if is_outside or law.cutoff < _LEAST_SPAN * law.rolloff or not line.is_straight:
        faults.warn(
            [
                "the spectrum has no self-affine band: its best power law, for wavenumbers from "
                f"{law.rolloff:.3g} to {law.cutoff:.3g}, has a Hurst exponent of {hurst:.3g} +- "
                f"{hurst_error:.2g}. It needs one from 0 to 1, known to {_LARGEST_ERROR}, over a "
                f"factor of {_LEAST_SPAN} of wavenumbers."
            ]
        )
    return law


def _bands(
    x: np.ndarray, y: np.ndarray, pairs: np.ndarray, dimension: int
) -> tuple[tuple[int, int], tuple[int, int] | None]:
    """Return first and last ring of the best law, and of the best one with H near [0, 1]."""
    # The variance of the logarithm of a mean of exponentials, to 3 %.
    weight = 1 / (1 / pairs + 0.64 / pairs**2 + _OFF_THE_LAW**2)
    outside = _COST_OUTSIDE * np.arange(x.size)[::-1]
    costs = np.full(2, np.inf)
    ends = [(0, _FEWEST_RINGS), None]
    for start in range(x.size - _FEWEST_RINGS):
        squares, power = _broken_lines(x, y, weight, start)
        is_likely = np.abs((power - dimension) / 2 - 0.5) <= 0.5 + _OUTSIDE_SOUGHT
        is_likely &= x - x[start] >= np.log(_LEAST_SPAN)
        for which, total in enumerate((squares, np.where(is_likely, squares, np.inf))):
            end = int(np.argmin(total + outside))
            if total[end] + outside[end] < costs[which]:
                costs[which] = total[end] + outside[end]
                ends[which] = (start, end)
    return ends[0], ends[1]


def _broken_lines(
    x: np.ndarray, y: np.ndarray, weight: np.ndarray, start: int
) -> tuple[np.ndarray, np.ndarray]:
    """Fit y = a - b max(x - x[start], 0) to the points up to each; return sums of squares and b."""
    z = np.maximum(x - x[start], 0)
    w, wz, wzz, wy, wzy, wyy = (
        np.cumsum(weight * factor) for factor in (np.ones_like(z), z, z * z, y, z * y, y * y)
    )
    determinant = w * wzz - wz**2
    is_long = np.arange(x.size) >= start + _FEWEST_RINGS
    safe = np.where(is_long, determinant, 1)
    power = -(w * wzy - wz * wy) / safe
    height = (wy + power * wz) / w
    return np.where(is_long, wyy - height * wy + power * wzy, np.inf), power


@dataclass(frozen=True)
class _PowerLine:
    """A line y = height - power (x - middle), whose two parameters are uncorrelated."""

    middle: float
    height: float
    power: float
    height_error: float
    power_error: float
    is_straight: bool

    @classmethod
    def fit(
        cls, x: np.ndarray, y: np.ndarray, pairs: np.ndarray, start: int, end: int
    ) -> "_PowerLine":
        """Fit logarithms y of means of exponentials by maximum likelihood: Fisher's scoring."""
        x, y, pairs = (values[start : end + 1] for values in (x, y, pairs))
        middle = np.average(x, weights=pairs)
        z = x - middle
        information = np.array([pairs.sum(), pairs @ z**2])
        height = np.average(y, weights=pairs)
        power = -(pairs * z) @ y / information[1]
        for _ in range(_MAX_STEPS):
            # A step that starts far off is cut, and the next goes on.
            residual = np.expm1(np.minimum(y - height + power * z, 1))
            step = np.array([pairs @ residual, -(pairs * z) @ residual]) / information
            height = height + step[0]
            power = power + step[1]
            if np.abs(step).max() < 1e-12:
                break
        residual = np.expm1(np.minimum(y - height + power * z, 50))
        excess = max(1.0, pairs @ residual**2 / (x.size - 2))
        errors = np.sqrt(excess / information)
        misfit = np.sqrt((excess - 1) / pairs.mean())
        is_close = excess <= _LARGEST_EXCESS or misfit <= _LARGEST_MISFIT
        is_straight = bool(is_close and errors[1] / 2 <= _LARGEST_ERROR)
        return cls(float(middle), height, power, *errors, is_straight=is_straight)

    def at(self, x: float) -> float:
        """Return y at x."""
        return self.height - self.power * (x - self.middle)

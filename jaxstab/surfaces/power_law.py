"""The power law of a measured spectrum."""

from dataclasses import dataclass

import numpy as np

from jaxstab.surfaces.statistics import PowerSpectrum

# Rings below this share of the largest density hold rounding and no waves.
_NOTHING = 1e-20
# Rings that a power law must span, and how far below it what lies beyond a cut-off must be.
_FEWEST_RINGS = 3
_DROP = np.log(10.0)


@dataclass(frozen=True)
class PowerLaw:
    """A spectrum that is flat up to a roll-off, falls with a power, and ends at a cut-off.

    Attributes:
        hurst: H of the power -(d + 2 H) on a d-dimensional grid, as fitted, also outside of [0, 1].
        rolloff: q_r, the ring where the plateau ends [1/length]; the lowest ring with waves where
            there is no plateau.
        cutoff: the last ring of the power law [1/length]; the last of all where there is none.
        density: C, that of the plateau [length^4 on a surface, length^3 on a line].
    """

    hurst: float
    rolloff: float
    cutoff: float
    density: float


def power_law(spectrum: PowerSpectrum) -> PowerLaw:
    """Fit C up to q_r, C (q / q_r)^-(d + 2 H) to a cut-off, and a constant beyond, to a spectrum.

    By least squares of the logarithm, in which each wave counts alike; roll-off and cut-off are
    those rings that leave the least.

    Arguments:
        spectrum: what `power_spectrum` returns; one ring holds at most two waves on a line.

    Raises:
        TypeError: for what is no spectrum.
        ValueError: if the spectrum is not finite, or has fewer than five rings with waves.
    """
    if not isinstance(spectrum, PowerSpectrum):
        raise TypeError(
            f"{type(spectrum).__name__} is no spectrum: give what jaxstab.surfaces.power_spectrum "
            "returned."
        )
    q, density, count = (
        np.asarray(x, float) for x in (spectrum.wavenumber, spectrum.density, spectrum.num_waves)
    )
    if not all(np.isfinite(part).all() for part in (q, density, count)):
        raise ValueError("The spectrum is NaN or infinite: compute it of heights that are finite.")
    dimension = 1 if count.max() <= 2 else 2
    is_held = (count > 0) & (density > _NOTHING * density.max())
    first = int(np.argmax(is_held))
    used = np.flatnonzero(count[first:] > 0) + first
    if is_held.sum() < _FEWEST_RINGS + 2:
        raise ValueError(f"The spectrum has {is_held.sum()} rings with waves: give 5 or more.")
    x, weight = np.log(q[used]), count[used]
    y = np.log(np.maximum(density[used], _NOTHING * density.max()))
    beyond = _cost_beyond(y, weight)
    best, rolloff, cutoff, height, power = np.inf, 0, 0, 0.0, 0.0
    for start in range(used.size - _FEWEST_RINGS):
        costs, heights, powers = _broken_lines(x, y, weight, start)
        costs = costs + np.where(_drops(x, heights, powers, start, beyond[1]), beyond[0], np.inf)
        end = int(np.argmin(costs))
        if costs[end] < best:
            best, rolloff, cutoff = costs[end], start, end
            height, power = heights[end], powers[end]
    return PowerLaw(
        hurst=float((power - dimension) / 2),
        rolloff=float(q[used[rolloff]]),
        cutoff=float(q[used[cutoff]]),
        density=float(np.exp(height)),
    )


def _cost_beyond(y: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each ring as the last of the law, the squares left by a constant beyond, and it.

    Beyond the last ring there is nothing, which leaves nothing.
    """

    def after(values: np.ndarray) -> np.ndarray:
        return np.append(np.cumsum(values[::-1])[::-1][1:], 0)

    total, level = after(weight), after(weight * y)
    mean = np.where(total > 0, level / np.where(total > 0, total, 1), -np.inf)
    squares = after(weight * y**2) - np.where(total > 0, level, 0) ** 2 / np.maximum(total, 1)
    return squares, mean


def _broken_lines(
    x: np.ndarray, y: np.ndarray, weight: np.ndarray, start: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit y = a - b max(x - x[start], 0) to the points up to each: what is left, a and b."""
    z = np.maximum(x - x[start], 0)
    w, wz, wzz, wy, wzy, wyy = (
        np.cumsum(weight * factor) for factor in (np.ones_like(z), z, z * z, y, z * y, y * y)
    )
    determinant = w * wzz - wz**2
    is_long = np.arange(x.size) >= start + _FEWEST_RINGS
    safe = np.where(is_long, determinant, 1)
    power = -(w * wzy - wz * wy) / safe
    height = (wy + power * wz) / w
    costs = np.where(is_long, wyy - height * wy + power * wzy, np.inf)
    return costs, height, power


def _drops(
    x: np.ndarray, heights: np.ndarray, powers: np.ndarray, start: int, level: np.ndarray
) -> np.ndarray:
    """Return for which last rings what is beyond lies well below the law: or nothing is there."""
    ends = heights - powers * np.maximum(x - x[start], 0)
    return level < ends - _DROP

"""Checks of the arguments of a `Topography`."""

from typing import Any

import numpy as np

from jaxstab.core.checks import concrete, require, require_shape, where_known
from jaxstab.core.display import times
from jaxstab.core.grid import Grid
from jaxstab.core.units import unit_of
from jaxstab.surfaces.formats import Scan

# Rounding must not decide whether a point or a wave at a limit is kept.
ROUNDING = 1e-5


def checked_heights(values: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return heights as a read-only array of float64, NaN where masked."""
    heights = np.ma.asarray(values)
    if heights.dtype.kind not in "fiub":
        raise TypeError(f"The array of heights is {heights.dtype}: give real numbers.")
    heights = np.ma.filled(heights.astype(float), np.nan)
    require_shape("The array of heights", heights.shape, shape, "they must agree.")
    if np.isnan(heights).all():
        raise ValueError("all heights are missing.")
    require("A height", heights, ~np.isinf(heights), "mark missing points by nan.")
    heights.flags.writeable = False
    return heights


def require_same_grid(grid: Grid, own: Grid) -> None:
    """Raise `ValueError` if a grid is not a topography's own."""
    cure = f"give the topography's own, {own}, as in HalfSpace(topography.grid, ...)."
    require("The grid", grid, grid.shape == own.shape, cure)
    ratios = concrete(grid.lengths) / concrete(own.lengths)
    require("The grid", grid, abs(ratios - 1) <= ROUNDING, cure)


def checked_band(k_low: Any, k_high: Any) -> tuple[float, float]:
    """Return the limits of a band of wavenumbers, None for no limit on a side."""
    low = 0.0
    if k_low is not None:
        low = real(k_low)
    high = np.inf
    if k_high is not None:
        high = real(k_high)
    if (k_low is None and k_high is None) or not (0 <= low <= high and high > 0):
        raise ValueError(
            f"k_low is {k_low!r}, k_high {k_high!r}: give one or both, positive and in order."
        )
    return low, high


def require_agreement(scan: Scan, lengths: Any, unit: str | None) -> None:
    """Raise `ValueError` if lengths or unit contradict the statements of a scan."""
    if scan.lengths is not None and not scan.is_counted:
        own = np.broadcast_to(scan.lengths, lengths.shape)
        _require_lengths(own, lengths, scan.unit)
    if scan.unit and unit is not None and unit_of(unit) != scan.unit:
        raise ValueError(
            f"the unit is {unit!r}, but the heights are in {scan.unit!r}: leave `unit` out, and "
            f'convert by `.in_unit("{unit}")`.'
        )


def points_between(name: str, interval: Any, n: int, dx: float, rounding: float) -> slice:
    """Return the slice of the n points of a side in an interval [length]."""
    ends = []
    if np.iterable(interval):
        ends = [real(end) for end in interval]
    if len(ends) != 2 or np.isnan(ends).any():
        raise ValueError(
            f"{name} is {interval!r}: give two numbers, as in {name}=(0, {n * dx / 2:.3g})."
        )
    start, end = (int(np.ceil(np.clip(end / dx - rounding, 0, n))) for end in ends)
    if end - start < 2:
        raise ValueError(
            f"{max(end - start, 0)} points lie in {ends[0]:g} <= {name} < {ends[1]:g}: take 2 or "
            f"more of those from 0 to {(n - 1) * dx:.6g}."
        )
    return slice(start, end)


def real(value: Any) -> float:
    """Convert to a number; NaN for anything that is not a number."""
    if isinstance(value, str):
        return np.nan
    try:
        return float(value)
    except (TypeError, ValueError):
        return np.nan


@where_known
def _require_lengths(own: np.ndarray, lengths: np.ndarray, unit: str | None) -> None:
    if not np.allclose(own, lengths, ROUNDING, 0):
        come = f"{times(own, '.10g')} {unit or ''}".strip()
        raise ValueError(
            f"lengths are {times(lengths, '.10g')}, but the heights come with lengths of "
            f"{come}: use these."
        )

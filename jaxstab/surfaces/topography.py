"""A measured surface: heights on a grid, in a unit, with points that may be missing."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import jax
import numpy as np
from jaxtyping import Array

from jaxstab.core.checks import concrete, is_readable, require_one_of, where_known
from jaxstab.core.display import times
from jaxstab.core.grid import Grid, require_grid, resample
from jaxstab.core.units import convert_lengths, unit_of
from jaxstab.core.warn import warn
from jaxstab.surfaces import faults, processing
from jaxstab.surfaces.arguments import (
    ROUNDING,
    checked_band,
    checked_heights,
    points_between,
    require_agreement,
    require_same_grid,
)
from jaxstab.surfaces.formats import scan_of

FILL = "fill them, as by `js.surfaces.Topography(grid, heights).filled()`."
_TAPER = 0.1
_TRENDS = ("mean", "best plane", "best quadric")
_FILLINGS = {"harmonic": 1, "biharmonic": 2}


@dataclass(frozen=True, eq=False, repr=False)
class Topography:
    """A measured surface. Its methods return new ones, and `print` shows its processing.

    Arguments:
        grid: the grid; a side is as long as its points times their spacing, since the surface is
            to be periodic.
        heights: h at its points [length], the first index along x; NaN where points are missing, or
            masked in the input. Kept as float64 of NumPy. An array of xarray with dimensions x and
            y, in either order, or a surface of SurfaceTopography brings its unit and its side
            lengths, which must agree with the grid.
        unit: the unit of heights and lengths, from pm to km, or None.
        remarks: the history of its processing.
        is_periodic: whether opposite edges are known to meet.
        edge_faults: faults of the edges when the surface was resampled or filtered by its Fourier
            series, which rings there.

    Raises:
        ValueError: for heights of another shape than the grid, infinite, or missing altogether.
            For a unit that is none of length, and where lengths or unit of heights contradict.
        TypeError: for anything but a grid, and for heights that are not real numbers.

    Example:
        >>> scan = js.surfaces.Topography(grid, np.asarray(heights), unit="µm")
        >>> f"{js.surfaces.rms_height(scan.in_unit('nm')):.1f}"
        '50.0'
    """

    grid: Grid
    heights: np.ndarray
    unit: str | None = None
    remarks: tuple[str, ...] = ()
    is_periodic: bool = False
    edge_faults: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require_grid(self.grid)
        if (scan := scan_of(self.heights)) is not None:
            require_agreement(scan, concrete(self.grid.lengths), self.unit)
            object.__setattr__(self, "heights", scan.heights)
            object.__setattr__(self, "unit", scan.unit or self.unit)
            object.__setattr__(self, "remarks", (*scan.remarks, *self.remarks))
            object.__setattr__(self, "is_periodic", scan.is_periodic or self.is_periodic)
        object.__setattr__(self, "heights", checked_heights(self.heights, self.grid.shape))
        if self.unit is not None:
            object.__setattr__(self, "unit", unit_of(self.unit))

    @property
    def lengths(self) -> np.ndarray:
        """Side lengths [length]."""
        return np.asarray(self.grid.lengths, float)

    @property
    def num_missing(self) -> int:
        """The number of missing points."""
        return int(np.isnan(self.heights).sum())

    @property
    def edges_meet(self) -> bool:
        """Whether opposite edges are known to meet, or the heights go on smoothly across them."""
        return self.is_periodic or faults.edges_meet(self.heights)

    @property
    def suspicions(self) -> list[str]:
        """Warnings, a sentence each: scales, and from 32 points a side on tilt and edges."""
        return [*self.wrong_scale, *self.edge_faults, *self._wrong_edges]

    @property
    def _wrong_edges(self) -> list[str]:
        if self.is_periodic:
            return []
        return faults.looks_wrong(self.heights)

    @property
    def wrong_scale(self) -> list[str]:
        """A sentence if the rms slope shows that heights and lengths differ in unit."""
        return faults.has_wrong_scale(self.heights, self.lengths)

    def __repr__(self) -> str:
        missing = self.num_missing
        unit = " (unit unknown)"
        if self.unit:
            unit = f" {self.unit}"
        rows = [
            ("points", times(self.grid.shape)),
            ("lengths", times(self.lengths, ".6g") + unit),
            ("rms height", f"{faults.rms(self.heights):.4g}{unit}"),
            ("rms slope", f"{faults.rms_slope(self.heights, self.lengths):.4g}"),
            ("missing", f"{missing} points ({100 * missing / self.grid.size:.3g} %)"),
            *(("done", remark) for remark in self.remarks),
            *(("looks wrong", sentence) for sentence in self.suspicions),
        ]
        return "\n".join(["Topography", *(f"  {name:<11}  {text}" for name, text in rows)])

    def require_complete(self, purpose: str) -> None:
        """Raise `ValueError`, with the purpose, if points are missing."""
        if missing := self.num_missing:
            raise ValueError(
                f"{purpose} needs all heights, of which {missing} of {self.grid.size} are missing: "
                f"{FILL}"
            )

    def on(self, grid: Grid) -> np.ndarray:
        """Return the heights for computations on a grid, which must be this one.

        Raises:
            ValueError: if points are missing, or the grid has another shape or other lengths.
        """
        self.require_complete("A contact or a statistic")
        require_same_grid(grid, self.grid)
        return self.heights

    def __neg__(self) -> "Topography":
        """Reverse the heights, so that their summits point the other way."""
        return self._with_heights("heights reversed", heights=-self.heights)

    def filled(self, method: Literal["harmonic", "biharmonic"] = "harmonic") -> "Topography":
        """Fill missing points from the others.

        Take a tilt off before, by `detrended`: at the edge of the map a membrane is level, so that
        a gap there would not be tilted as the rest is.

        Arguments:
            method: "harmonic", like a membrane through the points around (the least squared
                gradient), or "biharmonic", like a thin plate, which carries slopes on.

        Raises:
            ValueError: for another method, and if the points lie on one line for "biharmonic".
        """
        require_one_of("method", method, _FILLINGS)
        order = _FILLINGS[method]
        if not (missing := self.num_missing):
            return self
        heights = processing.fill(self.heights, list(self.lengths / self.grid.shape), order)
        share = f"{100 * missing / self.grid.size:.3g} % of the points filled, {method}"
        return self._with_heights(share, heights=heights)

    def detrended(self, order: int = 1) -> "Topography":
        """Subtract the polynomial that fits the points that are not missing best.

        Arguments:
            order: 0 subtracts the mean, 1 the best plane, 2 the best quadric.

        Raises:
            ValueError: for another order.
        """
        require_one_of("order", order, (0, 1, 2))
        heights = self.heights - processing.trend(self.heights, order)
        is_periodic = self.is_periodic and order == 0
        return self._with_heights(
            f"{_TRENDS[order]} subtracted", heights=heights, is_periodic=is_periodic
        )

    def levelled(self, order: int | None = None) -> "Topography":
        """Subtract the trend and fill missing points, with a warning of these and of lone points.

        Arguments:
            order: of the trend, as in `detrended`. By default the edges decide: if they meet the
                mean, if they meet without a tilt this tilt, otherwise the best plane.

        Raises:
            ValueError: for another order.
        """
        level = self
        if order is None:
            level = self._without_tilt
            order = 0 if level.edges_meet else 1
        # Filled before, a gap at the edge of a tilted map would be level, and a summit or a pit.
        level = level.detrended(order)
        if level.num_missing:
            share = 100 * level.num_missing / level.grid.size
            warn(f"{share:.3g} % of the points were missing and have been filled.")
            level = level.filled()
        faults.warn(faults.lone_points(level.heights))
        return level

    @property
    def _without_tilt(self) -> "Topography":
        """A tilted periodic surface without its tilt, any other surface as it is."""
        if self.edges_meet:
            return self
        joined = self._with_heights(
            "plane subtracted without which opposite edges meet",
            heights=self.heights - faults.joining_plane(self.heights),
        )
        return joined if joined.edges_meet else self

    def in_unit(self, unit: str) -> "Topography":
        """Convert lengths and heights to another unit of length.

        Raises:
            ValueError: if the unit of the surface is unknown, or the other is no unit of length.
        """
        if self.unit is None:
            raise ValueError(
                "The unit of this topography is unknown: give it first, by `unit=` in "
                "`js.surfaces.read` or `Topography(grid, heights, unit)`."
            )
        unit = unit_of(unit)
        lengths, heights = (
            convert_lengths(x, self.unit, unit) for x in (self.lengths, self.heights)
        )
        return replace(self, grid=Grid(self.grid.shape, lengths), heights=heights, unit=unit)

    def cropped(self, x: tuple[float, float], y: tuple[float, float] | None = None) -> "Topography":
        """Crop the surface to the points with x0 <= x < x1, y0 <= y < y1.

        Arguments:
            x: x0 and x1 [length].
            y: y0 and y1 [length]; the full side by default.

        Raises:
            ValueError: unless two numbers are given, if fewer than two points are left along a
                side, and for y on a line.
        """
        intervals = [x]
        if y is not None:
            intervals.append(y)
        if len(intervals) > len(self.grid.shape):
            raise ValueError("y is given, but the surface is a line.")
        spacing = self.lengths / self.grid.shape
        # The rounding in points; far from the origin the rounding of the lengths is the larger.
        precision = float(np.finfo(self.grid.lengths.dtype).eps)
        rounding = max(ROUNDING, 4 * precision * max(self.grid.shape))
        sides = zip("xy", intervals, self.grid.shape, spacing, strict=False)
        heights = self.heights[tuple(points_between(*side, rounding) for side in sides)]
        grid = Grid(heights.shape, spacing * heights.shape)
        is_periodic = self.is_periodic and heights.shape == self.grid.shape
        remark = f"cropped from {times(self.grid.shape)} points"
        return self._with_heights(remark, grid=grid, heights=heights, is_periodic=is_periodic)

    def resampled(
        self, shape: int | Sequence[int], method: Literal["spectral", "area"] = "spectral"
    ) -> "Topography":
        """Resample the surface on another number of points.

        Arguments:
            shape: number of points along each side; one integer counts for all sides.
            method: "spectral", by the Fourier series: exact for the waves that both grids resolve,
                if opposite edges meet. Or "area", by the mean over tiles, for any surface; missing
                points are left out of the mean.

        Raises:
            ValueError: for another method, and if points are missing for "spectral".
        """
        require_one_of("method", method, ("spectral", "area"))
        numbers: Any = shape
        if np.ndim(shape) == 0:
            numbers = (shape,) * len(self.grid.shape)
        if len(numbers) != len(self.grid.shape):
            raise ValueError(f"The shape is {shape}: give {len(self.grid.shape)} numbers.")
        grid = Grid(numbers, self.lengths)
        if grid.shape == self.grid.shape:
            return self
        edge_faults = self.edge_faults
        if method == "area":
            heights = processing.area_average(self.heights, grid.shape)
        else:
            edge_faults = self._edge_faults_before("resampled")
            self.require_complete('`.resampled(method="spectral")`')
            # It is computed in double precision, also for a contact in single precision.
            with jax.enable_x64(True):
                heights = np.asarray(resample(jax.device_put(self.heights), grid.shape))
        remark = f"resampled from {times(self.grid.shape)} points ({method})"
        return self._with_heights(remark, grid=grid, heights=heights, edge_faults=edge_faults)

    def filtered(self, k_low: float | None = None, k_high: float | None = None) -> "Topography":
        """Keep the waves from k_low to k_high, sharply cut, and the mean.

        Arguments:
            k_low, k_high: numbers of waves per longest side, as in `self_affine`; None for no
                limit.

        Raises:
            ValueError: if no cut-off is given, they are not positive and in order, or points miss.
        """
        low, high = checked_band(k_low, k_high)
        self.require_complete("`.filtered()`")
        sides = zip(self.grid.waves, self.lengths.max() / self.lengths, strict=True)
        waves = np.sqrt(sum((k * ratio) ** 2 for k, ratio in sides))
        margin = 1 + ROUNDING
        heights = processing.pass_band(self.heights, waves, low / margin, high * margin)
        remark = f"waves from {low:g} to {high:g} per longest side"
        edge_faults = self._edge_faults_before("filtered")
        return self._with_heights(remark, heights=heights, edge_faults=edge_faults)

    def periodic(self, how: Literal["window", "mirror", "as_is"]) -> "Topography":
        """Make opposite edges meet.

        Arguments:
            how: "window" multiplies heights about their mean by a window that falls to zero as a
                cosine over the outer tenth of each side. It flattens a third of a map, and its
                Hurst exponent becomes too large. "mirror" appends the mirror images, which doubles
                each side; statistics of the mirrored surface are the least biased. "as_is" keeps
                the heights and declares that edges meet.

        Raises:
            ValueError: for another way, and for a window where points are missing.
        """
        require_one_of("how", how, ("window", "mirror", "as_is"))
        if how == "as_is":
            return self._with_heights("taken as periodic", is_periodic=True)
        grid = self.grid
        heights = self.heights
        if how == "window":
            self.require_complete('`.periodic("window")`')
            mean = heights.mean()
            heights = mean + (heights - mean) * processing.taper(grid.shape, _TAPER)
            remark = "heights about the mean windowed over the outer tenth of each side"
        else:
            for axis in range(heights.ndim):
                heights = np.concatenate([heights, np.flip(heights, axis)], axis)
            grid = Grid(heights.shape, 2 * self.lengths)
            remark = "mirrored, twice as long along each side"
        return self._with_heights(remark, grid=grid, heights=heights, is_periodic=True)

    def _edge_faults_before(self, change: str) -> tuple[str, ...]:
        new = (f"before it was {change}, {sentence}" for sentence in self._wrong_edges)
        return (*self.edge_faults, *new)

    def _with_heights(self, remark: str, **fields: Any) -> "Topography":
        return replace(self, remarks=(*self.remarks, remark), **fields)


def as_topography(heights: object, grid: Grid) -> Topography | None:
    """Convert heights with a unit, named axes or masked points; return None for a plain array."""
    if isinstance(heights, Topography):
        return heights
    scan: Any = heights
    if not np.ma.is_masked(heights):
        scan = scan_of(heights)
    if scan is None:
        return None
    return Topography(grid, scan)


def warn_of_faults(
    heights: Array | np.ndarray, topography: Topography | None, lengths: Array, is_window: bool
) -> None:
    """Warn of heights that look wrong on a grid; on a window neither tilt nor edges matter.

    Arguments:
        heights: as they were given [length].
        topography: the surface that they are of, if it is one.
        lengths: the sides of the grid [length].
        is_window: whether the grid is a window.
    """
    if topography is None:
        if is_readable(heights):
            _warn_of_array(heights, lengths, is_window)
    elif is_window:
        faults.warn([*topography.wrong_scale, *topography.edge_faults])
    else:
        faults.warn(topography.suspicions)


@where_known
def _warn_of_array(heights: Array | np.ndarray, lengths: Array, is_window: bool) -> None:
    values = np.asarray(heights)
    wrong = faults.has_wrong_scale(values, concrete(lengths))
    if not wrong and not is_window:
        wrong = faults.looks_wrong(values)
    faults.warn(wrong)

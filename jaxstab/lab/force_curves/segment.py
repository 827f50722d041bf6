"""A segment of a force curve: the columns of approach, retraction or a pause."""

from dataclasses import dataclass
from typing import TypeVar, overload

import numpy as np

from jaxstab.units import powers_of_ten

# The powers of ten of units.
LENGTHS = powers_of_ten("length")
FORCES = powers_of_ten("force")
# A measured number is told from noise if it exceeds its standard error so many times.
SIGNIFICANT = 5.0
Value = TypeVar("Value", float, np.ndarray)

# Forces are sought in means over so many blocks of points.
_BLOCKS = 200
# A force that occurs so many times as often as the one next to it is the end of a range, unless
# there are as few forces as in a made-up curve.
_CLIPPED = 8
_FEWEST_VALUES = 16
_NO_TIP = (
    "The tip position is unknown: give the spring constant in N/m, as in "
    "js.lab.force_curves.read(path, spring_constant=0.2), or the tip of a segment made by hand, as "
    "in Segment(force, height, tip=height + force / 0.2)."
)


@dataclass(frozen=True, eq=False, repr=False)
class Segment:
    """A part of a force curve in the order of the measurement, NaN where points are missing.

    Attributes:
        force: positive in compression [force].
        height: of the far end of the cantilever, growing away from the sample [length].
        tip: the height of the tip, height + force / spring constant, None if unknown [length].
        time: [s], None if the file holds none.
        stated_speed: the speed according to the file [length/s].

    Raises:
        ValueError: without a point.

    Example:
        >>> approach = js.lab.force_curves.Segment(force=np.zeros(5), height=np.arange(5.0))
        >>> int(approach.is_present.sum())
        5
    """

    force: np.ndarray
    height: np.ndarray
    tip: np.ndarray | None = None
    time: np.ndarray | None = None
    stated_speed: float | None = None

    def __post_init__(self) -> None:
        if len(self.force) == 0:
            raise ValueError("The segment has no point: leave it out, as in `retraction=None`.")

    @property
    def tip_position(self) -> np.ndarray:
        """The height of the tip, height + force / spring constant [length].

        Raises:
            ValueError: if it is unknown, for want of a spring constant.
        """
        if self.tip is None:
            raise ValueError(_NO_TIP)
        return self.tip

    @property
    def speed(self) -> float | None:
        """The mean speed of the far end, or the speed that the file states [length/s]."""
        if self.time is None:
            return self.stated_speed
        is_known = self.is_present & np.isfinite(self.time)
        time = self.time[is_known]
        height = self.height[is_known]
        if time.size == 0 or np.ptp(time) == 0:
            return self.stated_speed
        return float(abs(height[-1] - height[0]) / np.ptp(time))

    @property
    def is_present(self) -> np.ndarray:
        """The mask of points that are not missing."""
        return np.isfinite(self.force) & np.isfinite(self.height)

    @property
    def num_missing(self) -> int:
        """The number of missing points."""
        return int(np.sum(~self.is_present))

    @property
    def is_clipped(self) -> np.ndarray:
        """The mask of points at either end of the range of the detector, which repeats one force.

        Steps of a digitised force repeat too, but no more often at an end than beside it, and so
        may the force of no contact.
        """
        values, place, counts = np.unique(self.force, return_inverse=True, return_counts=True)
        finite = int(np.sum(np.isfinite(values)))
        clipped = np.zeros(len(values), bool)
        if finite > _FEWEST_VALUES and self.is_present.any():
            far = place[np.nanargmax(np.where(self.is_present, self.height, np.nan))]
            for end, beside in ((0, 1), (finite - 1, finite - 2)):
                clipped[end] = end != far and counts[end] > _CLIPPED * counts[beside]
        return clipped[place]

    def __len__(self) -> int:
        return len(self.force)

    def scaled(self, length: float, force: float) -> "Segment":
        """Return the segment in other units, given factors."""
        return Segment(
            force=self.force * force,
            height=self.height * length,
            tip=scaled(self.tip, length),
            time=self.time,
            stated_speed=scaled(self.stated_speed, length),
        )


@overload
def scaled(value: None, factor: float) -> None: ...
@overload
def scaled(value: Value, factor: float) -> Value: ...
def scaled(value: Value | None, factor: float) -> Value | None:
    """Return a value in another unit, None if it is missing."""
    if value is None:
        return None
    return value * factor


def tip_from_height(
    height: np.ndarray, force: np.ndarray, spring_constant: float | None
) -> np.ndarray | None:
    """Return the tip position, height + force / spring constant, None if that is unknown."""
    if spring_constant is None:
        return None
    return height + force / spring_constant


def size_of_blocks(values: np.ndarray) -> int:
    """Return the number of points in each block over which forces are sought."""
    return max(len(values) // _BLOCKS, 1)


def block_means(values: np.ndarray, size: int) -> np.ndarray:
    """Return the means over blocks of points, the rest of the last one left out."""
    count = len(values) // size
    return values[: count * size].reshape(count, size).mean(axis=1)


def finite_values(values: np.ndarray) -> np.ndarray:
    """Return the values that are finite."""
    return values[np.isfinite(values)]

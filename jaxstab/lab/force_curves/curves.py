"""Several force curves: of a file, or of the pixels of a map."""

import warnings
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, overload

import numpy as np

from jaxstab.lab.force_curves.force_curve import ForceCurve, ForceCurveWarning, require_baseline

if TYPE_CHECKING:
    import xarray

_NOT_CORRECTED = "not corrected"
# So many of several curves that fail alike are named in a warning.
_MOST_NAMED = 5


@dataclass(frozen=True, eq=False, repr=False)
class ForceCurves(Sequence[ForceCurve]):
    """Force curves in the order of their file: a sequence, with the methods of one for each.

    Attributes:
        curves: the curves.
        shape: columns and rows of the map that they are pixels of, None if they are of none. A map
            may lack pixels.

    Example:
        >>> len(js.lab.force_curves.ForceCurves((curve, curve)))
        2
    """

    curves: tuple[ForceCurve, ...]
    shape: tuple[int, int] | None = None

    def __len__(self) -> int:
        return len(self.curves)

    @overload
    def __getitem__(self, number: int) -> ForceCurve: ...

    @overload
    def __getitem__(self, number: slice) -> "ForceCurves": ...

    def __getitem__(self, number: int | slice) -> "ForceCurve | ForceCurves":
        if isinstance(number, slice):
            return replace(self, curves=self.curves[number])
        return self.curves[number]

    def in_units(self, unit: str, force_unit: str) -> "ForceCurves":
        """Return the curves in other units, as `ForceCurve.in_units`."""
        return self._map(lambda curve: curve.in_units(unit, force_unit))

    def __neg__(self) -> "ForceCurves":
        """Reverse the signs of all forces."""
        return self._map(lambda curve: -curve)

    @property
    def sources(self) -> list[str]:
        """The source of each curve, or its number."""
        return [curve.source or f"curve {number}" for number, curve in enumerate(self.curves)]

    def corrected(self, baseline: Literal["linear", "constant"] = "linear") -> "ForceCurves":
        """Correct each curve, as `ForceCurve.corrected`.

        A curve that cannot be corrected stays as it is, without a `correction`, and its last remark
        says why.

        Raises:
            ValueError: if no curve can be corrected, and for another baseline.

        Warns:
            ForceCurveWarning: for curves that are not corrected, with their names and reasons.
        """
        require_baseline(baseline)
        curves = []
        failed = []
        for source, curve in zip(self.sources, self.curves, strict=True):
            try:
                curves.append(curve.corrected(baseline))
            except ValueError as error:
                failed.append(f"{source}: {error}")
                remarks = (*curve.remarks, f"{_NOT_CORRECTED}: {error}")
                curves.append(replace(curve, remarks=remarks))
        if len(failed) == len(self) > 0:
            raise ValueError(f"None of {len(self)} curves can be corrected. {failed[0]}")
        if failed:
            text = all_of("are not corrected", failed, len(self))
            warnings.warn(text, ForceCurveWarning, stacklevel=2)
        return replace(self, curves=tuple(curves))

    @property
    def numbers(self) -> np.ndarray:
        """The number of the curve at each pixel of the map, -1 where there is none.

        Raises:
            ValueError: if the curves are of no map.
        """
        if self.shape is None:
            raise ValueError("These curves are of no map: their file states no pixels.")
        numbers = np.full(self.shape, -1)
        for number, curve in enumerate(self.curves):
            if curve.pixel is not None:
                numbers[curve.pixel] = number
        return numbers

    def on_map(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return one value for each curve as a map, columns first, NaN where there is no curve.

        Raises:
            ValueError: if the curves are of no map, or for another number of values.
        """
        if len(values) != len(self):
            raise ValueError(f"There are {len(values)} values for {len(self)} curves.")
        # The number of a hole, -1, is that of the last.
        return np.append(np.asarray(values, float), np.nan)[self.numbers]

    def to_dataset(self) -> "xarray.Dataset":
        """Return a data set of xarray: as `ForceCurve.to_dataset`, with the dimension `curve`.

        Shorter curves end with NaN.

        Raises:
            ImportError: without xarray.
            ValueError: without a curve, and if the curves differ in units.
        """
        if not self.curves:
            raise ValueError("There is no force curve: a data set needs at least one.")
        units = {(curve.unit, curve.force_unit) for curve in self.curves}
        if len(units) > 1:
            raise ValueError("The curves differ in units: convert them first, by `in_units`.")
        datasets = [curve.to_dataset() for curve in self.curves]
        import xarray

        most = Counter[Hashable]()
        for one in datasets:
            most |= Counter(dict(one.sizes))
        joined = xarray.concat(
            [
                one.pad({d: (0, most[d] - size) for d, size in one.sizes.items()})
                for one in datasets
            ],
            "curve",
            data_vars="all",
            combine_attrs="drop_conflicts",
        )
        # Curves that are alike would leave the description of one.
        joined.attrs.pop("curve", None)
        pixels = [curve.pixel for curve in self.curves]
        if all(pixel is not None for pixel in pixels):
            for axis, name in enumerate(("column", "row")):
                joined.coords[name] = ("curve", [pixel[axis] for pixel in pixels if pixel])
        return joined.assign_coords(source=("curve", self.sources))

    def __repr__(self) -> str:
        count = len(self)
        rows = [("curves", str(count))]
        if self.shape is not None:
            there = int(np.sum(self.numbers >= 0))
            holes = self.numbers.size - there
            text = f"{self.shape[0]} x {self.shape[1]} pixels"
            if holes:
                text += f", {holes} of {self.numbers.size} pixels missing"
            rows.append(("map", text))
        rows += [("gaps", f"{number} of {count} curves: {gap}") for gap, number in self._gaps()]
        rows += [
            ("looks wrong", f"{number} of {count} curves: {sentence}")
            for sentence, number in Counter(x for c in self.curves for x in c.suspicions).items()
        ]
        return "\n".join([type(self).__name__, *(f"  {name:<11}  {x}" for name, x in rows)])

    def _gaps(self) -> Iterator[tuple[str, int]]:
        lacks = {
            "no approach": lambda curve: curve.approach is None,
            "no retraction": lambda curve: curve.retraction is None,
            "no spring constant": lambda curve: curve.spring_constant is None,
            "not corrected": lambda c: c.remarks and c.remarks[-1].startswith(_NOT_CORRECTED),
            "missing points": lambda c: any(part.num_missing for part in c.segments.values()),
        }
        for name, is_lacking in lacks.items():
            if number := sum(map(bool, map(is_lacking, self.curves))):
                yield name, number

    def _map(self, change: Callable[[ForceCurve], ForceCurve]) -> "ForceCurves":
        return replace(self, curves=tuple(map(change, self.curves)))


def all_of(fate: str, reasons: Sequence[str], count: int) -> str:
    """Return a sentence on curves that share a fate, with the reason of each of the first few."""
    if count == 1:
        return reasons[0]
    named = " ".join(reasons[:_MOST_NAMED])
    if len(reasons) > _MOST_NAMED:
        named += " ..."
    return f"{len(reasons)} of {count} curves {fate}. {named}"

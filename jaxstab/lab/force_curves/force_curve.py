"""A measured force curve: approach and retraction, with the cantilever that measured them."""

import json
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from jaxstab.lab.force_curves.baseline import Baseline
from jaxstab.lab.force_curves.correction import Correction, correct
from jaxstab.lab.force_curves.segment import (
    FORCES,
    LENGTHS,
    SIGNIFICANT,
    Segment,
    finite_values,
    scaled,
    tip_from_height,
)
from jaxstab.units import prefixed, unit_of

# Xarray is imported where it is used, since its import is slow.
if TYPE_CHECKING:
    import xarray

_BASELINES = ("linear", "constant")
# The parts of a curve that is far from the sample, and deepest in it.
_FAR = 0.25
_DEEP = 0.02
# The travel of a tip, of nanometres in most curves, is less than this in those of large beads [m].
_LARGEST_TRAVEL = 0.1


class ForceCurveWarning(UserWarning):
    """A force curve looks wrong: its forces have the opposite sign, or are clipped.

    Example:
        A file in which tension is positive:

        >>> height = np.linspace(2000.0, -1000.0, 400)
        >>> force = -3e-4 * np.maximum(-height, 0) ** 1.5
        >>> titles = "height [nm],force [nN]"
        >>> np.savetxt("curve.csv", np.c_[height, force], delimiter=",", header=titles, comments="")
        >>> import warnings
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     curve = js.lab.force_curves.read("curve.csv", spring_constant=0.2)
        >>> caught[0].category.__name__
        'ForceCurveWarning'
        >>> f"{(-curve).approach.force.max():.1e}"
        '9.5e-09'
    """


@dataclass(frozen=True, eq=False, repr=False)
class ForceCurve:
    """A measured force curve. Its methods return new ones; `print` shows what it holds and lacks.

    `-curve` reverses the sign of the forces.

    Attributes:
        approach: the part in which the tip approaches the sample, or None.
        retraction: the part in which it retracts, or None.
        pauses: other parts, as between approach and retraction, in their order.
        spring_constant: of the cantilever [force/length], N/m in the files of instruments.
        sensitivity: its deflection over the signal of the detector [length/V, or length/A].
        signal_unit: the unit of that signal, "V" or "A".
        position: where on the sample it was measured, x and y [length].
        pixel: its column and row on a map.
        unit: the unit of lengths.
        force_unit: the unit of forces.
        source: the file, and the number of the curve in it.
        instrument: the name of the instrument.
        remarks: the choices of the reader.
        correction: the baseline, the contact point and the drift that `corrected` has removed.

    Example:
        >>> height = np.linspace(2e-6, -1e-6, 400)
        >>> force = 0.01 * np.maximum(-height, 0) ** 1.5
        >>> approach = js.lab.force_curves.Segment(force, height)
        >>> curve = js.lab.force_curves.ForceCurve(approach, None, spring_constant=1.0)
        >>> f"{curve.approach.force.max():.1e}"
        '1.0e-11'
    """

    approach: Segment | None
    retraction: Segment | None
    pauses: tuple[Segment, ...] = ()
    spring_constant: float | None = None
    sensitivity: float | None = None
    signal_unit: str = "V"
    position: tuple[float, float] | None = None
    pixel: tuple[int, int] | None = None
    unit: str = "m"
    force_unit: str = "N"
    source: str = ""
    instrument: str = ""
    remarks: tuple[str, ...] = ()
    correction: Correction | None = None

    @property
    def speed(self) -> float | None:
        """The speed of the approach, or without one of the retraction [length/s]."""
        segments = [self.approach, self.retraction]
        return next((segment.speed for segment in segments if segment is not None), None)

    @property
    def segments(self) -> dict[str, Segment]:
        """Approach, pauses and retraction by name, those that the curve has."""
        named = {f"pause {i}": pause for i, pause in enumerate(self.pauses, 1)}
        ends = {"approach": self.approach, "retraction": self.retraction}
        return {name: part for name, part in (ends | named).items() if part is not None}

    @property
    def suspicions(self) -> list[str]:
        """A sentence for each property of the curve that looks wrong."""
        return [x for name, segment in self._ends() for x in self._suspicions_of(name, segment)]

    def _suspicions_of(self, name: str, segment: Segment) -> Iterator[str]:
        if _is_reversed(segment):
            yield (
                f"the forces of the {name} fall where it is deepest: attraction seems to be "
                "positive. Reverse the forces by `-curve`."
            )
        if segment.is_clipped.any():
            yield (
                f"{np.sum(segment.is_clipped)} forces of the {name} are at the end of the range of "
                "the detector: `corrected` leaves them out."
            )
        travel = _travel(segment)
        if travel * 10.0 ** LENGTHS[self.unit] > _LARGEST_TRAVEL:
            yield (
                f"the heights of the {name} span {travel:.3g} {self.unit}, which no tip "
                "moves: are they in another unit?"
            )

    def corrected(self, baseline: Literal["linear", "constant"] = "linear") -> "ForceCurve":
        """Remove the baseline of the forces, and count heights from the contact point.

        - The baseline is a line through the forces of each segment over the height, fitted from the
          far end to where a force first exceeds the noise. A retraction whose far part bends, or
          rises as in contact, has not detached: it has the baseline of the approach.
        - The drift is the speed at which heights of equal force move in the contact, from approach
          to retraction. It is removed if it is below 1 % of the speed of the approach: more is
          hysteresis of the sample, which stays.
        - The contact point is d in F = K (d - tip)^(3/2) - F_0, fitted to the lower part of the
          approach: the theory of Derjaguin, Muller and Toporov, for a paraboloid. It is a start for
          a fit of the contact, as by `jaxstab.calibrate`. Its error includes how far it moves if
          forces below a tenth or a fifth of the largest are left out.

        Without a spring constant the baseline alone is removed. `print` shows the numbers with
        their standard errors, which allow for noise that is correlated over some points.

        Arguments:
            baseline: "linear", with a tilt, or "constant".

        Raises:
            ValueError: for another baseline, for fewer than 50 points of a segment, and where no
                part of the curve is free of force, or none in contact.
        """
        require_baseline(baseline)
        segments, correction, remarks = correct(
            self.segments, self.spring_constant, baseline == "linear"
        )
        return replace(
            self,
            approach=segments.pop("approach", None),
            retraction=segments.pop("retraction", None),
            pauses=tuple(segments.values()),
            correction=correction,
            remarks=(*self.remarks, *remarks),
        )

    def in_units(self, unit: str, force_unit: str) -> "ForceCurve":
        """Return the curve in other units, as in `curve.in_units("nm", "nN")`.

        Arguments:
            unit: of lengths, from pm to km.
            force_unit: of forces, N with any prefix.

        Raises:
            ValueError: for other units.
        """
        unit = unit_of(unit)
        # Micro is written as u, or as a Greek letter.
        force_unit = re.sub("^(u|\u03bc)", "µ", force_unit)
        if force_unit not in FORCES:
            raise ValueError(
                f"the unit of force is {force_unit!r}: choose one of {', '.join(FORCES)}."
            )
        length = 10.0 ** (LENGTHS[self.unit] - LENGTHS[unit])
        force = 10.0 ** (FORCES[self.force_unit] - FORCES[force_unit])
        curve = self._map(lambda segment: segment.scaled(length, force))
        position = self.position
        if position is not None:
            position = (position[0] * length, position[1] * length)
        correction = self.correction
        if correction is not None:
            correction = correction.scaled(length, force)
        return replace(
            curve,
            unit=unit,
            force_unit=force_unit,
            spring_constant=scaled(self.spring_constant, force / length),
            sensitivity=scaled(self.sensitivity, length),
            position=position,
            correction=correction,
        )

    @property
    def readable(self) -> "ForceCurve":
        """The curve in metres and newtons with the prefixes that suit its size, as in figures.

        Other units than "m" and "N" are the user's choice, and stay.
        """
        sizes = [0.0, 0.0]
        for segment in self.segments.values():
            if segment.num_missing < len(segment):
                height, force = (
                    np.ptp(finite_values(segment.height)),
                    np.abs(finite_values(segment.force)).max(),
                )
                sizes = [max(sizes[0], float(height)), max(sizes[1], float(force))]
        units = self.unit, self.force_unit
        unit, force_unit = (
            prefixed(size, one)[1] if one in ("m", "N") else one
            for size, one in zip(sizes, units, strict=True)
        )
        return self.in_units(unit if unit in LENGTHS else self.unit, force_unit)

    def __neg__(self) -> "ForceCurve":
        """Reverse the sign of the forces, of which a correction no longer holds."""
        constant = self.spring_constant

        def reverse(segment: Segment) -> Segment:
            tip = tip_from_height(segment.height, -segment.force, constant)
            return replace(segment, force=-segment.force, tip=tip)

        remarks = (*self.remarks, "forces reversed")
        return replace(self._map(reverse), remarks=remarks, correction=None)

    def to_dataset(self) -> "xarray.Dataset":
        """Return a data set of xarray, with a dimension for each segment, and units.

        It holds all of the curve: `from_dataset` is the inverse.

        Raises:
            ImportError: without xarray.
        """
        try:
            import xarray
        except ImportError as error:
            cure = "Labelled data sets need xarray: pip install 'jaxstab[data]'."
            raise ImportError(cure) from error

        units = {"height": self.unit, "tip_position": self.unit, "force": self.force_unit}
        variables = {}
        for name, segment in self.segments.items():
            prefix = name.replace(" ", "_")
            columns = {
                "force": segment.force,
                "height": segment.height,
                "tip_position": segment.tip,
                "time": segment.time,
            }
            for column, values in columns.items():
                if values is not None:
                    attributes = {
                        "long_name": f"{column.replace('_', ' ')}, {name}",
                        "units": units.get(column, "s"),
                    }
                    variables[f"{prefix}_{column}"] = (f"{prefix}_point", values, attributes)
        per_signal = f"{self.unit}/{self.signal_unit}"
        lengths = f"{self.force_unit}/{self.unit}", per_signal, self.unit, self.unit
        x, y = self.position or (None, None)
        numbers = {
            "spring_constant": self.spring_constant,
            "sensitivity": self.sensitivity,
            "x": x,
            "y": y,
        }
        for (name, value), unit in zip(numbers.items(), lengths, strict=True):
            if value is not None:
                variables[name] = ((), value, {"long_name": name.replace("_", " "), "units": unit})
        attributes: dict[str, Any] = {"title": "Force curve", "source": self.source}
        if self.instrument:
            attributes["instrument"] = self.instrument
        if self.remarks:
            attributes["remarks"] = "; ".join(self.remarks)
        attributes["curve"] = json.dumps(self._without_arrays())
        return xarray.Dataset(variables, attrs=attributes)

    @classmethod
    def from_dataset(cls, dataset: "xarray.Dataset") -> Self:
        """Return the curve of a data set that `to_dataset` made.

        Raises:
            ValueError: for another data set.
        """
        if "curve" not in dataset.attrs:
            raise ValueError("The data set is none of a force curve, made by its `to_dataset`.")
        parts = json.loads(dataset.attrs["curve"])
        speeds = parts.pop("stated_speeds")
        segments = {}
        for name, speed in speeds.items():
            prefix = name.replace(" ", "_")
            columns = {"force": "force", "height": "height", "tip": "tip_position", "time": "time"}
            values = {
                column: np.asarray(dataset[f"{prefix}_{title}"])
                for column, title in columns.items()
                if f"{prefix}_{title}" in dataset
            }
            segments[name] = Segment(**values, stated_speed=speed)
        correction = parts.pop("correction")
        if correction is not None:
            for name in ("approach", "retraction"):
                if correction[name] is not None:
                    correction[name] = Baseline(**correction[name])
            correction = Correction(**correction)
        for name in ("position", "pixel", "remarks"):
            if parts[name] is not None:
                parts[name] = tuple(parts[name])
        return cls(
            approach=segments.pop("approach", None),
            retraction=segments.pop("retraction", None),
            pauses=tuple(segments.values()),
            correction=correction,
            **parts,
        )

    def _without_arrays(self) -> dict[str, Any]:
        """Return all fields but the segments, and of these the speeds that the file states."""
        kept = {field.name for field in fields(self)} - {"approach", "retraction", "pauses"}
        parts = {name: getattr(self, name) for name in sorted(kept)}
        parts["correction"] = None if self.correction is None else asdict(self.correction)
        speeds = {name: segment.stated_speed for name, segment in self.segments.items()}
        return {**parts, "stated_speeds": speeds}

    def __repr__(self) -> str:
        return "\n".join([type(self).__name__, *(f"  {k:<15}  {v}" for k, v in self._rows())])

    def _rows(self) -> Iterator[tuple[str, str]]:
        yield "source", self.source or "not from a file"
        if self.instrument:
            yield "instrument", self.instrument
        texts = {name: self._description(segment) for name, segment in self.segments.items()}
        yield from ({"approach": "missing", "retraction": "missing"} | texts).items()
        constant = "missing: no tip position"
        if self.spring_constant is not None:
            per_si = 10.0 ** (FORCES[self.force_unit] - LENGTHS[self.unit])
            constant = f"{self.spring_constant * per_si:.6g} N/m"
        yield "spring constant", constant
        if self.sensitivity is not None:
            yield "sensitivity", f"{self.sensitivity:.6g} {self.unit}/{self.signal_unit}"
        if self.position is not None:
            x, y = self.position
            yield "position", f"x = {x:.6g} {self.unit}, y = {y:.6g} {self.unit}"
        if self.pixel is not None:
            yield "pixel", f"column {self.pixel[0]}, row {self.pixel[1]}"
        if self.correction is not None:
            yield from self.correction.rows(self.unit, self.force_unit)
        yield from (("done", remark) for remark in self.remarks)
        yield from (("looks wrong", sentence) for sentence in self.suspicions)

    def _description(self, segment: Segment) -> str:
        if segment.num_missing == len(segment):
            return f"{len(segment)} points, all of them missing"
        parts = [f"{len(segment)} points"]
        if segment.num_missing:
            parts.append(f"{segment.num_missing} missing")
        for name, values, unit in (
            ("height", segment.height, self.unit),
            ("force", segment.force, self.force_unit),
        ):
            lowest = f"{name} {np.nanmin(values):.4g}"
            parts.append(f"{lowest} to {np.nanmax(values):.4g} {unit}")
        if segment.speed is not None:
            parts.append(f"{segment.speed:.4g} {self.unit}/s")
        return ", ".join(parts)

    def _ends(self) -> list[tuple[str, Segment]]:
        ends = [("approach", self.approach), ("retraction", self.retraction)]
        return [(name, segment) for name, segment in ends if segment is not None]

    def _map(self, change: Any) -> "ForceCurve":
        """Return the curve with each segment changed."""
        ends = {name: change(segment) for name, segment in self._ends()}
        return replace(self, **ends, pauses=tuple(map(change, self.pauses)))


def require_baseline(baseline: object) -> None:
    """Raise `ValueError` for another kind of baseline than those known."""
    if baseline not in _BASELINES:
        raise ValueError(f"baseline is {baseline!r}: choose one of {', '.join(_BASELINES)}.")


def _travel(segment: Segment) -> float:
    """Return the range of the heights, zero if all are missing."""
    heights = finite_values(segment.height)
    return float(np.ptp(heights)) if heights.size else 0.0


def _is_reversed(segment: Segment) -> bool:
    """Whether the deepest points pull, and more than any others push."""
    force = segment.force[segment.is_present]
    height = segment.height[segment.is_present]
    if force.size < 1 / _DEEP:
        return False
    order = np.argsort(height)
    count = force.size
    far = force[order[count - int(_FAR * count) :]]
    zero = np.median(far)
    noise = 1.4826 * np.median(np.abs(far - zero))
    deep = np.median(force[order[: max(int(_DEEP * count), 1)]]) - zero
    return bool(deep < -SIGNIFICANT * noise and -deep > force.max() - zero)


def curve_to_fit(curve: ForceCurve, segment: str) -> ForceCurve:
    """Return the corrected curve for a fit to one of its segments, or raise what forbids one.

    Raises:
        TypeError: for anything but a force curve.
        ValueError: for another segment or one that the curve lacks, no spring constant, and a curve
            that cannot be corrected.
    """
    if not isinstance(curve, ForceCurve):
        raise TypeError(
            f"The curve is a {type(curve).__name__}: give a ForceCurve, as "
            "jaxstab.lab.force_curves.read returns it; jaxstab.lab.fit_each fits several."
        )
    if segment not in ("approach", "retraction"):
        raise ValueError(f"The segment is {segment!r}: choose approach or retraction.")
    if getattr(curve, segment) is None:
        raise ValueError(f"The curve has no {segment}: fit another segment.")
    if curve.spring_constant is None:
        raise ValueError(
            "The curve has no spring constant, without which indentations are unknown: give it in "
            "N/m, as in jaxstab.lab.force_curves.read(path, spring_constant=0.2)."
        )
    return curve if curve.correction is not None else curve.corrected()

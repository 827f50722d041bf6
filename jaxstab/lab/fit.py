"""The result of a fit to a force curve."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

import jaxstab as js
from jaxstab.lab.tips import (
    Cone,
    ElasticTip,
    FlatPunch,
    Paraboloid,
    Pyramid,
    Sphere,
    SphereOnPlate,
    Tip,
    TwoSpheres,
)

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

_SYMBOLS = {
    "youngs_modulus": "Pa",
    "work_of_adhesion": "J/m²",
    "range": "m",
    "contact_point": "m",
}
_OF_FORCES = "noise", "misfit"
# A figure shows this part of the depth beyond the contact and beyond the fitted attraction, which
# ends where it is this part of the largest one.
_BESIDE, _FAINT = 0.3, 0.02
_LENGTHS, _FORCES = js.units.powers_of_ten("length"), js.units.powers_of_ten("force")


@dataclass(frozen=True)
class FitErrors:
    """Standard errors of a fit, by the names of its numbers; NaN where nothing is known.

    Attributes:
        youngs_modulus: of E [Pa].
        work_of_adhesion: of w [J/m^2].
        range: of the range of the attraction [m].
        contact_point: of the contact point [m].

    Example:
        >>> noise = np.random.default_rng(0).normal(0.0, 1e-13, 400)
        >>> approach = js.lab.force_curves.Segment(force + noise, height)
        >>> curve = js.lab.force_curves.ForceCurve(approach, None, spring_constant=1.0)
        >>> fit = js.lab.fit_curve(curve, js.lab.Paraboloid(radius=5e-6))
        >>> bool(abs(fit.contact_point) < 3 * fit.errors.contact_point)
        True
        >>> fit.errors.work_of_adhesion
        nan
    """

    youngs_modulus: float
    work_of_adhesion: float
    range: float
    contact_point: float


@dataclass(frozen=True, eq=False, repr=False)
class ForceCurveFit:
    """The fit of a force curve, in SI units; `print` adds the units of the curve.

    Attributes:
        youngs_modulus: E of the sample [Pa].
        work_of_adhesion: w, zero for a curve without attraction [J/m^2].
        range: the gap up to which the constant attraction w / range acts (Dugdale), NaN without
            adhesion and for a flat punch [m].
        contact_point: the tip position at which the undeformed surfaces would touch, from the zero
            of `curve` [m].
        errors: standard errors by the same names.
        result: a member of `jaxstab.RESULTS`: `misfit` if the model does not describe the curve.
        misfit: the rms deviation of forces from the model, in contact or, where it is larger, in
            the attraction before contact [N].
        noise: the standard deviation of forces where none acts [N].
        curve: the corrected curve that is fitted, in its own units.
        segment: "approach" or "retraction".
        tip: the tip.
        poisson_ratio: nu.
        forces: the fitted force at each point of the segment, with the rest of its baseline, NaN
            where a point is missing, in the units of the curve.

    Example:
        >>> fit = js.lab.fit_curve(curve, js.lab.Paraboloid(radius=5e-6))
        >>> bool(abs(fit.contact_point) < 1e-10)
        True
    """

    youngs_modulus: float
    work_of_adhesion: float
    range: float
    contact_point: float
    errors: FitErrors
    result: js.RESULTS
    misfit: float
    noise: float
    curve: js.lab.force_curves.ForceCurve
    segment: Literal["approach", "retraction"]
    tip: Tip | FlatPunch
    poisson_ratio: float
    forces: np.ndarray

    @property
    def status(self) -> str:
        """The result as a sentence, with its cause and cure."""
        return str(js.RESULTS[self.result])

    @property
    def contact_modulus(self) -> float:
        """E* of both bodies, 1 / E* = (1 - nu^2) / E + (1 - nu_t^2) / E_t [Pa]."""
        own = (1 - self.poisson_ratio**2) / self.youngs_modulus
        return 1 / (own + (self.tip.compliance if isinstance(self.tip, ElasticTip) else 0.0))

    @property
    def points(self) -> js.lab.force_curves.Segment:
        """The measured points, in the units of the curve."""
        return getattr(self.curve, self.segment)

    @property
    def tip_positions(self) -> np.ndarray:
        """Tip positions of the fitted forces, without noise, in the units of the curve."""
        assert self.curve.spring_constant is not None
        return self.points.height + self.forces / self.curve.spring_constant

    def to_dataset(self) -> xarray.Dataset:
        """Return the curve, as its own `to_dataset`, with the fitted forces and all numbers.

        Each number is in SI units, with `units` and `standard_error` among its attributes.
        `from_dataset` is the inverse; `jaxstab.save` and `load` write and read a fit as a file.

        Raises:
            ImportError: without xarray.
        """
        dataset = self.curve.to_dataset()
        attributes = {"long_name": "fitted force", "units": self.curve.force_unit}
        dataset["fitted_force"] = (f"{self.segment}_point", self.forces, attributes)
        store_numbers(dataset, self, _SYMBOLS)
        title = {"title": "Fit of a force curve", **dict(self._statements())}
        inputs = {
            "result": self.result.name,
            "segment": self.segment,
            "tip": numbers_of_tip(self.tip),
            "poisson_ratio": self.poisson_ratio,
            "errors": asdict(self.errors),
        }
        return dataset.assign_attrs(title, fit=json.dumps(inputs))

    @classmethod
    def from_dataset(cls, dataset: xarray.Dataset) -> Self:
        """Return the fit of a data set that `to_dataset` made.

        Raises:
            ValueError: for another data set.
        """
        if "fit" not in dataset.attrs:
            raise ValueError("The data set is none of a fit, made by its `to_dataset`.")
        inputs = json.loads(dataset.attrs["fit"])
        return cls(
            **stored_numbers(dataset, _SYMBOLS),
            errors=FitErrors(**inputs.pop("errors")),
            result=getattr(js.RESULTS, inputs.pop("result")),
            curve=js.lab.force_curves.ForceCurve.from_dataset(dataset),
            tip=tip_of_numbers(inputs.pop("tip")),
            forces=np.asarray(dataset["fitted_force"]),
            **inputs,
        )

    def to_csv(self, path: str | Path) -> Path:
        """Write numbers, errors and the fitted curve as text in UTF-8, and return its path.

        Comments hold the numbers with standard errors, in SI units. The columns are those that
        `jaxstab.lab.force_curves.read` reads, and the fitted force, in the units of the curve.

        Arguments:
            path: the file; it must not exist yet.

        Raises:
            FileExistsError: if the file exists.
        """
        points, curve = self.points, self.curve
        tip = {f"tip position [{curve.unit}]": points.tip_position}
        time = {} if points.time is None else {"time [s]": points.time}
        columns = {
            f"height [{curve.unit}]": points.height,
            f"force [{curve.force_unit}]": points.force,
            f"fitted force [{curve.force_unit}]": self.forces,
            **tip,
            **time,
        }
        comments = [*self._statements()]
        for name, symbol in _SYMBOLS.items():
            value, error = getattr(self, name), getattr(self.errors, name)
            comments.append((name, with_error(value, error, symbol)))
        return write_table(path, comments, columns)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the curve over the tip position, with the fitted forces and the contact point.

        The contact and the attraction fill the figure, not the baseline.

        Arguments:
            axes: the axes to draw on; new ones by default.
        """
        axes = js.plots.force_curve(self.curve, "tip_position", axes=axes)
        shown = self.curve.readable
        own, drawn = own_units(self.curve), own_units(shown)
        tips = self.tip_positions * (drawn[0] / own[0])
        forces = self.forces * (drawn[1] / own[1])
        contact = self.contact_point * drawn[0]
        axes.plot(tips, forces, color="black", linewidth=1, label="fit")
        axes.axvline(contact, color="grey", linewidth=1, linestyle=":", label="contact point")
        deepest = np.nanmin(tips)
        depth = contact - deepest
        end = contact
        if self.work_of_adhesion > 0:
            is_attracted = forces < _FAINT * np.nanmin(forces)
            end = max(end, np.nanmax(tips[is_attracted], initial=contact))
        lowest, highest = np.nanmin(forces), np.nanmax(forces)
        margin = _BESIDE * (highest - lowest) / 2
        axes.set_xlim(deepest - _BESIDE * depth / 2, end + _BESIDE * (end - deepest))
        axes.set_ylim(lowest - margin, highest + margin)
        axes.legend(frameon=False)
        return axes

    def _statements(self) -> Iterator[tuple[str, str]]:
        yield "fit of a force curve", self.result.name
        yield "source", self.curve.source or "not from a file"
        yield "segment", self.segment
        yield "tip", str(self.tip)
        yield "poisson ratio", f"{self.poisson_ratio:.6g}"
        length, force = own_units(self.curve)
        assert self.curve.spring_constant is not None
        yield "spring constant", f"{self.curve.spring_constant * length / force:.9g} N/m"

    def __repr__(self) -> str:
        rows = [("", "value", "standard error", "", "in units of the curve"), *_rows(self)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join(
                [
                    row[0].ljust(widths[0]),
                    *(text.rjust(width) for text, width in zip(row[1:3], widths[1:3], strict=True)),
                    row[3].ljust(widths[3]),
                    row[4],
                ]
            ).rstrip()
            for row in rows
        ]
        by, unit = js.units.prefixed(self.noise, "N")
        head = (
            f"ForceCurveFit: {self.result.name}, {self.segment}, {self.tip}, misfit "
            f"{self.misfit / self.noise:.2g} times the noise of {self.noise / by:.3g} {unit}"
        )
        return "\n".join([head, *lines])


def numbers_of_tip(tip: Tip | FlatPunch) -> dict[str, Any]:
    """Return the class of a tip and its numbers, or the tip within it."""
    parts = {
        name: numbers_of_tip(part) if isinstance(part, Tip) else part
        for name, part in vars(tip).items()
    }
    return {"shape": type(tip).__name__, **parts}


def tip_of_numbers(numbers: dict[str, Any]) -> Any:
    """Return the tip of a class and its numbers."""
    shapes = Cone, ElasticTip, FlatPunch, Paraboloid, Pyramid, Sphere, SphereOnPlate, TwoSpheres
    shape = {shape.__name__: shape for shape in shapes}[numbers.pop("shape")]
    parts = {
        name: tip_of_numbers(part) if isinstance(part, dict) else part
        for name, part in numbers.items()
    }
    return shape(**parts)


def store_numbers(dataset: xarray.Dataset, fit: Any, units: Mapping[str, str]) -> None:
    """Add the numbers of a fit to a data set, with their standard errors, noise and misfit."""
    for name, unit in units.items():
        attributes = {"units": unit, "standard_error": getattr(fit.errors, name)}
        dataset[name] = ((), getattr(fit, name), attributes)
    for name in _OF_FORCES:
        dataset[name] = ((), getattr(fit, name), {"units": "N"})


def stored_numbers(dataset: xarray.Dataset, names: Iterable[str]) -> dict[str, Any]:
    """Return by name the numbers that `store_numbers` has added."""
    return {name: float(dataset[name]) for name in (*names, *_OF_FORCES)}


def with_error(value: float, error: float, unit: str) -> str:
    """Return a number of a fit in words, with its standard error."""
    return f"{value:.9g} {unit}, standard error {error:.3g} {unit}"


def write_table(
    path: str | Path, comments: Iterable[tuple[str, str]], columns: Mapping[str, Iterable]
) -> Path:
    """Write comments and columns by their titles as text in UTF-8, and return its path.

    Raises:
        FileExistsError: if the file exists.
    """
    path = Path(path)
    with path.open("x", encoding="utf-8", newline="") as file:
        file.writelines(f"# {name}: {text}\n" for name, text in comments)
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([x if isinstance(x, str) else f"{x:.9g}" for x in row])
    return path


def own_units(curve: js.lab.force_curves.ForceCurve) -> tuple[float, float]:
    """Return one metre and one newton in the units of a curve."""
    return 10.0 ** -_LENGTHS[curve.unit], 10.0 ** -_FORCES[curve.force_unit]


def _rows(fit: ForceCurveFit) -> Iterator[tuple[str, str, str, str, str]]:
    curve = fit.curve.readable
    length, force = own_units(curve)
    names = curve.unit, curve.force_unit
    for name, factor, own in (
        ("youngs_modulus", force / length**2, f"{names[1]}/{names[0]}²"),
        ("work_of_adhesion", force / length, f"{names[1]}/{names[0]}"),
        ("range", length, names[0]),
        ("contact_point", length, names[0]),
    ):
        symbol = _SYMBOLS[name]
        value, error = getattr(fit, name), getattr(fit.errors, name)
        if np.isnan(value):
            yield name, "-", "-", "", ""
            continue
        by, unit = js.units.prefixed(max(abs(value), np.nan_to_num(error)), symbol)
        in_own = f"{value * factor:.5g} ± {error * factor:.2g} {own}"
        if np.isnan(error):
            in_own = f"{value * factor:.5g} {own}"
        errors = "-" if np.isnan(error) else f"{error / by:.2g}"
        yield name, f"{value / by:.5g}", errors, unit, in_own

"""The result of a fit to a force curve in time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

import jaxstab as js
from jaxstab.lab.figures import axes_or_new
from jaxstab.lab.fit import (
    numbers_of_tip,
    store_numbers,
    stored_numbers,
    tip_of_numbers,
    with_error,
    write_table,
)
from jaxstab.lab.tips import Tip

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

# Units of the numbers, and of those of each mode.
_SYMBOLS = {
    "relaxed_modulus": "Pa",
    "instantaneous_modulus": "Pa",
    "work_of_adhesion": "J/m²",
    "range": "m",
    "contact_point": "m",
}
_OF_MODES = {"ratios": "1", "relaxation_times": "s"}


@dataclass(frozen=True, eq=False)
class ViscoelasticErrors:
    """Standard errors of a fit in time, by the names of its numbers; NaN where nothing is known.

    Attributes:
        relaxed_modulus, instantaneous_modulus: of the moduli [Pa].
        ratios: of each mode.
        relaxation_times: of each mode, zero of a time that is given [s].
        work_of_adhesion: of w [J/m^2].
        range: of the range of the law [m].
        contact_point: of the contact point [m].

    Example:
        The sample is elastic, so that no ratio is told:

        >>> time = np.linspace(0, 1, 400)
        >>> timed = js.lab.force_curves.Segment(force, height, height + force / 1.0, time)
        >>> curve = js.lab.force_curves.ForceCurve(timed, None, spring_constant=1.0)
        >>> tip = js.lab.Paraboloid(radius=5e-6)
        >>> fit = js.lab.fit_viscoelastic(curve, tip, relaxation_times=[0.1])
        >>> bool(fit.ratios[0] < fit.errors.ratios[0])
        True
        >>> fit.errors.relaxation_times  # given, not fitted
        array([0.])
    """

    relaxed_modulus: float
    instantaneous_modulus: float
    ratios: np.ndarray
    relaxation_times: np.ndarray
    work_of_adhesion: float
    range: float
    contact_point: float


@dataclass(frozen=True, eq=False, repr=False)
class ViscoelasticFit:
    """The fit of approach, pauses and retraction by a Prony series, in SI units.

    Attributes:
        relaxed_modulus: E at long times [Pa].
        instantaneous_modulus: E at once, relaxed_modulus (1 + sum of the ratios) [Pa].
        ratios: r_k in E(t) = E (1 + sum r_k exp(-t / T_k)).
        relaxation_times: T_k, rising [s].
        work_of_adhesion: w, zero for a curve without attraction [J/m^2].
        range: of the exponential law -w exp(-g / range), NaN without adhesion [m].
        contact_point: the tip position at which the undeformed surfaces would touch, from the zero
            of `curve` [m].
        errors: standard errors by the same names.
        result: a member of `jaxstab.RESULTS`: `misfit` if the model does not describe the curve,
            `undetermined` if the curve does not tell all modes.
        misfit: the rms deviation of means of the force from the model [N].
        noise: the typical standard error of these means [N].
        curve: the corrected curve, in its own units.
        tip: the tip.
        poisson_ratio: nu.
        times: of each mean [s].
        measured: the mean forces at these times [N].
        forces: the fitted ones [N].

    Example:
        The sample is elastic, so that no ratio is told:

        >>> time = np.linspace(0, 1, 400)
        >>> timed = js.lab.force_curves.Segment(force, height, height + force / 1.0, time)
        >>> curve = js.lab.force_curves.ForceCurve(timed, None, spring_constant=1.0)
        >>> tip = js.lab.Paraboloid(radius=5e-6)
        >>> fit = js.lab.fit_viscoelastic(curve, tip, relaxation_times=[0.1])
        >>> again = js.load(js.save("fit.nc", fit))
        >>> f"{again.result.name}, {again.relaxed_modulus:.2f} Pa"
        'undetermined, 2.52 Pa'
    """

    relaxed_modulus: float
    instantaneous_modulus: float
    ratios: np.ndarray
    relaxation_times: np.ndarray
    work_of_adhesion: float
    range: float
    contact_point: float
    errors: ViscoelasticErrors
    result: js.RESULTS
    misfit: float
    noise: float
    curve: js.lab.force_curves.ForceCurve
    tip: Tip
    poisson_ratio: float
    times: np.ndarray
    measured: np.ndarray
    forces: np.ndarray

    @property
    def status(self) -> str:
        """The result as a sentence, with its cause and cure."""
        return str(js.RESULTS[self.result])

    def to_dataset(self) -> xarray.Dataset:
        """Return the curve, as its own `to_dataset`, with the means, their fit and all numbers.

        Each number is in SI units, with `units` and `standard_error` among its attributes; those of
        the modes have a dimension, and their errors are variables. `from_dataset` is the inverse;
        `jaxstab.save` and `load` write and read a fit as a file.

        Raises:
            ImportError: without xarray.
        """
        dataset = self.curve.to_dataset()
        for name, values, unit in (
            ("mean_time", self.times, "s"),
            ("mean_force", self.measured, "N"),
            ("fitted_force", self.forces, "N"),
        ):
            attributes = {"long_name": name.replace("_", " "), "units": unit}
            dataset[name] = ("mean", values, attributes)
        for name, unit in _OF_MODES.items():
            attributes = {"long_name": name.replace("_", " "), "units": unit}
            dataset[name] = ("mode", getattr(self, name), attributes)
            attributes = {"long_name": f"standard errors of the {name}", "units": unit}
            dataset[f"{name}_error"] = ("mode", getattr(self.errors, name), attributes)
        store_numbers(dataset, self, _SYMBOLS)
        errors = {k: x for k, x in asdict(self.errors).items() if k not in _OF_MODES}
        inputs = {
            "result": self.result.name,
            "tip": numbers_of_tip(self.tip),
            "poisson_ratio": self.poisson_ratio,
            "errors": errors,
        }
        title = {"title": "Fit of a force curve in time", **dict(self._statements())}
        return dataset.assign_attrs(title, fit_in_time=json.dumps(inputs))

    @classmethod
    def from_dataset(cls, dataset: xarray.Dataset) -> Self:
        """Return the fit of a data set that `to_dataset` made.

        Raises:
            ValueError: for another data set.
        """
        if "fit_in_time" not in dataset.attrs:
            raise ValueError("The data set is none of a fit in time, made by its `to_dataset`.")
        inputs: dict[str, Any] = json.loads(dataset.attrs["fit_in_time"])
        modes: dict[str, Any] = {name: np.asarray(dataset[name]) for name in _OF_MODES}
        own: dict[str, Any] = {name: np.asarray(dataset[f"{name}_error"]) for name in _OF_MODES}
        return cls(
            **stored_numbers(dataset, _SYMBOLS),
            **modes,
            errors=ViscoelasticErrors(**inputs["errors"], **own),
            result=getattr(js.RESULTS, inputs["result"]),
            curve=js.lab.force_curves.ForceCurve.from_dataset(dataset),
            tip=tip_of_numbers(inputs["tip"]),
            poisson_ratio=inputs["poisson_ratio"],
            times=np.asarray(dataset["mean_time"]),
            measured=np.asarray(dataset["mean_force"]),
            forces=np.asarray(dataset["fitted_force"]),
        )

    def to_csv(self, path: str | Path) -> Path:
        """Write numbers, errors, measured and fitted forces as text in UTF-8; return its path.

        Arguments:
            path: the file; it must not exist yet.

        Raises:
            FileExistsError: if the file exists.
        """
        comments = [*self._statements()]
        for name, value, error, symbol in self._numbers():
            comments.append((name, with_error(value, error, symbol)))
        columns = {
            "time [s]": self.times,
            "force [N]": self.measured,
            "fitted force [N]": self.forces,
        }
        return write_table(path, comments, columns)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the measured and the fitted forces over the time.

        Arguments:
            axes: the axes to draw on; new ones by default.
        """
        axes = axes_or_new(axes)
        by, unit = js.units.prefixed(float(np.max(np.abs(self.measured))), "N")
        axes.plot(self.times, self.measured / by, ".", color="0.6", label="measured")
        axes.plot(self.times, self.forces / by, color="black", linewidth=1, label="fit")
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"force [{unit}]")
        axes.legend(frameon=False)
        return axes

    def _statements(self) -> Iterator[tuple[str, str]]:
        yield "fit of a force curve in time", self.result.name
        yield "source", self.curve.source or "not from a file"
        yield "tip", str(self.tip)
        yield "poisson ratio", f"{self.poisson_ratio:.6g}"

    def _numbers(self) -> Iterator[tuple[str, float, float, str]]:
        """Yield name, value, standard error and unit of each number."""
        names = [*_SYMBOLS]
        for name in names[:2]:
            yield name, getattr(self, name), getattr(self.errors, name), _SYMBOLS[name]
        for mode in range(len(self.ratios)):
            for name, symbol in _OF_MODES.items():
                numbered = name.removesuffix("s")
                if len(self.ratios) > 1:
                    numbered += f" {mode + 1}"
                value, error = getattr(self, name)[mode], getattr(self.errors, name)[mode]
                yield numbered, float(value), float(error), symbol
        for name in names[2:]:
            yield name, getattr(self, name), getattr(self.errors, name), _SYMBOLS[name]

    def __repr__(self) -> str:
        return "\n".join([*self._rows()])

    def _rows(self) -> Iterator[str]:
        times = f"{self.misfit / self.noise:.2g} times the noise of the means"
        yield f"ViscoelasticFit: {self.result.name}, {self.tip}, misfit {times}"
        for name, value, error, symbol in self._numbers():
            by, unit = 1.0, ""
            if symbol != "1":
                by, unit = js.units.prefixed(abs(value), symbol)
            numbers = "-" if np.isnan(value) else f"{value / by:.5g} ± {error / by:.2g} {unit}"
            yield f"  {name:<21}  {numbers}".rstrip()

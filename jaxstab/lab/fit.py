"""The result of a fit to a force curve."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

import jaxstab as js
from jaxstab.lab.tips import FlatPunch, Tip

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}


@dataclass(frozen=True)
class FitErrors:
    """Standard errors of a fit, by the names of its numbers; NaN where nothing is known.

    Attributes:
        youngs_modulus: of E [Pa].
        work_of_adhesion: of w [J/m^2].
        range: of the range of the attraction [m].
        contact_point: of the contact point [m].
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
        by, prefix = _prefix(self.noise)
        head = (
            f"ForceCurveFit: {self.result.name}, {self.segment}, {self.tip}, misfit "
            f"{self.misfit / self.noise:.2g} times the noise of {self.noise / by:.3g} {prefix}N"
        )
        return "\n".join([head, *lines])


def _rows(fit: ForceCurveFit) -> Iterator[tuple[str, str, str, str, str]]:
    # One metre and one newton in the units of the curve.
    unit = js.lab.force_curves.ForceCurve(
        js.lab.force_curves.Segment(np.ones(1), np.ones(1)), None
    ).in_units(fit.curve.unit, fit.curve.force_unit)
    assert unit.approach is not None
    length, force = unit.approach.height[0], unit.approach.force[0]
    names = fit.curve.unit, fit.curve.force_unit
    for name, symbol, factor, own in (
        ("youngs_modulus", "Pa", force / length**2, f"{names[1]}/{names[0]}²"),
        ("work_of_adhesion", "J/m²", force / length, f"{names[1]}/{names[0]}"),
        ("range", "m", length, names[0]),
        ("contact_point", "m", length, names[0]),
    ):
        value, error = getattr(fit, name), getattr(fit.errors, name)
        if np.isnan(value):
            yield name, "-", "-", "", ""
            continue
        by, prefix = _prefix(max(abs(value), np.nan_to_num(error)))
        in_own = f"{value * factor:.5g} ± {error * factor:.2g} {own}"
        if np.isnan(error):
            in_own = f"{value * factor:.5g} {own}"
        errors = "-" if np.isnan(error) else f"{error / by:.2g}"
        yield name, f"{value / by:.5g}", errors, prefix + symbol, in_own


def _prefix(value: float) -> tuple[float, str]:
    """Return a power of ten near a number, and its prefix."""
    if value == 0 or not np.isfinite(value):
        return 1.0, ""
    power = int(np.clip(np.floor(np.log10(value) / 3) * 3, -12, 12))
    return 10.0**power, _PREFIXES[power]

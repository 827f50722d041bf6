"""Apparent moduli of ever deeper parts of one approach."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import jaxstab as js
from jaxstab.lab import dugdale
from jaxstab.lab.figures import axes_or_new
from jaxstab.lab.fit import ForceCurveFit, own_units, write_table
from jaxstab.lab.fit_curve import fit_curve
from jaxstab.lab.fit_each import Fits, fit_each
from jaxstab.lab.tips import FlatPunch, Tip

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The least depth over the largest, and the fewest points in contact of a fit.
_LEAST = 0.1
_FEWEST = 20
# The least of the largest forces over the pull-off.
_PUSHED = 2.0


@dataclass(frozen=True, eq=False, repr=False)
class ModulusOverDepth:
    """The fits of ever deeper parts of an approach, each from its far end to a depth.

    Attributes:
        depths: the largest indentation of each part, from the contact point of a shallow part [m].
        parts: the fits from the shallowest part to the whole, with a reason for each that has
            failed or is no good description.

    Example:
        >>> found = js.lab.modulus_over_depth(curve, js.lab.Paraboloid(radius=5e-6), count=3)
        >>> f"{found.depths[-1]:.1e}"
        '1.0e-06'
        >>> [fit.result.name for fit in found.parts.fits]
        ['successful', 'successful', 'successful']
    """

    depths: np.ndarray
    parts: Fits[ForceCurveFit]

    @property
    def youngs_moduli(self) -> np.ndarray:
        """The apparent modulus of each part, NaN without a fit [Pa]."""
        return self.parts.values(lambda fit: fit.youngs_modulus)

    @property
    def errors(self) -> np.ndarray:
        """Their standard errors [Pa]."""
        return self.parts.values(lambda fit: fit.errors.youngs_modulus)

    @property
    def statuses(self) -> list[str]:
        """The status of each fit, or why there is none."""
        pairs = zip(self.parts.fits, self.parts.reasons, strict=True)
        return [reason if fit is None else fit.status for fit, reason in pairs]

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the moduli over the depth, with standard errors.

        Open symbols are moduli of fits that are not `successful`.

        Arguments:
            axes: the axes to draw on; new ones by default.
        """
        axes = axes_or_new(axes)
        curve = self.parts.curves[0].readable
        depths = self.depths * own_units(curve)[0]
        by, unit = js.units.prefixed(float(np.nanmax(self.youngs_moduli)), "Pa")
        moduli, errors = self.youngs_moduli / by, self.errors / by
        fits = self.parts.fits
        is_good = np.array([fit and fit.result == js.RESULTS.successful for fit in fits], bool)
        for chosen, face, label in (
            (is_good, "black", "fit"),
            (~is_good, "white", "fit that does not describe the curve"),
        ):
            if chosen.any():
                axes.errorbar(
                    depths[chosen],
                    moduli[chosen],
                    errors[chosen],
                    fmt="o",
                    color="black",
                    markerfacecolor=face,
                    capsize=3,
                    label=label,
                )
        axes.set_xlabel(f"indentation depth [{curve.unit}]")
        axes.set_ylabel(f"Young's modulus [{unit}]")
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        if not is_good.all():
            axes.legend(frameon=False)
        return axes

    def to_csv(self, path: str | Path) -> Path:
        """Write depths, moduli, errors and statuses as text in UTF-8, and return its path.

        Arguments:
            path: the file; it must not exist yet.

        Raises:
            FileExistsError: if the file exists.
        """
        whole = self.parts.curves[-1]
        comments = [("modulus over depth", "apparent moduli"), ("source", whole.source)]
        columns = {
            "depth [m]": self.depths,
            "youngs modulus [Pa]": self.youngs_moduli,
            "standard error [Pa]": self.errors,
            "status": self.statuses,
        }
        return write_table(path, comments, columns)

    def __repr__(self) -> str:
        return "\n".join([type(self).__name__, *self._rows()])

    def _rows(self) -> Iterator[str]:
        curve = self.parts.curves[0].readable
        length = own_units(curve)[0]
        fits, reasons = self.parts.fits, self.parts.reasons
        for depth, fit, reason in zip(self.depths, fits, reasons, strict=True):
            place = f"  depth {depth * length:10.4g} {curve.unit}"
            if fit is None:
                yield f"{place}  no fit: {reason}"
                continue
            by, unit = js.units.prefixed(fit.youngs_modulus, "Pa")
            yield (
                f"{place}  modulus {fit.youngs_modulus / by:8.4g} ± "
                f"{fit.errors.youngs_modulus / by:.2g} {unit}  {fit.result.name}"
            )


def modulus_over_depth(
    curve: js.lab.force_curves.ForceCurve,
    tip: Tip | FlatPunch,
    poisson_ratio: float = 0.5,
    count: int = 8,
) -> ModulusOverDepth:
    """Fit modulus, adhesion and contact point to ever deeper parts of an approach.

    Each part goes from the far end to a depth, and is fitted by `fit_curve` as a homogeneous
    sample. The depths are in a geometric sequence from a tenth of the largest one, or from the
    first 20 points in contact, or from where the force exceeds twice the pull-off, and count
    from the contact point of such a shallow part. On a homogeneous sample the moduli agree within
    their errors, which are not independent: deeper parts contain the shallower ones. A modulus that
    rises with depth is a stiff base below a thin sample, a stiffer interior, or a tip that is
    blunter than stated.

    The moduli are apparent ones: averages over the volume that is deformed. The parts that are no
    homogeneous sample may have the result `misfit`; this is not warned of.

    Arguments:
        curve: the curve, with a spring constant; one that is not corrected is.
        tip: a `Sphere`, `Paraboloid`, `Cone`, `Pyramid` or `FlatPunch`.
        poisson_ratio: nu of the sample.
        count: the number of depths.

    Raises:
        ValueError: for fewer than two depths, fewer than 40 points in contact, a force that nowhere
            exceeds twice the pull-off, and as `fit_curve` does.
        TypeError: for something that is no force curve or no tip.

    Example:
        >>> found = js.lab.modulus_over_depth(curve, js.lab.Paraboloid(radius=5e-6), count=3)
        >>> [f"{modulus:.2f}" for modulus in found.youngs_moduli]
        ['2.52', '2.52', '2.52']
    """
    if count < 2:
        raise ValueError(f"There are {count} depths: give two or more.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", js.exceptions.FitWarning)
        whole = fit_curve(curve, tip, poisson_ratio)
        # The contact point of a whole that is not homogeneous may be far off.
        shallow = fit_curve(_parts(whole, whole.contact_point, 2)[1][0], tip, poisson_ratio)
    depths, parts = _parts(whole, shallow.contact_point, count)
    fits = fit_each(parts, lambda part: fit_curve(part, tip, poisson_ratio))
    return ModulusOverDepth(depths, fits)


def _parts(
    whole: ForceCurveFit, contact: float, count: int
) -> tuple[np.ndarray, js.lab.force_curves.ForceCurves]:
    """Return depths and ever deeper parts of a fitted approach, given a contact point [m]."""
    unit = whole.curve.unit
    own = own_units(whole.curve)[0]
    below = contact * own - whole.tip_positions
    in_contact = np.sort(below[below > 0])
    if in_contact.size < 2 * _FEWEST:
        raise ValueError(
            f"The approach has {in_contact.size} points in contact: moduli over the depth need "
            f"{2 * _FEWEST}. Measure more points, or fit the whole by fit_curve."
        )
    deepest = in_contact[-1]
    shallowest = max(_LEAST * deepest, in_contact[_FEWEST - 1])
    if whole.work_of_adhesion > 0:
        # Where adhesion prevails the contact tells little of the modulus.
        is_pushed = whole.forces > _PUSHED * _pull_off(whole) * own_units(whole.curve)[1]
        if not is_pushed.any():
            raise ValueError(
                "The approach pushes by less than twice the pull-off, so that no part of it "
                "tells a modulus: indent deeper, or fit the whole by fit_curve."
            )
        shallowest = max(shallowest, np.min(below[is_pushed]))
    depths = np.geomspace(shallowest, deepest, count)
    # Rounding leaves no point of the whole out.
    depths[-1] = deepest
    curves = []
    for depth in depths:
        is_kept = below <= depth
        columns = {name: getattr(whole.points, name) for name in ("force", "height", "tip", "time")}
        kept = {name: x[is_kept] for name, x in columns.items() if x is not None}
        source = f"{whole.curve.source} to a depth of {depth:.4g} {unit}".strip()
        approach = replace(whole.points, **kept)
        ends = {"approach": approach, "retraction": None, "pauses": ()}
        curves.append(replace(whole.curve, **ends, source=source))
    return depths / own, js.lab.force_curves.ForceCurves(tuple(curves))


def _pull_off(fit: ForceCurveFit) -> float:
    """Return the largest attraction of the fitted contact, which an approach need not show [N]."""
    assert isinstance(fit.tip, Tip)
    depth = fit.contact_point - float(np.nanmin(fit.tip_positions)) / own_units(fit.curve)[0]
    law = fit.contact_modulus, fit.work_of_adhesion, fit.range
    branch = dugdale.with_adhesion(fit.tip, *law, depth, 0.0)
    return -float(np.min(branch.force))

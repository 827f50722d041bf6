"""Fits to several force curves, of a file or of the pixels of a map."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxstab.calibration.advice import FitWarning
from jaxstab.calibration.calibrate import calibrate
from jaxstab.calibration.result import Calibration, numbers_of, units_of
from jaxstab.contact import Contact
from jaxstab.core.checks import require_kind, require_one_of
from jaxstab.core.display import number, several, table
from jaxstab.core.interrupts import early_ends
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS, SolverError
from jaxstab.core.warn import warn
from jaxstab.force_curves import ForceCurve, ForceCurves
from jaxstab.force_curves.curves import all_of
from jaxstab.loads import Load


@dataclass(frozen=True, eq=False, repr=False)
class Calibrations:
    """The fits of several force curves, in their order; None where there is no fit.

    At least one curve has a fit.

    Attributes:
        curves: the curves.
        fits: their fits, in the units of their contacts.
        reasons: for each curve why there is no fit, or what its fit warns of; empty if nothing.

    Raises:
        ValueError: without a curve.
        SolverError: without a fit, with the reason of the first curve.
    """

    curves: ForceCurves
    fits: tuple[Calibration | None, ...]
    reasons: tuple[str, ...]

    def __post_init__(self) -> None:
        if not self.fits:
            raise ValueError("There is no force curve: give at least one.")
        failed = self.failures
        if len(failed) == len(self.fits):
            raise SolverError(f"None of {several(len(failed), 'curve')} has a fit. {failed[0]}")

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters that are fitted to a curve at least."""
        return tuple(self._units)

    @property
    def _units(self) -> dict[str, tuple[float, str]]:
        """The name of each fitted parameter, with the unit in which it is shown."""
        there = [fit for fit in self.fits if fit is not None]
        return {
            name: unit for fit in there for name, unit in zip(fit.names, units_of(fit), strict=True)
        }

    @property
    def failures(self) -> list[str]:
        """The sources of the curves without a fit, each with its reason."""
        return [
            f"{source}: {reason}"
            for source, fit, reason in zip(
                self.curves.sources, self.fits, self.reasons, strict=True
            )
            if fit is None
        ]

    def values(self, name: str) -> np.ndarray:
        """Return a fitted parameter, NaN where none was fitted: a map if the curves are of one.

        Arguments:
            name: one of `names`, as "solid.youngs_modulus".

        Raises:
            ValueError: for another name.
        """
        return self._arranged(name, 0)

    def errors(self, name: str) -> np.ndarray:
        """Return the standard error of a fitted parameter, arranged as its `values`."""
        return self._arranged(name, 1)

    def with_error_of_grid(self, other: Calibrations) -> Calibrations:
        """Return the fits with the errors of the grid, as `Calibration.with_error_of_grid`.

        A curve without a fit on either grid has none.

        Arguments:
            other: fits of the same curves on another grid.

        Raises:
            TypeError: for something else.
            ValueError: for another number of curves.
            SolverError: if no curve has a fit on both grids.
        """
        require_kind(other, Calibrations, "no fits of several curves: give those of calibrate.")
        if len(other.fits) != len(self.fits):
            raise ValueError(f"There are {len(other.fits)} other fits for {len(self.fits)} curves.")
        fits = list(self.fits)
        reasons = list(self.reasons)
        for i, (one, two) in enumerate(zip(self.fits, other.fits, strict=True)):
            if one is None:
                continue
            if two is None:
                fits[i] = None
                reasons[i] = f"On the other grid: {other.reasons[i]}"
            else:
                fits[i] = one.with_error_of_grid(two)
        return replace(self, fits=tuple(fits), reasons=tuple(reasons))

    def _arranged(self, name: str, row: int) -> np.ndarray:
        require_one_of("The parameter", name, self.names)
        values = np.full(len(self.fits), np.nan)
        for i, fit in enumerate(self.fits):
            if fit is not None and name in fit.names:
                values[i] = numbers_of(fit)[row][fit.names.index(name)]
        if self.curves.shape is None:
            return values
        return self.curves.on_map(values)

    def __repr__(self) -> str:
        there = [fit for fit in self.fits if fit is not None]
        units = self._units
        columns = [
            (self.values(name) / divisor, self.errors(name) / divisor)
            for name, (divisor, _) in units.items()
        ]
        rows = {
            "parameter": self.names,
            "median": [number(np.nanmedian(values)) for values, _ in columns],
            "quartiles": [
                " to ".join(f"{x:.4g}" for x in np.nanpercentile(values, (25, 75)))
                for values, _ in columns
            ],
            "median error": [f"{np.nanmedian(errors):.2g}" for _, errors in columns],
            "unit": [unit for _, unit in units.values()],
        }
        head = f"{type(self).__name__}: {len(there)} of {several(len(self.fits), 'curve')} fitted"
        return "\n".join([head, table(rows), *self.failures])


def calibrate_each(
    contact: Contact | Callable[[ForceCurve], Contact],
    load: type[Load],
    curves: ForceCurves,
    *,
    progress: bool | None = None,
    **options: Any,
) -> Calibrations:
    """Fit each of several force curves by `calibrate`, one after another, as those of a map.

    A curve that cannot be fitted has no fit, but a reason. Curves share compiled programs if their
    contacts have grids of as many points.

    Arguments:
        contact: the contact to start all fits from, or a function that returns one for a curve, as
            `lambda curve: js.first_guess(curve, radius, poisson_ratio)`.
        load: one of the classes `FarDisplacement` and `Spring`.
        curves: the curves; those without a `correction` are corrected first.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        options: those of `calibrate`, such as `segment` and `where`.

    Returns:
        The fits. After Ctrl-C the curves that were not reached have none.

    Raises:
        TypeError: for something that is not several force curves.
        ValueError: without a curve.
        SolverError: if no curve can be fitted, with the reason of the first.

    Warns:
        FitWarning: for curves that have no fit, with their names and reasons; for an interrupt.
    """
    require_kind(curves, ForceCurves, "no sequence of force curves: fit one by `calibrate`.")
    fits: list[Calibration | None] = []
    reasons: list[str] = []
    with progress_bar("fits", len(curves), "curve", shown=progress) as bar:
        for curve in curves:
            try:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("ignore")
                    warnings.simplefilter("always", FitWarning)
                    start = contact
                    if not isinstance(start, Contact):
                        start = start(curve)
                    found = calibrate(start, load, curve, **options)
                reason = " ".join(str(warning.message) for warning in caught)
            except (ValueError, SolverError) as error:
                found = None
                reason = str(error)
            except early_ends():
                if not fits:
                    raise
                break
            fits.append(found)
            reasons.append(reason)
            bar.update()
            if found is not None and found.result == RESULTS.interrupted:
                break
    left = len(curves) - len(fits)
    if left:
        warn(f"The fits were interrupted: {left} of {len(curves)} curves have none.", FitWarning)
    fits += [None] * left
    reasons += ["The fits were interrupted before this one."] * left
    all_fits = Calibrations(curves, tuple(fits), tuple(reasons))
    failed = all_fits.failures
    if len(failed) > left:
        warn(all_of("have no fit", failed, len(curves)), FitWarning)
    return all_fits

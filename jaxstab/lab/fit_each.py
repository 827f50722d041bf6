"""Fits to several force curves, of a file or of the pixels of a map."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from tqdm import tqdm

import jaxstab as js

Fit = TypeVar("Fit")
# So many reasons are told in a warning.
_TOLD = 5


@dataclass(frozen=True, eq=False)
class Fits(Generic[Fit]):
    """The fits of several force curves, in their order.

    Attributes:
        curves: the curves.
        fits: what the function has returned for each; None where it has failed.
        reasons: for each curve why it has failed, or what was warned of; empty if nothing.

    Example:
        The second curve has no contact:

        >>> far = js.lab.force_curves.Segment(np.zeros(400), height)
        >>> missed = js.lab.force_curves.ForceCurve(far, None, spring_constant=1.0)
        >>> curves = js.lab.force_curves.ForceCurves((curve, missed))
        >>> tip = js.lab.Paraboloid(radius=5e-6)
        >>> import warnings
        >>> with warnings.catch_warnings(action="ignore", category=js.exceptions.FitWarning):
        ...     fits = js.lab.fit_each(curves, lambda one: js.lab.fit_curve(one, tip))
        >>> [None if fit is None else f"{fit.youngs_modulus:.2f}" for fit in fits.fits]
        ['2.52', None]
        >>> fits.reasons[1][:42]
        'The approach has no baseline or no contact'
    """

    curves: js.lab.force_curves.ForceCurves
    fits: tuple[Fit | None, ...]
    reasons: tuple[str, ...]

    def values(self, number: Callable[[Fit], float]) -> np.ndarray:
        """Return a number of each fit, NaN without one: a map if the curves are of one.

        Arguments:
            number: of a fit, as `lambda fit: fit.youngs_modulus`.
        """
        values = np.array([np.nan if fit is None else float(number(fit)) for fit in self.fits])
        return values if self.curves.shape is None else self.curves.on_map(values)

    def __repr__(self) -> str:
        rows = zip(self.curves.sources, self.reasons, strict=True)
        there = sum(fit is not None for fit in self.fits)
        head = f"{type(self).__name__}: {there} of {len(self.fits)} curves fitted"
        return "\n".join([head, *(f"  {source}: {reason}" for source, reason in rows if reason)])


def fit_each(
    curves: js.lab.force_curves.ForceCurves, fit: Callable[[js.lab.force_curves.ForceCurve], Fit]
) -> Fits[Fit]:
    """Fit each of several force curves by a function; those that cannot be fitted have a reason.

    Arguments:
        curves: the curves, as those of a map.
        fit: the function, as `lambda curve: js.lab.fit_curve(curve, tip)`.

    Returns:
        The fits. After Ctrl-C the curves that were not reached have none.

    Raises:
        TypeError: for something that is not several force curves.
        ValueError: without a curve.
        SolverError: if no curve can be fitted, with the reason of the first.

    Warns:
        FitWarning: for curves that have no fit, with their names and reasons.

    Example:
        >>> curves = js.lab.force_curves.ForceCurves((curve, curve))
        >>> tip = js.lab.Paraboloid(radius=5e-6)
        >>> fits = js.lab.fit_each(curves, lambda one: js.lab.fit_curve(one, tip))
        >>> len(fits.fits)
        2
    """
    if not isinstance(curves, js.lab.force_curves.ForceCurves):
        raise TypeError(f"The curves are a {type(curves).__name__}: fit one by the function alone.")
    if not curves:
        raise ValueError("There is no force curve: give at least one.")
    fits: list[Fit | None] = []
    reasons: list[str] = []
    is_silenced = bool(os.environ.get("TQDM_DISABLE"))
    try:
        for curve in tqdm(curves, "fits", leave=False, delay=2.0, disable=is_silenced or None):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("ignore")
                warnings.simplefilter("always", js.exceptions.FitWarning)
                try:
                    found, reason = fit(curve), ""
                except (ValueError, js.exceptions.SolverError) as error:
                    found, reason = None, str(error)
            fits.append(found)
            reasons.append(" ".join([reason, *(str(each.message) for each in caught)]).strip())
    except KeyboardInterrupt:
        if not fits:
            raise
    left = len(curves) - len(fits)
    fits += [None] * left
    reasons += ["The fits were interrupted before this one."] * left
    failed = [
        f"{source}: {reason}"
        for source, found, reason in zip(curves.sources, fits, reasons, strict=True)
        if found is None
    ]
    if len(failed) == len(curves):
        raise js.exceptions.SolverError(f"None of {len(curves)} curves has a fit. {failed[0]}")
    if failed:
        told = " ".join(failed[:_TOLD]) + (" ..." if len(failed) > _TOLD else "")
        warnings.warn(
            f"{len(failed)} of {len(curves)} curves have no fit. {told}",
            js.exceptions.FitWarning,
            stacklevel=2,
        )
    return Fits(curves, tuple(fits), tuple(reasons))

"""Fits to the curves of a map."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_curves as synthetic

import jaxstab as js

TIP = js.lab.Paraboloid(20e-9)
GOOD = synthetic.recorded(synthetic.hertz(), 0)


def fit(curve):
    return js.lab.fit_curve(curve, TIP, 0.0)


def test_a_map_with_holes_and_bad_curves_gives_maps():
    named = {(0, 0): GOOD, (2, 1): -GOOD}
    curves = [replace(x, pixel=pixel, source=f"pixel {pixel}") for pixel, x in named.items()]
    whole = js.lab.force_curves.ForceCurves(tuple(curves), (3, 2))
    message = r"1 of 2 curves have no fit. pixel \(2, 1\): .*-curve"
    with pytest.warns(js.exceptions.FitWarning, match=message):
        fits = js.lab.fit_each(whole, fit)
    modulus = fits.values(lambda fit: fit.youngs_modulus)
    assert np.argwhere(np.isfinite(modulus)).tolist() == [[0, 0]]
    assert modulus[0, 0] == fit(GOOD).youngs_modulus
    assert fits.fits[1] is None and "reverse the forces" in fits.reasons[1]
    assert "1 of 2 curves fitted" in repr(fits) and "pixel (2, 1): The approach" in repr(fits)


def test_an_interrupt_loses_no_fit_and_warnings_are_kept():
    def interrupted(curve):
        if curve.source == "last":
            raise KeyboardInterrupt
        import warnings

        warnings.warn("no sphere", js.exceptions.FitWarning, stacklevel=1)
        return 3.0

    curves = js.lab.force_curves.ForceCurves((GOOD, replace(GOOD, source="last")))
    with pytest.warns(js.exceptions.FitWarning, match="interrupted before this one"):
        fits = js.lab.fit_each(curves, interrupted)
    assert fits.fits == (3.0, None) and fits.reasons[0] == "no sphere"
    np.testing.assert_array_equal(fits.values(float), [3, np.nan])
    with pytest.raises(KeyboardInterrupt):
        js.lab.fit_each(curves[1:], interrupted)


def test_curves_without_any_fit_are_refused():
    curves = js.lab.force_curves.ForceCurves((-GOOD, -GOOD))
    with pytest.raises(
        js.exceptions.SolverError, match=r"None of 2 curves has a fit. curve 0: The approach"
    ):
        js.lab.fit_each(curves, fit)
    with pytest.raises(ValueError, match="There is no force curve: give at least one"):
        js.lab.fit_each(curves[2:], fit)
    with pytest.raises(TypeError, match="curves are a ForceCurve"):
        js.lab.fit_each(GOOD, fit)

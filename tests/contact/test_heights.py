"""Heights as users have them: with named axes, missing points, and from other packages."""

import re
import warnings

import numpy as np
import pytest
import SurfaceTopography
import xarray

import jaxstab as js

GRID = js.Grid((8, 6), (2.0, 1.0))
SOLID = js.HalfSpace(GRID, 1.0)
X, Y = np.arange(8) / 4, np.arange(6) / 6
HEIGHTS = np.random.default_rng(0).normal(size=(8, 6)) / 100


def contact_of(heights, solid=SOLID):
    return js.Contact(solid, heights, js.potentials.NoAdhesion())


@pytest.mark.parametrize(
    "heights",
    [
        xarray.DataArray(HEIGHTS.T, dims=("y", "x")),
        xarray.DataArray(HEIGHTS.T[::-1], {"x": X, "y": Y[::-1]}, ("y", "x")),
        xarray.Dataset({"heights": (("y", "x"), HEIGHTS.T)}),
        SurfaceTopography.Topography(HEIGHTS, (2.0, 1.0)),
        np.ma.masked_array(HEIGHTS),
    ],
    ids=["transposed", "falling y", "data set", "SurfaceTopography", "nothing masked"],
)
def test_heights_of_other_packages_lie_along_x_and_y(heights):
    np.testing.assert_array_equal(contact_of(heights).heights, HEIGHTS)
    np.testing.assert_array_equal(js.surfaces.Topography(GRID, heights).heights, HEIGHTS)
    assert js.surfaces.rms_slope(GRID, heights) == js.surfaces.rms_slope(GRID, HEIGHTS)


@pytest.mark.nightly
def test_heights_of_other_packages_bring_their_unit_and_keep_their_precision():
    sides = {"x": ("x", X, {"units": "um"}), "y": ("y", Y, {"units": "um"})}
    heights = xarray.DataArray(1e3 * HEIGHTS, sides, ("x", "y"), attrs={"units": "nm"})
    contact = contact_of(heights)
    assert contact.unit == "µm"
    np.testing.assert_allclose(contact.heights, HEIGHTS, rtol=1e-14)
    assert contact_of(heights.astype(np.float32)).heights.dtype == np.float32
    assert contact_of(SurfaceTopography.Topography(HEIGHTS, (2.0, 1.0), unit="nm")).unit == "nm"
    dataset = js.to_dataset(contact, js.equilibrate(contact, js.MeanGap(0.1)))
    np.testing.assert_array_equal(contact_of(dataset.heights).heights, contact.heights)


@pytest.mark.parametrize(
    ("heights", "message"),
    [
        (xarray.DataArray(HEIGHTS, dims=("row", "col")), "dimensions are 'row', 'col': name them"),
        (xarray.DataArray(HEIGHTS[:, 0], dims="x"), r"shape \(8,\), the grid \(8, 6\)"),
        (xarray.DataArray(HEIGHTS, {"x": X, "y": 2 * Y}, ("x", "y")), "2 x 1, but .* 2 x 2: use"),
        (xarray.DataArray(HEIGHTS, {"x": X**2, "y": Y}, ("x", "y")), "x are not evenly spaced"),
        (SurfaceTopography.Topography(HEIGHTS, (1.0, 1.0), unit="nm"), "2 x 1, but .* 1 x 1 nm"),
        (np.ma.masked_less(HEIGHTS, 0), r"are missing: fill them, as by `js.surfaces.Topography\("),
        (
            np.where(HEIGHTS > 0, HEIGHTS, np.nan),
            r"nan at \(0, 1\): fill them, as by `js",
        ),
    ],
)
def test_heights_that_do_not_fit_are_refused_with_a_cure(heights, message):
    with pytest.raises(ValueError, match=message):
        contact_of(heights)
    with pytest.raises(ValueError, match=r"missing|fill|use|name|evenly|shape"):
        js.surfaces.rms_slope(GRID, heights)


def test_the_cure_of_missing_points_works():
    for heights in (np.ma.masked_less(HEIGHTS, 0), np.where(HEIGHTS > 0, HEIGHTS, np.nan)):
        filled = contact_of(js.surfaces.Topography(GRID, heights).filled()).heights
        np.testing.assert_array_equal(np.where(HEIGHTS > 0, filled, 0), np.maximum(HEIGHTS, 0))


@pytest.mark.parametrize("mark", [-9999.0, 1e38])
def test_a_number_for_missing_points_is_named(mark):
    heights = HEIGHTS.copy()
    heights[2:4, 3] = mark
    message = re.escape(f"2 of 48 heights are {mark:g}, while all others lie within 0.0")
    for window in (SOLID, js.FreeHalfSpace(GRID, 1.0)):
        with pytest.warns(js.exceptions.SurfaceWarning, match=message):
            contact_of(heights, window)
        with pytest.warns(js.exceptions.SurfaceWarning, match=message):
            contact_of(heights.astype(np.float32), window)
    with pytest.warns(js.exceptions.SurfaceWarning, match=message):
        contact_of(js.surfaces.Topography(GRID, heights))


def test_a_punch_is_no_missing_point_and_in_no_other_unit():
    punch = np.where(np.abs(X[:, None] - 1) < 0.5, 0, -9999.0) * np.ones(6)
    with warnings.catch_warnings(action="error"):
        assert np.ptp(contact_of(punch).heights) == 9999


@pytest.mark.parametrize("factor", [1e-6, 1e3])
def test_an_array_in_another_unit_than_the_lengths_is_named(factor):
    with pytest.warns(js.exceptions.SurfaceWarning, match=r"rms slope is .*in one unit"):
        contact_of(factor * HEIGHTS)

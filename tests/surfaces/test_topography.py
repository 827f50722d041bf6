"""The processing of measured surfaces, and warnings of those that look wrong."""

import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.surfaces import Topography, faults

LAW = js.potentials.Exponential(0.01, 0.2)


def clean(shape=(48, 64), lengths=(1.5, 2.0), seed=0):
    grid = js.Grid(shape, lengths)
    return np.asarray(
        js.surfaces.self_affine(grid, jax.random.key(seed), k_high=10, rms_height=0.05)
    )


def topography(heights, lengths=(1.5, 2.0), unit="µm", **options):
    return Topography(js.Grid(heights.shape, lengths), heights, unit, **options)


def sides(shape, lengths):
    axes = [np.arange(n) * length / n for n, length in zip(shape, lengths, strict=True)]
    return np.meshgrid(*axes, indexing="ij")


def with_holes(heights, seed=0):
    holes = np.random.default_rng(seed).random(heights.shape) < 0.1
    holes[10:20, 30:37] = True
    # Away from the edges, where nothing carries a slope on.
    holes[:3] = holes[-3:] = holes[:, :3] = holes[:, -3:] = False
    return np.where(holes, np.nan, heights), holes


def test_what_is_printed_names_numbers_unit_and_what_was_done():
    heights = clean().copy()
    heights[3, 4] = np.nan
    text = str(topography(heights).filled().in_unit("nm"))
    for part in (
        "48 x 64",
        "1500 x 2000 nm",
        "missing      0 points",
        "0.0326 % of the points fill",
    ):
        assert part in text
    assert f"{1e3 * heights[np.isfinite(heights)].std():.2g}" in text
    assert "unit unknown" in str(topography(heights, unit=None))
    assert "looks wrong" not in text


def test_reversed_heights_keep_their_holes_and_unit():
    heights, _ = with_holes(clean())
    reverse = -topography(heights)
    np.testing.assert_array_equal(reverse.heights, -heights)
    assert reverse.unit == topography(heights).unit and "heights reversed" in str(reverse)


def test_heights_are_a_copy_that_stays():
    heights = clean().astype(np.float32)
    surface = topography(heights)
    heights[:] = 0
    assert surface.heights.any() and surface.heights.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        surface.heights[0, 0] = 1


@pytest.mark.parametrize("method", ["harmonic", "biharmonic"])
def test_a_plane_with_holes_is_filled_exactly(method):
    x, y = sides((48, 64), (1.5, 2.0))
    heights, holes = with_holes(0.3 * x - 0.2 * y + 1)
    filled = topography(heights).filled(method).heights
    np.testing.assert_allclose(filled, 0.3 * x - 0.2 * y + 1, rtol=1e-11)
    np.testing.assert_array_equal(filled[~holes], heights[~holes])


def test_a_harmonic_filling_solves_the_laplace_equation_of_its_grid():
    # With cos(a) + cosh(b) balanced, this solves the five-point equation for unequal spacings.
    dx, dy = 1.5 / 48, 2.0 / 64
    i, j = np.meshgrid(np.arange(48), np.arange(64), indexing="ij")
    rate = np.arccosh(1 + (dy / dx) ** 2 * (1 - np.cos(0.3)))
    heights, _ = with_holes(np.cos(0.3 * i) * np.cosh(rate * (j - 32)))
    expected = np.cos(0.3 * i) * np.cosh(rate * (j - 32))
    filled = topography(heights).filled().heights
    np.testing.assert_allclose(filled, expected, rtol=1e-9)


def test_a_biharmonic_filling_reproduces_quadrics_and_slopes_at_the_edge():
    x, y = sides((48, 64), (1.5, 2.0))
    quadric = x**2 - 3 * x * y + 0.5 * y**2 + x
    filled = topography(with_holes(quadric)[0]).filled("biharmonic").heights
    np.testing.assert_allclose(filled, quadric, atol=1e-9)
    plane = 2 * x - y
    corner = np.where((x < 0.2) & (y < 0.3), np.nan, plane)
    np.testing.assert_allclose(topography(corner).filled("biharmonic").heights, plane, atol=1e-9)
    # A membrane with a free edge lies flat there.
    assert abs(topography(corner).filled().heights - plane).max() > 0.1


def test_profiles_are_filled_in_straight_lines():
    heights = np.array([0, 1, np.nan, np.nan, 4, 3, np.nan])
    filled = topography(heights, 1.0).filled().heights
    np.testing.assert_allclose(filled, [0, 1, 2, 3, 4, 3, 3])
    filled = topography(heights, 1.0).filled("biharmonic").heights
    np.testing.assert_allclose(filled[-1], 2, atol=1e-12)


def test_what_the_points_do_not_decide_is_not_filled():
    heights = np.full((8, 8), np.nan)
    heights[3, 3:6] = 2.0
    np.testing.assert_allclose(topography(heights).filled().heights, 2.0)
    with pytest.raises(ValueError, match="lie on one line"):
        topography(heights).filled("biharmonic")


@pytest.mark.parametrize("order", [0, 1, 2])
def test_detrending_takes_off_the_least_squares_polynomial(order):
    x, y = sides((48, 64), (1.5, 2.0))
    heights, holes = with_holes(clean() + 5 + x - 2 * y + x * y - 3 * y**2)
    powers = [(a, b) for a in range(order + 1) for b in range(order + 1 - a)]
    basis = np.stack([(x**a * y**b)[~holes] for a, b in powers], axis=1)
    expected = heights[~holes] - basis @ np.linalg.lstsq(basis, heights[~holes])[0]
    detrended = topography(heights).detrended(order)
    np.testing.assert_allclose(detrended.heights[~holes], expected, atol=1e-10)
    assert detrended.num_missing == holes.sum()


def test_units_convert_exactly_and_back():
    surface = topography(clean())
    for unit, factor in {"m": 1e-6, "Å": 1e4, "um": 1.0, "\u03bcm": 1.0, "pm": 1e6}.items():
        there = surface.in_unit(unit)
        np.testing.assert_allclose(there.heights, factor * surface.heights, rtol=1e-15)
        np.testing.assert_allclose(there.lengths, factor * surface.lengths, rtol=1e-15)
        np.testing.assert_allclose(there.in_unit("µm").heights, surface.heights, rtol=1e-15)
    assert surface.in_unit("A").unit == "Å"
    with pytest.raises(ValueError, match=r"unit of this topography is unknown.*`unit=`"):
        topography(clean(), unit=None).in_unit("m")


def test_cropping_keeps_points_from_the_first_to_before_the_last_coordinate():
    surface = topography(clean())
    dx, dy = 1.5 / 48, 2.0 / 64
    part = surface.cropped((3 * dx, 10 * dx), (0.3 * dy, 8.5 * dy))
    np.testing.assert_array_equal(part.heights, surface.heights[3:10, 1:9])
    np.testing.assert_allclose(part.lengths, [7 * dx, 8 * dy])
    assert surface.cropped((0, 0.5)).grid.shape == (16, 64)
    with pytest.raises(ValueError, match=r"1 points lie in 0 <= y < 0\.02"):
        surface.cropped((0, 1), (0, 0.02))
    # As lengths are where JAX has single precision.
    line = js.Grid((2048,), np.float32(0.7))
    line = js.surfaces.Topography(line, np.zeros(2048))
    for first in range(500, 2000, 11):
        assert line.cropped((first * 0.7 / 2048, 0.7)).grid.size == 2048 - first


def test_spectral_resampling_is_exact_in_any_precision():
    fine, coarse = clean((96, 128)), clean((48, 64))
    with jax.enable_x64(False):
        resampled = topography(fine).resampled((48, 64))
    np.testing.assert_allclose(resampled.heights, coarse, atol=1e-14)
    np.testing.assert_allclose(resampled.lengths, (1.5, 2.0), rtol=1e-7)


def test_area_resampling_is_the_mean_over_tiles_for_every_ratio():
    heights, _ = with_holes(clean())
    halves = topography(clean()).resampled((24, 32), "area").heights
    np.testing.assert_allclose(halves, clean().reshape(24, 2, 32, 2).mean((1, 3)), atol=1e-15)
    # Brute force sums over a common refinement.
    fine = np.repeat(np.repeat(heights, 5, 0), 3, 1).reshape(20, 12, 24, 8)
    counts = np.isfinite(fine).sum((1, 3))
    expected = np.nansum(fine, (1, 3)) / np.where(counts, counts, np.nan)
    averaged = topography(heights).resampled((20, 24), "area").heights
    np.testing.assert_allclose(averaged, expected, atol=1e-14)
    line = topography(np.arange(6.0), 1.0).resampled(4, "area").heights
    np.testing.assert_allclose(line, [1 / 3, 5 / 3, 10 / 3, 14 / 3])


def test_filtering_keeps_the_waves_between_its_limits_and_the_mean():
    x, y = sides((48, 64), (1.5, 2.0))
    waves = [np.cos(2 * np.pi * (k * x / 1.5 + m * y / 2.0)) for k, m in ((1, 1), (3, 3), (6, 6))]
    surface = topography(7 + sum(waves))
    # The longest side is 2: (k, m) are sqrt((4 k / 3)^2 + m^2) = 5 k / 3 waves per longest side.
    for limits, kept in {(2, 6): [1], (None, 5): [0, 1], (5, None): [1, 2], (5, 5): [1]}.items():
        expected = 7 + sum(waves[i] for i in kept)
        np.testing.assert_allclose(surface.filtered(*limits).heights, expected, atol=1e-13)


def test_ways_to_make_a_surface_periodic():
    x, y = sides((48, 64), (1.5, 2.0))
    heights = clean() + 0.1 * x - y**2
    surface = topography(heights)
    window = surface.periodic("window").heights
    about_mean = abs(heights - heights.mean())
    assert (abs(window - heights.mean())[[0, -1]] <= 0.03 * about_mean[[0, -1]]).all()
    np.testing.assert_allclose(window[5:-5, 7:-7], heights[5:-5, 7:-7], atol=1e-15)
    mirror = surface.periodic("mirror")
    np.testing.assert_array_equal(mirror.heights[::-1, ::-1], mirror.heights)
    np.testing.assert_array_equal(mirror.heights[:48, :64], heights)
    np.testing.assert_allclose(mirror.lengths, [3, 4])
    assert surface.suspicions
    for how in ("window", "mirror", "as_is"):
        assert surface.periodic(how).is_periodic and not surface.periodic(how).suspicions
    # The edges of derived surfaces do not count as meeting either.
    for how in ("window", "mirror"):
        assert not topography(surface.periodic(how).heights).suspicions


def test_methods_that_need_every_point_name_the_cure():
    surface = topography(with_holes(clean())[0])
    for method in (
        lambda: surface.resampled((20, 20)),
        lambda: surface.filtered(1, 5),
        lambda: surface.periodic("window"),
        lambda: js.Contact(js.HalfSpace(surface.grid, 1.0), surface, LAW),
    ):
        with pytest.raises(ValueError, match=r"\d+ of 3072 are missing: fill .*\.filled\(\)"):
            method()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: topography(clean()).filled("linear"), "method is 'linear': choose one of harm"),
        (lambda: topography(clean()).detrended(3), "order is 3: choose one of 0, 1, 2"),
        (lambda: topography(clean()).periodic("tile"), "how is 'tile'"),
        (lambda: topography(clean()).resampled((8, 8), "cubic"), "method is 'cubic'"),
        (lambda: topography(clean()).resampled((8,)), r"shape is \(8,\): give 2 numbers"),
        (lambda: topography(clean()).filtered(), "k_low is None, k_high None: give"),
        (lambda: topography(clean()).filtered(5, 2), "k_low is 5, k_high 2: give"),
        (lambda: topography(clean()).in_unit("inch"), "unit is 'inch': choose one of km, m"),
        (lambda: topography(clean()).cropped((np.nan, 1)), r"x is \(nan, 1\): give two numbers"),
        (
            lambda: topography(clean()).cropped(1.0),
            r"x is 1\.0: give two numbers, as in x=\(0, 0\.75",
        ),
        (lambda: topography(clean()[:, 0], 1.0).cropped((0, 1), (0, 1)), "is a line"),
        (lambda: Topography(js.Grid(8), clean()), r"shape \(48, 64\), the grid \(8, 8\)"),
        (lambda: Topography(clean(), js.Grid(8)), "grid is a ndarray"),
        (lambda: topography(clean() + 1j), "complex128: give real"),
        (lambda: topography(np.full((8, 8), np.nan)), "all heights are missing"),
    ],
)
def test_what_cannot_be_done_is_said(make, message):
    with pytest.raises((ValueError, TypeError), match=message):
        make()


def test_a_contact_takes_a_topography_and_its_unit():
    surface = topography(clean())
    contact = js.Contact(js.HalfSpace(surface.grid, 1.0), surface, LAW)
    np.testing.assert_array_equal(contact.heights, surface.heights)
    assert contact.unit == "µm"
    assert js.Contact(contact.solid, surface.heights, LAW).unit is None
    modulus = jax.jit(
        lambda modulus: js.Contact(js.HalfSpace(surface.grid, modulus), surface, LAW)
        .solid.max_stiffness
    )  # fmt: skip
    np.testing.assert_allclose(modulus(2.0), 2 * contact.solid.max_stiffness)
    # Lengths that are traced are not known.
    jax.eval_shape(lambda lengths: surface.on(js.Grid((48, 64), lengths)), surface.grid.lengths)
    with pytest.raises(ValueError, match=r"own, .*\(48, 64\), lengths=\[1.5, 2\]"):
        jax.eval_shape(lambda lengths: surface.on(js.Grid((64, 48), lengths)), jnp.ones(2))
    for other in (js.Grid((48, 64)), js.Grid((64, 48), (1.5, 2.0))):
        with pytest.raises(ValueError, match=r"own, .*\(48, 64\), lengths=\[1.5, 2\]"):
            js.Contact(js.HalfSpace(other, 1.0), surface, LAW)


def contact_of(surface, is_array):
    solid = js.HalfSpace(surface.grid, 1.0)
    return js.Contact(solid, jnp.asarray(surface.heights) if is_array else surface, LAW)


@pytest.mark.parametrize("is_array", [False, True])
def test_a_tilt_above_the_roughness_warns(is_array):
    x, _ = sides((48, 64), (1.5, 2.0))
    surface = topography(clean(seed=int(is_array)) + 0.2 * x)
    with pytest.warns(
        js.exceptions.SurfaceWarning, match=r"best plane is 0\.0\d+.*`Topography.detrended"
    ) as said:
        contact_of(surface, is_array)
    assert len(said) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        contact_of(surface.detrended(), is_array)


@pytest.mark.parametrize("is_array", [False, True])
def test_edges_that_do_not_meet_warn(is_array):
    _, y = sides((48, 64), (1.5, 2.0))
    surface = topography(clean(seed=2 + int(is_array)) + 0.2 * np.sin(4 * y))
    with pytest.warns(
        js.exceptions.SurfaceWarning, match=r'along y: .*periodic\("mirror"\)'
    ) as said:
        contact_of(surface, is_array)
    assert len(said) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        contact_of(surface.periodic("window"), is_array)
        contact_of(surface.periodic("as_is"), False)
        # The edges of a window need not meet.
        window = js.FreeHalfSpace(surface.grid, 1.0)
        js.Contact(window, jnp.asarray(surface.heights) if is_array else surface, LAW)


def test_a_slope_that_cannot_be_warns():
    with pytest.warns(
        js.exceptions.SurfaceWarning, match=r"rms slope is \d.*sides of 1\.5e-06 x 2e-06"
    ):
        contact_of(topography(clean(), (1.5e-6, 2e-6)), False)
    with pytest.warns(js.exceptions.SurfaceWarning, match="rms slope"):
        contact_of(topography(1e-9 * clean()), False)


def test_clean_surfaces_are_not_suspected():
    grid, phase = js.Grid(64), 2 * np.pi * np.arange(64) / 64
    surfaces = [
        *(js.surfaces.self_affine(grid, jax.random.key(i), hurst=0.1 + 0.2 * i, k_low=1,
                                  k_rolloff=1, rms_height=0.1) for i in range(5)),
        js.surfaces.paraboloid(grid, 2.0),
        js.surfaces.sinusoid(grid, 0.1, (1, 2)),
        # One long wave, as like to a plane as can be; walls at the edge; a flat; and noise.
        np.add.outer(np.sin(phase), np.sin(phase)),
        np.broadcast_to(phase < np.pi, (64, 64)).astype(float),
        np.full((64, 64), 0.3),
        np.random.default_rng(0).normal(size=(64, 64)),
    ]  # fmt: skip
    for heights in surfaces:
        for surface in (np.asarray(heights), np.asarray(heights, np.float32) + np.float32(10)):
            assert js.surfaces.faults.looks_wrong(surface) == []
            assert js.surfaces.faults.looks_wrong(surface[:, 0]) == []


def test_every_method_takes_a_profile():
    grid = js.Grid((128,), (2.0,))
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=10, rms_height=0.05)
    profile = Topography(grid, np.asarray(heights), "mm")
    np.testing.assert_allclose(profile.in_unit("nm").in_unit("mm").heights, heights, rtol=1e-15)
    there = profile.resampled(256).resampled((128,))
    np.testing.assert_allclose(there.heights, heights, atol=1e-15)
    np.testing.assert_allclose(profile.filtered(None, 10).heights, heights, atol=1e-15)
    assert profile.periodic("mirror").grid.shape == (256,)
    assert profile.detrended(2).cropped((0.5, 1.5)).periodic("window").grid.shape == (64,)
    contact = js.Contact(js.HalfSpace(grid, 1.0), profile, LAW)
    np.testing.assert_array_equal(contact.heights, heights)


def test_what_looks_wrong_is_still_said_once_a_fourier_series_has_spread_it():
    x = np.linspace(0, 1, 64)[:, None]
    tilted = topography(0.002 * np.random.default_rng(0).normal(size=(64, 48)) + 0.02 * x)
    assert len(tilted.suspicions) == 1
    for change in (lambda t: t.resampled((128, 96)), lambda t: t.filtered(k_high=4)):
        changed = change(tilted)
        assert re.match("before it was .*, the surface is tilted", changed.suspicions[0])
        assert "looks wrong  before it was" in repr(changed)
        solid = js.FreeHalfSpace(changed.grid, 1.0)
        with pytest.warns(js.exceptions.SurfaceWarning, match="before it was"):
            js.Contact(solid, changed, js.potentials.NoAdhesion())
        assert not change(tilted.detrended(1).periodic("window")).edge_faults
    assert not tilted.resampled((32, 24), "area").edge_faults


HOLED = np.where(np.eye(48, 64), np.nan, clean())
PILLARS = np.kron([[1.0, 0.0], [0.0, 0.0]], np.ones((16, 16)))


@pytest.mark.parametrize(
    ("heights", "meets"),
    [
        (clean(), True),
        (np.sin(2 * np.pi * np.arange(64) / 64)[:, None] * np.ones(48), True),
        (np.zeros((8, 8)), True),
        # A wall of a periodic pattern lies at its edge.
        (PILLARS, True),
        (clean()[:32, :], False),
        (clean()[:, :40], False),
        # Waves of three points rise as much between neighbours as across the cut.
        (clean()[::3, ::2][:12], False),
        (np.sin(6.5 * np.pi * np.arange(64) / 64)[:, None] * np.ones(48), False),
        (np.sin(3 * np.pi * np.arange(64) / 64 + 1)[:, None] * np.ones(48), False),
        (clean() + 0.5 * np.arange(48)[:, None] / 48, False),
    ],
)
def test_edges_meet_if_they_step_as_neighbours_do(heights, meets):
    assert topography(heights).edges_meet is meets
    assert topography(heights).periodic("as_is").edges_meet


@pytest.mark.parametrize("heights", [clean(), clean()[0], HOLED])
def test_the_tilt_of_a_periodic_surface_is_found_whatever_its_waves(heights):
    axes = np.meshgrid(*(np.linspace(-1, 1, n) for n in heights.shape), indexing="ij")
    plane = sum(slope * x for slope, x in zip((0.3, -2.0), axes, strict=False))
    found = faults.joining_plane(heights + plane)
    # The waves between the last point and the first are known up to a cubic.
    assert np.abs(found - plane).max() < 0.02 * np.nanstd(heights)
    assert faults.edges_meet(heights + plane - found)
    assert not faults.edges_meet(heights + plane)


def with_heights(heights, places, value):
    heights = np.array(heights)
    heights[places] = value
    return heights


@pytest.mark.parametrize(
    ("heights", "number"),
    [
        (clean(), 0),
        # The highest summit of a rough surface, and one of several points.
        (with_heights(clean(), (7, 9), 0.2), 0),
        (np.maximum(clean(), 0), 0),
        (PILLARS, 0),
        (with_heights(clean(), (7, 9), 5.0), 1),
        (with_heights(clean(), (7, 9), -1.0), 1),
        (with_heights(clean(), (slice(7, 9), slice(9, 11)), 5.0), 4),
        # A line of the scan.
        (with_heights(clean(), (7, slice(None)), 5.0), 64),
        (with_heights(np.zeros((16, 16)), (7, 9), 1e-3), 1),
    ],
)
def test_points_that_stand_out_alone_are_told(heights, number):
    sentences = faults.lone_points(heights)
    assert len(sentences) == (number > 0)
    for sentence in sentences:
        assert f"{number} of {heights.size} heights stand out alone" in sentence


def test_a_levelled_surface_has_neither_tilt_nor_gaps_and_keeps_its_waves():
    heights = np.array(clean())
    heights -= heights.mean()
    tilt = np.linspace(0, 3, heights.shape[0])[:, None]
    grid = js.Grid(heights.shape, (1.5, 2.0))
    holed = with_heights(heights + tilt, (7, 9), np.nan)
    with pytest.warns(UserWarning, match="of the points were missing and have been filled"):
        level = Topography(grid, holed).levelled()
    assert level.num_missing == 0 and level.edges_meet
    apart = np.abs(level.heights - heights) / heights.std()
    assert apart[7, 9] < 0.2
    assert np.delete(apart, 7, axis=0).max() < 0.001
    # The best plane of a part of the surface, whose edges do not meet.
    part = np.s_[: heights.shape[0] // 2]
    cut = Topography(js.Grid(heights[part].shape), (heights + tilt)[part])
    assert np.allclose(cut.levelled().heights, cut.detrended(1).heights)
    spike = Topography(grid, with_heights(heights, (7, 9), 5.0))
    with pytest.warns(js.exceptions.SurfaceWarning, match="stand out alone"):
        assert np.ptp(spike.levelled(0).heights) > 4

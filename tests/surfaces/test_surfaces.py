import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import SurfaceTopography
from scipy.special import ellipe

import jaxstab as js
from jaxstab import surfaces


def test_a_paraboloid_has_its_summit_in_the_middle():
    grid = js.Grid((32, 16), (1.0, 0.5))
    heights = surfaces.paraboloid(grid, radius=2.0)
    assert heights[16, 8] == 0
    assert heights.max() == 0
    np.testing.assert_allclose(heights[0, 0], -(0.5**2 + 0.25**2) / 4)


@pytest.mark.parametrize("shape", [(64,), (33, 48)])
def test_statistics_of_a_sinusoid_are_those_of_calculus(shape):
    grid = js.Grid(shape, (2.0,) * len(shape))
    heights = surfaces.sinusoid(grid, amplitude=0.3, waves=(3, 4)[: len(shape)])
    q = 2 * np.pi / 2.0 * np.linalg.norm((3, 4)[: len(shape)])
    rms = 0.3 / np.sqrt(2)
    np.testing.assert_allclose(surfaces.rms_height(heights), rms)
    np.testing.assert_allclose(surfaces.rms_slope(grid, heights), rms * q)
    np.testing.assert_allclose(surfaces.rms_curvature(grid, heights), rms * q**2 / len(shape))


@pytest.mark.parametrize("shape", [(512,), (64, 64), (63, 80)])
@pytest.mark.parametrize("exponent", ["field", "paper"])
def test_a_self_affine_surface_has_what_was_asked_for(shape, exponent):
    grid = js.Grid(shape)
    key = jax.random.key(3)
    options = {"k_low": 2, "k_rolloff": 4, "k_high": 16, "exponent": exponent}
    by_height = surfaces.self_affine(grid, key, rms_height=0.1, **options)
    by_slope = surfaces.self_affine(grid, key, rms_slope=0.2, **options)
    np.testing.assert_allclose(surfaces.rms_height(by_height), 0.1)
    np.testing.assert_allclose(surfaces.rms_slope(grid, by_slope), 0.2)
    np.testing.assert_allclose(by_height.mean(), 0, atol=1e-15)
    np.testing.assert_allclose(by_height / by_height.max(), by_slope / by_slope.max(), atol=1e-10)
    spectrum = np.abs(np.fft.rfftn(by_height))
    waves = np.asarray(grid.wavenumbers) / (2 * np.pi)
    outside = (waves < 2 - 1e-6) | (waves > 16 + 1e-6)
    assert spectrum[outside].max() < 1e-12 * spectrum.max()


@pytest.mark.parametrize(("exponent", "slope"), [("field", -3.6), ("paper", -2.8)])
def test_the_spectrum_falls_with_the_exponent_asked_for(exponent, slope):
    grid = js.Grid(256)

    def density(key):
        heights = surfaces.self_affine(
            grid, key, hurst=0.8, k_low=1, k_rolloff=4, k_high=100, rms_height=1, exponent=exponent
        )
        return surfaces.power_spectrum(grid, heights).density

    densities = jax.jit(jax.vmap(density))(jax.random.split(jax.random.key(0), 16))
    mean = np.asarray(densities).mean(0)
    k = np.arange(1, mean.size + 1)
    fit = np.polyfit(np.log(k[9:80]), np.log(mean[9:80]), 1)
    assert fit[0] == pytest.approx(slope, abs=0.05)
    # The plateau below the roll-off is as high as the power law there.
    assert mean[:3].mean() == pytest.approx(np.exp(np.polyval(fit, np.log(4))), rel=0.2)


@pytest.mark.parametrize(
    ("shape", "lengths"), [((50,), (3.0,)), ((20, 33), (2.0, 5.0)), ((64, 64), (1.0, 10.0))]
)
def test_the_power_spectrum_sums_to_the_mean_square_height(shape, lengths):
    grid = js.Grid(shape, lengths)
    heights = jax.random.normal(jax.random.key(0), grid.shape)
    spectrum = jax.jit(lambda heights: surfaces.power_spectrum(grid, heights))(heights)
    area = np.prod(lengths)
    total = np.sum(np.asarray(spectrum.density * spectrum.num_waves)) / area
    np.testing.assert_allclose(total, surfaces.rms_height(heights) ** 2, rtol=1e-12)
    assert spectrum.num_waves.sum() == grid.size - 1


def test_one_key_gives_one_surface_at_every_resolution():
    key = jax.random.key(5)
    coarse = surfaces.self_affine(js.Grid(64), key, k_high=16, rms_height=0.1)
    fine = surfaces.self_affine(js.Grid(192), key, k_high=16, rms_height=0.1)
    np.testing.assert_allclose(fine[::3, ::3], coarse, atol=1e-14)
    other = surfaces.self_affine(js.Grid(64), jax.random.key(6), k_high=16, rms_height=0.1)
    assert abs(np.corrcoef(coarse.ravel(), other.ravel())[0, 1]) < 0.5


def test_on_a_long_line_no_two_waves_have_one_noise():
    grid = js.Grid((2**18,))
    heights = surfaces.self_affine(
        grid, jax.random.key(0), k_low=1, k_rolloff=2**17, k_high=2**17, rms_height=1.0
    )
    modes = np.fft.rfft(np.asarray(heights))[1:]
    first, second = modes[: 2**16 - 1], modes[2**16 : 2**17 - 1]
    assert abs(np.vdot(first, second)) < 0.05 * np.linalg.norm(first) * np.linalg.norm(second)


def test_surfaces_can_be_drawn_in_batches_and_differentiated():
    grid = js.Grid(32)
    keys = jax.random.split(jax.random.key(0), 3)
    draw = jax.vmap(lambda key: surfaces.self_affine(grid, key, k_high=8, rms_height=0.1))
    batch = draw(keys)
    single = surfaces.self_affine(grid, keys[1], k_high=8, rms_height=0.1)
    np.testing.assert_allclose(batch[1], single, atol=1e-14)

    def slope(hurst):
        heights = surfaces.self_affine(grid, keys[0], hurst=hurst, k_high=8, rms_height=0.1)
        return surfaces.rms_slope(grid, heights)

    step = 1e-6
    difference = (slope(0.5 + step) - slope(0.5 - step)) / (2 * step)
    np.testing.assert_allclose(jax.grad(slope)(0.5), difference, rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "exactly one of rms_height and rms_slope"),
        ({"rms_height": 1.0, "rms_slope": 1.0}, "exactly one"),
        ({"rms_height": -1.0}, "-1.0.*positive"),
        ({"rms_height": 1.0, "hurst": 1.5}, r"Hurst exponent is 1.5.*\[0, 1\]"),
        ({"rms_height": 1.0, "k_low": 8, "k_rolloff": 4}, "ascend"),
        ({"rms_height": 1.0, "k_high": 17}, "k_high is 17.*resolves 16"),
        ({"rms_height": 1.0, "k_low": 1.1, "k_rolloff": 1.2, "k_high": 1.3}, "widen"),
        ({"rms_height": 1.0, "exponent": "other"}, "choose one of field, paper"),
        ({"rms_height": np.ones(32)}, r"rms height or slope has shape \(32,\): .* jax.vmap"),
        ({"rms_height": 1.0, "hurst": np.ones(32)}, r"hurst has shape \(32,\)"),
    ],
)
def test_a_surface_that_cannot_be_drawn_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        surfaces.self_affine(js.Grid(32), jax.random.key(0), **{"k_high": 8, **options})


@pytest.mark.parametrize("key", [0, 1.5, None, jnp.arange(2)])
def test_what_is_not_a_random_key_is_refused(key):
    with pytest.raises(TypeError, match="give a random key, as"):
        surfaces.self_affine(js.Grid(32), key, k_high=8, rms_height=0.1)


@pytest.mark.parametrize("make", [jax.random.key, jax.random.PRNGKey])
def test_several_keys_are_refused_where_one_is_asked_for(make):
    keys = jax.random.split(make(0), 3)
    with pytest.raises(ValueError, match=r"keys of shape \(3,\).* give one of them"):
        surfaces.self_affine(js.Grid(8), keys, k_high=2, rms_height=0.1)

    def draw(key):
        return surfaces.self_affine(js.Grid(8), key, k_high=2, rms_height=0.1)

    np.testing.assert_array_equal(jax.vmap(draw)(keys)[1], draw(keys[1]))


def test_waves_that_do_not_fit_into_the_cell_are_refused():
    with pytest.raises(TypeError, match=r"number of waves is 1\.5: give an integer"):
        surfaces.sinusoid(js.Grid(8), 0.1, (1.5, 0))
    with pytest.raises(ValueError, match="one number for each side"):
        surfaces.sinusoid(js.Grid(8), 0.1, 3)
    with pytest.raises(ValueError, match=r"number of waves is .*5.*half of the points, \(8, 8\)"):
        surfaces.sinusoid(js.Grid(8), 0.1, (1, -5))
    line = js.Grid((8,))
    np.testing.assert_array_equal(
        surfaces.sinusoid(line, 0.1, 3), surfaces.sinusoid(line, 0.1, (3,))
    )


def test_a_power_law_is_found_in_a_spectrum_of_its_form():
    q = np.arange(1.0, 301)
    for dimension, most in ((2, 60), (1, 2)):
        for hurst, rolloff, cutoff in ((0.8, 8, 200), (0.3, 1, 300), (0.5, 20, 90)):
            density = 3.0 * np.maximum(q / rolloff, 1) ** -(dimension + 2 * hurst)
            density[q > cutoff] *= 1e-4
            spectrum = surfaces.PowerSpectrum(q, density, np.full(300, most))
            law = surfaces.power_law(spectrum)
            np.testing.assert_allclose(law.hurst, hurst, rtol=1e-6)
            np.testing.assert_allclose(law.density, 3.0, rtol=1e-6)
            assert (law.rolloff, law.cutoff) == (rolloff, cutoff)
    with pytest.raises(ValueError, match="has 4 rings with waves: give 5"):
        surfaces.power_law(surfaces.PowerSpectrum(q[:4], density[:4], np.ones(4)))


@pytest.mark.parametrize(("how", "k_high"), [("as it is", 63), ("window", 16), ("piece", 32)])
def test_hurst_exponents_of_scans_are_found_within_their_errors(how, k_high):
    # A piece is cut out of a surface twice as large, as a scan is.
    size = 2 if how == "piece" else 1
    grid, deviations = js.Grid(128 * size, 10.0 * size), []
    for seed, (hurst, k_rolloff) in enumerate([(0.3, 2), (0.5, 5), (0.8, 2), (0.8, 5), (0.9, 2)]):
        heights = surfaces.self_affine(
            grid, jax.random.key(seed), hurst=hurst, k_low=2, k_rolloff=k_rolloff * size,
            k_high=k_high * size, rms_height=0.1,
        )  # fmt: skip
        scan = surfaces.Topography(js.Grid(128, 10.0), np.asarray(heights)[:128, :128])
        if how != "as it is":
            scan = scan.detrended().periodic("window")
        law = surfaces.power_law(surfaces.power_spectrum(scan.grid, scan))
        blur = 0 if how == "as it is" else 0.03
        assert law.hurst == pytest.approx(hurst, abs=3 * law.hurst_error + blur)
        assert law.hurst_error < {16: 0.13, 32: 0.05, 63: 0.025}[k_high]
        assert law.cutoff / (2 * np.pi / 10) == pytest.approx(k_high, abs=1.01)
        if k_high > 16:
            assert law.rolloff / (2 * np.pi / 10) == pytest.approx(k_rolloff, abs=2.1)
        deviations.append((law.hurst - hurst) / law.hurst_error)
    assert 0.3 < np.std(deviations) < 2.5


CROPPED = js.Grid(256, 20.0)


def cropped(seed, hurst=0.8):
    """Return a periodic surface with waves as long as its sides, and a quarter of it."""
    whole = surfaces.self_affine(
        CROPPED, jax.random.key(seed), hurst=hurst, k_low=1, k_high=96, rms_height=0.05
    )
    whole = surfaces.Topography(CROPPED, np.asarray(whole), is_periodic=True)
    return whole, whole.cropped((0, 10), (0, 10))


def test_mirrored_crops_have_the_statistics_of_the_whole_surface():
    hursts = 0.3, 0.5, 0.8, 0.95, 0.8, 0.8, 0.8, 0.8
    off = []
    for seed, hurst in enumerate(hursts):
        whole, crop = cropped(seed, hurst)
        mirror = crop.periodic("mirror")
        law = surfaces.power_law(surfaces.power_spectrum(mirror.grid, mirror))
        assert law.hurst == pytest.approx(hurst, abs=2.5 * law.hurst_error)
        slopes = [surfaces.rms_slope(surface.grid, surface) for surface in (mirror, whole)]
        energies = [
            surfaces.full_contact_energy(js.HalfSpace(surface.grid, 1.0), surface)
            for surface in (mirror, whole)
        ]
        off.append((law.hurst - hurst, slopes[0] / slopes[1] - 1, energies[0] / energies[1] - 1))
    biases = abs(np.mean(off, axis=0))
    assert (biases < [0.025, 0.025, 0.1]).all()


@pytest.mark.nightly
@pytest.mark.parametrize("is_array", [False, True])
def test_statistics_of_a_surface_whose_edges_do_not_meet_warn(is_array):
    whole, crop = cropped(0)
    surface = crop.heights if is_array else crop
    solid = js.HalfSpace(crop.grid, 1.0)
    statistics = (
        lambda surface: surfaces.rms_slope(crop.grid, surface),
        lambda surface: surfaces.rms_curvature(crop.grid, surface),
        lambda surface: surfaces.power_spectrum(crop.grid, surface),
        lambda surface: surfaces.autocorrelation(crop.grid, surface),
        lambda surface: surfaces.full_contact_energy(solid, surface),
        lambda surface: surfaces.effective_work_of_adhesion(solid, surface, 5e-4),
    )
    for statistic in statistics:
        with pytest.warns(
            js.exceptions.SurfaceWarning, match=r"do not meet along x.*periodic\(\"mirror\"\)"
        ):
            statistic(surface)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        surfaces.rms_height(surface)
        surfaces.effective_work_of_adhesion(js.HalfSpace(CROPPED, 1.0), whole, 5e-4)
        # A window has edges, and what a user declares periodic is taken as such.
        surfaces.effective_work_of_adhesion(js.FreeHalfSpace(crop.grid, 1.0), surface, 5e-4)
        surfaces.effective_work_of_adhesion(solid, crop.periodic("as_is"), 5e-4)
        jax.eval_shape(lambda heights: surfaces.rms_slope(crop.grid, heights), crop.heights)


def test_the_effective_work_of_a_crop_has_the_sign_of_the_whole_surface():
    whole, crop = cropped(0)
    mirror = crop.periodic("mirror")
    of_whole, of_mirror = (
        float(surfaces.effective_work_of_adhesion(js.HalfSpace(surface.grid, 1.0), surface, 5e-4))
        for surface in (whole, mirror)
    )
    assert of_mirror == pytest.approx(of_whole, abs=5e-5) and of_whole > 1e-4


def test_a_window_has_the_true_area_of_its_own_heights():
    whole, crop = cropped(0)
    gained, stored = (
        surfaces.effective_work_of_adhesion(js.FreeHalfSpace(crop.grid, 1.0), crop, work)
        for work in (1.0, 0.0)
    )
    modes = np.fft.fft2(whole.heights)
    q = 2j * np.pi * np.fft.fftfreq(256, 20 / 256)
    slopes = (np.fft.ifft2(factor * modes).real for factor in (q[:, None], q))
    area = np.sqrt(1 + sum(slope**2 for slope in slopes))[:128, :128].mean()
    assert gained - stored - 1 == pytest.approx(area - 1, rel=0.01)


@pytest.mark.parametrize(("how", "k_high"), [("as_is", 60), ("window", 250)])
def test_hurst_exponents_of_profiles_are_found_within_their_errors(how, k_high):
    grid = js.Grid((2048,), 10.0)
    for seed in range(4):
        heights = surfaces.self_affine(
            grid, jax.random.key(seed), hurst=0.7, k_high=k_high, rms_height=0.1
        )
        scan = surfaces.Topography(grid, np.asarray(heights)).periodic(how)
        law = surfaces.power_law(surfaces.power_spectrum(grid, scan))
        assert law.hurst == pytest.approx(0.7, abs=3 * law.hurst_error)
        assert law.hurst_error < {60: 0.12, 250: 0.05, 1000: 0.02}[k_high]
        assert law.cutoff / (2 * np.pi / 10) == pytest.approx(k_high, rel=0.1)


@pytest.mark.nightly
def test_errors_of_a_power_law_are_those_of_its_waves():
    # Means of exponentials about a law, by far more draws than a surface has.
    q, waves, rng = np.arange(1.0, 101), 2 * np.round(np.pi * np.arange(1.0, 101)), np.random
    draws = rng.default_rng(0).gamma(waves / 2, 2 / waves, (200, 100)) * q**-3.6
    laws = [surfaces.power_law(surfaces.PowerSpectrum(q, draw, waves)) for draw in draws]
    found = np.array([law.hurst for law in laws])
    errors = np.array([law.hurst_error for law in laws])
    assert abs(found.mean() - 0.8) < 4 * found.std() / np.sqrt(200)
    assert errors.mean() == pytest.approx(found.std(), rel=0.2)
    scaled = [law.density / law.rolloff**-3.6 for law in laws]
    relative = np.mean([law.density_error / law.density for law in laws])
    assert relative == pytest.approx(np.std(scaled), rel=0.3)


@pytest.mark.parametrize(
    ("power", "hurst"), [(0.0, -1.0), (1.0, -0.5), (5.0, 1.5), (7.0, 2.5), (None, None)]
)
def test_a_spectrum_without_a_self_affine_band_warns(power, hurst):
    grid = js.Grid(128, 10.0)
    k = np.asarray(grid.wavenumbers) * 10 / (2 * np.pi)
    # Noise, surfaces too smooth to be self-affine, and one with Gaussian correlations.
    density = np.exp(-((k / 8) ** 2)) if power is None else np.maximum(k / 3, 1) ** -power
    modes = np.sqrt(density) * np.fft.rfftn(np.random.default_rng(0).normal(size=grid.shape))
    scan = surfaces.Topography(grid, np.fft.irfft2(modes)).periodic("window")
    with pytest.warns(
        js.exceptions.SurfaceWarning, match=r"no self-affine band: .* needs one from 0 to 1"
    ):
        law = surfaces.power_law(surfaces.power_spectrum(grid, scan))
    if hurst is not None and power > 0:
        assert law.hurst == pytest.approx(hurst, abs=0.15)


def test_the_autocorrelation_is_that_of_brute_force():
    grid = js.Grid((9, 16), (1.8, 4.0))
    heights = np.random.default_rng(0).normal(size=(9, 16)) + 3
    found = surfaces.autocorrelation(grid, jnp.asarray(heights))
    about_mean, rings = heights - heights.mean(), {}
    for i in range(9):
        for j in range(16):
            distance = np.hypot(0.2 * min(i, 9 - i), 0.25 * min(j, 16 - j))
            product = (about_mean * np.roll(about_mean, (i, j), (0, 1))).mean()
            rings.setdefault(int(np.ceil(distance / 0.25 - 1e-9)), []).append((distance, product))
    expected = np.array([np.mean(rings[k], axis=0) for k in range(9)])
    np.testing.assert_allclose(found.distance, expected[:, 0], rtol=1e-12)
    np.testing.assert_allclose(found.value, expected[:, 1], rtol=1e-12)
    np.testing.assert_allclose(found.value[0], heights.var(), rtol=1e-12)


@pytest.mark.parametrize("shape", [(64,), (32, 48)])
def test_full_contact_of_a_wave_stores_and_gains_what_calculus_says(shape):
    lengths = (2.0, 3.0)[: len(shape)]
    grid = js.Grid(shape, lengths)
    heights = 5 + surfaces.sinusoid(grid, 0.3, (1, 2)[: len(shape)])
    q = 2 * np.pi * np.linalg.norm(np.array((1, 2)[: len(shape)]) / lengths)
    solid = js.HalfSpace(grid, 0.75, 0.5)
    # Westergaard: E* q A^2 / 8 with E* = 1.
    energy = q * 0.3**2 / 8
    np.testing.assert_allclose(surfaces.full_contact_energy(solid, heights), energy, rtol=1e-12)
    # The mean of sqrt(1 + s^2 sin^2) is an elliptic integral, of the second kind.
    area = 2 / np.pi * ellipe(-((0.3 * q) ** 2))
    work = jax.jit(surfaces.effective_work_of_adhesion)(solid, heights, 2.0)
    np.testing.assert_allclose(work, 2 * area - energy, rtol=1e-12)
    # A layer whose waves are all as stiff, k = 3: 3 A^2 / 4.
    layer = js.solids.Spectral(grid, lambda q: 3 + 0 * q)
    np.testing.assert_allclose(surfaces.full_contact_energy(layer, heights), 3 * 0.09 / 4)


GRID = js.Grid((8, 12), (1.0, 2.0))
HEIGHTS = np.random.default_rng(0).normal(size=(8, 12))
SOLID = js.HalfSpace(GRID, 1.0)
STATISTICS = [
    lambda grid, heights: surfaces.rms_slope(grid, heights),
    lambda grid, heights: surfaces.rms_curvature(grid, heights),
    lambda grid, heights: surfaces.power_spectrum(grid, heights).density,
    lambda grid, heights: surfaces.autocorrelation(grid, heights).value,
    lambda grid, heights: surfaces.full_contact_energy(js.HalfSpace(grid, 1.0), heights),
    lambda grid, heights: surfaces.effective_work_of_adhesion(
        js.HalfSpace(grid, 1.0), heights, 1.0
    ),
]


@pytest.mark.parametrize("statistic", STATISTICS)
def test_statistics_take_a_topography_on_its_own_grid_alone(statistic):
    topography = surfaces.Topography(GRID, HEIGHTS, "µm")
    np.testing.assert_array_equal(statistic(GRID, topography), statistic(GRID, HEIGHTS))
    with pytest.raises(ValueError, match=r"own, .*\(8, 12\), lengths=\[1, 2\]"):
        statistic(js.Grid((8, 12), (1.0, 1.0)), topography)
    gap = surfaces.Topography(GRID, np.where(HEIGHTS > 2, np.nan, HEIGHTS))
    with pytest.raises(ValueError, match=r"of 96 are missing: fill them, as by .*\.filled\(\)`"):
        statistic(GRID, gap)


def test_the_roll_off_is_by_default_the_lower_cut_off():
    grid, key = js.Grid(32), jax.random.key(0)
    for options in ({"k_low": 4, "k_high": 8}, {"k_low": 1, "k_high": 8}, {"k_high": 8}):
        default = surfaces.self_affine(grid, key, rms_height=1.0, **options)
        k_rolloff = options.get("k_low", 2)
        given = surfaces.self_affine(grid, key, rms_height=1.0, k_rolloff=k_rolloff, **options)
        np.testing.assert_array_equal(default, given)


@pytest.mark.parametrize("statistic", STATISTICS)
def test_statistics_refuse_heights_off_the_grid_and_missing(statistic):
    for wrong in (HEIGHTS[:6], HEIGHTS[0], 1.0):
        with pytest.raises(ValueError, match=r"heights has shape \(.*\), the grid \(8, 12\)"):
            statistic(GRID, wrong)
    with pytest.raises(ValueError, match=r"A height is nan at \(0, 5\): .*\.filled\(\)"):
        statistic(GRID, np.where(np.arange(96).reshape(8, 12) == 5, np.nan, HEIGHTS))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: surfaces.rms_height(np.array([1, np.nan])), r"A height is nan at \(1,\)"),
        (lambda: surfaces.rms_height("rough"), "array of heights is 'rough': give real numbers"),
        (lambda: surfaces.rms_slope(HEIGHTS, GRID), "grid is a ndarray: give the grid first"),
        (lambda: surfaces.rms_curvature(HEIGHTS, GRID), "grid is a ndarray"),
        (lambda: surfaces.power_spectrum(HEIGHTS, GRID), "grid is a ndarray"),
        (lambda: surfaces.autocorrelation(SOLID, HEIGHTS), "grid is a HalfSpace: give the grid"),
        (lambda: surfaces.full_contact_energy(HEIGHTS, SOLID), "solid is a ndarray: give the sol"),
        (
            lambda: surfaces.full_contact_energy(surfaces.Topography(GRID, HEIGHTS), SOLID),
            "solid is a Topography: give the solid first",
        ),
        *(
            (
                lambda work=work: surfaces.effective_work_of_adhesion(SOLID, HEIGHTS, work),
                rf"work of adhesion is {work}: it must be finite, and not negative",
            )
            for work in (-1.0, np.nan, np.inf)
        ),
        (
            lambda: surfaces.power_law(
                surfaces.PowerSpectrum(np.arange(9.0), np.full(9, np.nan), np.ones(9))
            ),
            "spectrum is NaN or infinite",
        ),
    ],
)
def test_statistics_of_nonsense_are_refused_in_a_sentence(make, message):
    with pytest.raises((ValueError, TypeError), match=message):
        make()


def test_statistics_are_those_of_surface_topography():
    grid = js.Grid((256, 192), (2.0, 1.5))
    heights = surfaces.self_affine(grid, jax.random.key(2), k_high=10, rms_height=0.1)
    other = SurfaceTopography.Topography(np.asarray(heights), (2.0, 1.5), periodic=True)
    height = other.rms_height_from_area()
    np.testing.assert_allclose(surfaces.rms_height(heights), height, rtol=1e-9)
    # By differences of neighbours there, by the Fourier series here.
    np.testing.assert_allclose(surfaces.rms_slope(grid, heights), other.rms_gradient(), rtol=0.01)
    # There it is half the mean square difference of heights.
    distance, structure = other.autocorrelation_from_area()
    ours = surfaces.autocorrelation(grid, heights)
    # Its rings grow wide farther out.
    near = (distance > 0) & (distance < 0.5)
    expected = height**2 - np.interp(distance[near], ours.distance, ours.value)
    np.testing.assert_allclose(structure[near], expected, atol=0.01 * height**2)


def test_traced_parameters_that_are_refused_otherwise_give_no_surface():
    grid, key = js.Grid(16), jax.random.key(0)
    with pytest.raises(ValueError, match=r"-0\.1"):
        surfaces.self_affine(grid, key, k_high=4, rms_height=-0.1)
    draw = jax.vmap(lambda k, rms: surfaces.self_affine(grid, key, k_high=k, rms_height=rms))
    heights = jax.jit(draw)(jnp.array([4.0, 4.0, 9.0]), jnp.array([0.1, -0.1, 0.1]))
    np.testing.assert_allclose(heights[0].std(), 0.1)
    assert np.isnan(heights[1:]).all()


def test_statistics_of_nanometres_on_a_large_constant_keep_their_digits_in_float32():
    wave = 1e-10 * np.sqrt(2) * np.cos(2 * np.pi * np.arange(32) / 32)[:, None] * np.ones(32)
    with jax.enable_x64(False):
        grid = js.Grid((32, 32), (1e-7, 1e-7))
        surface = surfaces.Topography(grid, wave + 5e-3, "m")
        rms = surfaces.rms_height(surface), surfaces.rms_slope(grid, surface)
    np.testing.assert_allclose(rms, [1e-10, 1e-10 * 2 * np.pi / 1e-7], rtol=1e-5)


def test_power_spectra_of_picometres_in_metres_do_not_underflow_in_float32():
    rough = np.random.default_rng(0).normal(size=(32, 32)) * 1e-12
    with jax.enable_x64(False):
        grid = js.Grid((32, 32), (1e-7, 1e-7))
        density = surfaces.power_spectrum(grid, surfaces.Topography(grid, rough, "m")).density
    expected = surfaces.power_spectrum(js.Grid((32, 32), (1e5, 1e5)), rough * 1e12).density
    np.testing.assert_allclose(density * 1e48, expected, rtol=1e-5)


def test_densities_that_underflow_in_single_precision_are_refused():
    rough = np.random.default_rng(0).normal(size=(32, 32))

    def density(unit):
        grid = js.Grid(32, 10 * unit)
        return surfaces.power_spectrum(grid, rough * unit).density / unit**4

    expected = density(1.0)
    with jax.enable_x64(False):
        np.testing.assert_allclose(density(1e-6), expected, rtol=1e-5)
        with pytest.raises(ValueError, match=r"underflow in float32\. Give .*as nm, or enable fl"):
            density(1e-9)
        flat = surfaces.power_spectrum(js.Grid(32, 1e-9), np.ones((32, 32)))
    assert not flat.density.any()

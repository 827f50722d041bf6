"""Prony series, surface tension and sheets, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.solids.viscoelastic import ramp

GRID = js.Grid(16)
SOLID = js.HalfSpace(GRID, 2.0, 0.3)


def wave(kx, ky):
    x, y = np.meshgrid(*[np.arange(16) / 16] * 2, indexing="ij")
    return jnp.asarray(np.cos(2 * np.pi * (kx * x + ky * y)))


def test_stiffness_goes_from_glassy_to_relaxed_with_the_length_of_a_step():
    solid = js.Viscoelastic(SOLID, (2.0, 1.0), (0.1, 1.0))
    for dt, factor in ((0.0, 4.0), (1e12, 1.0), (0.5, None)):
        if factor is None:
            factor = 1 + sum(
                r * t / dt * (1 - np.exp(-dt / t)) for r, t in ((2.0, 0.1), (1.0, 1.0))
            )
        expected = factor * np.array(SOLID.pressure(wave(1, 2)))
        assert np.array(solid.step(dt).pressure(wave(1, 2))) == pytest.approx(expected, abs=1e-9)
    assert solid.glassy.max_stiffness == pytest.approx(4 * float(SOLID.max_stiffness))
    assert solid.relaxed is SOLID


def test_moduli_as_finite_elements_take_them_are_the_same_series():
    given = js.Viscoelastic.from_moduli(SOLID, (0.5, 0.25), (0.1, 1.0))
    assert np.array(given.ratios) == pytest.approx([2.0, 1.0])
    assert given.glassy.max_stiffness == pytest.approx(float(SOLID.max_stiffness))
    assert (given.relaxed.youngs_modulus, given.relaxed.poisson_ratio) == (0.5, 0.3)
    with pytest.raises(ValueError, match="add up to less than one"):
        js.Viscoelastic.from_moduli(SOLID, (0.5, 0.5), (0.1, 1.0))
    for other in (given, 2.0):
        with pytest.raises(TypeError, match=f"glassy solid is a {type(other).__name__}"):
            js.Viscoelastic.from_moduli(other, (0.5, 0.25), (0.1, 1.0))


def test_storage_and_loss_are_the_transform_of_the_relaxation():
    solid = js.Viscoelastic(SOLID, (2.0, 1.0), (0.1, 1.0))
    storage, loss = solid.storage_and_loss(jnp.array([0.0, 3.0, 1e9]))
    # i w times the Fourier transform of 1 + sum r exp(-t / t_k), by quadrature.
    t = np.linspace(0, 60, 2_000_001)
    relaxing = 2 * np.exp(-t / 0.1) + np.exp(-t)
    transform = 3j * np.trapezoid(relaxing * np.exp(-3j * t), t)
    assert np.array(storage) == pytest.approx([1, 1 + transform.real, 4], rel=1e-6)
    assert loss[1] == pytest.approx(transform.imag, rel=1e-6)
    assert loss[0] == 0 and loss[2] < 1e-7
    # The square of the frequency overflows in single precision.
    single = js.Viscoelastic(SOLID, np.float32(3), np.float32(1))
    storage, loss = single.storage_and_loss(np.float32(1e25))
    assert storage == 4 and loss == pytest.approx(3e-25)


@pytest.mark.parametrize("exponent", [0.3, 1.0])
def test_a_power_law_is_met_to_the_error_that_is_told(exponent):
    solid, error = js.Viscoelastic.power_law(SOLID, 99.0, exponent, 1e-3)
    t = np.concatenate([[0.0], np.logspace(-5, 4, 200)])
    relaxing = 1 + np.exp(-t[:, None] / np.array(solid.times)) @ np.array(solid.ratios)
    expected = 1 + 99 * (1 + t / 1e-3) ** -exponent
    assert np.max(np.abs(relaxing - expected)) / 100 <= 1.05 * error < 0.01


BAND = np.logspace(-2, 4, 61)
# Times on the grid of the fit, between its points, and of moduli over three decades.
SERIES = [
    ((2.0, 1.0), (0.1, 1.0)),
    ((2.0, 1.0), (0.113, 1.27)),
    ((1000.0, 50.0, 5.0, 1.0), (1e-3, 0.0237, 0.5, 10.3)),
]


@pytest.mark.parametrize(("ratios", "times"), SERIES)
def test_a_series_is_found_from_its_storage_and_loss(ratios, times):
    true = js.Viscoelastic(SOLID, ratios, times)
    storage, loss = (3 * np.asarray(x) for x in true.storage_and_loss(BAND))
    backwards = BAND[::-1], storage[::-1], loss[::-1]
    found = js.Viscoelastic.from_storage_and_loss(SOLID, *backwards)
    assert found.fit_error < 0.005
    assert found.relaxed.poisson_ratio == SOLID.poisson_ratio
    modulus = float(found.relaxed.youngs_modulus)
    # It is known as well as the modulus at the lowest frequency.
    slowest = np.hypot(storage, loss)[0]
    assert modulus == pytest.approx(3, abs=4 * float(found.fit_error) * slowest + 1e-12)
    # The moduli of the fit are as far from the data as it says.
    fitted = [modulus * np.asarray(x) for x in found.storage_and_loss(BAND)]
    missed = np.hypot(fitted[0] - storage, fitted[1] - loss) / np.hypot(storage, loss)
    assert np.max(missed) == pytest.approx(float(found.fit_error), rel=1e-6, abs=1e-14)
    # Each term is shared by the two nearest times: their moduli add up to its own.
    for ratio, time in zip(ratios, times, strict=True):
        near = abs(np.log10(np.asarray(found.times) / time)) < 0.21
        assert np.asarray(found.ratios)[near].sum() == pytest.approx(ratio, rel=0.03)


def test_a_fit_to_noisy_moduli_has_an_error_of_the_noise():
    true = js.Viscoelastic(SOLID, *SERIES[1])
    noise = 1 + 0.02 * np.random.default_rng(1).normal(size=(2, BAND.size))
    measured = np.asarray(true.storage_and_loss(BAND)) * noise
    found = js.Viscoelastic.from_storage_and_loss(js.Layer(GRID, 1.0, 0.4, 0.1), BAND, *measured)
    assert 0.01 < found.fit_error < 0.08
    assert found.relaxed.youngs_modulus == pytest.approx(1, rel=0.02)
    assert found.stiffening(0.0) * found.relaxed.youngs_modulus == pytest.approx(4, rel=0.02)


def test_single_precision_and_one_frequency_are_fitted():
    # E' = E + E_1 / 2 and E'' = E_1 / 2 at w t = 1.
    found = js.Viscoelastic.from_storage_and_loss(SOLID, [5.0], np.float32([3.0]), [1.0])
    np.testing.assert_allclose((found.relaxed.youngs_modulus, found.ratios[0]), (2, 1), rtol=1e-6)
    assert found.times[0] == pytest.approx(0.2) and found.fit_error < 1e-7


@pytest.mark.parametrize(
    ("frequencies", "storage", "loss", "named"),
    [
        ((1.0, 2.0), (3.0, 4.0), (1.0, -0.5), r"loss modulus is -0\.5 at \(1,\): .* leave this"),
        (
            (1.0, 2.0),
            (3.0, 4.0, 5.0),
            (1.0, 1.0),
            r"\(2,\) of the frequency, \(3,\) of the storage.*one of each",
        ),
        ((), (), (), r"shapes \(0,\)"),
        ((1.0, np.nan), (3.0, 4.0), (1.0, 1.0), "frequency is nan"),
        ((0.0, 2.0), (3.0, 4.0), (1.0, 1.0), "frequency is 0.0"),
        ((1.0, 2.0), (3.0, np.inf), (1.0, 1.0), "storage modulus is inf"),
        ((1.0, 2.0), (-3.0, 4.0), (1.0, 1.0), "storage modulus is -3.0"),
        ((1.0, 2.0), (3.0, 4.0), (np.nan, 1.0), "loss modulus is nan"),
        ((1.0, 2.0), (3.0, 3.0), (0.0, 0.0), "elastic solid of modulus 3: use that"),
        ((1.0, 2.0), (-3.0, -4.0), (1.0, 1.0), "storage modulus is -3.0 at"),
    ],
)
def test_moduli_that_make_no_solid_are_named(frequencies, storage, loss, named):
    with pytest.raises(ValueError, match=named):
        js.Viscoelastic.from_storage_and_loss(SOLID, frequencies, storage, loss)


def test_a_fit_needs_one_modulus_and_known_numbers():
    coated = js.CoatedHalfSpace(GRID, (2.0, 0.3), 0.1, (1.0, 0.3))
    with pytest.raises(TypeError, match="CoatedHalfSpace, without one Young's modulus"):
        js.Viscoelastic.from_storage_and_loss(coated, [1.0], [3.0], [1.0])
    with pytest.raises(TypeError, match="JAX is tracing these"):
        jax.jit(lambda x: js.Viscoelastic.from_storage_and_loss(SOLID, [1.0], x, [1.0]).ratios)(
            jnp.array([3.0])
        )


@pytest.mark.nightly
def test_a_fitted_solid_is_kept_in_a_file(tmp_path):
    solid = js.Viscoelastic.from_storage_and_loss(SOLID, [5.0], [3.0], [1.0])
    heights = js.surfaces.paraboloid(GRID, 2.0)
    contact = js.Contact(solid, heights, js.potentials.Exponential(0.1, 0.2))
    state = js.equilibrate(contact, js.MeanGap(0.3))
    js.save(tmp_path / "state.nc", contact, state)
    kept, _ = js.load(tmp_path / "state.nc")
    assert kept.solid.fit_error == solid.fit_error and kept.solid.ratios == solid.ratios


@pytest.mark.parametrize(
    ("ratios", "times", "named"),
    [
        ((1.0,), (1.0, 2.0), r"shape \(1,\)"),
        ((), (), r"shape \(0,\)"),
        ((-1.0,), (1.0,), "ratio of moduli is -1.0"),
        ((1.0, 1.0), (2.0, 1.0), "sort them"),
        ((1.0,), (0.0,), "relaxation time is 0.0"),
    ],
)
def test_a_series_that_is_none_is_named(ratios, times, named):
    with pytest.raises(ValueError, match=named):
        js.Viscoelastic(SOLID, ratios, times)


def test_a_step_and_a_power_law_refuse_impossible_numbers():
    with pytest.raises(ValueError, match=r"time step is -1\.0"):
        js.Viscoelastic(SOLID, 1.0, 1.0).step(-1.0)
    for wrong in ({"decades": -3.0}, {"terms_per_decade": 0}):
        with pytest.raises(ValueError, match="must be positive"):
            js.Viscoelastic.power_law(SOLID, 99.0, 0.5, 1e-3, **wrong)


def test_a_scaled_solid_relaxes_as_before():
    solid = js.Viscoelastic(SOLID, (2.0, 1.0), (0.1, 1.0))
    scaled = solid.scaled(jnp.array(4.0))
    for dt in (0.0, 0.3, 1e12):
        # A power of two leaves all digits.
        expected = 4 * solid.step(dt).pressure(wave(1, 2))
        np.testing.assert_array_equal(scaled.step(dt).pressure(wave(1, 2)), expected)


def test_calls_without_time_take_the_relaxed_solid():
    heights = js.surfaces.paraboloid(GRID, 2.0)
    law = js.potentials.Exponential(0.1, 0.2)
    solid = js.Viscoelastic(SOLID, (2.0,), (1.0,))
    states = [js.equilibrate(js.Contact(s, heights, law), js.MeanGap(0.3)) for s in (solid, SOLID)]
    assert states[0].mean_pressure == states[1].mean_pressure


def test_surface_tension_adds_s_q_squared():
    solid = js.SurfaceTension(SOLID, 0.5)
    q = 2 * np.pi * np.hypot(1, 2)
    expected = (2 / (1 - 0.3**2) * q / 2 + 0.5 * q**2) * np.array(wave(1, 2))
    assert np.array(solid.pressure(wave(1, 2))) == pytest.approx(expected, abs=1e-9)
    with pytest.raises(TypeError, match="FreeHalfSpace"):
        js.SurfaceTension(js.FreeHalfSpace(GRID, 1.0), 0.5)
    with pytest.raises(ValueError, match="surface tension is -1"):
        js.SurfaceTension(SOLID, -1.0)


def test_a_sheet_bends_by_the_fourth_power():
    solid = js.Sheet(GRID, 0.01, 0.2)
    q = 2 * np.pi * np.hypot(1, 2)
    expected = (0.01 * q**4 + 0.2 * q**2) * np.array(wave(1, 2))
    assert np.array(solid.pressure(wave(1, 2))) == pytest.approx(expected, abs=1e-9)


@pytest.mark.nightly
def test_a_traced_ratio_or_time_that_is_refused_otherwise_is_nan():
    def glassy(ratio, time):
        return js.Viscoelastic(SOLID, (ratio, 1.0), (1.0, time)).glassy.pressure(wave(1, 2))

    pressures = jax.vmap(glassy)(jnp.array([2.0, -2.0]), jnp.array([3.0, 3.0]))
    np.testing.assert_allclose(pressures[0], 4 * SOLID.pressure(wave(1, 2)))
    assert np.isnan(pressures[1]).all()

    def relaxed(fraction):
        return js.Viscoelastic.from_moduli(SOLID, (fraction, 0.5), (1.0, 2.0)).max_stiffness

    assert np.isnan(jax.vmap(relaxed)(jnp.array([0.25, 0.75]))).tolist() == [False, True]
    moduli = jax.vmap(
        lambda time: js.Viscoelastic(SOLID, (2.0, 1.0), (1.0, time)).storage_and_loss(1.0)[0]
    )(jnp.array([3.0, 0.5]))
    assert np.isfinite(moduli[0]) and np.isnan(moduli[1])


def test_a_traced_tension_that_is_refused_otherwise_is_nan():
    def pressures(tension):
        gel, sheet = js.SurfaceTension(SOLID, tension), js.Sheet(GRID, 0.01, tension)
        return jnp.stack([solid.pressure(wave(1, 2)) for solid in (gel, sheet)])

    found = jax.vmap(pressures)(jnp.array([0.5, -0.5]))
    np.testing.assert_allclose(found[0], pressures(0.5))
    assert np.isnan(found[1]).all()


def test_of_a_ramp_that_takes_no_time_all_remains():
    remains = ramp(jnp.array([0.0, 0.5, 40.0]))
    np.testing.assert_allclose(remains, [1, 2 * (1 - np.exp(-0.5)), 1 / 40], rtol=1e-12)
    assert jnp.isfinite(jax.grad(ramp)(0.0))

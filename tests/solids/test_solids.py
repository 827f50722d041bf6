import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.solids import Solid

GRIDS = [js.Grid((12,), (2.0,)), js.Grid((9, 6), (1.0, 3.0)), js.Grid((8, 7))]


@pytest.mark.parametrize("grid", GRIDS)
def test_a_wave_is_as_stiff_as_westergaard_says(grid):
    solid = js.HalfSpace(grid, youngs_modulus=3.0, poisson_ratio=0.4)
    x, length = grid.coordinates[0], grid.lengths[0]
    wave = jnp.cos(2 * jnp.pi * 2 * x / length)
    modulus = 3.0 / (1 - 0.4**2)
    expected = modulus * np.pi * 2 / length * wave
    np.testing.assert_allclose(solid.pressure(wave), expected, atol=1e-12)
    # Mean square of a cosine: 1/2.
    area = float(jnp.prod(grid.lengths))
    energy = 0.5 * modulus * np.pi * 2 / length * 0.5 * area
    np.testing.assert_allclose(solid.energy(wave), energy)


def test_any_solid_can_be_scaled_and_given_a_uniform_stiffness():
    solid = js.HalfSpace(GRIDS[1], youngs_modulus=3.0)
    # As of a solid that has no rule of its own.
    scaled = Solid.scaled(solid, jnp.array(0.25))
    assert scaled.max_stiffness == 0.25 * solid.max_stiffness
    assert scaled.min_stiffness == 0.25 * solid.min_stiffness
    field = jnp.sin(jnp.arange(54.0)).reshape(9, 6)
    np.testing.assert_allclose(scaled.apply(field), 0.25 * solid.apply(field), atol=1e-14)
    held = Solid.with_uniform_stiffness(solid, jnp.array(2.0))
    uniform = held.apply(field) - solid.apply(field)
    np.testing.assert_allclose(uniform, 2 * jnp.mean(field), rtol=1e-10)


def test_a_traced_poisson_ratio_that_no_solid_has_gives_no_number():
    grid = GRIDS[0]
    stiffest = jax.jit(lambda ratio: js.HalfSpace(grid, 3.0, ratio).max_stiffness)
    softest = np.pi / 2 * 6
    for ratio in (-0.99, -0.3, 0.0, 0.5):
        np.testing.assert_allclose(stiffest(ratio), 3 / (1 - ratio**2) * softest)
    for ratio in (-1.5, -1.0, 0.51, 0.9):
        assert np.isnan(stiffest(ratio))


@pytest.mark.parametrize("grid", GRIDS)
def test_displacement_undoes_pressure_but_for_the_mean(grid):
    solid = js.HalfSpace(grid, 2.0, 0.3)
    field = jax.random.normal(jax.random.key(0), grid.shape)
    back = solid.displacement(solid.pressure(field))
    np.testing.assert_allclose(back, field - field.mean(), atol=1e-12)


def test_the_operator_equals_a_dense_circulant_matrix():
    grid = js.Grid((10,))
    solid = js.HalfSpace(grid, 1.0)
    dense = jax.vmap(solid.pressure)(jnp.eye(10))
    np.testing.assert_allclose(dense, dense.T, atol=1e-12)
    eigenvalues = np.linalg.eigvalsh(dense)
    waves = np.abs(np.fft.fftfreq(10, 1 / 10))
    np.testing.assert_allclose(eigenvalues, np.sort(np.pi * waves), atol=1e-10)
    np.testing.assert_allclose(solid.max_stiffness, np.pi * 5)


def test_a_thick_layer_is_a_half_space_and_a_thin_one_a_foundation():
    grid = js.Grid((16, 16))
    half_space = js.HalfSpace(grid, 1.0)

    def layer(thickness):
        # The shape of a layer that slides on a rigid base: E* q / 2 for short waves, flat for long.
        return js.solids.Spectral(grid, lambda q: q / 2 / jnp.tanh(q * thickness))

    wave = jnp.cos(2 * jnp.pi * grid.coordinates[1])
    np.testing.assert_allclose(layer(10.0).pressure(wave), half_space.pressure(wave))
    np.testing.assert_allclose(layer(1e-4).pressure(wave), wave / 2e-4, rtol=1e-6, atol=1e-9)
    assert layer(1e-4).uniform_stiffness == 0


def test_a_stiffness_may_depend_on_the_direction_of_a_wave():
    grid = js.Grid((9, 6), (1.0, 3.0))
    x, y = (2 * np.pi * x / n for x, n in zip(grid.coordinates, grid.lengths, strict=True))
    solid = js.solids.Spectral(grid, lambda qx, qy: jnp.sqrt(qx**2 + 4 * qy**2 + qx * qy))
    for a, b in ((1, 0), (0, 1), (2, 1), (2, -1)):
        qx, qy = 2 * np.pi * a, 2 * np.pi * b / 3
        wave = jnp.cos(a * x + b * y)
        exact = np.sqrt(qx**2 + 4 * qy**2 + qx * qy) * wave
        np.testing.assert_allclose(solid.pressure(wave), exact, atol=1e-12)
        tense = js.solids.SurfaceTension(solid, 0.1).pressure(wave)
        np.testing.assert_allclose(tense, exact + 0.1 * (qx**2 + qy**2) * wave, atol=1e-11)
    with pytest.raises(ValueError, match=r"direction of a wave"):
        js.solids.Axisymmetric(js.Rings(8, 1.0), solid)


@pytest.mark.nightly
def test_a_function_of_waves_takes_them_in_any_number():
    grid = js.Grid((8, 6))
    solid = js.solids.Spectral(
        grid, lambda qx, qy: jnp.where(qx * qy > 0, 2, 1) * jnp.hypot(qx, qy)
    )
    waves = np.array([[1.0, -2.0, 3.0], [0.0, 1.5, 4.0]])
    # JAX traces `where` and `hypot` for one shape.
    np.testing.assert_allclose(solid.stiffness_at(waves), [1.0, 2.5, 10.0])
    plane = js.solids.Spectral(grid, jnp.hypot)
    np.testing.assert_allclose(plane.waves.multiplier, grid.wavenumbers, rtol=1e-12)
    rings = js.Rings(8, 1.0)
    bent = js.solids.Spectral(grid, lambda q: jnp.where(q > 20, q, 20.0))
    same = js.solids.Spectral(grid, lambda q: q + jnp.maximum(20 - q, 0))
    found, exact = (
        js.solids.Axisymmetric(rings, one).stiffness_of_order(0) for one in (bent, same)
    )
    np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-9)


def test_a_solid_without_one_modulus_says_so():
    grid = js.Grid(8)
    for solid in (js.Layer(grid, 1.0, 0.3, 0.1), js.solids.Graded(grid, 1.0, 0.3, 0.1, 0.5)):
        with pytest.raises(
            AttributeError, match=r"depends on the size of the contact.*2 K / \|q\|"
        ):
            solid.contact_modulus  # noqa: B018
        assert not hasattr(solid, "contact_modulus")


def test_a_stiffness_that_closes_over_a_traced_value_can_be_differentiated():
    grid = js.Grid((16,))
    wave = jnp.cos(2 * jnp.pi * grid.coordinates[0])

    def energy(factor):
        return js.solids.Spectral(grid, lambda q: factor * q).energy(wave)

    gradient = jax.grad(energy)(2.0)
    np.testing.assert_allclose(gradient, energy(1.0))


@pytest.mark.parametrize("modulus", [0.0, -1.0, np.nan, np.inf])
def test_a_modulus_that_is_not_positive_is_refused(modulus):
    with pytest.raises(ValueError, match=f"Young's modulus is {modulus}.*positive"):
        js.HalfSpace(js.Grid(8), modulus)


@pytest.mark.parametrize("ratio", [-1.0, 0.51, 1.0, np.nan])
def test_a_poisson_ratio_outside_its_range_is_refused(ratio):
    with pytest.raises(ValueError, match=rf"Poisson's ratio is {ratio}.*\(-1, 0.5\]"):
        js.HalfSpace(js.Grid(8), 1.0, ratio)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda q: q - 10.0, "stiffness of a wave is -3.7"),
        (lambda q: jnp.maximum(q - 10.0, 0), "stiffness of a wave is 0.0"),
        (lambda q: 1j * q, "one real stiffness for each"),
        (lambda q: jnp.stack([q, q]), "one real stiffness for each"),
        (lambda a, b, c: a, r"takes 3 arguments: give one of \|q\|, or of q_x and q_y"),
        (lambda q: np.tanh(q), "jax.numpy in place of NumPy"),
        (0.5, r"The function of the solid is 0.5: give one of \|q\|"),
    ],
)
def test_a_stiffness_that_cannot_be_one_is_refused(function, message):
    with pytest.raises((ValueError, TypeError), match=message):
        js.solids.Spectral(js.Grid(8), function)


def test_what_is_refused_eagerly_is_invalid_where_traced():
    @jax.jit
    def is_valid(lowest):
        return js.solids.Spectral(js.Grid(8), lambda q: jnp.maximum(q - lowest, 0)).is_valid

    assert is_valid(1.0)
    assert not is_valid(10.0)


def test_complex_moduli_are_refused():
    with pytest.raises(TypeError, match="Young's modulus is complex128: give real"):
        js.HalfSpace(js.Grid(8), 1 + 1j)


@pytest.mark.parametrize("function", [lambda q: q / 2 * jnp.tanh(q), jax.jit(lambda q: q + 0.1)])
def test_a_solid_of_any_function_takes_the_precision_of_the_heights(function):
    grid = js.Grid((8,))
    wave = jnp.cos(2 * jnp.pi * grid.coordinates[0])
    solid = js.solids.Spectral(grid, function)
    single = js.Contact(solid, wave.astype(jnp.float32), js.potentials.NoAdhesion()).solid
    assert single.waves.multiplier.dtype == jnp.float32
    np.testing.assert_allclose(single.waves.multiplier, solid.waves.multiplier, rtol=1e-6)
    found = single.pressure(wave.astype(jnp.float32))
    np.testing.assert_allclose(found, function(2 * jnp.pi) * wave, rtol=1e-5, atol=1e-5)

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js


def test_coordinates_and_cell_area_of_a_rectangle():
    grid = js.Grid((4, 5), (2.0, 10.0))
    x, y = grid.coordinates
    np.testing.assert_allclose(x[:, 0], [0, 0.5, 1, 1.5])
    np.testing.assert_allclose(y[0], [0, 2, 4, 6, 8])
    assert grid.cell_area == 1.0
    assert js.Grid(16).shape == (16, 16)
    assert js.Grid((1024,), (1.0,)).size == 1024
    assert js.Grid(np.array(16)).shape == (16, 16)
    assert js.Grid(jnp.array([4, 5])).shape == (4, 5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((4, 4, 4),), r"\(4, 4, 4\).*one side"),
        ((1,), r"\(1, 1\).*2 points"),
        (((4, 4), (1.0, -2.0)), "-2.*positive"),
        (((4, 4), (1.0, 2.0, 3.0)), "one for each side"),
        ((64.5,), "64.5: give an integer"),
        (((64, 32.0),), "32.0: give an integer"),
        (((4, 4), 1j), "length is complex128: give real numbers"),
    ],
)
def test_a_grid_that_makes_no_sense_is_refused(arguments, message):
    with pytest.raises((ValueError, TypeError), match=message):
        js.Grid(*arguments)


@pytest.mark.parametrize("length", [1e-30, 1e-19, 1.0, 1e19, 1e30])
def test_wavenumbers_keep_to_the_range_of_single_precision(length):
    lengths = np.array([2 * length, 3 * length], np.float32)
    k, m = np.meshgrid(np.fft.fftfreq(6, 1 / 6), np.arange(4), indexing="ij")
    expected = 2 * np.pi * np.hypot(k / float(lengths[0]), m / float(lengths[1]))
    wavenumbers = js.Grid((6, 6), lengths).wavenumbers
    assert wavenumbers.dtype == jnp.float32
    np.testing.assert_allclose(wavenumbers, expected, rtol=1e-6)


def test_a_grid_is_made_of_traced_lengths_in_a_list():
    areas = jax.vmap(lambda length: js.Grid((4, 5), [2.0, length]).cell_area)(
        jnp.array([5.0, 10.0])
    )
    np.testing.assert_allclose(areas, [0.5, 1.0])


def test_wavenumbers_can_be_differentiated_by_the_lengths():
    def fifth(lengths):
        return js.Grid((6, 6), lengths).wavenumbers[1, 2]

    # q = 2 pi |(1 / a, 2 / b)|
    a, b = 2.0, 3.0
    q = 2 * np.pi * np.hypot(1 / a, 2 / b)
    expected = -((2 * np.pi) ** 2) / q * np.array([1 / a**3, 4 / b**3])
    np.testing.assert_allclose(jax.grad(fifth)(jnp.array([a, b])), expected)


def test_a_second_number_of_points_is_no_length():
    with pytest.raises(ValueError, match=r"Grid\(32, 32\) would have sides .* Grid\(\(32, 32\)\)"):
        js.Grid(32, 32)
    for grid in (js.Grid(32, 32.0), js.Grid((32, 32), 32), js.Grid(32, (32, 32))):
        np.testing.assert_array_equal(grid.lengths, [32, 32])

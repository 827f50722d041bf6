"""Properties of grids and of units, for numbers that Hypothesis chooses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

import jaxstab as js
from jaxstab.core.grid import mean_over, resample, total
from jaxstab.core.units import (
    LENGTHS,
    PRESSURES,
    Units,
    convert_lengths,
    readable_unit,
    unit_of,
    unit_symbol,
)

# Few, since each is compiled for.
SHAPES = [(9,), (6, 8), (7, 4)]
POWERS = {"": 0, "k": 3, "M": 6, "G": 9, "T": 12, "m": -3, "µ": -6, "n": -9, "p": -12, "f": -15}
POWERS["a"] = -18
sizes = st.floats(1e-9, 1e9)


@st.composite
def fields(draw, shape=None):
    shape = draw(st.sampled_from(SHAPES)) if shape is None else shape
    return np.random.default_rng(draw(st.integers(0, 2**32))).normal(size=shape)


@given(fields(), st.lists(sizes, min_size=2, max_size=2))
def test_the_spectrum_of_a_field(field, lengths):
    grid = js.Grid(field.shape, lengths[: field.ndim])
    modes = np.asarray(grid.transform(field))
    np.testing.assert_allclose(grid.inverse_transform(modes), field, atol=1e-12)
    energy = np.sum(np.asarray(grid.mode_multiplicity) * np.abs(modes) ** 2) / grid.size
    assert energy == pytest.approx(np.sum(field**2))
    sides = zip(field.shape, lengths, strict=False)
    waves = [2 * np.pi * np.fft.fftfreq(n, side / n) for n, side in sides]
    waves = np.meshgrid(*waves, indexing="ij")
    norm = np.sqrt(sum(k**2 for k in waves))[..., : modes.shape[-1]]
    np.testing.assert_allclose(grid.wavenumbers, norm, rtol=1e-12)


@given(fields(), st.data())
def test_sums_and_means(field, data):
    mask = data.draw(st.integers(0, 2**32).map(lambda seed: _mask(seed, field.shape)))
    assert total(field) == pytest.approx(field.sum(), abs=1e-12)
    expected = field[mask].mean() if mask.any() else 0
    assert mean_over(jnp.asarray(mask), field) == pytest.approx(expected, abs=1e-12)


def _mask(seed, shape):
    random = np.random.default_rng(seed)
    return random.random(shape) < random.choice([0.0, 0.2, 0.8, 1.0])


@given(fields(), st.sampled_from([(12, 12), (5, 6), (4, 11)]))
def test_resampling(field, shape):
    expected, shape = field, shape[: field.ndim]
    for axis, n in enumerate(shape):
        expected = scipy.signal.resample(expected, n, axis=axis)
    # One program for each pair of shapes.
    found = jax.jit(resample, static_argnums=1)(field, shape)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@given(st.floats(-1e6, 1e6), st.sampled_from([*LENGTHS]), st.sampled_from([*LENGTHS]))
def test_a_length_in_another_unit_and_back(value, unit, other):
    there = convert_lengths(np.float64(value), unit, other)
    assert there == pytest.approx(value * 10.0 ** (LENGTHS[unit] - LENGTHS[other]), rel=1e-15)
    assert convert_lengths(there, other, unit) == pytest.approx(value, rel=1e-15)
    assert unit_of(unit) == unit


def _in_si(unit):
    """Return the value of a unit symbol of energies, forces or energies per area in SI."""
    power, _, symbol = unit.rpartition(" ")
    scale = 10.0 ** int(power[2:]) if power else 1.0
    prefix = symbol.partition("/")[0][:-1]
    return scale * 10.0 ** POWERS[prefix]


@given(
    st.sampled_from([*LENGTHS]),
    st.sampled_from([*PRESSURES]),
    st.sampled_from([("energy", 3), ("force", 2), ("energy/area", 1)]),
    st.floats(1e-12, 1e12),
)
def test_units_of_energies_and_forces_follow_from_length_and_pressure(
    length, pressure, dimension, largest
):
    name, power = dimension
    units = Units.of_names(length, pressure)
    expected = 10.0 ** (PRESSURES[pressure] + power * LENGTHS[length])
    assert _in_si(unit_symbol(units, name)) == pytest.approx(expected)
    divisor, unit = readable_unit(units, name, largest)
    assert divisor * expected == pytest.approx(_in_si(unit))
    in_prefixes = 1e-18 <= largest * expected < 1e15
    assert 1 - 1e-6 <= largest / divisor < 1000 or not in_prefixes

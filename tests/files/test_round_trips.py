"""Surfaces and results that come back from a file, for numbers that Hypothesis chooses."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from saved import assert_same_bits

import jaxstab as js

SHAPE = (4, 6)
numbers = st.floats(1e-6, 1e6)
units = st.sampled_from([None, "nm", "µm", "mm", "m"])


@st.composite
def maps(draw):
    values = st.floats(-1e9, 1e9, allow_subnormal=False) | st.just(np.nan)
    size = SHAPE[0] * SHAPE[1]
    heights = np.array(draw(st.lists(values, min_size=size, max_size=size))).reshape(SHAPE)
    return np.where(np.isnan(heights).all(), 0.0, heights)


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.SurfaceWarning")
@settings(max_examples=5)
@given(maps(), st.tuples(numbers, numbers), units)
def test_a_surface_in_an_array_or_as_text(heights, lengths, unit):
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "surface"
        unit_of = {} if unit is None else {"unit": unit}
        np.savez(file, heights=heights, lengths=lengths, **unit_of)
        found = js.surfaces.read(f"{file}.npz")
        np.testing.assert_array_equal(found.heights, heights)
        np.testing.assert_array_equal(found.lengths, lengths)
        assert found.unit == unit
        np.savetxt(file, heights)
        found = js.surfaces.read(file, lengths, unit)
        np.testing.assert_array_equal(found.heights, heights)


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.SurfaceWarning")
@settings(max_examples=5)
@given(maps(), st.permutations(range(24)), st.tuples(*[st.floats(1e-3, 1e3)] * 2))
def test_points_in_any_order(heights, order, spacing):
    sides = [dx * np.arange(n) for dx, n in zip(spacing, SHAPE, strict=True)]
    x, y = np.meshgrid(*sides, indexing="ij")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "points.xyz"
        np.savetxt(file, np.stack([x, y, heights], -1).reshape(-1, 3)[order])
        found = js.surfaces.read(file)
    np.testing.assert_array_equal(found.heights, heights)
    np.testing.assert_allclose(found.lengths, np.array(spacing) * SHAPE, rtol=1e-12)


@pytest.mark.nightly
@settings(max_examples=5)
@given(*[st.floats(1e-3, 1e3)] * 3, st.floats(-0.9, 0.5), st.integers(0, 2**32))
def test_a_contact_and_its_state(work, length, modulus, ratio, seed):
    random = np.random.default_rng(seed)
    solid = js.HalfSpace(js.Grid(SHAPE, random.uniform(0.5, 2, 2)), modulus, ratio)
    law = js.potentials.Exponential(work, length)
    contact = js.Contact(solid, random.normal(size=SHAPE), law)
    state = js.equilibrate(contact, js.MeanGap(1.0), throw=False)
    with tempfile.TemporaryDirectory() as folder:
        js.save(f"{folder}/state.nc", contact, state)
        saved, found = js.load(f"{folder}/state.nc")
    assert_same_bits(saved, contact)
    assert_same_bits(found, state)

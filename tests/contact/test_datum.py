"""Nothing depends on a constant in the heights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js

LAW = js.potentials.Exponential(0.06, 0.06)
LOADS = {
    "gap": lambda offset: js.MeanGap(0.1),
    "displacement": lambda offset: js.MeanDisplacement(0.1 + offset),
    "pressure": lambda offset: js.MeanPressure(-0.1),
    "spring": lambda offset: js.Spring(0.1 + offset, 3.0),
}


def heights_of(kind=js.Grid):
    return np.asarray(
        js.surfaces.self_affine(kind(32), jax.random.key(3), k_high=4, rms_height=0.05)
    )


def state(heights, load, solid=js.HalfSpace):
    contact = js.Contact(solid(js.Grid(32), 1.0), heights, LAW)
    return js.equilibrate(contact, load)


@pytest.mark.nightly
def test_an_offset_costs_no_digits_in_single_precision():
    multiple = 2e8
    # Given in double precision, which JAX casts to single precision.
    heights = heights_of()
    with jax.enable_x64(False):
        level, offset = (
            state(heights, js.MeanGap(0.1)),
            state(heights + 0.05 * multiple, js.MeanGap(0.1)),
        )
        assert offset.gap.dtype == jnp.float32
        np.testing.assert_allclose(offset.mean_pressure, level.mean_pressure, rtol=1e-5)
        np.testing.assert_allclose(offset.gap, level.gap, atol=1e-5)
        # To the precision that displacements of this size have.
        moved = level.displacement + 0.05 * multiple
        np.testing.assert_allclose(offset.displacement, moved, rtol=2e-7)
    expected = state(heights, js.MeanGap(0.1)).mean_pressure
    np.testing.assert_allclose(offset.mean_pressure, expected, rtol=2e-5)


@pytest.mark.parametrize("load", LOADS)
def test_an_offset_moves_displacements_and_positions_alone(load):
    heights, offset = heights_of(), 1e4
    level, moved = state(heights, LOADS[load](0)), state(heights + offset, LOADS[load](offset))
    np.testing.assert_allclose(moved.mean_pressure, level.mean_pressure, rtol=1e-9)
    np.testing.assert_allclose(moved.gap, level.gap, atol=1e-10)
    np.testing.assert_allclose(moved.displacement - offset, level.displacement, atol=1e-10)
    np.testing.assert_allclose(moved.energy, level.energy, rtol=1e-9)


def test_under_jit_and_vmap_an_offset_is_taken_off_as_precision_allows():
    heights, offsets = heights_of(), jnp.array([0.0, 1e4])

    def pressure(offset):
        contact = js.Contact(js.HalfSpace(js.Grid(32), 1.0), heights + offset, LAW)
        found = js.equilibrate(contact, js.MeanDisplacement(0.1 + offset), throw=False)
        return found.mean_pressure, contact.datum, found.displacement - offset

    found, datum, displacement = jax.vmap(jax.jit(pressure))(offsets)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)
    np.testing.assert_allclose(datum, [0, heights[0, 0] + 1e4])
    np.testing.assert_allclose(displacement[1], displacement[0], atol=1e-10)


@pytest.mark.parametrize(
    "load",
    ["displacement", *(pytest.param(x, marks=pytest.mark.nightly) for x in ("gap", "spring"))],
)
def test_derivatives_know_nothing_of_an_offset(load):
    heights, offset = heights_of(), 1e4
    direction = np.cos(2 * np.pi * np.arange(32) / 32)[:, None] * np.ones(32) + 1

    def energy(step, offset):
        load_at = LOADS[load](offset)
        contact = js.Contact(
            js.HalfSpace(js.Grid(32), 1.0), heights + offset + step * direction, LAW
        )
        found = js.equilibrate(contact, load_at)
        return jnp.stack([found.energy, found.mean_pressure, found.displacement[3, 5]])

    level, moved = (jax.jacfwd(energy)(0.0, offset) for offset in (0.0, 1e4))
    np.testing.assert_allclose(moved, level, rtol=1e-6, atol=1e-9)
    differences = (energy(1e-5, offset) - energy(-1e-5, offset)) / 2e-5
    np.testing.assert_allclose(moved, differences, rtol=1e-3, atol=1e-6)


@pytest.mark.nightly
def test_windows_flat_surfaces_paths_and_files_keep_an_offset(tmp_path):
    window, offset = js.Grid(16, 8.0), 1e5
    tip = np.asarray(js.surfaces.paraboloid(window, 4.0))
    found = []
    for level in (0.0, offset):
        contact = js.Contact(js.FreeHalfSpace(window, 1.0), tip + level, LAW)
        loads = js.FarDisplacement(level + jnp.array([0.3, -0.1]))
        sweep = js.sweep(contact, loads, order="continuation")
        found.append(sweep.equilibrium)
        stability = js.assess_stability(contact, sweep.equilibrium[1])
        found[-1] = (*jax.tree.leaves(found[-1].mean_pressure), stability.cone.eigenvalue)
        path = js.save(tmp_path / f"{level}.nc", contact, sweep.equilibrium[1])
        again, state = js.load(path)
        np.testing.assert_array_equal(again.datum, contact.datum)
        np.testing.assert_array_equal(again.heights, contact.heights)
        np.testing.assert_array_equal(state.displacement, sweep.equilibrium[1].displacement)
    for level, moved in zip(*found, strict=True):
        np.testing.assert_allclose(moved, level, rtol=1e-7)
    flat = js.Contact(js.HalfSpace(js.Grid(8), 1.0), np.full((8, 8), 1e8), LAW)
    state = js.equilibrate(flat, js.MeanDisplacement(1e8 + 0.25))
    np.testing.assert_allclose(state.gap, 0.25, rtol=1e-7)


def test_usual_heights_stay_as_they_are():
    heights = heights_of()
    for given in (heights, heights + 0.5, jnp.asarray(heights), heights.astype(np.float32)):
        contact = js.Contact(js.HalfSpace(js.Grid(32), 1.0), given, LAW)
        assert contact.datum == 0
        np.testing.assert_array_equal(contact.heights, given)
    far = js.Contact(js.HalfSpace(js.Grid(32), 1.0), heights + 100.0, LAW)
    axes = js.plots.surface(far)
    above = axes.images[0].get_array().mean()
    np.testing.assert_allclose(above + float(far.datum), 100 + heights.mean(), atol=1e-6)
    assert f"above {float(far.datum):.6g}" in axes.images[0].colorbar.ax.get_ylabel()


@pytest.mark.parametrize("datum", [1.0, -3.0, 1e4])
@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray])
def test_heights_far_from_zero_are_kept_relative_to_their_first(datum, kind):
    waves = 1e-3 * np.outer(np.sin(np.arange(8)), np.ones(8))
    contact = js.Contact(js.HalfSpace(js.Grid(8), 1.0), kind(datum + waves), LAW)
    assert contact.datum == datum
    np.testing.assert_allclose(contact.heights, waves, atol=4e-16 * abs(datum))

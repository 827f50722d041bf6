"""Leakage: plates, waves, a dense network, symmetry and balance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import state_of

import jaxstab as js

SOLVERS = ["direct", "multigrid"]


def state_with(gap, lengths=1.0, dtype=jnp.float64):
    gap = jnp.asarray(gap, dtype)
    grid = js.Grid(gap.shape, lengths)
    potential = js.potentials.NoAdhesion()
    return state_of(js.Contact(js.HalfSpace(grid, 2.0), jnp.zeros_like(gap), potential), gap)


def leaking(gap, lengths=1.0, dtype=jnp.float64, **options):
    return js.leakage(*state_with(gap, lengths, dtype), **options)


def wave(depth, shape=(32, 20)):
    gap = 1 + (1 - depth) * np.cos(2 * np.pi * np.arange(shape[0]) / shape[0])
    return gap[:, None] * np.ones(shape)


def rough(share, shape=(24, 18), seed=0):
    """Return a smooth gap that is closed at a share of its points."""
    x, y = np.meshgrid(*(2 * np.pi * np.arange(n) / n for n in shape), indexing="ij")
    random = np.random.default_rng(seed)
    field = np.zeros(shape)
    for k in range(-3, 4):
        for m in range(4):
            field += random.normal() * np.cos(k * x + m * y + random.uniform(0, 7))
    return np.maximum(field - np.quantile(field, share), 0)


def outflow(found, spacing):
    flux = np.asarray(found.flux)
    parts = [flux[:, i] - np.roll(flux[:, i], 1, 1 + i) for i in range(len(spacing))]
    return sum(part / step for part, step in zip(parts, spacing, strict=True))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_parallel_plates(dtype):
    found = leaking(np.full((6, 8), 0.3), (1.0, 3.0), dtype, viscosity=2.0)
    assert found.permeability.dtype == dtype
    rtol = {jnp.float32: 1e-6, jnp.float64: 1e-13}[dtype]
    np.testing.assert_allclose(found.permeability, 0.3**3 / 12 * np.eye(2), rtol=rtol, atol=1e-12)
    np.testing.assert_allclose(found.rate([3.0, 1.0]), 0.3**3 / 24 * np.array([3, 1]), rtol=1e-6)
    np.testing.assert_allclose(found.drop[0], np.arange(6)[:, None] / 6 * np.ones(8), atol=1e-6)
    np.testing.assert_allclose(found.drop[1], np.arange(8) * 3 / 8 * np.ones((6, 1)), atol=1e-6)


def test_a_rate_has_a_derivative_with_respect_to_the_drop_of_pressure():
    found = leaking(np.full((6, 8), 0.3), viscosity=2.0)
    slope = jax.jit(jax.jacobian(found.rate))(jnp.array([3.0, 1.0]))
    np.testing.assert_allclose(slope, 0.3**3 / 24 * np.eye(2), atol=1e-12)


def test_a_rate_along_a_path_is_that_of_each_state():
    contact, state = state_with(rough(0.2))
    one = js.leakage(contact, state, viscosity=2.0)
    several = jax.tree.map(lambda x: jnp.stack([x, 2 * x, 4 * x]), one)
    np.testing.assert_allclose(
        several.rate([3.0, 1.0]), np.tile(one.permeability @ np.array([3, 1]) / 2, (3, 1))
    )


@pytest.mark.parametrize("drop", [1.0, [1.0], [1.0, 0.0, 0.0]])
def test_a_rate_of_other_than_one_drop_for_each_side_is_refused(drop):
    with pytest.raises(ValueError, match=r"has shape \(.*give one for each of the 2 sides, as in"):
        leaking(np.full((6, 8), 0.3)).rate(drop)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("depth", [0.5, 1e-2, 1e-4, 1e-5])
def test_across_and_along_a_wave_up_to_contrasts_of_1e15(depth, solver):
    gap = wave(depth)
    found = leaking(gap, (1.0, 2.0), solver=solver)
    exact = np.diag([1 / np.mean(gap**-3), np.mean(gap**3)]) / 12
    np.testing.assert_allclose(found.permeability, exact, rtol=1e-9, atol=1e-14)
    turned = leaking(gap.T, (2.0, 1.0), solver=solver)
    np.testing.assert_allclose(turned.permeability, exact[::-1, ::-1], rtol=1e-9, atol=1e-14)


def network_permeability(gap, lengths):
    """Return the permeability by the least dissipation, by dense algebra."""
    n, m = gap.shape
    dx, dy = lengths[0] / n, lengths[1] / m
    k = gap**3 / 12
    cells = np.arange(n * m).reshape(n, m)
    rows, weights, drops = [], [], []
    for side, step in enumerate((dx, dy)):
        other = np.roll(cells, -1, side)
        with np.errstate(divide="ignore", invalid="ignore"):
            face = np.nan_to_num(2 / (1 / k + 1 / np.roll(k, -1, side)))
        row = np.zeros((n * m, n * m))
        row[cells.ravel(), other.ravel()] += 1 / step
        row[cells.ravel(), cells.ravel()] -= 1 / step
        rows.append(row)
        weights.append(face.ravel())
        drops.append(np.repeat(np.eye(2)[side][None], n * m, axis=0))
    gradient, weight, drop = np.concatenate(rows), np.concatenate(weights), np.concatenate(drops)
    root = np.sqrt(weight)[:, None]
    moved = np.linalg.lstsq(root * gradient, -root * drop, rcond=1e-12)[0]
    total = root * (gradient @ moved + drop)
    return total.T @ total / (n * m)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("share", [0.0, 0.2, 0.3])
def test_the_tensor_is_that_of_the_least_dissipation(share, solver):
    gap, lengths = rough(share), (1.0, 1.5)
    found = leaking(gap, lengths, solver=solver)
    exact = network_permeability(gap, lengths)
    np.testing.assert_allclose(found.permeability, exact, rtol=1e-7, atol=1e-9 * exact.max())
    means = np.asarray(found.flux).mean(axis=(2, 3)).T
    np.testing.assert_allclose(means, means.T, rtol=1e-8, atol=1e-12 * exact.max())


def test_fluxes_balance_and_follow_the_drops():
    gap = rough(0.3)
    found = leaking(gap)
    size = np.abs(found.flux).max()
    assert np.abs(outflow(found, (1, 24 / 18))).max() <= 1e-9 * size
    assert not np.asarray(found.flux)[:, 0][:, gap == 0].any()
    assert np.isnan(found.drop)[:, gap == 0].all()
    # Over an inner face, by hand.
    i, j = np.unravel_index(np.argmax(gap[:-1]), gap[:-1].shape)
    mean = 2 / (gap[i, j] ** -3 + gap[i + 1, j] ** -3) / 12
    drop = found.drop[0, i + 1, j] - found.drop[0, i, j]
    np.testing.assert_allclose(found.flux[0, 0, i, j], mean * drop * gap.shape[0], rtol=1e-8)


def test_what_is_blocked_is_exactly_tight():
    gap = np.ones((8, 8))
    gap[3] = 0
    found = leaking(gap)
    assert found.permeability[0, 0] == found.permeability[0, 1] == found.permeability[1, 0] == 0
    np.testing.assert_allclose(found.permeability[1, 1], 7 / 8 / 12)
    gap[:, 5] = 0
    found = leaking(gap)
    assert not found.permeability.any()
    assert not found.flux.any()
    assert not leaking(np.zeros((4, 4))).permeability.any()


def test_cells_that_meet_at_corners_alone_leak_nothing():
    found = leaking(0.3 * np.eye(6))
    np.testing.assert_array_equal(found.permeability, np.zeros((2, 2)))
    np.testing.assert_array_equal(found.flux, 0)


def test_a_diagonal_channel_leaks_along_itself():
    gap = np.eye(6) + np.roll(np.eye(6), 1, axis=1)
    found = leaking(gap)
    value = found.permeability[0, 0]
    assert value > 0
    np.testing.assert_allclose(found.permeability, value * np.ones((2, 2)), rtol=1e-10)


def test_on_a_line_it_is_the_harmonic_mean():
    gap = np.array([1.0, 2.0, 0.5, 3.0])
    np.testing.assert_allclose(leaking(gap).permeability, [[1 / np.mean(12 / gap**3)]], rtol=1e-12)
    assert leaking(np.array([1.0, 0.0, 2.0])).permeability == 0


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_any_unit_of_length_gives_the_same(dtype):
    gap = rough(0.2)
    one, small = leaking(gap, 1.0, dtype), leaking(1e-9 * gap, 1e-6, dtype)
    rtol = {jnp.float32: 1e-5, jnp.float64: 1e-9}[dtype]
    np.testing.assert_allclose(small.permeability, 1e-27 * one.permeability, rtol=rtol)


def test_what_cannot_be_done_is_said():
    contact, state = state_with(wave(0.5))
    for options, sentence in [
        ({"viscosity": 0.0}, r"viscosity is 0\.0: it must be positive"),
        ({"solver": "fast"}, r"solver is \'fast\': choose one of direct, multigrid"),
    ]:
        with pytest.raises(ValueError, match=sentence):
            js.leakage(contact, state, **options)
    with pytest.raises(TypeError, match=r"leakage works on known numbers"):
        jax.jit(lambda state: js.leakage(contact, state).permeability)(state)
    window = js.Contact(
        js.FreeHalfSpace(contact.grid, 1.0), contact.heights, js.potentials.NoAdhesion()
    )
    with pytest.raises(ValueError, match="a window that does not repeat"):
        js.leakage(window, state)
    # Gaps that differ by twenty orders, of which double precision has sixteen.
    gap = 10.0 ** (-20 * np.random.default_rng(0).random((8, 8)))
    with pytest.raises(
        js.exceptions.SolverError, match=r"fluxes balance to .* of the largest only"
    ):
        leaking(gap)

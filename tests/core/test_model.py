"""The model on a page, against dense matrices and bisection."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.core import model

SHAPE, LENGTHS, E = (6, 5), (1.5, 1.0), 2.0


def law(gap):
    return -0.3 * jnp.exp(-gap / 0.4)


def slope(gap):
    return 0.75 * jnp.exp(-gap / 0.4)


def curvature(gap):
    return -1.875 * jnp.exp(-gap / 0.4)


@pytest.fixture
def fields():
    rng = np.random.default_rng(0)
    heights, gap = rng.normal(size=SHAPE), np.maximum(rng.normal(size=SHAPE), 0)
    return jnp.asarray(heights), jnp.asarray(gap)


def dense():
    """Return K as a matrix, each entry summed over all waves."""
    n, m = SHAPE
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    matrix = np.zeros((n * m, n * m))
    for k in np.fft.fftfreq(n, 1 / n):
        for l in np.fft.fftfreq(m, 1 / m):
            q = 2 * np.pi * np.hypot(k / LENGTHS[0], l / LENGTHS[1])
            wave = np.exp(2j * np.pi * (k * i / n + l * j / m)).ravel()
            matrix += E * q / 2 * np.real(np.outer(wave, wave.conj())) / (n * m)
    return matrix


def operator():
    grid = js.Grid(SHAPE, LENGTHS)
    stiffness = E * grid.wavenumbers / 2
    return grid, stiffness, lambda u: model.filtered(grid, stiffness, u)


def test_k_is_the_dense_matrix_and_w_its_inverse(fields):
    u = fields[0]
    grid, stiffness, K = operator()
    p = K(u)
    np.testing.assert_allclose(np.ravel(p), dense() @ np.ravel(u), atol=1e-12)
    back = model.filtered(grid, model.compliance(stiffness), p)
    np.testing.assert_allclose(back, u - u.mean(), atol=1e-12)


def test_energy_gradient_and_hessian_are_those_of_matrices(fields):
    heights, gap = fields
    K, u = dense(), np.ravel(gap + heights)
    E_p = float(u @ K @ u / 2 + np.sum(law(gap)))
    apply = operator()[2]
    assert float(model.energy(apply, law, heights, gap)) == pytest.approx(E_p, rel=1e-13)
    net = K @ u + np.ravel(slope(gap))
    np.testing.assert_allclose(
        np.ravel(model.gradient(apply, slope, heights, gap)), net, atol=1e-12
    )
    A = K + np.diag(np.ravel(curvature(gap)))
    x = np.linspace(-1, 2, gap.size)
    product = model.hessian(apply, curvature(gap), jnp.asarray(x.reshape(SHAPE)))
    np.testing.assert_allclose(np.ravel(product), A @ x, atol=1e-12)
    derivative = jax.grad(lambda gap: model.energy(apply, law, heights, gap))(gap)
    np.testing.assert_allclose(np.ravel(derivative), net, atol=1e-12)


def test_optimality_tells_tension_in_contact_from_pressure():
    net, gap = jnp.array([2.0, -3.0, 0.5, 0.0]), jnp.array([0.0, 0.0, 1.0, 2.0])
    assert model.imbalance(net, gap).tolist() == [0, -3, 0.5, 0]
    assert model.reaction(net, gap).tolist() == [2, -3, 0, 0]
    assert float(model.held_mean_pressure(net, gap)) == -0.25


def test_projections_meet_their_conditions(fields):
    field, gap = fields
    assert float(jnp.mean(model.onto_load(gap, 0.7))) == pytest.approx(0.7, rel=1e-14)
    everywhere = jnp.ones(SHAPE, bool)
    np.testing.assert_allclose(
        model.onto_space(field, everywhere), field - field.mean(), atol=1e-14
    )
    assert float(jnp.linalg.norm(model.onto_sphere(field).ravel())) == pytest.approx(1, rel=1e-14)
    contact = gap == 0
    # x - s, cut in contact, with the shift of zero mean by bisection.
    low, high = -10.0, 10.0
    for _ in range(100):
        shift = (low + high) / 2
        cut = np.where(contact, np.maximum(field - shift, 0), field - shift)
        low, high = (shift, high) if cut.sum() > 0 else (low, shift)
    np.testing.assert_allclose(model.onto_cone(field, contact, everywhere), cut, atol=1e-12)

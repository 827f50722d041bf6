"""MINRES against dense algebra, on systems that are symmetric and indefinite."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstab.core.linear_system import LinearSystem
from jaxstab.equilibrium.solvers.minres import minres


def indefinite(size, seed):
    """Return a matrix with eigenvalues from -3 to 40, and a positive one that is roughly |A|^-1."""
    random = np.random.default_rng(seed)
    vectors = np.linalg.qr(random.normal(size=(size, size)))[0]
    values = np.append(np.linspace(-3, -1, size // 6), np.linspace(0.5, 40, size - size // 6))
    rough = 1 / (np.abs(values) + random.uniform(size=size))
    return vectors * values @ vectors.T, vectors * rough @ vectors.T, random.normal(size=size)


def without_mean(field):
    return field - field.mean()


def found(matrix, rough, right, accuracy=1e-12, max_steps=200):
    system = LinearSystem(lambda x: matrix @ x, lambda x: rough @ x, without_mean)
    return minres(system, right, accuracy, max_steps)


def exact(matrix, right):
    """Return the solution among vectors of zero mean."""
    space = np.linalg.svd(np.ones((1, len(right))))[2][1:].T
    return space @ np.linalg.solve(space.T @ matrix @ space, space.T @ right)


@pytest.mark.parametrize("size", [12, 60])
def test_it_solves_indefinite_systems_on_a_subspace(size):
    matrix, rough, right = indefinite(size, 0)
    solution = found(matrix, rough, right)
    np.testing.assert_allclose(solution, exact(matrix, right), rtol=1e-8, atol=1e-9)


def test_it_stops_at_the_accuracy_in_the_metric_of_the_preconditioner():
    matrix, rough, right = indefinite(40, 1)

    def size(vector):
        vector = without_mean(vector)
        return np.sqrt(vector @ rough @ vector)

    for accuracy in (3e-1, 1e-2, 1e-4):
        left = size(right - matrix @ np.asarray(found(matrix, rough, right, accuracy)))
        assert accuracy / 100 < left / size(right) <= accuracy * (1 + 1e-6)


def test_the_residual_falls_as_far_as_it_can_with_every_step():
    matrix, _, right = indefinite(24, 2)
    right, identity = without_mean(right), np.eye(24)
    projected = identity - np.full((24, 24), 1 / 24)
    operator, powers = projected @ matrix @ projected, [right]
    for steps in range(1, 8):
        space = operator @ np.linalg.qr(np.stack(powers, 1))[0]
        best = right - space @ np.linalg.lstsq(space, right, rcond=None)[0]
        left = right - operator @ np.asarray(found(matrix, identity, right, 0.0, steps))
        np.testing.assert_allclose(np.linalg.norm(left), np.linalg.norm(best), rtol=1e-8)
        powers.append(operator @ powers[-1] / np.linalg.norm(powers[-1]))


def test_systems_are_solved_side_by_side_and_in_single_precision():
    systems = [indefinite(12, seed) for seed in range(3)]
    parts = [np.stack(part).astype(np.float32) for part in zip(*systems, strict=True)]
    solutions = jax.jit(jax.vmap(lambda *system: found(*system, accuracy=1e-5)))(*parts)
    assert solutions.dtype == jnp.float32
    for solution, (matrix, _, right) in zip(solutions, systems, strict=True):
        np.testing.assert_allclose(solution, exact(matrix, right), rtol=1e-2, atol=1e-3)


def test_a_zero_right_hand_side_has_the_solution_zero():
    matrix, rough, _ = indefinite(12, 0)
    np.testing.assert_array_equal(found(matrix, rough, jnp.zeros(12)), 0)

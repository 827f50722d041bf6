"""The solver of linear equations whose operator is neither symmetric nor positive."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxstab.core.gmres import gmres


def system(size, seed):
    random = np.random.default_rng(seed)
    values = np.linspace(-4, 10, size)
    diagonal = np.diag(values + np.copysign(1, values))
    matrix = diagonal + random.normal(size=(size, size)) / 20
    return matrix, random.normal(size=size)


def solved(matrix, right, accuracy, max_restarts=50):
    """Return the solution of a system, its last entry apart from the others."""
    size = len(right)

    def operator(parts):
        product = jnp.asarray(matrix) @ jnp.append(parts[0], parts[1])
        return product[:-1], product[-1]

    residual = accuracy * jnp.linalg.norm(right)
    found = gmres(operator, (right[:-1], right[-1]), residual, max_restarts)
    return jnp.append(found[0], found[1]).reshape(size)


# More unknowns than the 30 vectors of one cycle, and fewer.
@pytest.mark.parametrize("size", [12, 45])
def test_it_solves_indefinite_systems(size):
    matrix, right = system(size, 0)
    found = solved(matrix, jnp.asarray(right), 1e-10, 500)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-6, atol=1e-8)


def test_it_stops_at_the_accuracy_that_is_asked():
    matrix, right = system(25, 1)
    for accuracy in (3e-1, 1e-1, 1e-2):
        found = solved(matrix, jnp.asarray(right), accuracy)
        left = np.linalg.norm(right - matrix @ found) / np.linalg.norm(right)
        assert accuracy / 100 < left <= accuracy


def test_systems_are_solved_side_by_side_and_in_single_precision():
    systems = [system(12, seed) for seed in range(3)]
    matrices, rights = (np.stack(parts).astype(np.float32) for parts in zip(*systems, strict=True))
    found = jax.jit(jax.vmap(lambda m, r: solved(m, r, 1e-5)))(matrices, rights)
    assert found.dtype == jnp.float32
    exact = np.linalg.solve(matrices, rights[..., None])[..., 0]
    np.testing.assert_allclose(found, exact, rtol=1e-2, atol=1e-3)


def test_nothing_is_the_solution_for_nothing():
    matrix, _ = system(12, 0)
    np.testing.assert_array_equal(solved(matrix, jnp.zeros(12), 1e-6), 0)

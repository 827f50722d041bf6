"""Eigenvalues by dense algebra, and the conditions of equilibrium looked at one by one."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np


def check_optimality(contact, equilibrium, tolerance):
    """Assert equations 9 and 10 field by field, on the equilibrium that is returned."""
    pressure, reaction, gap = (
        np.asarray(x) for x in (equilibrium.pressure, equilibrium.reaction, equilibrium.gap)
    )
    attraction = np.asarray(jnp.vectorize(jax.grad(contact.potential))(equilibrium.gap))
    scale = np.sqrt(np.mean(pressure**2 + attraction**2))
    error = np.sqrt(np.mean((pressure + attraction - reaction) ** 2))
    assert error <= tolerance * scale
    assert gap.min() >= 0
    assert reaction.min() >= -tolerance * scale * np.sqrt(gap.size)
    assert not (reaction * gap).any()
    assert not reaction[~np.asarray(equilibrium.in_contact)].any()
    np.testing.assert_allclose(pressure.mean(), equilibrium.mean_pressure, rtol=1e-6)
    np.testing.assert_allclose((reaction - attraction).mean(), equilibrium.mean_pressure)
    elastic = np.asarray(contact.solid.pressure(equilibrium.displacement))
    np.testing.assert_allclose(pressure - pressure.mean(), elastic, atol=1e-6 * scale)


def periodic_stiffness(shape, lengths, modulus):
    """Return K of a half space as a matrix, from its symbol and NumPy's transforms."""
    waves = [2 * np.pi * np.fft.fftfreq(n, 1 / n) / a for n, a in zip(shape, lengths, strict=True)]
    symbol = modulus / 2 * np.sqrt(sum(np.square(q) for q in np.meshgrid(*waves, indexing="ij")))
    return matrix_of(lambda x: np.fft.ifftn(symbol * np.fft.fftn(x)).real, shape)


def matrix_of(operator, shape):
    """Return a linear operator on fields as a matrix."""
    units = np.eye(int(np.prod(shape))).reshape(-1, *shape)
    matrix = np.stack([np.asarray(operator(unit)).ravel() for unit in units], axis=1)
    return (matrix + matrix.T) / 2


def dense_hessian(contact, gap):
    n = gap.size
    columns = jax.vmap(contact.hessian(gap))(jnp.eye(n).reshape(n, *gap.shape))
    return np.asarray(columns).reshape(n, n)


@cache
def zero_mean_basis(size):
    """Return orthonormal vectors of zero mean, as rows."""
    return np.linalg.svd(np.ones((1, size)))[2][1:]


def on_zero_mean(matrix):
    """Return the eigenvalues on the space of zero mean, in ascending order, by dense algebra."""
    basis = zero_mean_basis(len(matrix))
    return np.linalg.eigvalsh(basis @ matrix @ basis.T)


def smallest_on_zero_mean(matrix):
    """Return the smallest eigenvalue on the space of zero mean, by dense algebra."""
    return on_zero_mean(matrix).min(initial=np.inf)


def smallest_on_critical_cone(contact, equilibrium):
    """Return the smallest eigenvalue where contact points stay and the rest keeps its mean."""
    free = ~np.asarray(equilibrium.in_contact).ravel()
    return smallest_on_zero_mean(dense_hessian(contact, equilibrium.gap)[np.ix_(free, free)])


def smallest_on_cone(matrix, touching):
    """Return the smallest eigenvalue on V0+ by looking at each of its faces.

    From the largest face down: on a part of a face no eigenvalue is smaller than on all of it.
    """
    free, smallest = np.flatnonzero(~touching), np.inf
    faces = {tuple(np.flatnonzero(touching))}
    while faces:
        parts = set()
        for lifting in faces:
            face = np.concatenate([free, np.array(lifting, int)])
            if len(face) < 2:
                continue
            basis = zero_mean_basis(len(face))
            values, vectors = np.linalg.eigh(basis @ matrix[np.ix_(face, face)] @ basis.T)
            for value, vector in zip(values, vectors.T @ basis, strict=True):
                if value >= smallest:
                    break
                lifts = vector[len(free) :]
                if (lifts > -1e-12).all() or (lifts < 1e-12).all():
                    smallest = value
            if values[0] < smallest:
                parts |= {lifting[:i] + lifting[i + 1 :] for i in range(len(lifting))}
        faces = parts
    return smallest

"""The exact minimum of a Rayleigh quotient on a cone, by dense algebra on all of its faces."""

from functools import cache
from itertools import combinations

import numpy as np


def smallest_on_cone(
    matrix: np.ndarray, one_sided: np.ndarray, held: np.ndarray, fixes_mean: bool
) -> float:
    """Return the smallest Rayleigh quotient on a cone, by going through its faces.

    It is attained at an eigenvector of a face. Every eigenvector is brought onto the cone before
    it counts, so that none needs to be called admissible. Faces without an eigenvalue below the
    best so far are left out, with all faces of theirs.
    """
    free, sided = np.flatnonzero(~held & ~one_sided), np.flatnonzero(one_sided)
    best, excluded = np.inf, []
    for num_lifting in range(len(sided), -1, -1):
        for lifting in map(frozenset, combinations(sided, num_lifting)):
            if any(lifting <= face for face in excluded):
                continue
            points = np.concatenate([free, sorted(lifting)]).astype(int)
            values, vectors = eigenpairs_on(matrix, points, fixes_mean)
            for vector in vectors.T[values < best]:
                best = min(
                    best,
                    *(quotient(matrix, one_sided, free, fixes_mean, s * vector) for s in (1, -1)),
                )
            if values.min(initial=np.inf) >= best:
                excluded.append(lifting)
    return best


def eigenpairs_on(
    matrix: np.ndarray, points: np.ndarray, fixes_mean: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return eigenvalues and vectors on the fields of some points, with zero mean or without."""
    basis = np.eye(len(matrix))[:, points]
    if fixes_mean:
        basis = basis @ complement_of_ones(len(points))
    values, vectors = np.linalg.eigh(basis.T @ matrix @ basis)
    return values, basis @ vectors


@cache
def complement_of_ones(size: int) -> np.ndarray:
    return np.linalg.qr(np.column_stack([np.ones(size), np.eye(size)[:, : size - 1]]))[0][:, 1:]


def quotient(
    matrix: np.ndarray,
    one_sided: np.ndarray,
    free: np.ndarray,
    fixes_mean: bool,
    vector: np.ndarray,
) -> float:
    """Return the Rayleigh quotient of a vector cut at zero, and shifted to its mean where free."""
    cut = np.where(one_sided, np.maximum(vector, 0), vector)
    if fixes_mean:
        if not free.size:
            return np.inf
        cut[free] -= cut.sum() / free.size
    norm = np.linalg.norm(cut)
    return cut @ matrix @ cut / norm**2 if norm > 0.1 else np.inf

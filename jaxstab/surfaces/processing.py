"""Processing of measured heights, in NumPy: NaN is a missing point, the first index along x.

SciPy is imported late, since it takes long.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

Heights = np.ndarray


def trend(heights: Heights, order: int) -> Heights:
    """Fit a polynomial of order 0, 1 or 2 to the points that are not missing; return its values."""
    field = np.atleast_2d(heights.T).T
    is_present = np.isfinite(field)
    # Across a line there is one point, of whose coordinate only the power zero is used.
    x, y = (np.linspace(-1, 1, n) for n in field.shape)
    powers = [(a, b) for a in range(order + 1) for b in range(order + 1 - a) if not b or y.size > 1]
    along, across = (np.vander(side, 2 * order + 1, increasing=True) for side in (x, y))
    moments = along.T @ is_present.astype(float) @ across
    products = along.T @ np.where(is_present, field, 0) @ across
    gram = np.array([[moments[a + c, b + d] for c, d in powers] for a, b in powers])
    # With too few points for an order the smallest coefficients do.
    fitted = np.linalg.lstsq(gram, np.array([products[p] for p in powers]), rcond=1e-13)[0]
    coefficients = np.zeros((order + 1, order + 1))
    coefficients[tuple(np.transpose(powers))] = fitted
    values = along[:, : order + 1] @ coefficients @ across[:, : order + 1].T
    return values.reshape(heights.shape)


def fill(heights: Heights, spacing: Sequence[float], order: int) -> Heights:
    """Fill missing points by minimizing the sum of squared derivatives of an order.

    The first order gives the discrete Laplace equation (harmonic); the second, with hxx, hxy and
    hyy, the biharmonic equation. Natural conditions hold at the edges of the map.
    """
    from scipy.sparse import csr_array, vstack
    from scipy.sparse.linalg import splu

    places = np.argwhere(np.isfinite(heights))
    about_first = places - places[0]
    if order == 2 and np.linalg.matrix_rank(about_first.T @ about_first) < heights.ndim:
        raise ValueError(
            "the points that are not missing lie on one line, which leaves the slope of a plate "
            'open: fill by "harmonic".'
        )
    is_missing = np.isnan(heights).ravel()
    derivatives = csr_array(vstack(list(_derivatives(heights.shape, spacing, order))))
    derivatives = derivatives[abs(derivatives) @ is_missing.astype(float) > 0]
    unknown = derivatives[:, is_missing]
    right_side = -unknown.T @ (derivatives[:, ~is_missing] @ heights.ravel()[~is_missing])
    # These options are usual for symmetric matrices.
    factors = splu(
        (unknown.T @ unknown).tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    result = heights.copy()
    result.ravel()[is_missing] = factors.solve(right_side)
    return result


def _derivatives(shape: tuple[int, ...], spacing: Sequence[float], order: int) -> Iterator[Any]:
    """Yield a sparse matrix for each derivative of an order, in units of the first spacing."""
    from scipy.sparse import csr_array, eye_array, kron

    shape = (*shape, 1)[:2]
    spacing = (*spacing, spacing[0])[:2]
    for numbers in [(order, 0), (0, order), (1, 1)][: order + 1]:
        if any(n <= k for n, k in zip(shape, numbers, strict=True)):
            continue
        sides = []
        for n, k, d in zip(shape, numbers, spacing, strict=True):
            side = csr_array(eye_array(n))
            for _ in range(k):
                side = (side[1:] - side[:-1]) / (d / spacing[0])
            sides.append(side)
        # The sum of squares contains hxy twice.
        yield math.sqrt(math.comb(order, numbers[0])) * kron(*sides, format="csr")


def taper(shape: tuple[int, ...], share: float) -> np.ndarray:
    """Return a factor that rises as a cosine over a fraction of each side at the edges (Tukey)."""
    factor = np.ones(())
    for n in shape:
        place = (np.arange(n) + 0.5) / n
        nearness = np.minimum(np.minimum(place, 1 - place) / share, 1)
        factor = np.multiply.outer(factor, (1 - np.cos(np.pi * nearness)) / 2)
    return factor


def area_average(heights: Heights, shape: tuple[int, ...]) -> Heights:
    """Return the means over the tiles of another number of points, missing points left out.

    A point stands for the tile of which it is the corner with the least coordinates.
    """
    is_present = np.isfinite(heights)
    totals = np.where(is_present, heights, 0)
    areas = is_present.astype(float)
    for axis, n in enumerate(shape):
        overlap = _overlap(heights.shape[axis], n)
        totals, areas = (
            np.moveaxis(np.tensordot(overlap, field, (1, axis)), 0, axis)
            for field in (totals, areas)
        )
    return np.where(areas > 0, totals / np.where(areas > 0, areas, 1), np.nan)


def _overlap(n: int, other: int) -> np.ndarray:
    """Return the overlaps of n equal parts of a side with `other` equal parts."""
    edges = np.arange(n + 1) * other
    others = np.arange(other + 1) * n
    low = np.maximum(edges[None, :-1], others[:-1, None])
    high = np.minimum(edges[None, 1:], others[1:, None])
    return np.maximum(high - low, 0) / n


def pass_band(heights: Heights, waves: np.ndarray, low: float, high: float) -> Heights:
    """Return the mean of heights and their waves between two wavenumbers."""
    modes = np.fft.rfftn(heights)
    passes = (waves >= low) & (waves <= high) | (waves == 0)
    return np.fft.irfftn(np.where(passes, modes, 0), s=heights.shape, axes=range(heights.ndim))

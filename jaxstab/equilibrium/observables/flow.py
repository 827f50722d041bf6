"""Slow flow through a periodic network: cells, and faces that conduct between them.

Each cell of the grid is a node, each face to the next cell along a side a link. Fluxes are kept
beside the pressures: the remaining imbalance is solved for again and added to them, so that they
balance to all digits also where conductances differ by many orders, and differences of pressures
are lost to rounding.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from jaxstab.core.accuracy import EQUILIBRIUM, EXACT
from jaxstab.core.optional_packages import are_installed, require_packages
from jaxstab.core.results import SolverError
from jaxstab.equilibrium.observables.clusters import clusters_of

Solver = Literal["direct", "multigrid"]
_Field = Float[np.ndarray, " *grid"]
_Faces = Float[np.ndarray, "sides *grid"]
_Solve = Callable[[Float[np.ndarray, " cells"]], Float[np.ndarray, " cells"]]

# With more cells the factors of a direct solver take several gigabytes.
_LARGE = 1 << 21
# The imbalance of a cell over the largest flux: the one aimed at, and the largest allowed.
_BALANCED = EXACT["float64"]
_LIMIT = EQUILIBRIUM["float64"]
_MAX_ROUNDS = 30
# Two bounds of a conductance may differ by this part.
_BOUNDS = 1e-7


@dataclass(frozen=True)
class Flow:
    """The flow through a network under a unit drop of pressure per length along a side.

    Attributes:
        drop: by how much the pressure falls from the first cell, in lengths.
        flux: through the face to the next cell along each side.
    """

    drop: _Field
    flux: _Faces


def conducting(
    conductivity: _Field, is_open: Bool[np.ndarray, " *grid"]
) -> tuple[_Faces, Bool[np.ndarray, " sides"]]:
    """Return the conductance of each face on a percolating path, and the sides along which one is.

    A face conducts the harmonic mean of its two cells.
    """
    around = clusters_of(is_open)
    leads = np.append(False, around.spans.any(axis=1))[around.labels]
    own = np.where(leads, conductivity, 0.0)
    faces = []
    for side in range(own.ndim):
        following = np.roll(own, -1, side)
        both = own + following
        # In this order nothing falls below the range of numbers before the mean does.
        faces.append(2 * own * (following / np.where(both > 0, both, 1)))
    return np.stack(faces), np.asarray(around.spans.any(axis=0))


def flows(
    faces: _Faces,
    leads: Bool[np.ndarray, " sides"],
    spacing: Float[np.ndarray, " sides"],
    solver: Solver | None,
) -> list[Flow]:
    """Return the flow under a unit drop of pressure per length along each side.

    Along a side that no way leads along nothing flows.

    Raises:
        SolverError: if fluxes do not balance.
    """
    ratios = (spacing[0] / spacing).reshape(-1, *(1,) * (faces.ndim - 1))
    links = faces * ratios**2
    none = Flow(np.full(faces.shape[1:], np.nan), np.zeros_like(faces))
    if not leads.any():
        return [none] * len(faces)
    solve, is_cell = _solver(links, solver)
    found = []
    for side in range(len(faces)):
        if not leads[side]:
            found.append(none)
            continue
        step = spacing[side] / spacing[0]
        start = np.zeros_like(links)
        start[side] = links[side] * step
        moved, flux = _balance(links, start, solve, is_cell)
        _require_bounds(links, moved, flux, side, step)
        places = np.arange(faces.shape[1 + side]) * spacing[side]
        shape = [1] * (faces.ndim - 1)
        shape[side] = -1
        drop = places.reshape(shape) + np.where(is_cell, moved, 0) * spacing[0]
        found.append(Flow(np.where(is_cell, drop, np.nan), flux / ratios))
    return found


def _differences(field: _Field) -> _Faces:
    """Return by how much a field grows to the next cell along each side."""
    return np.stack([np.roll(field, -1, side) - field for side in range(field.ndim)])


def _outflow(flux: _Faces) -> _Field:
    """Return the flow out of each cell."""
    return sum((x - np.roll(x, 1, side) for side, x in enumerate(flux)), np.zeros(()))


def _balance(
    links: _Faces, flux: _Faces, solve: _Solve, is_cell: Bool[np.ndarray, " *grid"]
) -> tuple[_Field, _Faces]:
    """Return the pressure drops beside a uniform one, and the fluxes, balanced."""
    moved = np.zeros(is_cell.shape)
    best = np.inf
    best_found = (moved, flux)
    for _ in range(_MAX_ROUNDS):
        left = _outflow(flux)
        size = np.abs(flux).max()
        residual = np.abs(left).max() / size
        if residual < best:
            best = residual
            best_found = (moved, flux)
        elif residual > 0.5 * best and best <= _LIMIT:
            break
        if residual <= _BALANCED:
            break
        change = np.zeros(is_cell.shape)
        change[is_cell] = solve(left[is_cell])
        moved = moved + change
        flux = flux + links * _differences(change)
    if not best <= _LIMIT:
        raise SolverError(
            f"The flow was not found: fluxes balance to {best:.1e} of the largest only, where "
            f"conductances differ by a factor of {_contrast(links):.1e}. Press less, or give "
            'solver="direct".'
        )
    return best_found


def _contrast(links: _Faces) -> float:
    flowing = links[links > 0]
    return float(flowing.max() / flowing.min())


def _require_bounds(links: _Faces, moved: _Field, flux: _Faces, side: int, step: float) -> None:
    """Raise `SolverError` if the bounds of the conductance by pressures and by fluxes differ.

    The one is from above, the other from below (Dirichlet, Thomson).
    """
    drops = _differences(moved)
    drops[side] += step
    through = flux[side].sum() * step
    from_drops = (links * drops**2).sum()
    is_open = links > 0
    lost = (flux[is_open] ** 2 / links[is_open]).sum()
    if not abs(through**2 / lost - from_drops) <= _BOUNDS * from_drops:
        raise SolverError(
            f"The flow is not known well enough: its dissipation is {from_drops:.6e} by pressures "
            f"and {lost:.6e} by fluxes. Conductances differ by a factor of {_contrast(links):.1e}: "
            "press less."
        )


def _solver(links: _Faces, solver: Solver | None) -> tuple[_Solve, Bool[np.ndarray, " *grid"]]:
    """Return a solver for the drops that make given outflows, and the mask of cells with flow."""
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.csgraph import connected_components

    shape = links.shape[1:]
    cells = np.arange(np.prod(shape)).reshape(shape)
    ends = [(cells.ravel(), np.roll(cells, -1, side).ravel()) for side in range(len(links))]
    one, other = (np.concatenate(x) for x in zip(*ends, strict=True))
    is_open = links.ravel() > 0
    rows = np.append(one[is_open], other[is_open])
    columns = np.append(other[is_open], one[is_open])
    conductances = np.tile(links.ravel()[is_open], 2)
    total = np.bincount(rows, conductances, cells.size)
    kept = np.flatnonzero(total)
    joined: Any = coo_array((conductances, (rows, columns)), (cells.size, cells.size)).tocsr()
    joined = joined[kept][:, kept]
    # Each part is at rest in one cell, since only differences count.
    first = np.unique(connected_components(joined, directed=False)[1], return_index=True)[1]
    diagonal = total[kept]
    diagonal[first] *= 2
    scale = 1 / np.sqrt(diagonal)
    # The diagonal is scaled to one, since conductances differ by many orders.
    scaled = diags_array(scale) @ (diags_array(diagonal) - joined) @ diags_array(scale)
    inverse = _inverse(scaled, solver)
    return lambda outflow: scale * inverse(scale * outflow), (total > 0).reshape(shape)


def _inverse(matrix: Any, solver: Solver | None) -> _Solve:
    """Return a function that applies the inverse of a sparse positive matrix."""
    from scipy.sparse.linalg import cg, splu

    if solver is None:
        solver = "direct"
        if matrix.shape[0] > _LARGE and are_installed("pyamg"):
            solver = "multigrid"
    if solver == "direct":
        options = {"SymmetricMode": True}
        factors = splu(
            matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
        )
        return factors.solve
    require_packages("Multigrid solvers", "leakage", "pyamg")
    import pyamg

    levels: Any = pyamg.ruge_stuben_solver(matrix.tocsr())
    precondition = levels.aspreconditioner()
    # The remaining imbalance is solved for again.
    return lambda right_side: cg(matrix, right_side, rtol=1e-8, maxiter=500, M=precondition)[0]

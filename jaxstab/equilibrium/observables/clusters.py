"""Clusters: connected points of a mask, also over the edges of a periodic cell.

Points are joined within the cell first, by SciPy. The parts are then joined over the edges by
breadth-first search, which counts the cells that a path has crossed: two paths to one part that
differ in this number go around the cell.
"""

from collections import defaultdict, deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Int

Neighbours = Literal[4, 8]
# A part, another one, and the cells crossed from the one to the other.
_Join = tuple[int, int, tuple[int, ...]]


@dataclass(frozen=True)
class Clusters:
    """The clusters of a mask.

    Attributes:
        labels: the cluster of each point, from 1 on; 0 outside of the mask.
        number: how many there are.
        spans: for each cluster and side, whether it goes on without end along the side; in a cell
            that is not repeated, whether it reaches both edges.
    """

    labels: Int[np.ndarray, " *grid"]
    number: int
    spans: Bool[np.ndarray, "clusters sides"]


def clusters_of(
    mask: Bool[np.ndarray, " *grid"], neighbours: Neighbours = 4, is_periodic: bool = True
) -> Clusters:
    """Return the clusters of a mask, in the order of their first points."""
    from scipy.ndimage import generate_binary_structure, label

    reach = mask.ndim
    if neighbours == 4:
        reach = 1
    found: Any = label(mask, generate_binary_structure(mask.ndim, reach))
    parts, number = found
    if not is_periodic:
        return Clusters(parts, number, _reaching(parts, number))
    whole, spans = _join(number, list(_joins(parts, reach > 1)), mask.ndim)
    return Clusters(np.append(0, whole)[parts], len(spans), spans)


def _reaching(parts: Int[np.ndarray, " *grid"], number: int) -> Bool[np.ndarray, "clusters sides"]:
    """Return for each part and side whether it reaches both edges."""
    names = np.arange(1, number + 1)
    sides = []
    for side in range(parts.ndim):
        first, last = (np.take(parts, edge, side) for edge in (0, -1))
        sides.append(np.isin(names, first) & np.isin(names, last))
    return np.stack(sides, axis=-1)


def _joins(parts: Int[np.ndarray, " *grid"], with_corners: bool) -> Iterator[_Join]:
    """Yield which parts meet over an edge."""
    for side in range(parts.ndim):
        last, first = (np.atleast_1d(np.take(parts, edge, side)) for edge in (-1, 0))
        steps = (0,)
        if with_corners and parts.ndim > 1:
            steps = (-1, 0, 1)
        for step in steps:
            # Over a corner, the other side's edge is crossed too.
            along = np.arange(first.size) + step
            crossed = along // first.size
            pairs = np.stack([last, first[along % first.size], crossed], axis=-1)
            found = pairs[(pairs[:, 0] > 0) & (pairs[:, 1] > 0)]
            for one, other, aside in np.unique(found, axis=0).tolist():
                cells = [aside] * parts.ndim
                cells[side] = 1
                yield one - 1, other - 1, tuple(cells)


def _join(
    number: int, joins: list[_Join], num_sides: int
) -> tuple[Int[np.ndarray, " parts"], Bool[np.ndarray, "clusters sides"]]:
    """Return the cluster of each part, from 1 on, and where the clusters span the cell."""
    adjacent = defaultdict(list)
    for one, other, cells in joins:
        step = np.array(cells)
        adjacent[one].append((other, step))
        adjacent[other].append((one, -step))
    whole = np.zeros(number, int)
    place = np.zeros((number, num_sides), int)
    spans = []
    for start in range(number):
        if whole[start]:
            continue
        whole[start] = len(spans) + 1
        around = np.zeros(num_sides, bool)
        waiting = deque([start])
        while waiting:
            part = waiting.popleft()
            for other, step in adjacent[part]:
                reached = place[part] + step
                if not whole[other]:
                    whole[other] = whole[part]
                    place[other] = reached
                    waiting.append(other)
                else:
                    around |= reached != place[other]
        spans.append(around)
    return whole, np.array(spans, bool).reshape(len(spans), num_sides)

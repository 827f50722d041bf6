"""Every equilibrium of a small contact that yields, found by looking at each set of points.

The unknown is w = u - h + z_old: the gap where it is positive, and less what the solid is newly
indented by where it is negative. The energy is

    u.K u / 2 + p0 sum(u) + sum min over y >= 0 of f(w + y) + H y,

p0 being zero where the mean of u is prescribed. A point is open, held at the kink, or yielding, so
that there are 3^n sets; on each the energy is smooth. In NumPy, with a row for each set and start.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

OPEN, HELD, YIELDING = 1, 0, -1
# Relative to the energies and pressures of a problem of order one.
EXACT = 1e-11


class Law(NamedTuple):
    """A law and its first two derivatives, functions of an array of gaps.

    Attributes:
        length: its range, from which searches start [length].
    """

    energy: Callable
    slope: Callable
    curvature: Callable
    length: float


@dataclass(frozen=True)
class Line:
    """A contact of n points and its load.

    Attributes:
        stiffness: K, n x n, symmetric.
        heights: h.
        law: f.
        hardness: H, one or n numbers.
        indentation: z_old, by which the solid has been flattened before.
        mean_displacement: the mean of u, or None.
        mean_pressure: p0, or None.
    """

    stiffness: np.ndarray
    heights: np.ndarray
    law: Law
    hardness: np.ndarray | float
    indentation: np.ndarray | float = 0.0
    mean_displacement: float | None = None
    mean_pressure: float | None = None

    @cached_property
    def closest(self):
        """The smallest gap: 0, or where the law repels by H."""
        hardness = np.broadcast_to(self.hardness, self.heights.shape)
        low, high = np.full(hardness.shape, 1e-9 * self.law.length), np.full(hardness.shape, 1.0)
        is_closed = self.law.slope(low) > -hardness
        for _ in range(200):
            middle = (low + high) / 2
            is_below = self.law.slope(middle) < -hardness
            low, high = np.where(is_below, middle, low), np.where(is_below, high, middle)
        return np.where(is_closed, 0.0, high)

    def law_of(self, w):
        """Return energy, slope and curvature of the law, linear below the closest gap."""
        closest = self.closest
        gap = np.maximum(w, closest)
        slope, is_above = self.law.slope(gap), w >= closest
        energy = self.law.energy(gap) + slope * (w - gap)
        return energy, slope, np.where(is_above, self.law.curvature(gap), 0.0)

    def energy(self, w):
        """Return the energy at w, an array whose last axis counts points."""
        displacement = w + self.heights - self.indentation
        elastic = np.einsum("...i,ij,...j", displacement, self.stiffness, displacement) / 2
        work = 0.0 if self.mean_pressure is None else self.mean_pressure * displacement.sum(-1)
        energy, slope, _ = self.law_of(w)
        below = np.maximum(self.closest - w, 0)
        return elastic + work + (energy + (self.hardness + slope) * below).sum(-1)


class Minimum(NamedTuple):
    """A local minimum of the energy, in the fields of an equilibrium.

    Attributes:
        w: u - h + z_old.
        displacement, gap, indentation: u, g, z.
        pressure: K u + p0.
        reaction: the pressure and the attraction of the law, where the gap is closest.
        mean_pressure: p0.
        sides: OPEN, HELD or YIELDING.
        curvature: the smallest of the Hessian on the critical cone.
    """

    w: np.ndarray
    displacement: np.ndarray
    gap: np.ndarray
    indentation: np.ndarray
    pressure: np.ndarray
    reaction: np.ndarray
    mean_pressure: float
    sides: np.ndarray
    curvature: float


def exponential(energy, length):
    """Return -w exp(-g / rho)."""
    return Law(
        lambda gap: -energy * np.exp(-gap / length),
        lambda gap: energy / length * np.exp(-gap / length),
        lambda gap: -energy / length**2 * np.exp(-gap / length),
        length,
    )


def lennard_jones(energy, length):
    """Return w / 2 ((z0 / g)^9 - 3 (z0 / g)^3)."""
    return Law(
        lambda gap: energy / 2 * ((length / gap) ** 9 - 3 * (length / gap) ** 3),
        lambda gap: -9 * energy / 2 / length * ((length / gap) ** 10 - (length / gap) ** 4),
        lambda gap: (
            9 * energy / 2 / length**2 * (10 * (length / gap) ** 11 - 4 * (length / gap) ** 5)
        ),
        length,
    )


def minima(line, num_steps=60):
    """Return the local minima of a contact, each once, from the lowest energy up.

    On each set of points Newton's method descends from small and large gaps in all combinations,
    4^n searches together. Where the energy of a set is convex, as for a weak law, that is certain
    to find its minimum.
    """
    starts = np.array(list(product((0.3, 3.0, HELD, YIELDING), repeat=line.heights.size)))
    sides = np.sign(starts)
    w = line.closest + line.law.length * np.where(sides == YIELDING, -0.3, starts)
    moves = sides != HELD
    if line.mean_displacement is not None:
        total = (line.mean_displacement - line.heights + line.indentation).sum()
        lacking = total - w.sum(-1, keepdims=True)
        w = w + moves * lacking / np.maximum(moves.sum(-1, keepdims=True), 1)
        is_possible = moves.any(-1) | (abs(lacking[:, 0]) < EXACT)
        w, sides, moves = w[is_possible], sides[is_possible], moves[is_possible]
    searches = np.arange(len(w))
    for _ in range(num_steps):
        step = _descent(line, w[searches], sides[searches])
        w[searches] += np.where(sides[searches] == HELD, 0, step)
        searches = searches[abs(step).max(-1) > 1e-13 * line.law.length]
        if not searches.size:
            break
    is_on_side = ((sides == HELD) | (sides * (w - line.closest) > EXACT)).all(-1)
    _, rows = np.unique(np.round(w[is_on_side], 9), axis=0, return_index=True)
    states = zip(w[is_on_side][rows], sides[is_on_side][rows], strict=True)
    states = [state for state in (minimum_at(line, *row) for row in states) if state]
    distinct = []
    for state in sorted(states, key=lambda state: line.energy(state.w)):
        if all(abs(state.w - other.w).max() > 1e-7 * line.law.length for other in distinct):
            distinct.append(state)
    return distinct


def _energy_on_sets(line, w, sides):
    """Return the energy of each row, as smooth as its set of points has it."""
    displacement = w + line.heights - line.indentation
    work = (line.mean_pressure or 0.0) * displacement.sum(-1)
    law = np.where(sides == YIELDING, -line.hardness * w, line.law_of(w)[0]).sum(-1)
    return (displacement @ line.stiffness * displacement).sum(-1) / 2 + work + law


def _descent(line, w, sides):
    """Return a step that lowers the energy of each set, by Newton's method with positive moduli."""
    energy, yields = _energy_on_sets(line, w, sides), sides == YIELDING
    _, slope, curvature = line.law_of(w)
    pressure = (w + line.heights - line.indentation) @ line.stiffness + (line.mean_pressure or 0.0)
    gradient = pressure + np.where(yields, -line.hardness, slope)
    curvature = np.where(yields, 0, curvature)
    hessian = line.stiffness + np.eye(w.shape[-1]) * curvature[:, None, :]
    basis = _projector(line, sides)
    gradient = np.einsum("bij,bj->bi", basis, gradient)
    values, vectors = np.linalg.eigh(basis @ hessian @ basis + np.eye(w.shape[-1]) - basis)
    floor = 1e-6 * abs(line.stiffness).max()
    parts = np.einsum("bji,bj->bi", vectors, gradient) / np.maximum(abs(values), floor)
    step = -np.einsum("bij,bj->bi", vectors, parts)
    # No search leaves for another region at once.
    longest = abs(step).max(-1, keepdims=True)
    step = step * np.minimum(1, 2 * line.law.length / np.maximum(longest, 1e-300))
    descent, length = (gradient * step).sum(-1), np.ones(len(w))
    for _ in range(30):
        new = _energy_on_sets(line, w + length[:, None] * step, sides)
        is_lower = new <= energy + 1e-4 * length * descent + 1e-13 * (1 + abs(energy))
        if is_lower.all():
            break
        length = np.where(is_lower, length, length / 2)
    return length[:, None] * step


def _projector(line, sides):
    """Return the projector of each row onto what its set and the load leave free."""
    moves = (sides != HELD).astype(float)
    projector = np.eye(sides.shape[-1]) * moves[:, None, :]
    if line.mean_displacement is not None:
        number = np.maximum(moves.sum(-1), 1)[:, None, None]
        projector = projector - moves[:, :, None] * moves[:, None, :] / number
    return projector


def minimum_at(line, w, sides):
    """Return a row as a state, if it is a local minimum whose points are on their sides."""
    closest, (_, slope, curvature) = line.closest, line.law_of(w)
    hardness = np.broadcast_to(line.hardness, w.shape)
    # A wall without a kink, as of a law that repels by H itself, holds nothing.
    largest = hardness + slope
    displacement = w + line.heights - line.indentation
    elastic = line.stiffness @ displacement
    mean_pressure = line.mean_pressure
    if mean_pressure is None:
        needed = np.where(sides == YIELDING, hardness, -slope) - elastic
        if (sides == HELD).all():
            return None
        mean_pressure = needed[sides != HELD].mean()
    pressure = elastic + mean_pressure
    reaction = np.where(sides == OPEN, 0.0, pressure + slope)
    net = np.where(sides == OPEN, pressure + slope, pressure - hardness)
    if abs(net[sides != HELD]).max(initial=0.0) > 1e-10 * abs(line.stiffness).max():
        return None
    if not ((reaction >= -EXACT) & (reaction <= largest + EXACT))[sides == HELD].all():
        return None
    is_held, may_open, may_yield = sides == HELD, reaction <= EXACT, reaction >= largest - EXACT
    # A point that is only about to yield has no curvature of the law there.
    matrix = line.stiffness + np.diag(np.where(may_open, curvature, 0))
    smallest = smallest_on_cone(
        matrix,
        np.where(is_held & ~may_yield, 0.0, -np.inf),
        np.where(is_held & ~may_open, 0.0, np.inf),
        fixes_mean=line.mean_displacement is not None,
    )
    if not smallest > 0:
        return None
    newly = np.maximum(closest - w, 0)
    return Minimum(
        w=w,
        displacement=displacement,
        gap=np.maximum(w, closest),
        indentation=line.indentation + newly,
        pressure=pressure,
        reaction=reaction,
        mean_pressure=mean_pressure,
        sides=sides,
        curvature=smallest,
    )


def smallest_on_cone(matrix, lower, upper, fixes_mean):
    """Return the smallest x.A x / x.x over lower <= x <= upper, bounds of 0 and infinity.

    Each face is looked at, from the largest down: on a part of a face no eigenvalue is smaller
    than on all of it. The matrix is strictly copositive on the cone if the number is positive.
    Without an admissible x it is infinite.
    """
    lower, upper = (np.broadcast_to(bound, len(matrix)) for bound in (lower, upper))
    is_free = np.isinf(lower) & np.isinf(upper)
    one_sided = np.flatnonzero(np.isinf(lower) != np.isinf(upper))
    signs = np.where(np.isinf(upper), 1.0, -1.0)
    smallest, faces = np.inf, {tuple(one_sided)}
    while faces:
        parts = set()
        for moving in faces:
            face = np.concatenate([np.flatnonzero(is_free), np.array(moving, int)])
            basis = np.eye(len(face))
            if fixes_mean:
                basis = np.linalg.svd(np.ones((1, len(face))))[2][1:] if len(face) else basis
            if not len(basis):
                continue
            values, vectors = np.linalg.eigh(basis @ matrix[np.ix_(face, face)] @ basis.T)
            for value, vector in zip(values, vectors.T @ basis, strict=True):
                if value >= smallest:
                    break
                moved = (vector * signs[face])[len(face) - len(moving) :]
                if (moved > -1e-12).all() or (moved < 1e-12).all():
                    smallest = value
            if values[0] < smallest:
                parts |= set(combinations(moving, len(moving) - 1)) if moving else set()
        faces = parts
    return smallest

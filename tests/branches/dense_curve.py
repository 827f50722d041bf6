"""Curves of equilibria of small contacts by dense algebra: every change of contact on its own.

Between two changes the free points stay the same and the curve is smooth. It is followed by
arclength steps that turn by a degree at most. Where a gap or a reaction would become negative, the
step is bisected, and that point changes sides.
"""

from dataclasses import dataclass, field

import numpy as np

_LEAST_COSINE = np.cos(np.radians(1.2))
_SHORTEST = 1e-11


@dataclass
class DenseCurve:
    """The curve g_F(s), p0(s) with (K (g + h) + p0 + f'(g))_F = 0 and g = 0 elsewhere.

    `load` is (a, b, c): the value of the load is a mean(g) + b p0 + c.
    """

    stiffness: np.ndarray
    heights: np.ndarray
    slope: object
    curvature: object
    load: tuple
    events: list = field(default_factory=list)
    states: list = field(default_factory=list)

    def __post_init__(self):
        self.heights = np.asarray(self.heights, float).ravel()
        self.size = self.heights.size
        self.own_length = np.ptp(self.heights)
        values = np.linalg.eigvalsh(self.stiffness)
        self.soft = values[values > 1e-9 * values[-1]][0]

    def value(self, x):
        a, b, c = self.load
        return a * np.mean(x[:-1]) + b * x[-1] + c

    def net(self, x):
        gap = x[:-1]
        return self.stiffness @ (gap + self.heights) + x[-1] + self.slope(gap)

    def weights(self):
        return np.append(np.full(self.size, 1 / self.size), 1 / self.soft**2)

    def jacobian(self, x):
        hessian = self.stiffness + np.diag(self.curvature(x[:-1]))
        return np.column_stack([hessian, np.ones(self.size)])

    def tangent(self, x, free, row):
        """Return the direction of length one along which a linear function grows."""
        moving = np.append(free, True)
        matrix = np.vstack([self.jacobian(x)[np.ix_(free, moving)], row[moving]])
        t = np.zeros(self.size + 1)
        t[moving] = np.linalg.solve(matrix, np.append(np.zeros(free.sum()), 1.0))
        return t / np.sqrt(np.sum(self.weights() * t**2))

    def corrected(self, x, free, row, target):
        """Return the point of the curve with row.x = target, or None."""
        x, moving = x.copy(), np.append(free, True)
        for _ in range(12):
            missed = np.append(self.net(x)[free], row @ x - target)
            matrix = np.vstack([self.jacobian(x)[np.ix_(free, moving)], row[moving]])
            move = np.linalg.solve(matrix, -missed)
            x[moving] += move
            if not np.all(np.isfinite(x)):
                return None
            if np.max(np.abs(move[:-1]), initial=0) < 1e-13 * self.own_length:
                return x
        return x if np.max(np.abs(move[:-1]), initial=0) < 1e-10 * self.own_length else None

    def step(self, x, free, tangent, length):
        row = self.weights() * tangent
        found = self.corrected(x + length * tangent, free, row, row @ x + length)
        if found is None or not np.all(np.isfinite(found)):
            return None, None
        new = self.tangent(found, free, row)
        return (found, new) if row @ new > _LEAST_COSINE else (None, None)

    def violated(self, x, free):
        size = np.where(free, x[:-1] / self.own_length, self.net(x) / (self.soft * self.own_length))
        return size < -1e-13

    def follow(self, gap, pressure, last, longest, max_steps=20000, max_events=10**9):
        """Return why the curve ends; events and states are kept."""
        x, free = np.append(gap.ravel(), pressure), gap.ravel() > 0
        a, b, _ = self.load
        gradient = np.append(np.full(self.size, a / self.size), b)
        mean = np.append(np.full(self.size, 1 / self.size), 0.0)
        x = self.corrected(x, free, mean, mean @ x)
        sign = np.sign(last - self.value(x))
        t = self.tangent(x, free, gradient * sign)
        length = longest / 10
        self.states.append(x)
        first, away = x, False
        for _ in range(max_steps):
            new, turned = self.step(x, free, t, length)
            if new is None:
                length /= 3
                if length < _SHORTEST * longest:
                    return "lost"
                continue
            taken, flipped = length, None
            if np.any(self.violated(new, free)):
                low, high = 0.0, length
                for _ in range(60):
                    middle = (low + high) / 2
                    trial, _ = self.step(x, free, t, middle)
                    if trial is None:
                        break
                    if np.any(self.violated(trial, free)):
                        high, new = middle, trial
                    else:
                        low = middle
                    if high - low < 1e-14 * longest:
                        break
                taken = high
                flipped = np.flatnonzero(self.violated(new, free))
                if len(flipped) > 1:
                    return "tie"
                turned = self.tangent(new, free, self.weights() * t)
            # A fold between the two, before any change of contact.
            if (gradient @ t) * (gradient @ turned) < 0:
                low, high, at = 0.0, taken, new
                for _ in range(60):
                    middle = (low + high) / 2
                    trial, speed = self.step(x, free, t, middle)
                    if trial is None:
                        break
                    at = trial
                    low, high = (
                        (middle, high) if (gradient @ t) * (gradient @ speed) > 0 else (low, middle)
                    )
                self.events.append(("fold", self.value(at)))
            if (self.value(new) - last) * (self.value(x) - last) <= 0 and len(self.states) > 1:
                self.states.append(new)
                return "load"
            before, x, t = x, new, turned
            if flipped is not None:
                point = flipped[0]
                unit = np.zeros(self.size + 1)
                opens = not free[point]
                row = self.jacobian(x)[point] / self.soft if not opens else unit
                unit[point] = 1.0
                free = free.copy()
                free[point] = opens
                x = x.copy()
                x[point] = 0.0
                t = self.tangent(x, free, unit if opens else row)
                if (gradient @ turned) * (gradient @ t) < 0:
                    self.events.append(("release" if opens else "touch", self.value(x)))
            else:
                length = min(1.5 * length, longest)
            self.states.append(x)
            far = np.sqrt(np.sum(self.weights() * (x - first) ** 2))
            away = away or far > 3 * longest
            if away and far < longest:
                row = self.weights() * (self.states[1] - first)
                if row @ (before - first) < 0 <= row @ (x - first):
                    return "loop"
            if len(self.events) >= max_events:
                return "events"
        return "steps"


def exponential(energy, length):
    return (
        lambda g: energy / length * np.exp(-g / length),
        lambda g: -energy / length**2 * np.exp(-g / length),
    )

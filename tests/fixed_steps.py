"""Viscoelastic contacts by many equal time steps and dense matrices, down the energy in jumps."""

import numpy as np
from brute_force import periodic_stiffness


class FixedSteps:
    """A half space of modulus one under an exponential law, on a few points.

    Every load is a spring, p0 = k (mean(u) - x): a soft one presses, a stiff one holds.
    """

    def __init__(self, heights, lengths, ratios, times, energy, length):
        self.heights = np.ravel(heights)
        self.K = periodic_stiffness(np.shape(heights), lengths, 1.0)
        self.ratios, self.times = np.array(ratios), np.array(times)
        self.energy, self.length = energy, length
        self.scale = energy / length + np.linalg.norm(self.K, 2) * np.ptp(self.heights)

    def rest(self, gap):
        """Start from an equilibrium of the relaxed solid without a load."""
        self.gap = np.ravel(gap)
        self.w = self._deformation()
        self.v = np.zeros((self.times.size, self.gap.size))

    def go(self, times, stiffness, positions):
        """Take the steps, and return the times of jumps and the mean pressure at the end."""
        jumps = []
        for i, (time, position) in enumerate(zip(times, positions, strict=True)):
            dt = time - times[max(i - 1, 0)]
            x = np.maximum(dt / self.times, 1e-300)
            kept, felt = np.exp(-x), -np.expm1(-x) / x
            force = self.K @ (self.ratios @ (kept[:, None] * self.v - np.outer(felt, self.w)))
            before = self.gap
            spring = stiffness, position
            self.gap = self._below((1 + self.ratios @ felt) * self.K, force, spring, before)
            change = self._deformation() - self.w
            self.v = kept[:, None] * self.v + np.outer(felt, change)
            self.w = self.w + change
            if np.max(abs(self.gap - before)) > self.length:
                jumps.append(time)
        return jumps, stiffness * (np.mean(self.gap + self.heights) - positions[-1])

    def _deformation(self):
        return self.gap + self.heights - np.mean(self.gap + self.heights)

    def _below(self, matrix, force, spring, gap):
        """Return the equilibrium below a gap: by Newton's method, or along the gradient."""
        stiffness, position = spring
        law = self.energy / self.length

        def net(gap):
            u = gap + self.heights
            pull = law * np.exp(-gap / self.length)
            return matrix @ u + force + stiffness * (np.mean(u) - position) + pull

        def newton(gap, farthest):
            for _ in range(50):
                residual = net(gap)
                free = (gap > 0) | (residual < 0)
                if np.max(abs(residual), where=free, initial=0) < 1e-9 * self.scale:
                    return gap
                softening = law / self.length * np.exp(-gap / self.length)
                hessian = matrix + stiffness / gap.size - np.diag(softening)
                hessian = hessian[np.ix_(free, free)]
                if np.linalg.eigvalsh(hessian)[0] <= 0:
                    return None
                move = np.zeros_like(gap)
                move[free] = -np.linalg.solve(hessian, residual[free])
                if np.max(abs(move)) > farthest:
                    return None
                gap = np.maximum(gap + move, 0)
            return None

        found = newton(gap, 0.3 * self.length)
        step = 1 / (np.linalg.norm(matrix, 2) + stiffness + law / self.length)
        while found is None:
            for _ in range(200):
                gap = np.maximum(gap - step * net(gap), 0)
            found = newton(gap, 0.03 * self.length)
        return found

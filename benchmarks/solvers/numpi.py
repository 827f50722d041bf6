"""NuMPI: conjugate gradients of Bugnicourt and others, L-BFGS and Newton's method.

They minimise the energy of `problems.py`, which Adhesion and ContactMechanics state at a rigid
offset only. At a mean gap `constrained_conjugate_gradients` is tried first, and where it fails
`l_bfgs_projected`; only the one that succeeds is timed. At a mean pressure it is
`tr_newton_bounded`, which has no condition on a mean.
"""

from contextlib import redirect_stdout
from io import StringIO
from time import process_time

import numpy as np
from NuMPI.Optimization import (
    LinearConstraint,
    constrained_conjugate_gradients,
    l_bfgs_projected,
    tr_newton_bounded,
)

MAX_STEPS = 2_000


def solve(problem, tolerance):
    heights = problem.heights - problem.heights.mean()
    # The gap in units of the rms height, and pressures in units of those of full contact.
    length = np.sqrt(np.mean(heights**2))
    stiffness = problem.stiffness()
    pressure = np.sqrt(np.mean(problem.pressure(np.zeros_like(heights)) ** 2))
    held = problem.value if problem.control == "pressure" else 0.0

    def elastic_pressure(displacement):
        return np.fft.irfft2(stiffness * np.fft.rfft2(displacement), heights.shape)

    def energy(scaled):
        gap = length * scaled.reshape(heights.shape)
        elastic = elastic_pressure(gap + heights)
        value, slope, _ = problem.law_and_derivatives(gap)
        total = np.sum((gap + heights) * elastic / 2 + value + held * gap)
        gradient = (elastic + slope + held) / pressure
        return total / (pressure * length), gradient.reshape(scaled.shape)

    def product(scaled, direction):
        curvature = problem.law_and_derivatives(length * scaled.reshape(heights.shape))[2]
        move = length * direction.reshape(heights.shape)
        return ((elastic_pressure(move) + curvature * move) / pressure).reshape(direction.shape)

    # A law with a core is infinite at a gap of zero.
    floor = 0.0
    if problem.law == "lennard-jones":
        floor = min(0.3 * problem.length, 0.5 * problem.value) / length
    gap = np.maximum((heights.max() - heights) / length, floor)
    options = {"gtol": tolerance, "maxiter": MAX_STEPS}
    if problem.control == "pressure":
        seconds, found = timed(tr_newton_bounded, energy, gap, product, bounds_lo=0.0, **options)
    else:
        mean = problem.value / length
        gap = floor + (gap - floor) * (mean - floor) / (gap.mean() - floor)
        constraint = LinearConstraint(np.ones(gap.size), mean * gap.size)
        seconds, found = timed(
            constrained_conjugate_gradients,
            energy,
            product,
            gap,
            linear_constraint=constraint,
            bounds=np.full(gap.size, floor),
            **options,
        )
        if not (found.success and problem.is_met(length * np.asarray(found.x))):
            seconds, found = timed(
                l_bfgs_projected, energy, gap, constraint, jac=True, bounds_lo=floor, **options
            )
    if not found.success:
        raise RuntimeError(found.message)
    return length * np.asarray(found.x).reshape(heights.shape), seconds


def timed(solver, *arguments, **options):
    """Return processor seconds and result; what a solver prints is not shown."""
    start = process_time()
    with redirect_stdout(StringIO()), np.errstate(all="ignore"):
        found = solver(*arguments, **options)
    return process_time() - start, found

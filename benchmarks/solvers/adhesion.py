"""Adhesion: its default solver, L-BFGS-B, for the exponential law at a mean gap.

Adhesion prescribes a rigid offset. The offset of a mean gap is sought by the secant method, each
solution starting from the last; all of them are timed. The half space resists a mean displacement
as it resists its shortest wave, so that the mean gap follows the offset.
"""

from time import process_time

import numpy as np
from Adhesion.Interactions import Exponential
from Adhesion.System import BoundedSmoothContactSystem
from ContactMechanics import PeriodicFFTElasticHalfSpace
from SurfaceTopography import Topography

MAX_STEPS = 5_000
MAX_OFFSETS = 20


def solve(problem, tolerance):
    if (problem.law, problem.control) != ("exponential", "gap"):
        raise NotImplementedError
    heights, shape = problem.heights, problem.heights.shape
    stiffness = problem.stiffness().max()
    solid = PeriodicFFTElasticHalfSpace(shape, problem.modulus, (1.0, 1.0), stiffness_q0=stiffness)
    law = Exponential(problem.energy, problem.length)
    surface = Topography(heights, (1.0, 1.0), periodic=True)
    system = BoundedSmoothContactSystem(solid, law, surface)
    attraction = np.sqrt(np.mean(problem.pressure(np.zeros(shape)) ** 2))
    forces = tolerance * min(attraction, problem.energy / problem.length) * system.area_per_pt
    limits = {"gtol": forces, "ftol": 0.0, "maxiter": MAX_STEPS, "maxfun": MAX_STEPS}
    start = process_time()
    offsets, missed, displacement = [-problem.value - heights.mean()], [], None
    while len(offsets) <= MAX_OFFSETS:
        found = system.minimize_proxy(offsets[-1], displacement, options=limits)
        if not found.success:
            raise RuntimeError(found.message)
        displacement = found.x.reshape(shape)
        gap = np.maximum(displacement - heights - offsets[-1], 0)
        missed.append(gap.mean() - problem.value)
        if abs(missed[-1]) <= tolerance * problem.value:
            return gap * (problem.value / gap.mean()), process_time() - start
        step = missed[-1]
        if len(missed) > 1:
            step *= (offsets[-2] - offsets[-1]) / (missed[-1] - missed[-2])
        offsets.append(offsets[-1] + step)
    raise RuntimeError(f"no offset has the mean gap {problem.value:g}")

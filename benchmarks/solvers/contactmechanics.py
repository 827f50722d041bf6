"""ContactMechanics: conjugate gradients after Polonsky and Keer, without adhesion."""

from time import process_time

import numpy as np
from ContactMechanics import PeriodicFFTElasticHalfSpace
from ContactMechanics.Optimization import constrained_conjugate_gradients
from SurfaceTopography import Topography

MAX_STEPS = 5_000


def solve(problem, tolerance):
    if (problem.law, problem.control) != ("none", "pressure"):
        raise NotImplementedError
    heights = problem.heights
    solid = PeriodicFFTElasticHalfSpace(heights.shape, problem.modulus, (1.0, 1.0))
    start = process_time()
    found = constrained_conjugate_gradients(
        solid,
        Topography(heights, (1.0, 1.0), periodic=True),
        external_force=problem.value,
        pentol=tolerance * heights.std(),
        forcetol=tolerance * problem.value * solid.area_per_pt,
        thermotol=tolerance,
        maxiter=MAX_STEPS,
    )
    seconds = process_time() - start
    if not found.success:
        raise RuntimeError(found.message)
    # Points that carry pressure touch.
    gap = np.where(found.jac > 0, 0, found.x - heights - found.offset)
    return np.maximum(gap, 0), seconds

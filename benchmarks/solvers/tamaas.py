"""Tamaas: `PolonskyKeerRey`, for the gap at its mean or, without adhesion, for the pressure."""

from time import process_time

import numpy as np
import tamaas

FUNCTIONALS = {
    "exponential": tamaas.ExponentialAdhesionFunctional,
    "gaussian": tamaas.SquaredExponentialAdhesionFunctional,
}
MAX_STEPS = 5_000
tamaas.set_log_level(tamaas.LogLevel.error)


def solve(problem, tolerance):
    if problem.law not in ("none", *FUNCTIONALS):
        raise NotImplementedError
    heights = problem.heights.copy()
    model = tamaas.Model(tamaas.model_type.basic_2d, [1.0, 1.0], list(heights.shape))
    model.E, model.nu = problem.modulus, 0.0
    kind = getattr(tamaas.PolonskyKeerRey, problem.control)
    solver = tamaas.PolonskyKeerRey(model, heights, tolerance, kind, kind)
    solver.max_iter = MAX_STEPS
    if problem.law != "none":
        adhesion = FUNCTIONALS[problem.law](heights)
        adhesion.parameters = {"surface_energy": problem.energy, "rho": problem.length}
        solver.addFunctionalTerm(adhesion)
    start = process_time()
    error = solver.solve(problem.value)
    seconds = process_time() - start
    if not error <= tolerance:
        raise RuntimeError(f"error {error:.1e}")
    gap = np.array(model.displacement) - heights
    if problem.control == "pressure":
        # Points that carry pressure touch.
        touches = np.array(model.traction) > 0
        return np.maximum(np.where(touches, 0, gap - gap[touches].mean()), 0), seconds
    gap = np.maximum(gap, 0)
    return gap * (problem.value / gap.mean()), seconds

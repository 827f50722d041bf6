"""jaxstab: `equilibrate` with its default solver."""

from time import process_time

import jax
import numpy as np

import jaxstab as js

LAWS = {
    "exponential": js.potentials.Exponential,
    "gaussian": js.potentials.Gaussian,
    "rational": js.potentials.Rational,
    "lennard-jones": js.potentials.LennardJones,
}
LOADS = {"gap": js.MeanGap, "pressure": js.MeanPressure}
compiled = set()


def solve(problem, tolerance):
    solid = js.HalfSpace(js.Grid(problem.heights.shape), problem.modulus)
    law = js.potentials.NoAdhesion()
    if problem.law != "none":
        law = LAWS[problem.law](problem.energy, problem.length)
    contact, load = js.Contact(solid, problem.heights, law), LOADS[problem.control](problem.value)
    solver = js.solvers.PreconditionedConjugateGradient(tolerance)
    kind = problem.heights.shape, problem.law, problem.control
    if kind not in compiled:
        js.equilibrate(contact, load, solver, throw=False)
        compiled.add(kind)
    start = process_time()
    state = jax.block_until_ready(js.equilibrate(contact, load, solver))
    return np.asarray(state.gap), process_time() - start

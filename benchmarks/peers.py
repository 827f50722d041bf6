"""Time to equilibrium of jaxstab and of its peers, on the same problems, with one thread each.

The peers are Tamaas' `PolonskyKeerRey`; without adhesion the conjugate gradients of
ContactMechanics; with adhesion the solver of Adhesion, L-BFGS-B, and NuMPI's `tr_newton_bounded` on
the same energy. Where there is a choice, it is made in their favour:
- Accuracy is jaxstab's optimality residual of each answer. A peer's tolerance is tuned until its
  answer is about as accurate as jaxstab's or less so, as long as the gaps agree.
- What a peer sets up before it solves is not timed; jaxstab's compilation has a column of its own.
- The solvers of Adhesion and NuMPI need a rigid offset. They are given that of jaxstab's answer,
  without a search.
- Above 1024 points a side, where Tamaas takes many minutes, tolerances are those that the last
  smaller grid was tuned to, and each peer runs once.

Runs of jaxstab and of the peer alternate, on the last core that is allowed (choose with `taskset`),
and medians are printed. Steps of NuMPI are its Hessian products, those of Adhesion its gradients.
"""

import os

# Before any library starts its threads. It is the pinning that holds XLA to one of them.
os.environ |= {
    "JAX_PLATFORMS": "cpu",
    "OMP_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import argparse
import math
import re
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple, TextIO

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js

TOLERANCE = 1e-8
# The largest grid on which a peer's tolerance is tuned and runs are repeated.
TUNED = 1024
# The rms difference of the gaps over the rms height, from which on answers are different.
AGREEMENT = 1e-6
# The residual of a peer over jaxstab's that is near enough, and the most runs spent to get there.
NEAR_ENOUGH = 3.0
TRIALS = 6
COLUMNS = (
    "   n | k_high | problem     | peer             | compile + first [s] | jaxstab [s] | "
    "peer [s] | peer / jaxstab | steps      | residual: jaxstab, peer | gaps differ by"
)


class Problem(NamedTuple):
    n: int
    k_high: int
    is_adhesive: bool
    contact: js.Contact
    load: js.MeanGap | js.MeanPressure


class Answer(NamedTuple):
    gap: np.ndarray
    num_steps: int
    seconds: float


class Peer(NamedTuple):
    packages: tuple[str, ...]
    # Of a problem, its equilibrium and a tolerance.
    solve: Callable[[Problem, js.results.Equilibrium, float], Answer]
    # Without and with adhesion: the last one tuned, which is near the next, to spare runs.
    tolerance: dict[bool, float]


class NotConvergedError(Exception):
    pass


def main() -> None:
    options = parse_options()
    jax.config.update("jax_enable_x64", True)
    agree = True
    with options.out.open("w") as file:
        emit("float64; one thread\n", file)
        emit(f"| {COLUMNS} |\n|{re.sub('[^|]', '-', f'-{COLUMNS}-')}|", file)
        for n in options.sizes:
            repeats = options.repeats if n <= TUNED else 1
            for problem in problems(n):
                agree &= compare(problem, options.peers, repeats, file)
    if not agree:
        sys.exit("Answers differ, or a peer did not converge: see the rows marked with !")


def parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[256, 512], help="points per side")
    parser.add_argument("--peers", nargs="+", choices=PEERS, default=list(PEERS))
    parser.add_argument("--repeats", type=int, default=3, help="runs of which medians are taken")
    parser.add_argument("--out", type=Path, default=os.devnull, help="a file for the table as well")
    options = parser.parse_args()
    missing = [p for name in options.peers for p in PEERS[name].packages if not find_spec(p)]
    if missing:
        parser.error(f'{", ".join(missing)} not installed: pip install "jaxstab[peers]"')
    return options


def emit(text: str, file: TextIO) -> None:
    print(text, flush=True)
    print(text, file=file, flush=True)


def problems(n: int) -> Iterator[Problem]:
    """Yield rough contacts of E* = 1 on n x n points of the unit square."""
    grid = js.Grid(n)
    solid = js.HalfSpace(grid, youngs_modulus=1.0, poisson_ratio=0.0)
    for k_high in sorted({32, n // 8}):
        heights = js.surfaces.self_affine(
            grid, jax.random.key(0), hurst=0.8, k_low=2, k_rolloff=2, k_high=k_high, rms_slope=0.1
        )
        scale = 32 / k_high
        bare = js.Contact(solid, heights, js.potentials.NoAdhesion())
        yield Problem(n, k_high, False, bare, js.MeanPressure(0.005))
        adhesion = js.potentials.Exponential(surface_energy=2e-5 * scale, length=1e-3 * scale)
        load = js.MeanGap(js.surfaces.rms_height(heights))
        yield Problem(n, k_high, True, js.Contact(solid, heights, adhesion), load)


def compare(problem: Problem, names: list[str], repeats: int, file: TextIO) -> bool:
    """Write one row for each peer, and return whether all of them agree with jaxstab."""
    jax.clear_caches()
    equilibrium, first = solve_jaxstab(problem)
    kind = "adhesive" if problem.is_adhesive else "no adhesion"
    case = f"{problem.n:4d} | {problem.k_high:6d} | {kind:11s}"
    agree = True
    for name in names:
        if problem.is_adhesive not in PEERS[name].tolerance:
            continue
        row = f"| {case} | {name:16s} | {first:19.2f} |"
        try:
            ours, theirs, answer = alternate(problem, PEERS[name], equilibrium, repeats)
        except NotConvergedError as error:
            emit(f"{row} ! {error} |", file)
            agree = False
            continue
        steps = f"{equilibrium.num_steps}, {answer.num_steps}"
        residuals = f"{residual(problem, equilibrium.gap):.1e}, {residual(problem, answer.gap):.1e}"
        apart = difference(problem, equilibrium, answer)
        row += f" {ours:11.3f} | {theirs:8.3f} | {theirs / ours:14.1f} | {steps:10s} |"
        emit(f"{row} {residuals:23s} |{' !'[apart >= AGREEMENT]}{apart:14.1e} |", file)
        agree &= apart < AGREEMENT
    return agree


def alternate(
    problem: Problem, peer: Peer, equilibrium: js.results.Equilibrium, repeats: int
) -> tuple[float, float, Answer]:
    """Return median seconds of jaxstab and of the peer, run in turn, and the peer's answer."""
    if problem.n <= TUNED:
        peer.tolerance[problem.is_adhesive] = tune(problem, peer, equilibrium)
    tolerance = peer.tolerance[problem.is_adhesive]
    ours, theirs = [], []
    for _ in range(repeats):
        ours.append(solve_jaxstab(problem)[1])
        answer = peer.solve(problem, equilibrium, tolerance)
        theirs.append(answer.seconds)
    return median(ours), median(theirs), answer


def tune(problem: Problem, peer: Peer, equilibrium: js.results.Equilibrium) -> float:
    """Return the tolerance, of a few tried, that is nearest to jaxstab's accuracy from above."""
    target = residual(problem, equilibrium.gap)
    tolerance = peer.tolerance[problem.is_adhesive]
    tried: dict[float, tuple[bool, bool, float]] = {}
    for _ in range(TRIALS):
        answer = peer.solve(problem, equilibrium, tolerance)
        excess = residual(problem, answer.gap) / target
        differs = difference(problem, equilibrium, answer) >= AGREEMENT
        rank = (differs, excess < 1, abs(math.log(excess)))
        # Newton's method jumps over whole ranges of residuals: then an answer comes back.
        is_back = rank in tried.values()
        tried[tolerance] = rank
        has_looser = not min(tried.values())[1]
        if 1 <= excess <= NEAR_ENOUGH or (is_back and has_looser):
            break
        factor = 1e3 if is_back else math.sqrt(NEAR_ENOUGH) / excess
        tolerance *= min(max(factor, 1e-3), 1e3)
    return min(tried, key=lambda tolerance: tried[tolerance])


def residual(problem: Problem, gap: np.ndarray | jax.Array) -> float:
    """Return jaxstab's optimality residual of an answer; contact is where its gap is zero."""
    control = problem.contact.control(problem.load)
    return float(problem.contact.balance(control)(jnp.asarray(gap)).residual)


def difference(problem: Problem, equilibrium: js.results.Equilibrium, answer: Answer) -> float:
    """Return the rms difference of the gaps over the rms height."""
    rms = np.sqrt(np.mean((answer.gap - np.asarray(equilibrium.gap)) ** 2))
    return float(rms / js.surfaces.rms_height(problem.contact.heights))


def solve_jaxstab(problem: Problem) -> tuple[js.results.Equilibrium, float]:
    solver = js.solvers.PreconditionedConjugateGradient(TOLERANCE)
    start = time.perf_counter()
    equilibrium = js.equilibrate(problem.contact, problem.load, solver)
    jax.block_until_ready(equilibrium)
    return equilibrium, time.perf_counter() - start


def solve_tamaas(problem: Problem, _: js.results.Equilibrium, tolerance: float) -> Answer:
    """Solve for the gap at its mean or, without adhesion, for the pressure at its mean."""
    import tamaas

    class Counter(tamaas.Functional):
        count = -2  # it is called once before the steps, and once after

        def computeF(self, *_: object) -> float:
            return 0.0

        def computeGradF(self, *_: object) -> None:
            self.count += 1

    tamaas.initialize(1)
    tamaas.set_log_level(tamaas.LogLevel.error)
    heights, potential = np.array(problem.contact.heights), problem.contact.potential
    model = tamaas.Model(tamaas.model_type.basic_2d, [1.0, 1.0], list(heights.shape))
    model.E, model.nu = 1.0, 0.0
    kind = tamaas.PolonskyKeerRey
    kind = kind.gap if problem.is_adhesive else kind.pressure
    solver = tamaas.PolonskyKeerRey(model, heights, tolerance, kind, kind)
    solver.max_iter = 20_000
    counter = Counter()
    solver.addFunctionalTerm(counter)
    if problem.is_adhesive:
        adhesion = tamaas.ExponentialAdhesionFunctional(heights)
        energy, length = float(potential.surface_energy), float(potential.length)
        adhesion.parameters = {"surface_energy": energy, "rho": length}
        solver.addFunctionalTerm(adhesion)
    start = time.perf_counter()
    error = solver.solve(float(problem.load.value))
    seconds = time.perf_counter() - start
    if not error <= tolerance:
        raise NotConvergedError(f"Tamaas: error {error:.1e}, tolerance {tolerance:.1e}")
    gap = np.array(model.displacement) - heights
    if not problem.is_adhesive:
        # Points that carry pressure touch; the noise in their gap is not jaxstab's idea of that.
        touches = np.array(model.traction) > 0
        gap = np.where(touches, 0, gap - gap[touches].mean())
    return Answer(np.maximum(gap, 0), counter.count, seconds)


def solve_contact_mechanics(
    problem: Problem, _: js.results.Equilibrium, tolerance: float
) -> Answer:
    """Solve for the pressure at its mean, without adhesion."""
    from ContactMechanics import PeriodicFFTElasticHalfSpace
    from ContactMechanics.Optimization import constrained_conjugate_gradients
    from SurfaceTopography import Topography

    heights, pressure = np.array(problem.contact.heights), float(problem.load.value)
    solid = PeriodicFFTElasticHalfSpace(heights.shape, 1.0, (1.0, 1.0))
    start = time.perf_counter()
    result = constrained_conjugate_gradients(
        solid,
        Topography(heights, (1.0, 1.0), periodic=True),
        external_force=pressure,
        pentol=tolerance * heights.std(),
        forcetol=tolerance * pressure * solid.area_per_pt,
        thermotol=tolerance,
        maxiter=20_000,
    )
    seconds = time.perf_counter() - start
    if not result.success:
        raise NotConvergedError(f"ContactMechanics: {result.message}")
    # Points that carry pressure touch, as for Tamaas.
    gap = np.where(result.jac > 0, 0, result.x - heights - result.offset)
    return Answer(np.maximum(gap, 0), result.nit, seconds)


def solve_adhesion(
    problem: Problem, equilibrium: js.results.Equilibrium, tolerance: float
) -> Answer:
    """Solve for the displacement by the solver of Adhesion, L-BFGS-B."""
    system, offset = adhesive_system(problem, equilibrium)
    limits = {"maxiter": 20_000, "maxfun": 20_000}
    start = time.perf_counter()
    result = system.minimize_proxy(
        offset=offset, options={"gtol": tolerance * system.area_per_pt, "ftol": 0.0, **limits}
    )
    seconds = time.perf_counter() - start
    if not result.success:
        raise NotConvergedError(f"Adhesion: {result.message}")
    gap = result.x.reshape(problem.contact.grid.shape) - problem.contact.heights - offset
    return Answer(np.maximum(gap, 0), result.nfev, seconds)


def solve_numpi(problem: Problem, equilibrium: js.results.Equilibrium, tolerance: float) -> Answer:
    """Solve for the gap by the Newton method of NuMPI."""
    from NuMPI.Optimization import tr_newton_bounded

    system, offset = adhesive_system(problem, equilibrium)
    objective = system.primal_objective(offset, gradient=True)
    # No displacement.
    gap = np.maximum(-offset - np.array(problem.contact.heights), 0)
    forces = tolerance * system.area_per_pt
    start = time.perf_counter()
    result = tr_newton_bounded(
        objective,
        gap,
        system.primal_hessian_product,
        bounds_lo=0.0,
        gtol=forces,
        maxiter=1000,
    )
    seconds = time.perf_counter() - start
    if not result.success:
        raise NotConvergedError(f"NuMPI: {result.message}")
    return Answer(result.x, result.nb_hessp, seconds)


def adhesive_system(problem: Problem, equilibrium: js.results.Equilibrium) -> tuple[Any, float]:
    """Return the system of Adhesion, and the rigid offset of an equilibrium.

    The half space also carries a mean displacement, with the stiffness K0 of its longest waves,
    and u - h less the offset is the gap. At equilibrium the mean pressure is p0 = K0 mean(u).
    """
    from Adhesion.Interactions import Exponential
    from Adhesion.System import BoundedSmoothContactSystem
    from ContactMechanics import PeriodicFFTElasticHalfSpace
    from SurfaceTopography import Topography

    heights, potential = np.array(problem.contact.heights), problem.contact.potential
    solid = PeriodicFFTElasticHalfSpace(heights.shape, 1.0, (1.0, 1.0))
    adhesion = Exponential(float(potential.surface_energy), float(potential.length))
    surface = Topography(heights, (1.0, 1.0), periodic=True)
    system = BoundedSmoothContactSystem(solid, adhesion, surface)
    mean_displacement = float(equilibrium.mean_pressure) / solid.surface_stiffness[0, 0].real
    return system, mean_displacement - float(problem.load.value) - heights.mean()


PEERS = {
    "tamaas": Peer(("tamaas",), solve_tamaas, {False: 2e-8, True: 3e-7}),
    "contactmechanics": Peer(("ContactMechanics",), solve_contact_mechanics, {False: 1e-8}),
    "adhesion": Peer(("Adhesion", "ContactMechanics"), solve_adhesion, {True: 1e-8}),
    "numpi": Peer(("NuMPI", "Adhesion", "ContactMechanics"), solve_numpi, {True: 1e-8}),
}


if __name__ == "__main__":
    main()

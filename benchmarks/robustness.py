"""Outcomes of the equilibrium solvers on many random problems, side by side.

Surfaces of 64 x 64 and 128 x 128 points, four laws, adhesion over four decades of strength, and
mean gaps from nearly full contact to detached. An outcome is the solver's own result, and what is
checked from outside: that no step raised the energy, and that the state is no saddle, by the
smallest eigenvalue of the Hessian where points in contact stay and the mean gap is held.
"""

import argparse
import time
import warnings
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

import jaxstab as js

SOLVERS = (js.solvers.PreconditionedConjugateGradient(), js.solvers.PolonskyKeerRey())
LAWS = (
    js.potentials.Exponential,
    js.potentials.Gaussian,
    js.potentials.Rational,
    js.potentials.LennardJones,
)
# Relative to the stiffest wave, and to the largest energy: what rounding may do.
SADDLE = 1e-8
ROUNDING = 1e-12


class Outcome(NamedTuple):
    result: str
    num_steps: int
    rises: bool
    is_saddle: bool


def main() -> None:
    options = parse_options()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)
    lines = [
        f"{options.problems} random problems, float64; steps are those of the successful ones",
        "",
        "| solver | outcomes | energy rose | saddles | steps: median, 90 %, most | seconds |",
        "|---|---|---|---|---|---|",
    ]
    for solver in SOLVERS:
        start = time.perf_counter()
        outcomes = [outcome(solver, seed) for seed in range(options.problems)]
        lines.append(row(solver, outcomes, time.perf_counter() - start))
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=500)
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    return parser.parse_args()


def random_problem(seed: int) -> tuple[js.Contact, js.MeanGap]:
    random = np.random.default_rng(seed)
    n, law = (64, 128)[seed % 2], LAWS[seed // 2 % len(LAWS)]
    grid = js.Grid(n)
    rms_height = 10 ** random.uniform(-2.5, -0.5)
    heights = js.surfaces.self_affine(
        grid,
        jax.random.key(seed),
        hurst=random.uniform(0.3, 1.0),
        k_high=int(random.choice([8, 16, n // 4])),
        rms_height=rms_height,
    )
    bare = js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.NoAdhesion())
    length = rms_height * 10 ** random.uniform(-1, 1)
    stress = float(bare.conforming_pressure) * 10 ** random.uniform(-2, 2)
    load = js.MeanGap(rms_height * 10 ** random.uniform(-3, 0.7))
    return js.Contact(bare.solid, heights, law(stress * length, length)), load


def outcome(solver, seed: int) -> Outcome:
    contact, load = random_problem(seed)
    equilibrium = js.equilibrate(contact, load, solver, throw=False)
    energies = np.asarray(equilibrium.history.values.get("energy", [0.0]))
    energies = energies[np.isfinite(energies)]
    rises = np.diff(energies).max(initial=0) > ROUNDING * np.abs(energies).max(initial=0)
    result = equilibrium.result.name
    found = result == "successful"
    is_saddle = found and is_a_saddle(contact, equilibrium)
    return Outcome(result, int(equilibrium.num_steps), bool(rises), is_saddle)


def is_a_saddle(contact: js.Contact, equilibrium: js.results.Equilibrium) -> bool:
    """Return whether a perturbation of zero mean, zero in contact, lowers the energy."""
    multiplier = np.asarray(contact.solid.waves.multiplier)
    curvature = np.asarray(contact.curvature(equilibrium.gap))
    free = ~np.asarray(equilibrium.in_contact)
    count = int(free.sum())
    if count < 4:
        return False
    # Scaled by each point's own stiffness, which leaves the signs, the eigenvalues lie within 2.
    scale = 1 / np.sqrt(multiplier.max() + np.maximum(curvature[free], 0))
    constant = scale / np.linalg.norm(scale)

    def hessian(values: np.ndarray) -> np.ndarray:
        field = np.zeros(free.shape)
        field[free] = scale * (values - constant * (constant @ values))
        waves = np.fft.irfft2(multiplier * np.fft.rfft2(field), field.shape)
        product = scale * (waves + curvature * field)[free]
        # What changes the mean gap is put out of the way.
        return product + constant * (2 * constant @ values - constant @ product)

    operator = LinearOperator((count, count), matvec=hessian, dtype=float)
    start = np.random.default_rng(0).normal(size=count)
    try:
        smallest = eigsh(operator, 1, which="SA", v0=start, tol=1e-4, return_eigenvectors=False)
    except ArpackNoConvergence as error:
        smallest = error.eigenvalues
    return bool(smallest.min(initial=np.inf) < -SADDLE)


def row(solver, outcomes: list[Outcome], seconds: float) -> str:
    results = Counter(outcome.result for outcome in outcomes)
    counts = ", ".join(f"{count} {result}" for result, count in results.most_common())
    rises = sum(outcome.rises for outcome in outcomes)
    measured = (
        str(rises) if isinstance(solver, js.solvers.PreconditionedConjugateGradient) else "not kept"
    )
    saddles = sum(outcome.is_saddle for outcome in outcomes)
    steps = [outcome.num_steps for outcome in outcomes if outcome.result == "successful"]
    most = f"{np.median(steps):.0f}, {np.quantile(steps, 0.9):.0f}, {max(steps)}"
    name = type(solver).__name__
    return f"| {name} | {counts} | {measured} | {saddles} | {most} | {seconds:.0f} |"


if __name__ == "__main__":
    main()

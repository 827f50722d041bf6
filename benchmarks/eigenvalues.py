"""Cost of the smallest eigenvalues of the Hessian, against Algorithm 1 and against SciPy.

On the cone V0+, `assess_stability` with its default solver, whose three numbers are all counted,
against Algorithm 1 (`ProximalIteration`), of which only the cone's number is: to the same projected
residual of a unit vector. The column "verdict" counts what is enough for the verdict alone
(`verdict_only`). On the space of zero mean, `lowest_modes` against ARPACK (`eigsh`) and
LOBPCG of SciPy: to the same residual, in units of the size of A. Where there is a choice, it is
made in SciPy's favour: `eigsh` is given the tolerance that follows from the known eigenvalue, and
LOBPCG the shift that follows from the known mode.

A pair is one forward and one inverse Fourier transform, in A or in a preconditioner; "over pairs"
is the time over that of as many pairs alone, in the same run. All run on one
thread of the last core that is allowed (choose with `taskset`). Seconds are of that processor's
time and without compilation, which has a column of its own and is done once for each law and size;
they are medians of repeats, but for Algorithm 1 and SciPy, which run once.
"""

import os

# Before any library starts its threads.
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import argparse
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median
from typing import NamedTuple

import jax
import numpy as np
import scipy
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh, lobpcg

import jaxstab as js
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.eigenpair import Eigenpair, eigenpair_of
from jaxstab.stability.lowest_modes import noise

TOLERANCE = 1e-7
GROWTH_SIZES = [128, 256, 512, 1024]
# Eigenvalues higher than Algorithm 1's by more than this, relative to the bound, are marked.
HIGHER = 1e-9
# The blocks of SciPy's LOBPCG, its most steps, and the most restarts of ARPACK.
BLOCKS = (1, 4)
MAX_STEPS, MAX_RESTARTS = 5000, 2000
# Young's modulus, the law with gamma and rho, and mean displacements from contact to detached.
SERIES = {
    "exponential": (1.0, js.potentials.Exponential, (1.0, 0.1), (0.5, 0.8, 1.0)),
    "gaussian": (1.0, js.potentials.Gaussian, (1.0, 0.1), (0.105, 0.9)),
    "rational": (1.0, js.potentials.Rational, (1.0, 0.1), (0.008, 0.65, 1.5)),
    "unloading": (1e-3, js.potentials.Exponential, (1e-2, 1.0), (1e-3, 0.1, 0.5, 1.0, 2.0)),
}
CONE_COLUMNS = (
    "   n | case                 | contact | verdict | pairs | Algorithm 1 | ratio  | fast [s] | "
    "over pairs | Algorithm 1 [s] | ratio  | compile [s] | difference     | Algorithm 1 ended as"
)
SPACE_COLUMNS = (
    "   n | case                 | method                   | pairs | seconds | "
    "residual / scale | eigenvalue      "
)


class State(NamedTuple):
    name: str
    contact: js.Contact
    equilibrium: js.results.Equilibrium


def main() -> None:
    options = parse_options()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)
    with open(options.out, "w") as file:
        for line in lines(options):
            print(line, flush=True)
            print(line, file=file, flush=True)


def parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[128, 256, 512], help="points/side")
    parser.add_argument("--repeats", type=int, default=3, help="runs of which medians are taken")
    parser.add_argument(
        "--growth", type=int, nargs="+", default=GROWTH_SIZES, help="sizes to count"
    )
    only = "only count the pairs of the default solver"
    parser.add_argument("--skip-reference", action="store_true", help=only)
    parser.add_argument(
        "--out", type=Path, default=os.devnull, help="a file for the tables as well"
    )
    return parser.parse_args()


def lines(options: argparse.Namespace) -> Iterator[str]:
    yield f"float64; one thread; tolerance {TOLERANCE:g}"
    if not options.skip_reference:
        yield from compare_on_cone(options.sizes, options.repeats)
        yield from compare_on_space(options.sizes, options.repeats)
    yield from tabulate_growth(options.growth)


def head(title: str, columns: str) -> str:
    rule = "|".join("-" * len(column) for column in f" {columns} ".split("|"))
    return f"\n{title}\n\n| {columns} |\n|{rule}|"


def states(n: int) -> Iterator[State]:
    grid = js.Grid(n)
    k_high = min(32, n // 4)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=k_high, rms_height=0.1)
    for name, (youngs_modulus, law, parameters, displacements) in SERIES.items():
        contact = js.Contact(js.HalfSpace(grid, youngs_modulus), heights, law(*parameters))
        for displacement in displacements:
            equilibrium = js.equilibrate(contact, js.MeanDisplacement(displacement))
            yield State(f"{name:11s} at {displacement:g}", contact, equilibrium)


def compare_on_cone(sizes: list[int], repeats: int) -> Iterator[str]:
    yield head("On the cone V0+", CONE_COLUMNS)
    ratios: dict[int, list[tuple[float, ...]]] = {}
    for n in sizes:
        for state in states(n):
            row, *numbers = compare_with_algorithm_1(state, repeats)
            yield f"| {n:4d} | {state.name:20s} | {row} |"
            ratios.setdefault(n, []).append(tuple(numbers))
    yield "\nAlgorithm 1 over the default solver, and that over its pairs alone, median and worst:"
    for n, rows in ratios.items():
        pairs, seconds, over_pairs = np.transpose(rows)
        yield (
            f"- n = {n}: {np.median(pairs):.1f} and {pairs.min():.1f} in pairs, "
            f"{np.median(seconds):.1f} and {seconds.min():.1f} in seconds; "
            f"{np.median(over_pairs):.2f} and {over_pairs.max():.2f} over pairs"
        )


def compare_with_algorithm_1(state: State, repeats: int) -> tuple[str, float, float, float]:
    """Return what a row says, the ratios of pairs and of seconds, and time over transforms."""
    _, contact, equilibrium = state
    first, ours, stability = timed(
        lambda: js.assess_stability(contact, equilibrium, throw=False), repeats
    )
    field, number = jax.device_put(equilibrium.gap), count(stability)
    _, alone, _ = timed(lambda: transform_pairs(field, number), repeats)
    brief = js.ProximalIteration(max_steps=1)
    setup, shortest, _ = timed(lambda: algorithm_1(contact, equilibrium, brief), 1)
    _, theirs, pair = timed(lambda: algorithm_1(contact, equilibrium, js.ProximalIteration()), 0)
    proof = js.assess_stability(contact, equilibrium, verdict_only=True, throw=False)
    pairs, their_pairs = count(stability), int(pair.num_applications)
    apart = stability.cone.eigenvalue - pair.eigenvalue
    apart = float(apart / contact.hessian(equilibrium.gap).bound)
    result = pair.result.name
    at_least = "" if result == "successful" else ">="
    row = (
        f"{100 * equilibrium.contact_area:6.2f}% | {count(proof):7d} | {pairs:5d} | "
        f"{f'{at_least}{their_pairs}':>11s} | {their_pairs / pairs:6.1f} | "
        f"{ours:8.3f} | {ours / alone:10.2f} | {theirs:15.2f} | {theirs / ours:6.1f} | "
        f"{max(first - ours, 0):4.1f}, {max(setup - shortest, 0):4.1f}  | "
        f"{apart:+.0e} {'higher' if apart > HIGHER else '':7s} | {result!s:20s}"
    )
    return row, their_pairs / pairs, theirs / ours, ours / alone


@jax.jit
def algorithm_1(
    contact: js.Contact, equilibrium: js.results.Equilibrium, solver: js.ProximalIteration
) -> Eigenpair:
    """Do what `assess_stability` does on the cone, without looking for a lower eigenvalue."""
    hessian, cone = contact.hessian(equilibrium.gap), AdmissibleCone(equilibrium.in_contact)
    start = noise(jax.random.key(0), 4, equilibrium.gap)
    found = solver.solve(hessian, cone, start)
    return eigenpair_of(hessian, cone, found, found.vector)


@jax.jit
def transform_pairs(field: jax.Array, number: int) -> jax.Array:
    """Do a number of pairs of transforms, and the multiplication between the two."""

    def pair(_: int, field: jax.Array) -> jax.Array:
        return jax.numpy.fft.irfftn(0.5 * jax.numpy.fft.rfftn(field), s=field.shape)

    return jax.lax.fori_loop(0, number, pair, field)


def count(stability: js.results.Stability) -> int:
    """Return the pairs of all three numbers."""
    return sum(int(pair.num_applications) for pair in stability.pairs.values())


def timed(run: Callable[[], object], repeats: int) -> tuple[float, float, object]:
    """Return the seconds of a first run, the median of more, and the last result."""
    seconds = []
    for _ in range(1 + repeats):
        start = time.process_time()
        result = jax.block_until_ready(run())
        seconds.append(time.process_time() - start)
    return seconds[0], median(seconds[1:] or seconds), result


class Hessian:
    """A on fields of zero mean, in NumPy; the constant field is put out of the way.

    It counts pairs, and keeps the shift s of the preconditioner 1 / (K + s).
    """

    def __init__(self, state: State, mode: np.ndarray):
        hessian = state.contact.hessian(state.equilibrium.gap)
        self.shape = state.contact.grid.shape
        self.multiplier = np.asarray(hessian.solid.multiplier)
        self.curvature = np.asarray(hessian.curvature)
        self.scale = float(hessian.scale)
        elastic = float(mode.ravel() @ self.convolved(mode, self.multiplier).ravel())
        self.shift = max(elastic, self.multiplier[self.multiplier > 0].min())
        self.pairs = 0

    def operator(self, apply: Callable[[np.ndarray], np.ndarray]) -> LinearOperator:
        def product(columns: np.ndarray) -> np.ndarray:
            fields = columns.T.reshape(-1, *self.shape)
            self.pairs += len(fields)
            return apply(fields).reshape(columns.T.shape).T

        size = self.curvature.size
        return LinearOperator((size, size), product, matmat=product, dtype=float)

    def apply(self, fields: np.ndarray) -> np.ndarray:
        means = fields.mean((-2, -1), keepdims=True)
        fields = fields - means
        product = self.convolved(fields, self.multiplier) + self.curvature * fields
        return product - product.mean((-2, -1), keepdims=True) + self.scale * means

    def precondition(self, fields: np.ndarray) -> np.ndarray:
        return self.convolved(fields, 1 / (self.multiplier + self.shift))

    def convolved(self, fields: np.ndarray, multiplier: np.ndarray) -> np.ndarray:
        return scipy.fft.irfft2(multiplier * scipy.fft.rfft2(fields), self.shape)

    def measure(self, vector: np.ndarray) -> tuple[float, float]:
        """Return the residual over the scale, and the eigenvalue, of a vector."""
        mode = vector.reshape(self.shape) / np.linalg.norm(vector)
        product = self.apply(mode)
        eigenvalue = float(np.sum(mode * product))
        return float(np.linalg.norm(product - eigenvalue * mode)) / self.scale, eigenvalue


def compare_on_space(sizes: list[int], repeats: int) -> Iterator[str]:
    yield head("On the space of zero mean", SPACE_COLUMNS)
    costs: dict[tuple[int, str], list[tuple[int, float]]] = {}
    for n in sizes:
        for state in states(n):
            for method, pairs, seconds, (residual, eigenvalue) in eigensolvers(state, repeats):
                yield (
                    f"| {n:4d} | {state.name:20s} | {method:24s} | {pairs:5d} | {seconds:7.2f} | "
                    f"{residual:16.1e} | {eigenvalue:+.9e} |"
                )
                costs.setdefault((n, method), []).append((pairs, seconds))
    yield "\nPairs and seconds, median and most:"
    for (n, method), rows in costs.items():
        pairs, seconds = np.transpose(rows)
        yield (
            f"- n = {n}, {method}: {np.median(pairs):.0f} and {pairs.max():.0f} pairs, "
            f"{np.median(seconds):.2f} and {seconds.max():.2f} s"
        )


def eigensolvers(state: State, repeats: int) -> Iterator[tuple]:
    """Yield for each its name, pairs, seconds, and the residual and eigenvalue of its answer."""
    _, seconds, modes = timed(
        lambda: js.lowest_modes(state.contact, state.equilibrium, 1, throw=False), repeats
    )
    mode = np.asarray(modes.mode[0])
    hessian = Hessian(state, mode)
    yield "jaxstab Davidson", int(modes.num_applications[0]), seconds, hessian.measure(mode)
    starts = np.random.default_rng(0).normal(size=(mode.size, max(BLOCKS)))
    starts -= starts.mean(0)
    apply, precondition = map(hessian.operator, (hessian.apply, hessian.precondition))
    residual = TOLERANCE * hessian.scale

    def arpack() -> np.ndarray:
        tolerance = residual / abs(float(modes.eigenvalue[0]))
        settings = {"v0": starts[:, 0], "maxiter": MAX_RESTARTS, "tol": tolerance}
        try:
            return eigsh(apply, 1, which="SA", **settings)[1]
        except ArpackNoConvergence:
            return np.full(mode.size, np.nan)

    def blocks(size: int, preconditioner: LinearOperator | None) -> np.ndarray:
        held = {"M": preconditioner, "Y": np.ones((mode.size, 1))}
        settings = {"tol": residual, "maxiter": MAX_STEPS, "largest": False}
        values, vectors = lobpcg(apply, starts[:, :size], **held, **settings)
        return vectors[:, np.argmin(values)]

    runs = {"eigsh": arpack}
    for size in BLOCKS:
        runs[f"lobpcg, block {size}"] = partial(blocks, size, None)
        runs[f"lobpcg, block {size}, 1/(K+s)"] = partial(blocks, size, precondition)
    for name, run in runs.items():
        hessian.pairs = 0
        with warnings.catch_warnings(action="ignore"):
            _, seconds, vector = timed(run, 0)
        yield name, hessian.pairs, seconds, hessian.measure(vector)


def tabulate_growth(sizes: list[int]) -> Iterator[str]:
    columns = [f"{'case':20s}", *(f"{n:5d}" for n in sizes), "last / first"]
    yield head("Pairs of the default solver, for all three numbers", " | ".join(columns))
    pairs: dict[str, list[int]] = {}
    for n in sizes:
        for name, *problem in states(n):
            pairs.setdefault(name, []).append(count(js.assess_stability(*problem, throw=False)))
    for name, counts in pairs.items():
        cells = " | ".join(f"{each:5d}" for each in counts)
        yield f"| {name:20s} | {cells} | {counts[-1] / counts[0]:12.2f} |"


if __name__ == "__main__":
    main()

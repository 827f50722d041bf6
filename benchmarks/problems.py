"""An open set of test problems, and the solvers that run on it.

The set has the 500 random problems of `robustness.py` and 40 rough contacts on 256 x 256 points. A
problem is plain NumPy: heights, modulus, a law by name, a load. `--write FOLDER` writes each as
`.npz`, for solvers in other languages.

A solver is a file in `benchmarks/solvers/` with a function `solve(problem, tolerance)`, which
returns the gap and the processor seconds of the solution, without setting up or compiling. It
raises `NotImplementedError` for a problem that it does not offer, and any other exception if it
fails. It is called with a relative tolerance of 1e-6 and, until its answer is good, 1e-8 and 1e-10.
The run that gives a good answer is timed. A longer one than 20 s has failed, and a failure counts
as 20 s.

An answer is good if no gap is negative, the load is met to 1e-8, and the residual is at most 1e-6.
The residual is evaluated here in NumPy: the rms value of min(k g, K u + p0 + f'(g)), which is zero
where either the gap closes and the reaction is not negative, or the net pressure vanishes (k: the
stiffness of the shortest wave). It is relative to the larger one of the rms values of K u and f'.
"""

import argparse
import os

# Before any library starts its threads: one for each solver.
os.environ |= {
    "JAX_PLATFORMS": "cpu",
    "OMP_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np

TOLERANCES = 1e-6, 1e-8, 1e-10
RESIDUAL = 1e-6
LOAD = 1e-8
LIMIT = 20.0  # [s]
SHIFT = 0.01  # of the shifted geometric mean [s]
SOLVERS = Path(__file__).parent / "solvers"


@dataclass(frozen=True)
class Problem:
    """A rigid rough surface against a half space, on a unit square that repeats itself.

    Attributes:
        name: of the problem; those of one set begin alike.
        heights: of the surface, n x n.
        modulus: E*.
        law: the name of f: none, exponential, gaussian, rational or lennard-jones.
        energy, length: w and rho of the law.
        control: what the load holds, "gap" or "pressure", in the mean.
        value: of the load.
    """

    name: str
    heights: np.ndarray
    modulus: float
    law: str
    energy: float
    length: float
    control: str
    value: float

    def stiffness(self) -> np.ndarray:
        """Return K over the wavenumbers of `numpy.fft.rfft2`."""
        n = len(self.heights)
        x, y = np.fft.fftfreq(n, 1 / n)[:, None], np.fft.rfftfreq(n, 1 / n)
        return self.modulus * np.pi * np.hypot(x, y)

    def pressure(self, gap: np.ndarray) -> np.ndarray:
        """Return the elastic pressure K u of the displacement u = g + h."""
        spectrum = self.stiffness() * np.fft.rfft2(gap + self.heights)
        return np.fft.irfft2(spectrum, gap.shape)

    def law_and_derivatives(self, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return f(g), f'(g) and f''(g)."""
        w, rho, x = self.energy, self.length, gap / self.length
        if self.law == "exponential":
            value = w * np.exp(-x)
            return -value, value / rho, -value / rho**2
        if self.law == "gaussian":
            value = w * np.exp(-(x**2) / 2)
            return -value, x * value / rho, (1 - x**2) * value / rho**2
        if self.law == "rational":
            value = w / (1 + x**2)
            square = value / (1 + x**2)
            return -value, 2 * x * square / rho, square * (2 - 8 * x**2 / (1 + x**2)) / rho**2
        if self.law == "lennard-jones":
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
                y = 1 / x**3
                slope, curvature = y / x * (1 - y**2), y / x**2 * (10 * y**2 - 4)
                return w / 2 * y * (y**2 - 3), 4.5 * w / rho * slope, 4.5 * w / rho**2 * curvature
        return np.zeros_like(gap), np.zeros_like(gap), np.zeros_like(gap)

    def residual(self, gap: np.ndarray) -> float:
        """Return the relative residual of the conditions of an equilibrium."""
        elastic, slope = self.pressure(gap), self.law_and_derivatives(gap)[1]
        net, closing = elastic + slope, self.stiffness().max() * gap

        def conditions(mean: float) -> np.ndarray:
            # No gap closes against a core.
            is_core = self.law == "lennard-jones"
            return net + mean if is_core else np.minimum(closing, net + mean)

        mean = self.value
        if self.control == "gap":
            # The multiplier of the mean gap: their sum grows with it.
            low, high = -net.max() - 1e-300, -net.min() + 1e-300
            for _ in range(200):
                mean = (low + high) / 2
                low, high = (mean, high) if conditions(mean).sum() < 0 else (low, mean)
        scale = max(_rms(elastic), _rms(slope))
        return _rms(conditions(mean)) / scale

    def is_met(self, gap: np.ndarray) -> bool:
        """Return whether the gap is admissible: nowhere negative, and of the mean of the load."""
        is_met = self.control != "gap" or abs(gap.mean() / self.value - 1) <= LOAD
        return bool(np.isfinite(gap).all() and gap.min() >= 0 and is_met)


def _rms(field: np.ndarray) -> float:
    return float(np.sqrt(np.mean(field**2)))


def problems(every: int = 1) -> Iterator[Problem]:
    """Yield one in so many problems, the random ones first."""
    yield from random_problems(range(0, 500, every))
    yield from list(rough_problems())[::every]


def random_problems(seeds: range) -> Iterator[Problem]:
    """Yield those of `robustness.py`: four laws, strengths over four decades, all mean gaps."""
    import jax
    from robustness import random_problem

    jax.config.update("jax_enable_x64", True)
    names = {"Exponential": "exponential", "Gaussian": "gaussian", "Rational": "rational"}
    for seed in seeds:
        contact, load = random_problem(seed)
        law = contact.potential
        length = law.length if hasattr(law, "length") else law.equilibrium_gap
        name = names.get(type(law).__name__, "lennard-jones")
        numbers = float(law.surface_energy), float(length), "gap", float(load.value)
        yield Problem(f"random {seed}", np.array(contact.heights), 1.0, name, *numbers)


def rough_problems() -> Iterator[Problem]:
    """Yield contacts of five surfaces of rms slope 0.1: bare, weakly and strongly adhesive."""
    import jax

    import jaxstab as js

    jax.config.update("jax_enable_x64", True)
    grid = js.Grid(256)
    for seed in range(5):
        heights = js.surfaces.self_affine(
            grid, jax.random.key(seed), k_low=2, k_rolloff=2, k_high=32, rms_slope=0.1
        )
        rms = float(js.surfaces.rms_height(heights))
        settings = [
            *(("none", 0.0, 1.0, "pressure", value) for value in (0.001, 0.005, 0.03)),
            *(("exponential", 2e-5, 1e-3, "gap", share * rms) for share in (0.3, 1.0, 2.0)),
            ("exponential", 1e-4, 1e-3, "gap", rms),
            ("rational", 2e-5, 1e-3, "gap", rms),
        ]
        for law, energy, length, control, value in settings:
            name = f"rough {seed}, {law} {energy:g}, {control} {value:.2g}"
            yield Problem(name, np.array(heights), 1.0, law, energy, length, control, value)


@dataclass(frozen=True)
class Outcome:
    """The end of one solver on one problem: solved, failed or not offered."""

    end: str
    seconds: float
    residual: float


def run(solve: Callable, problem: Problem) -> Outcome:
    """Return the outcome with the loosest tolerance that gives a good answer."""
    best = np.inf
    for tolerance in TOLERANCES:
        try:
            gap, seconds = solve(problem, tolerance)
        except NotImplementedError:
            return Outcome("not offered", np.nan, np.nan)
        except Exception as error:  # a failure of whatever kind is one
            print(f"{problem.name}: {type(error).__name__}: {error}", file=sys.stderr)
            return Outcome("failed", LIMIT, best)
        gap = np.asarray(gap)
        if not problem.is_met(gap):
            return Outcome("failed", LIMIT, best)
        best = min(best, problem.residual(gap))
        if best <= RESIDUAL:
            return Outcome("solved" if seconds <= LIMIT else "failed", min(seconds, LIMIT), best)
    return Outcome("failed", LIMIT, best)


def shifted_geometric_mean(seconds: np.ndarray) -> float:
    """Return exp(mean(log(t + s))) - s."""
    return float(np.exp(np.mean(np.log(seconds + SHIFT))) - SHIFT) if seconds.size else np.nan


def table(outcomes: dict[str, list[Outcome]], names: list[str]) -> Iterator[str]:
    """Yield the lines of the table: a row for each part of the set and each solver."""
    yield (
        "| problems | solver | offered | solved | residual: median, largest | "
        "seconds, all offered | seconds, and of the first, solved by both |"
    )
    yield "|---|---|---|---|---|---|---|"
    for part in ("random", "rough"):
        chosen = [i for i, name in enumerate(names) if name.startswith(part)]
        first = next(iter(outcomes.values()))
        for solver, every in outcomes.items():
            offered = [every[i] for i in chosen if every[i].end != "not offered"]
            if not offered:
                continue
            solved = np.array([x.residual for x in offered if x.end == "solved"])
            residuals = f"{np.median(solved):.0e}, {solved.max():.0e}" if solved.size else ""
            of_all = shifted_geometric_mean(np.array([x.seconds for x in offered]))
            both = [i for i in chosen if first[i].end == every[i].end == "solved"]
            of_both, of_first = (
                shifted_geometric_mean(np.array([x[i].seconds for i in both]))
                for x in (every, first)
            )
            yield (
                f"| {len(chosen)} {part} | {solver} | {len(offered)} | {solved.size} | {residuals} "
                f"| {of_all:.3g} | {of_both:.3g}, {of_first:.3g} ({len(both)} problems) |"
            )


def load_solver(name: str) -> ModuleType:
    """Return the module of a file in the folder of solvers."""
    spec = spec_from_file_location(f"solver_{name}", SOLVERS / f"{name}.py")
    assert spec and spec.loader
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> None:
    # The others are compared with the first.
    known = sorted((path.stem for path in SOLVERS.glob("*.py")), key=lambda x: (x != "jaxstab", x))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--solvers", nargs="+", choices=known, default=known)
    parser.add_argument("--write", type=Path, help="write the problems into a folder, and stop")
    parser.add_argument("--every", type=int, default=1, help="run one in so many problems")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    options = parser.parse_args()
    chosen = list(problems(options.every))
    if options.write:
        options.write.mkdir(parents=True, exist_ok=True)
        for number, problem in enumerate(chosen):
            np.savez(options.write / f"{number:03}.npz", **vars(problem))
        return
    outcomes: dict[str, list[Outcome]] = {}
    solvers = {name: load_solver(name) for name in options.solvers}
    for name, module in solvers.items():
        outcomes[name] = []
        for problem in chosen:
            outcomes[name].append(run(module.solve, problem))
            print(name, problem.name, outcomes[name][-1], file=sys.stderr, flush=True)
    rows = table(outcomes, [problem.name for problem in chosen])
    lines = ["float64; one thread", "", *rows]
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

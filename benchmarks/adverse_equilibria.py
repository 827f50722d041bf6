"""Equilibria of many adverse problems against NumPy: how often is one wrong and does not say so?

Random small surfaces, on lines and rectangles, some of them flat. Laws of every kind with range
and strength over ten decades each, units of pressure and length over the range of each precision,
and loads from a tenth of a percent of the surface's own gap or pressure to a hundred times it.

What says that it is successful is looked at from outside, in NumPy and the problem's own units of
length and modulus, by a law written out by hand. It is wrong where a gap is negative, the load is
not met, or the gap is further than a stated part of its own size from the equilibrium that Newton's
method on the active set goes to from there. Near a fold, where a gap says little, the residual
decides instead. The size of a gap is the rms height, or the gap's own deviation where that is
larger; between flat surfaces it is the gap. An error that rounding of the gap makes does not count.
"""

import argparse
import time
import warnings
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js

SHAPES = ((8, 8), (9, 12), (13,), (32,), (32, 9))
PRECISIONS = {"float64": np.float64, "float32": np.float32}
# Decades, to either side of one, of the units of pressure and of length.
UNITS = {"float64": (300, 100), "float32": (36, 12)}
# What is wrong: an error of the gap over its size, or near a fold a residual.
LIMITS = {"float64": 1e-5, "float32": 1e-2}
# Over the softest wave: the lowest eigenvalue below which a state is near a fold.
FOLD = 1e-3
LOADS = ("gap", "displacement", "pressure", "tension")


class Law(NamedTuple):
    """A law as jaxstab has it, and f'(g) and f''(g) of strength and range 1 by hand."""

    make: Callable
    slope: Callable
    curvature: Callable


def inverse_square(energy, length):
    return lambda gap: -energy / (1 + gap / length) ** 2


def sigmoid(x):
    return np.exp(-np.logaddexp(0, -x))


def dugdale(power: int) -> Callable:
    """Return the slope, or the curvature, of Dugdale's law with its smoothing of 0.1."""

    def derivative(x):
        attraction = sigmoid(10 * (1 - x)) * 10 / np.logaddexp(0, 10)
        return attraction if power == 1 else -10 * attraction * sigmoid(10 * (x - 1))

    return derivative


LAWS = {
    "no adhesion": Law(
        lambda energy, length: js.potentials.NoAdhesion(), np.zeros_like, np.zeros_like
    ),
    "exponential": Law(js.potentials.Exponential, lambda x: np.exp(-x), lambda x: -np.exp(-x)),
    "gaussian": Law(
        js.potentials.Gaussian,
        lambda x: x * np.exp(-(x**2) / 2),
        lambda x: (1 - x**2) * np.exp(-(x**2) / 2),
    ),
    "rational": Law(
        js.potentials.Rational,
        lambda x: 2 * x / (1 + x**2) ** 2,
        lambda x: (2 - 6 * x**2) / (1 + x**2) ** 3,
    ),
    "Dugdale": Law(js.potentials.Dugdale, dugdale(1), dugdale(2)),
    "Lennard-Jones": Law(
        js.potentials.LennardJones,
        lambda x: 4.5 * (x**-4 - x**-10),
        lambda x: 45 * x**-11 - 18 * x**-5,
    ),
    "a function": Law(inverse_square, lambda x: 2 / (1 + x) ** 3, lambda x: -6 / (1 + x) ** 4),
}


class Problem(NamedTuple):
    """A problem in any units; its numbers have the precision that it is solved in."""

    seed: int
    precision: str
    law: str
    shape: tuple[int, ...]
    load: str
    lengths: np.ndarray
    heights: np.ndarray
    modulus: np.ndarray
    energy: np.ndarray
    length: np.ndarray
    value: np.ndarray


def main() -> None:
    options = parse_options()
    prepare()
    start = time.perf_counter()
    problems = map(random_problem, options.seeds or range(options.problems))
    groups = {law: [] for law in LAWS}
    for problem in problems:
        groups[problem.law].append(problem)
    outcomes = Counter()
    # Each law in a process of its own: a compiled program keeps memory for as long as one lives.
    spawn = get_context("spawn")
    with ProcessPoolExecutor(1, spawn, initializer=prepare, max_tasks_per_child=1) as pool:
        for law, judgements in zip(groups, pool.map(judge_all, groups.values()), strict=True):
            for problem, (outcome, detail) in zip(groups[law], judgements, strict=True):
                outcomes[problem.precision, outcome] += 1
                outcomes[law, outcome] += 1
                if outcome == "wrong" or options.seeds:
                    print(f"{outcome}: {described(problem)}: {detail}", flush=True)
            print(f"{law}: {time.perf_counter() - start:.0f} s", flush=True)
    count = sum(map(len, groups.values()))
    lines = report(count, outcomes, time.perf_counter() - start)
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def prepare() -> None:
    jax.config.update("jax_enable_x64", True)
    warnings.filterwarnings("ignore", "the grid of")
    np.seterr(all="ignore")


def judge_all(problems: list[Problem]) -> list[tuple[str, str]]:
    judgements = []
    for number, problem in enumerate(problems):
        # Each bare function is compiled anew, and memory mappings are few.
        if number % 50 == 0:
            jax.clear_caches()
        judgements.append(judged(problem))
    return judgements


def parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=2000)
    parser.add_argument("--seeds", type=int, nargs="+", help="only these, each with its outcome")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    return parser.parse_args()


def random_problem(seed: int) -> Problem:
    """Return a random problem in random units, all of its numbers normal ones."""
    random = np.random.default_rng(seed)
    precision = str(random.choice(list(PRECISIONS)))
    law, load = str(random.choice(list(LAWS))), str(random.choice(LOADS))
    shape = SHAPES[random.integers(len(SHAPES))]
    lengths = np.array([1.0, 1.5][: len(shape)])
    rms = 10 ** random.uniform(-3, 0)
    waves = wavenumbers(shape, lengths)
    filtered = np.fft.rfftn(random.normal(size=shape)) * np.maximum(waves, 1) ** -1.8 * (waves > 0)
    heights = np.fft.irfftn(filtered, shape, axes=range(len(shape)))
    heights *= rms / heights.std() * (random.random() > 0.05)
    heights += random.choice([0, 0, rms])
    pressure = np.sqrt(np.mean(elastic(heights, waves / 2) ** 2)) or rms
    length = rms * 10 ** random.uniform(-5, 5)
    energy = pressure * length * 10 ** random.uniform(-5, 5)
    size = 10 ** random.uniform(-3, 2)
    value = {
        "gap": rms * size,
        "displacement": heights.mean() + rms * size,
        "pressure": pressure * size,
        "tension": -energy / length * random.uniform(0, 1.2),
    }[load]
    is_length = load in ("gap", "displacement")
    dtype = PRECISIONS[precision]
    while True:
        p, l = (10 ** np.longdouble(random.uniform(-d, d)) for d in UNITS[precision])
        scaled = (
            lengths * l,
            heights * l,
            p,
            energy * p * l,
            length * l,
            value * (l if is_length else p),
        )
        numbers = [np.asarray(number).astype(dtype) for number in scaled]
        sizes = np.abs(np.concatenate([number.ravel() for number in numbers]))
        limits = np.finfo(dtype)
        if np.all((sizes == 0) | ((sizes > limits.tiny) & (sizes < limits.max))):
            return Problem(seed, precision, law, shape, load, *numbers)


def wavenumbers(shape: tuple[int, ...], lengths: np.ndarray) -> np.ndarray:
    *full, half = (2 * np.pi * n / L for n, L in zip(shape, lengths, strict=True))
    axes = [np.fft.fftfreq(n) * q for n, q in zip(shape, full, strict=False)]
    axes.append(np.fft.rfftfreq(shape[-1]) * half)
    return np.sqrt(sum(q**2 for q in np.meshgrid(*axes, indexing="ij")))


def elastic(field: np.ndarray, multiplier: np.ndarray) -> np.ndarray:
    axes = range(-field.ndim, 0)
    return np.fft.irfftn(multiplier * np.fft.rfftn(field), field.shape, axes=axes)


def solved(problem: Problem) -> js.results.Equilibrium:
    """Return what jaxstab says."""
    solid = js.HalfSpace(js.Grid(problem.shape, problem.lengths), problem.modulus)
    law = LAWS[problem.law].make(jnp.asarray(problem.energy), jnp.asarray(problem.length))
    contact = js.Contact(solid, problem.heights, law)
    kinds = {"gap": js.MeanGap, "displacement": js.MeanDisplacement}
    load = kinds.get(problem.load, js.MeanPressure)(problem.value)
    return js.equilibrate(contact, load, throw=False)


def judged(problem: Problem) -> tuple[str, str]:
    """Return how a problem ended, and why that is wrong."""
    try:
        state = solved(problem)
    except ValueError as error:
        return "refused when made", str(error)
    if state.result != "successful":
        return state.result.name, ""
    outside = Outside(problem, np.asarray(state.gap))
    return outside.judged()


class Outside:
    """A problem and its gap in NumPy, in units of a side's length and of the modulus."""

    def __init__(self, problem: Problem, gap: np.ndarray):
        l, p = np.longdouble(problem.lengths[0]), np.longdouble(problem.modulus)
        self.problem = problem
        self.gap = (gap / l).astype(float)
        self.heights = (problem.heights / l).astype(float)
        self.multiplier = wavenumbers(problem.shape, np.float64(problem.lengths / l)) / 2
        self.length = float(problem.length / l)
        self.attraction = float(problem.energy / p / problem.length)
        self.holds_gap = problem.load in ("gap", "displacement")
        self.value = float(problem.value / (l if self.holds_gap else p))
        self.law = LAWS[problem.law]

    def judged(self) -> tuple[str, str]:
        gap, precision = self.gap, self.problem.precision
        eps = np.finfo(PRECISIONS[precision]).eps
        if not (np.isfinite(gap).all() and gap.min() >= 0):
            return "wrong", f"the least gap is {gap.min():.3g}"
        held, off = self.load()
        if not off <= (1e4 * eps if self.holds_gap else LIMITS[precision]):
            return "wrong", f"the load is {held:.9g}, not {self.value:.9g}"
        refined, lowest = self.refined()
        size = max(self.heights.std(), gap.std())
        if size <= 100 * eps * np.abs(gap + self.heights).max():
            size = np.abs(gap).max()
        off = np.sqrt(np.mean((refined - gap) ** 2))
        # Rounding of the gap moves it so far, through the stiffest wave.
        rounded = eps * np.abs(gap + self.heights).max() * self.multiplier.max() / abs(lowest)
        error = max(off - rounded, 0) / (size or 1)
        lowest /= self.multiplier[self.multiplier > 0].min()
        residual = self.residual()
        detail = f"gap off by {error:.2g}, residual {residual:.2g}, lowest eigenvalue {lowest:.2g}"
        if error <= LIMITS[precision]:
            return "right", detail
        is_at_fold = lowest <= FOLD and residual <= LIMITS[precision]
        return "right near a fold" if is_at_fold else "wrong", detail

    def load(self) -> tuple[float, float]:
        """Return what the load comes to, and by what part of its terms that is off."""
        if self.problem.load == "gap":
            terms = [self.gap]
        elif self.problem.load == "displacement":
            terms = [self.gap, self.heights]
        else:
            reaction = np.where(self.gap == 0, np.maximum(self.net(self.gap), 0), 0)
            terms = [reaction, -self.attraction * self.law.slope(self.gap / self.length)]
        held = sum(terms).mean()
        off = abs(held - self.value)
        size = abs(self.value) + sum(np.abs(term).mean() for term in terms[1:])
        return held, off / size if off else 0.0

    def net(self, gap: np.ndarray) -> np.ndarray:
        """Return K u + p0 + f'(g)."""
        displacement = gap + self.heights
        net = elastic(displacement - displacement.flat[0], self.multiplier)
        net += self.attraction * self.law.slope(gap / self.length)
        if not self.holds_gap:
            return net + self.value
        return net - net[gap > 0].mean() if (gap > 0).any() else net

    def residual(self) -> float:
        """Return the rms of what is missed over that of the pressures that free points balance."""
        net, is_free = self.net(self.gap), self.gap > 0
        missed = np.where(is_free, net, np.minimum(net, 0))
        pressure = elastic(self.gap + self.heights, self.multiplier)
        balanced = np.where(is_free, net - pressure, 0)
        return float(np.sqrt(np.mean(missed**2) / np.mean(pressure**2 + balanced**2)))

    def refined(self) -> tuple[np.ndarray, float]:
        """Return where Newton's method on the active set goes, and the lowest eigenvalue there."""
        gap, touches = self.gap.copy(), self.gap == 0
        for _ in range(50):
            net = self.net(gap)
            change, lowest = self.newton_step(gap, net, ~touches)
            moved = np.where(touches, 0, gap + change)
            entering = moved < 0
            moved = np.maximum(moved, 0)
            leaving = touches & (self.net(moved) < 0)
            is_done = np.abs(change).max() <= 1e-13 * np.abs(gap + self.heights).max()
            if is_done and not leaving.any():
                break
            gap, touches = moved, (touches | entering) & ~leaving
        return gap, lowest

    def newton_step(self, gap, net, is_free) -> tuple[np.ndarray, float]:
        """Return the step of the free points, and the lowest eigenvalue of their Hessian."""
        free = is_free.ravel()
        if free.sum() <= self.holds_gap:
            return np.zeros_like(gap), np.inf
        curvature = self.attraction / self.length * self.law.curvature(gap / self.length)
        key = self.problem.shape, tuple(np.float64(self.problem.lengths / self.problem.lengths[0]))
        hessian = (elastic_matrix(*key) + np.diag(curvature.ravel()))[np.ix_(free, free)]
        basis = np.eye(free.sum())
        if self.holds_gap:
            basis = np.linalg.qr(basis - 1 / free.sum())[0][:, :-1]
        values, vectors = np.linalg.eigh(basis.T @ hessian @ basis)
        vectors = basis @ vectors
        change = np.zeros(gap.size)
        change[free] = -vectors @ ((vectors.T @ net.ravel()[free]) / values)
        return change.reshape(gap.shape), values[0]


@cache
def elastic_matrix(shape: tuple[int, ...], lengths: tuple[float, ...]) -> np.ndarray:
    multiplier, size = wavenumbers(shape, np.array(lengths)) / 2, int(np.prod(shape))
    units = np.eye(size).reshape(size, *shape)
    matrix = np.stack([elastic(unit, multiplier).ravel() for unit in units])
    return (matrix + matrix.T) / 2


def described(problem: Problem) -> str:
    p, l = np.longdouble(problem.modulus), np.longdouble(problem.lengths[0])
    own = (problem.heights.std() / l, problem.length / l, problem.energy / p / problem.length)
    rms, reach, attraction = map(float, own)
    softest = np.format_float_scientific(p * np.pi / l, 1)
    return (
        f"seed {problem.seed}, {problem.precision}, {problem.shape}, {problem.law}, "
        f"{problem.load} {float(problem.value):.3g}; E {float(p):.3g}, side {float(l):.3g}, "
        f"softest wave {softest}; rms height {rms:.3g} and range {reach:.3g} sides, "
        f"attraction {attraction:.3g} E"
    )


def report(count: int, outcomes: Counter, seconds: float) -> list[str]:
    """Return the table of how problems ended, by precision and by law."""
    names = [
        name for name, _ in Counter(outcome for _, outcome in outcomes.elements()).most_common()
    ]
    limits = ", ".join(f"{limit:g} in {precision}" for precision, limit in LIMITS.items())
    lines = [
        f"{count} problems on grids of "
        f"{', '.join('x'.join(map(str, shape)) for shape in SHAPES)} points; a gap is wrong from "
        f"{limits} of its size; {seconds:.0f} s",
        "",
        f"| | {' | '.join(names)} |",
        "|---|" + "---|" * len(names),
    ]
    for group in (*PRECISIONS, *LAWS):
        cells = " | ".join(str(outcomes[group, name]) for name in names)
        lines.append(f"| {group} | {cells} |")
    return lines


if __name__ == "__main__":
    main()

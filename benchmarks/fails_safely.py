"""Verdicts on many random problems against exact ones: how often is one wrong and does not say so?

Grids of 9 to 64 points with at most 9 points in contact that can lift, so that the minimum on a
cone is exact: the least over all of its faces. The Hessian's diagonal is random over decades,
contact scattered or clustered, reactions positive, some of them zero. A share of the problems is
adverse: eigenvalues that are zero to rounding, multiple eigenvalues, cones with hardly any vector
in them, points a trillion times stiffer than others, extreme units, and states that are broken.

A silent failure is a verdict other than "undecided" that the exact eigenvalues contradict; an
eigenvalue said to be found that is off by more than its error; eigenvalues out of order; or a mode
that is not an admissible unit vector.
"""

import argparse
import time
from collections import Counter
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from faces import smallest_on_cone

import jaxstab as js

SHAPES = ((3, 3), (5, 6), (16,), (8, 8))
LOADS = (js.MeanGap, js.MeanPressure)
FAMILIES = {
    "random": 0.4,
    "eigenvalue of zero": 0.12,
    "multiple eigenvalues": 0.12,
    "hardly free": 0.12,
    "stiff points": 0.08,
    "extreme units": 0.06,
    "detached": 0.05,
    "broken": 0.05,
}
NAMES = ("lower_bound", "cone", "critical")
MOST_ONE_SIDED = 9
# Of the norm of A: what rounding may do to the reference, and what counts as the same eigenvalue.
ROUNDING = 1e-14
SAME = 1e-8


class Problem(NamedTuple):
    """A state, by the diagonal of its Hessian, D; `fault` is how a broken one is broken."""

    family: str
    shape: tuple[int, ...]
    load: int
    youngs_modulus: float
    curvature: np.ndarray
    in_contact: np.ndarray
    reaction: np.ndarray
    fault: int


class Cosine(eqx.Module):
    """f(g) = -s cos(g + phase): where the gap is chosen, f'' is any number in [-s, s]."""

    strength: jax.Array
    phase: jax.Array

    def __call__(self, gap):
        return -self.strength * jnp.cos(gap + self.phase)


class Case(NamedTuple):
    """A problem as arrays for `assess`."""

    youngs_modulus: np.ndarray
    strength: np.ndarray
    phase: np.ndarray
    gap: np.ndarray
    in_contact: np.ndarray
    reaction: np.ndarray
    fault: np.ndarray


def main() -> None:
    options = parse_options()
    jax.config.update("jax_enable_x64", True)
    start = time.perf_counter()
    problems = [random_problem(seed) for seed in range(options.problems)]
    compared = set(range(min(options.compared, options.problems)))
    failures, verdicts, right, found = Counter(), Counter(), Counter(), Counter()
    lines = []
    for shape in SHAPES:
        for load in range(len(LOADS)):
            seeds = [i for i, p in enumerate(problems) if (p.shape, p.load) == (shape, load)]
            if not seeds:
                continue
            exacts, states = judge_all(
                seeds, [problems[i] for i in seeds], failures, verdicts, right, lines
            )
            rivals = [n for n, seed in enumerate(seeds) if seed in compared]
            count_minima(
                [problems[seeds[n]] for n in rivals],
                [exacts[n] for n in rivals],
                [states[n] for n in rivals],
                found,
            )
    table = report(len(problems), failures, verdicts, right, found, time.perf_counter() - start)
    print("\n".join(lines + table if options.list else table))
    if options.out:
        options.out.write_text("\n".join(table) + "\n")


def parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--compared", type=int, default=500, help="of these, for both solvers")
    parser.add_argument("--list", action="store_true", help="list every silent failure")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    return parser.parse_args()


def random_problem(seed: int) -> Problem:
    random = np.random.default_rng(seed)
    family = str(random.choice(list(FAMILIES), p=list(FAMILIES.values())))
    load = int(random.integers(len(LOADS)))
    shape = SHAPES[0 if family == "hardly free" else random.integers(len(SHAPES))]
    in_contact = random_contact(random, family, shape)
    weak = in_contact & (random.random(shape) < random.choice([0, 0, 0.3, 1]))
    reaction = np.where(in_contact & ~weak, random.uniform(0.01, 1, shape), 0)
    scale = 10 ** random.uniform(-3, 3)
    curvature = scale * random.normal(size=shape) + scale * random.normal() * random.integers(2)
    if family == "multiple eigenvalues":
        curvature = np.full(shape, scale * random.normal())
    if family == "stiff points":
        stiffer = 10 ** random.uniform(0, 12, shape)
        curvature = np.where(random.random(shape) < 0.2, abs(curvature) * stiffer, curvature)
    touching = curvature.ravel()[0] if random.random() < 0.5 else scale * random.normal()
    curvature = np.where(in_contact, touching, curvature)
    reaction = reaction * np.abs(curvature).max()
    modulus = 10.0 ** random.choice([-12, 12]) if family == "extreme units" else 1.0
    problem = Problem(
        family,
        shape,
        load,
        modulus,
        modulus * curvature,
        in_contact,
        modulus * reaction,
        int(random.integers(1, 5)) if family == "broken" else 0,
    )
    if family == "eigenvalue of zero":
        values = exact_eigenvalues(problem, dense(problem, curvature))
        value = values[random.integers(3)]
        shift = value if np.isfinite(value) else 0.0
        problem = problem._replace(curvature=curvature - shift)
    return problem


def random_contact(random: np.random.Generator, family: str, shape: tuple[int, ...]) -> np.ndarray:
    """Return a contact set: scattered, clustered, symmetric, nearly full, or none."""
    size = int(np.prod(shape))
    if family == "detached":
        return np.zeros(shape, bool)
    if family == "hardly free":
        num_contact = size - int(random.integers(3))
    else:
        num_contact = int(random.integers(0, min(MOST_ONE_SIDED, size - 1) + 1))
    if family == "multiple eigenvalues" and random.random() < 0.7:
        coarse = np.zeros(shape, bool)
        # A lattice, which shares the symmetries of the grid.
        coarse[tuple(slice(None, None, max(n // 2, 3)) for n in shape)] = True
        return coarse if coarse.sum() <= MOST_ONE_SIDED else np.zeros(shape, bool)
    if random.random() < 0.5:
        order = random.permutation(size)
    else:
        distances = [np.minimum(i, n - i) for i, n in zip(np.indices(shape), shape, strict=True)]
        order = np.argsort(sum(d**2 for d in distances).ravel(), kind="stable")
    chosen = np.zeros(size, bool)
    chosen[order[:num_contact]] = True
    return chosen.reshape(shape)


def case_of(problem: Problem) -> Case:
    """Return a law and a gap with the problem's D."""
    strength = 2 * np.abs(problem.curvature).max()
    angles = np.arccos(problem.curvature / strength)
    touching = angles[problem.in_contact][:1]
    phase = touching[0] if touching.size else 0.0
    gap = np.where(angles > phase, angles - phase, angles - phase + 2 * np.pi)
    gap = np.where(problem.in_contact, 0, gap)
    return Case(
        np.array(problem.youngs_modulus),
        np.array(strength),
        np.array(phase),
        gap,
        problem.in_contact,
        problem.reaction,
        np.array(problem.fault),
    )


@cache
def template(shape: tuple[int, ...], load: int) -> js.Equilibrium:
    contact = js.Contact(js.HalfSpace(js.Grid(shape), 1.0), jnp.zeros(shape), lambda gap: 0 * gap)
    state = js.equilibrate(contact, js.MeanGap(1.0))
    return eqx.tree_at(lambda state: state.load, state, LOADS[load](1.0))


def state_of(anchor: js.Equilibrium, case: Case) -> tuple[js.Contact, js.Equilibrium]:
    """Return a contact, and a state of it: the heights are such that pressures balance."""
    shape = anchor.gap.shape
    solid = js.HalfSpace(js.Grid(shape), case.youngs_modulus)
    attraction = case.strength * jnp.sin(case.gap + case.phase)
    pressure = case.reaction - attraction
    heights = solid.displacement(pressure) - case.gap
    contact = js.Contact(solid, heights, Cosine(case.strength, case.phase))
    is_pressed = isinstance(anchor.load, js.MeanPressure)
    load = anchor.load.at(jnp.mean(pressure if is_pressed else case.gap))
    wrong = jnp.where(jnp.arange(4) == case.fault - 1, jnp.nan, 0)
    fields = (
        case.gap.at[(0,) * len(shape)].add(wrong[0]),
        case.in_contact,
        case.reaction + wrong[1],
        pressure + wrong[2],
        js.RESULTS.where(case.fault == 4, js.RESULTS.stagnated, js.RESULTS.successful),
    )
    return contact, eqx.tree_at(
        lambda state: (
            state.gap,
            state.in_contact,
            state.reaction,
            state.pressure,
            state.result,
            state.load,
        ),
        anchor,
        (*fields, load),
    )


@eqx.filter_jit
def assess(anchor: js.Equilibrium, cases: Case, solver) -> tuple:
    """Return the stability of every case, and its D as the library has it."""

    def one(case: Case) -> tuple[js.Stability, jax.Array]:
        contact, equilibrium = state_of(anchor, case)
        stability = js.assess_stability(contact, equilibrium, solver, throw=False)
        return stability, contact.curvature(case.gap)

    return jax.vmap(one)(cases)


def assess_all(problems: list[Problem], solver=None) -> list[tuple[js.Stability, np.ndarray]]:
    """Return what `assess` says of problems of one shape and one kind of load, one by one."""
    cases = jax.tree.map(lambda *leaves: jnp.stack(leaves), *map(case_of, problems))
    anchor = template(problems[0].shape, problems[0].load)
    out = jax.device_get(assess(anchor, cases, solver))
    return [jax.tree.map(lambda leaf, i=i: leaf[i], out) for i in range(len(problems))]


@cache
def elastic_matrix(shape: tuple[int, ...]) -> np.ndarray:
    solid = js.HalfSpace(js.Grid(shape), 1.0)
    size = solid.grid.size
    columns = jax.vmap(solid.pressure)(jnp.eye(size).reshape(size, *shape))
    matrix = np.asarray(columns).reshape(size, size)
    return (matrix + matrix.T) / 2


def dense(problem: Problem, curvature: np.ndarray) -> np.ndarray:
    return problem.youngs_modulus * elastic_matrix(problem.shape) + np.diag(curvature.ravel())


def exact_eigenvalues(problem: Problem, matrix: np.ndarray) -> list[float]:
    """Return the smallest eigenvalues on the space, the cone and the critical cone."""
    contact, presses = problem.in_contact.ravel(), problem.reaction.ravel() > 0
    fixes_mean = problem.load == 0
    nowhere = np.zeros_like(contact)
    sets = ((nowhere, nowhere), (contact, nowhere), (contact & ~presses, contact & presses))
    return [smallest_on_cone(matrix, *masks, fixes_mean) for masks in sets]


def judge_all(seeds, problems, failures, verdicts, right, lines) -> tuple[list, list]:
    """Assess problems of one shape and load; count their verdicts and silent failures."""
    exacts, states = [], []
    for seed, problem, (stability, curvature) in zip(
        seeds, problems, assess_all(problems), strict=True
    ):
        matrix = dense(problem, curvature)
        exact = exact_eigenvalues(problem, matrix)
        verdict = stability.verdict.name
        truth = "broken" if problem.fault else exact_verdict(exact, norm(matrix))
        kinds = list(silent_failures(problem, stability, exact, norm(matrix), truth))
        failures.update(kinds)
        failures["problems with any"] += bool(kinds)
        verdicts[truth, verdict] += 1
        right[problem.family] += 1
        right[problem.family, "undecided"] += verdict == "undecided"
        right[problem.family, "failed"] += bool(kinds)
        if kinds:
            values = [float(getattr(stability, name).eigenvalue) for name in NAMES]
            lines.append(f"{seed} {problem.family} {verdict}/{truth} {values} {exact} {kinds}")
        exacts.append((exact, norm(matrix)))
        states.append(stability)
    return exacts, states


def norm(matrix: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvalsh(matrix)).max())


def exact_verdict(exact: list[float], scale: float) -> str:
    """Return the verdict that exact eigenvalues prove, "undecided" where rounding decides."""
    _, cone, critical = exact
    if cone > ROUNDING * scale:
        return "stable"
    if critical < -ROUNDING * scale:
        return "unstable"
    if cone < -ROUNDING * scale and critical > ROUNDING * scale:
        return "held_by_contact"
    return "undecided"


def silent_failures(problem: Problem, stability: js.Stability, exact, scale: float, truth: str):
    """Yield the kinds of silent failure of an assessment."""
    verdict = stability.verdict.name
    pairs = [getattr(stability, name) for name in NAMES]
    results = [pair.result.name for pair in pairs]
    if problem.fault:
        if verdict != "undecided":
            yield "a verdict on a broken state"
        if "successful" in results or stability.result.name == "successful":
            yield "an eigenvalue of a broken state"
        return
    if verdict not in ("undecided", truth):
        yield f"{verdict}, but {truth}"
    presses = problem.in_contact & (problem.reaction > 0)
    for name, pair, result, value in zip(NAMES, pairs, results, exact, strict=True):
        if result != "successful":
            continue
        slack = pair.error + ROUNDING * scale
        if not (pair.eigenvalue == value or abs(pair.eigenvalue - value) <= slack):
            yield f"{name} off by more than its error"
        # A cone of the zero vector alone has no mode.
        is_unit = abs(np.linalg.norm(pair.mode) - np.isfinite(value)) < 1e-12
        has_mean = problem.load == 0 and abs(pair.mode.sum()) > 1e-12
        enters = name != "lower_bound" and pair.mode[problem.in_contact].min(initial=0) < 0
        leaves = name == "critical" and pair.mode[presses].any()
        if not is_unit or has_mean or enters or leaves:
            yield f"mode of {name} not an admissible unit vector"
    values = [p.eigenvalue for p, r in zip(pairs, results, strict=True) if r == "successful"]
    neighbours = pairwise(values)
    if not all(lower <= upper for lower, upper in neighbours):
        yield "eigenvalues out of order"


def count_minima(problems, exacts, states, found: Counter) -> None:
    """Count how often both solvers find the minimum on a cone that has faces."""
    kept = [n for n, p in enumerate(problems) if p.in_contact.any() and not p.fault]
    if not kept:
        return
    rivals = assess_all([problems[n] for n in kept], js.ProximalIteration())
    for n, (rival, _) in zip(kept, rivals, strict=True):
        (_, exact, _), scale = exacts[n]
        found["problems"] += 1
        for name, stability in (("ProjectedLOBPCG", states[n]), ("ProximalIteration", rival)):
            pair = stability.cone
            is_found = pair.result.name == "successful"
            is_same = pair.eigenvalue == exact or abs(pair.eigenvalue - exact) <= SAME * scale
            found[name, "converged"] += is_found
            found[name, "minimum"] += is_found and bool(is_same)


def report(count: int, failures, verdicts, right, found, seconds: float) -> list[str]:
    names = ("stable", "held_by_contact", "unstable", "undecided")
    lines = [
        f"{count} problems on grids of {', '.join('x'.join(map(str, s)) for s in SHAPES)} points, "
        f"half of them under a mean pressure; float64; {seconds:.0f} s",
        "",
        "| exact verdict | " + " | ".join(names) + " |",
        "|---|" + "---|" * len(names),
    ]
    for truth in (*names, "broken"):
        counts = (str(verdicts[truth, name]) for name in names)
        lines.append(f"| {truth} | " + " | ".join(counts) + " |")
    lines += ["", "| family | problems | undecided | silent failures |", "|---|---|---|---|"]
    for family in FAMILIES:
        cells = (right[family], right[family, "undecided"], right[family, "failed"])
        lines.append(f"| {family} | " + " | ".join(map(str, cells)) + " |")
    total = failures.pop("problems with any", 0)
    lines += ["", "| silent failure | count |", "|---|---|", f"| problems with any | {total} |"]
    lines += [f"| {kind} | {number} |" for kind, number in failures.most_common()]
    lines += ["", f"| cone solver, on {found['problems']} problems | converged | minimum found |"]
    lines.append("|---|---|---|")
    for name in ("ProjectedLOBPCG", "ProximalIteration"):
        lines.append(f"| {name} | {found[name, 'converged']} | {found[name, 'minimum']} |")
    return lines


if __name__ == "__main__":
    main()

"""Verdicts on many random problems against exact ones: how often is one wrong and does not say so?

A silent failure is a verdict other than "undecided" that the exact eigenvalues contradict; an
eigenvalue said to be found that is off by more than its error; eigenvalues out of order; or a mode
that is not an admissible unit vector.
"""

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from assessments import assess_all
from small_problems import (
    FAMILIES,
    ROUNDING,
    SHAPES,
    Problem,
    dense,
    exact_eigenvalues,
    exact_verdict,
    groups,
    random_problem,
)

import jaxstab as js

VERDICTS = ("stable", "held_by_contact", "unstable", "undecided")
SOLVERS = ("ProjectedLOBPCG", "ProximalIteration")
# Of the norm of A: what counts as the same eigenvalue.
SAME = 1e-8


class Judgement(NamedTuple):
    """What is said of a problem, and what is so; `scale` is the norm of A."""

    problem: Problem
    stability: js.results.Stability
    exact: list[float]
    scale: float
    truth: str
    failures: list[str]

    @property
    def verdict(self) -> str:
        return self.stability.verdict.name


def main() -> None:
    options = parse_options()
    jax.config.update("jax_enable_x64", True)
    start = time.perf_counter()
    judgements, minima = [], Counter()
    for problems in groups([random_problem(seed) for seed in range(options.problems)]):
        judged = [judge(*assessed) for assessed in zip(problems, assess_all(problems), strict=True)]
        minima += count_minima([each for each in judged if each.problem.seed < options.compared])
        judgements += judged
    lines = report(judgements, minima, time.perf_counter() - start)
    failed = [described(each) for each in judgements if each.failures]
    print("\n".join(failed + lines if options.list else lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--compared", type=int, default=500, help="of these, for both solvers")
    parser.add_argument("--list", action="store_true", help="list every silent failure")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    return parser.parse_args()


def judge(problem: Problem, assessed: tuple[js.results.Stability, np.ndarray]) -> Judgement:
    stability, curvature = assessed
    matrix = dense(problem, curvature)
    exact = exact_eigenvalues(problem, matrix)
    scale = float(np.abs(np.linalg.eigvalsh(matrix)).max())
    truth = "broken" if problem.fault else exact_verdict(exact, scale)
    if problem.fault:
        failures = failures_of_broken(stability)
    else:
        failures = silent_failures(problem, stability, exact, scale, truth)
    return Judgement(problem, stability, exact, scale, truth, list(failures))


def failures_of_broken(stability: js.results.Stability) -> Iterator[str]:
    if stability.verdict.name != "undecided":
        yield "a verdict on a broken state"
    if any(each.result.name == "successful" for each in (stability, *stability.pairs.values())):
        yield "an eigenvalue of a broken state"


def silent_failures(
    problem: Problem, stability: js.results.Stability, exact: list[float], scale: float, truth: str
) -> Iterator[str]:
    verdict = stability.verdict.name
    if verdict not in ("undecided", truth):
        yield f"{verdict}, but {truth}"
    values = []
    for (name, pair), value in zip(stability.pairs.items(), exact, strict=True):
        if pair.result.name != "successful":
            continue
        values.append(pair.eigenvalue)
        if not is_near(pair.eigenvalue, value, pair.error + ROUNDING * scale):
            yield f"{name} off by more than its error"
        # A cone of the zero vector alone has no mode.
        is_unit = abs(np.linalg.norm(pair.mode) - np.isfinite(value)) < 1e-12
        if not (is_unit and is_admissible(problem, name, pair.mode)):
            yield f"mode of {name} not an admissible unit vector"
    if not all(lower <= upper for lower, upper in pairwise(values)):
        yield "eigenvalues out of order"


def is_near(eigenvalue: float, exact: float, slack: float) -> bool:
    # Both are infinite where a cone is of the zero vector alone.
    return bool(eigenvalue == exact or abs(eigenvalue - exact) <= slack)


def is_admissible(problem: Problem, name: str, mode: np.ndarray) -> bool:
    has_mean = problem.fixes_mean and abs(mode.sum()) > 1e-12
    enters = name != "lower_bound" and mode[problem.in_contact].min(initial=0) < 0
    leaves = name == "critical" and mode[problem.presses].any()
    return not (has_mean or enters or leaves)


def count_minima(judgements: list[Judgement]) -> Counter:
    """Count how often both solvers find the minimum on a cone that has faces."""
    kept = [each for each in judgements if each.problem.in_contact.any() and not each.problem.fault]
    found = Counter(problems=len(kept))
    if not kept:
        return found
    rivals = assess_all([each.problem for each in kept], js.ProximalIteration())
    for each, (rival, _) in zip(kept, rivals, strict=True):
        for name, stability in zip(SOLVERS, (each.stability, rival), strict=True):
            pair = stability.cone
            if pair.result.name == "successful":
                found[name, "converged"] += 1
                found[name, "minimum"] += is_near(pair.eigenvalue, each.exact[1], SAME * each.scale)
    return found


def described(judgement: Judgement) -> str:
    problem, stability, exact, _, truth, kinds = judgement
    values = [float(pair.eigenvalue) for pair in stability.pairs.values()]
    return f"{problem.seed} {problem.family} {judgement.verdict}/{truth} {values} {exact} {kinds}"


def report(judgements: list[Judgement], minima: Counter, seconds: float) -> list[str]:
    shapes = ", ".join("x".join(map(str, shape)) for shape in SHAPES)
    return [
        f"{len(judgements)} problems on grids of {shapes} points, "
        f"half of them under a mean pressure; float64; {seconds:.0f} s",
        *verdict_table(judgements),
        *family_table(judgements),
        *failure_table(judgements),
        *solver_table(minima),
    ]


def verdict_table(judgements: list[Judgement]) -> list[str]:
    counts = Counter((each.truth, each.verdict) for each in judgements)
    rows = [(truth, *(counts[truth, name] for name in VERDICTS)) for truth in (*VERDICTS, "broken")]
    return table(("exact verdict", *VERDICTS), rows)


def family_table(judgements: list[Judgement]) -> list[str]:
    rows = []
    for family in FAMILIES:
        own = [each for each in judgements if each.problem.family == family]
        undecided = sum(each.verdict == "undecided" for each in own)
        rows.append((family, len(own), undecided, sum(bool(each.failures) for each in own)))
    return table(("family", "problems", "undecided", "silent failures"), rows)


def failure_table(judgements: list[Judgement]) -> list[str]:
    total = sum(bool(each.failures) for each in judgements)
    kinds = Counter(kind for each in judgements for kind in each.failures)
    return table(("silent failure", "count"), [("problems with any", total), *kinds.most_common()])


def solver_table(minima: Counter) -> list[str]:
    columns = (f"cone solver, on {minima['problems']} problems", "converged", "minimum found")
    rows = [(name, minima[name, "converged"], minima[name, "minimum"]) for name in SOLVERS]
    return table(columns, rows)


def table(columns: tuple[str, ...], rows: list[tuple]) -> list[str]:
    """Return the lines of a table, and an empty one before it."""
    cells = [f"| {' | '.join(map(str, row))} |" for row in (columns, *rows)]
    return ["", cells[0], "|" + "---|" * len(columns), *cells[1:]]


if __name__ == "__main__":
    main()

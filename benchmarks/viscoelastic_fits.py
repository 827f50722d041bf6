"""Fits in time to synthetic force curves of viscoelastic samples, beside their truths.

Without adhesion the curves are those of Ting's solution, with adhesion those of a disc with three
times the rings of the fit. Approach, dwell and retraction take a second each.
"""

import argparse
import sys
import time as clock
import warnings
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

import jaxstab as js

sys.path.append(str(Path(__file__).parents[1] / "tests" / "lab"))
from viscoelastic_curves import RADIUS, RELAXED, program, recorded, sticky, ting

jax.config.update("jax_enable_x64", True)
HEAD = (
    "| sample | relaxed modulus [Pa] | instantaneous modulus [Pa] | ratios "
    "| relaxation times [s] | work of adhesion [J/m²] | result | processor seconds |\n"
    "|---|---|---|---|---|---|---|---|"
)


class Case(NamedTuple):
    """A sample by its ratios and relaxation times [s], the times asked for, and adhesion."""

    name: str
    ratios: tuple[float, ...]
    times: tuple[float, ...]
    asked: int | tuple[float, ...]
    work: float = 0.0
    length: float = 0.0


CASES = (
    Case("one time", (1.5,), (0.4,), 1),
    Case("a short time", (0.5,), (0.1,), 1),
    Case("a time beyond the dwell", (4.0,), (1.5,), 1),
    Case("two times", (1.0, 1.5), (0.06, 0.8), 2),
    Case("two times, given", (1.0, 1.5), (0.06, 0.8), (0.06, 0.8)),
    Case("two times that lie near", (1.0, 1.0), (0.3, 0.45), 2),
    Case("one time, fitted by two", (1.5,), (0.4,), 2),
    Case("one time, sticky", (1.5,), (0.4,), 1, 5e-5, 1e-7),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=len(CASES), help="the first so many")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    lines = [HEAD]
    for seed, case in enumerate(CASES[: options.cases]):
        lines.append(row(seed, case))
        print(lines[-1], flush=True)
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def row(seed: int, case: Case) -> str:
    height, times = program()
    if case.work:
        coarse = times[::6]
        law = case.work, case.length, case.ratios[0], case.times[0]
        force = np.interp(times, coarse, sticky(height[::6], coarse, *law))
    else:
        force = ting(height, times, case.ratios, case.times)
    curve = recorded(height, times, force, seed)
    start = clock.process_time()
    fit = js.lab.fit_viscoelastic(curve, js.lab.Paraboloid(RADIUS), relaxation_times=case.asked)
    seconds = clock.process_time() - start
    numbers = {
        "relaxed_modulus": RELAXED,
        "instantaneous_modulus": RELAXED * (1 + sum(case.ratios)),
        "ratios": case.ratios,
        "relaxation_times": case.times,
        "work_of_adhesion": case.work,
    }
    cells = [cell(getattr(fit, k), getattr(fit.errors, k), x) for k, x in numbers.items()]
    return f"| {case.name} | {' | '.join(cells)} | {fit.result.name} | {seconds:.0f} |"


def cell(values: np.ndarray | float, errors: np.ndarray | float, truths: object) -> str:
    """Return numbers with their errors, and how many errors the truths are away."""
    found, sizes, true = (np.atleast_1d(x).astype(float) for x in (values, errors, truths))
    parts = []
    for number, (value, error) in enumerate(zip(found, sizes, strict=True)):
        text = f"{value:.4g}"
        if error > 0:
            text += f" ± {error:.2g}"
        if len(true) == len(found):
            text += f" for {true[number]:.4g}"
            if error > 0:
                text += f", {(value - true[number]) / error:+.1f} errors"
        parts.append(text)
    return "; ".join(parts)


if __name__ == "__main__":
    sys.exit(main())

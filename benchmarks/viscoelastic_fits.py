"""Fits in time to synthetic force curves of a standard linear solid, beside their truths.

Without adhesion the curves are those of Ting's solution, with adhesion those of a disc with three
times the rings of the fit. Approach, dwell and retraction take a second each.
"""

import argparse
import sys
import time as clock
import warnings
from pathlib import Path

import jax
import numpy as np

import jaxstab as js

sys.path.append(str(Path(__file__).parents[1] / "tests" / "lab"))
from viscoelastic_curves import RADIUS, RELAXED, program, recorded, sticky, ting

jax.config.update("jax_enable_x64", True)
# Ratio, relaxation time [s], work of adhesion [J/m²] and range [m].
CASES = [(1.5, 0.4, 0, 0), (0.5, 0.1, 0, 0), (4.0, 1.5, 0, 0), (1.5, 0.4, 5e-5, 1e-7)]
NUMBERS = "relaxed_modulus", "instantaneous_modulus", "time", "work_of_adhesion"
HEAD = (
    "| relaxed modulus [Pa] | instantaneous modulus [Pa] | relaxation time [s] "
    "| work of adhesion [J/m²] | result | processor seconds |\n|---|---|---|---|---|---|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=len(CASES), help="the first so many")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print(HEAD)
    for seed, case in enumerate(CASES[: options.cases]):
        print(row(seed, *case), flush=True)


def row(seed: int, ratio: float, time: float, work: float, length: float) -> str:
    height, times = program()
    if work:
        coarse = times[::6]
        force = np.interp(times, coarse, sticky(height[::6], coarse, work, length, ratio, time))
    else:
        force = ting(height, times, ratio, time)
    start = clock.process_time()
    fit = js.lab.fit_viscoelastic(recorded(height, times, force, seed), js.lab.Paraboloid(RADIUS))
    seconds = clock.process_time() - start
    cells = []
    for name, truth in zip(NUMBERS, (RELAXED, RELAXED * (1 + ratio), time, work), strict=True):
        value, error = getattr(fit, name), getattr(fit.errors, name)
        away = f", {(value - truth) / error:+.1f} errors" if np.isfinite(error) else ""
        cells.append(f"{value:.4g} for {truth:.4g}{away}")
    return f"| {' | '.join(cells)} | {fit.result.name} | {seconds:.0f} |"


if __name__ == "__main__":
    sys.exit(main())

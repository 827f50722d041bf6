"""Fits to all force curves of a folder, beside Sneddon's least squares of the corrected curve.

Public repositories with curves of instruments: the tests of afmformats and nanite
(https://github.com/AFM-analysis, MIT and GPL 3). Files without a spring constant, curves
without contact and formats that are not read are listed with the reason. The tip is a paraboloid
for all of them, since no file states it: the ratio of the two moduli does not depend on its radius
where adhesion is weak.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

import jaxstab as js

HEAD = (
    "| curve | modulus [Pa] | error | work of adhesion [J/m²] | error | Sneddon [Pa] | ratio "
    "| misfit over noise | result | processor seconds |\n|---|---|---|---|---|---|---|---|---|---|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--radius", type=float, default=5e-6, help="of the tip [m]")
    parser.add_argument("--poisson-ratio", type=float, default=0.5)
    parser.add_argument("--segment", default="approach", choices=["approach", "retraction"])
    parser.add_argument("--most", type=int, default=2, help="curves of each file")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    lines = [HEAD]
    reasons = []
    for name, curve in curves(options.folder, options.most, reasons):
        try:
            line = row(name, curve, options)
        except ValueError as error:
            reasons.append((name, str(error)))
            continue
        lines.append(line)
        print(line, flush=True)
    lines += ["", "| without a fit | reason |", "|---|---|"]
    for name, reason in reasons:
        text = reason.splitlines()[0].replace(f"{options.folder}/", "").replace(f"{name}: ", "")
        lines.append(f"| {name} | {text.split('. ')[0].split(': give')[0]} |")
    print("\n".join(lines[-len(reasons) - 3 :]))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def curves(
    folder: Path, most: int, reasons: list[tuple[str, str]]
) -> Iterator[tuple[str, js.lab.force_curves.ForceCurve]]:
    """Yield the first curves of each file."""
    for path in sorted(folder.iterdir()):
        try:
            found = js.lab.force_curves.read(path)
        except Exception as error:
            reasons.append((path.name, f"{type(error).__name__}: {error}"))
            continue
        if isinstance(found, js.lab.force_curves.ForceCurve):
            yield path.name, found
            continue
        for number, curve in enumerate(found[:most]):
            yield f"{path.name} {number}", curve


def row(name: str, curve: js.lab.force_curves.ForceCurve, options: argparse.Namespace) -> str:
    tip = js.lab.Paraboloid(options.radius)
    start = time.process_time()
    fit = js.lab.fit_curve(curve, tip, options.poisson_ratio, options.segment)
    seconds = time.process_time() - start
    plain = sneddon(fit.curve.in_units("m", "N"), options)
    return (
        f"| {name} | {fit.youngs_modulus:.4g} | {fit.errors.youngs_modulus:.2g} "
        f"| {fit.work_of_adhesion:.3g} | {fit.errors.work_of_adhesion:.2g} | {plain:.4g} "
        f"| {fit.youngs_modulus / plain:.3f} | {fit.misfit / fit.noise:.1f} | {fit.result.name} "
        f"| {seconds:.1f} |"
    )


def sneddon(curve: js.lab.force_curves.ForceCurve, options: argparse.Namespace) -> float:
    """Return E of F = 4/3 E* sqrt(R) (d0 - tip)^(3/2) + b, by least squares of all points."""
    segment = getattr(curve, options.segment)
    inside = segment.is_present
    tip, force = segment.tip_position[inside], segment.force[inside]
    scale, depth = force.max(), np.ptp(tip)

    def misfit(x: np.ndarray) -> np.ndarray:
        indentation = np.maximum(x[1] - tip / depth, 0)
        return x[0] * indentation**1.5 + x[2] - force / scale

    starts = np.quantile(tip / depth, [0.05, 0.2, 0.5])
    found = min(
        (least_squares(misfit, [1.0, start, 0.0]) for start in starts), key=lambda one: one.cost
    )
    modulus = found.x[0] * scale / depth**1.5 / (4 / 3 * np.sqrt(options.radius))
    return float(modulus * (1 - options.poisson_ratio**2))


if __name__ == "__main__":
    sys.exit(main())

"""Errors of fits to synthetic force curves: how often the truth is within two standard errors.

Each curve is computed from the closed form of Maugis' sphere in `jaxstab.references`, with modulus,
work of adhesion, range, depth, cantilever, noise, offsets, drift and tilt drawn at random, and is
recorded with jumps into and out of contact. The fit sees the curve as an instrument would save it.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxstab as js

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from synthetic_curves import RADIUS, maugis_with_approach, recorded

TIP = js.lab.Paraboloid(RADIUS * 1e-9)
# Tabor's parameter, lambda / 1.157, and the modulus [GPa] of each class.
CLASSES = {
    "DMT": ((0.03, 0.15), (0.2, 1.0)),
    "Maugis": ((0.26, 1.73), (0.1, 1.0)),
    "JKR": ((3.0, 12.0), (0.02, 0.1)),
}
# Points over which noise is correlated; points that a thinned curve keeps of 2000.
CORRELATED, FEW = 20, 200
CONDITIONS = "white noise", "correlated noise", "drift", "tilt", "few, uneven points"
NUMBERS = "youngs_modulus", "work_of_adhesion", "range", "contact_point"
HEAD = (
    "| class | segment | curves | not successful | modulus | work of adhesion | range "
    "| contact point | rms of deviations over errors | beyond three errors | median errors |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|"
)
# A range shows if its error is less than this part of it.
SHOWN = 0.5


class Trial(NamedTuple):
    """A fit beside its truth.

    Attributes:
        kind, condition, segment: how the curve was made, and the part that is fitted.
        away: deviations over standard errors, in the order of `NUMBERS`; NaN where none is known.
        errors: standard errors over the truths, of the contact point over the depth.
        result: the name of the result.
        seconds: processor time of the fit.
    """

    kind: str
    condition: str
    segment: str
    away: np.ndarray
    errors: np.ndarray
    result: str
    seconds: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--curves", type=int, default=200, help="of each class")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--class", dest="kind", choices=CLASSES, help="one class alone")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    kinds = [options.kind] if options.kind else [*CLASSES]
    found = []
    for kind in kinds:
        for seed in range(options.first, options.first + options.curves):
            found += trials(kind, seed)
        print("\n".join(rows(found, "kind")), flush=True)
    lines = [HEAD, *rows(found, "kind")]
    lines += ["", HEAD.replace("class", "condition"), *rows(found, "condition")]
    seconds = [trial.seconds for trial in found]
    lines += ["", f"Seconds of a processor for a fit: median {np.median(seconds):.2f}, "]
    lines[-1] += f"largest {max(seconds):.2f}."
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def trials(kind: str, seed: int) -> Iterator[Trial]:
    """Yield the fits of approach and retraction of one curve."""
    random = np.random.default_rng((seed, *kind.encode()))
    condition = CONDITIONS[seed % len(CONDITIONS)]
    tabor, modulus = (np.exp(random.uniform(*np.log(pair))) for pair in CLASSES[kind])
    # J/m^2 and nm.
    work = np.exp(random.uniform(*np.log((0.02, 0.1))))
    contact = random.uniform(-5, 5)
    deformation = np.cbrt(RADIUS * (work / modulus) ** 2)
    length = deformation / tabor
    depth = random.uniform(4, 16) + 2 * deformation
    noise = 1.5 * np.pi * work * RADIUS / np.exp(random.uniform(*np.log((20, 200))))
    law = maugis_with_approach(tabor, modulus, work, depth)
    constant = np.exp(random.uniform(*np.log((0.2, 2.0))))
    fast = 1 if condition == "drift" else 0.2
    steep = 1 if condition == "tilt" else 0.2
    curve = recorded(
        law,
        0,
        constant=constant,
        contact=contact,
        drift=0.7 * fast * random.uniform(-1, 1),
        force_drift=noise * fast * random.uniform(-1, 1),
        tilt=0.1 * noise * steep * random.uniform(-1, 1),
        offsets=tuple(random.uniform(-1, 1, 2)),
        noise=0.0,
        reach=100.0 + 3 * length,
    )
    parts = {
        name: noisy(part, noise, constant, condition, random)
        for name, part in curve.segments.items()
    }
    curve = replace(curve, **parts)
    truth = np.array([modulus * 1e9, work, length * 1e-9, 0.0])
    sizes = np.append(truth[:3], depth * 1e-9)
    for segment in ("approach", "retraction"):
        start = time.process_time()
        try:
            fit = js.lab.fit_curve(curve, TIP, 0.0, segment)
        except ValueError:
            # A curve that cannot be corrected is refused with the reason.
            unknown = np.full(4, np.nan)
            yield Trial(kind, condition, segment, unknown, unknown, "refused", 0.0)
            continue
        seconds = time.process_time() - start
        correction = fit.curve.correction
        assert correction is not None and correction.contact_point is not None
        truth[3] = (contact - correction.contact_point) * 1e-9
        errors = np.array([getattr(fit.errors, name) for name in NUMBERS])
        values = np.array([getattr(fit, name) for name in NUMBERS])
        away = (values - truth) / errors
        yield Trial(kind, condition, segment, away, errors / sizes, fit.result.name, seconds)


def noisy(
    part: js.lab.force_curves.Segment,
    noise: float,
    constant: float,
    condition: str,
    random: np.random.Generator,
) -> js.lab.force_curves.Segment:
    """Return a segment with noise of the force, or with some of its points."""
    length = CORRELATED if condition == "correlated noise" else 1
    assert part.tip is not None and part.time is not None
    white = random.normal(size=len(part) + length - 1)
    added = noise * np.convolve(white, np.ones(length) / np.sqrt(length), "valid")
    kept = np.arange(len(part))
    if condition == "few, uneven points":
        kept = np.sort(random.choice(len(part), FEW, replace=False))
    return js.lab.force_curves.Segment(
        force=(part.force + added)[kept],
        height=part.height[kept],
        tip=(part.tip + added / constant)[kept],
        time=part.time[kept],
    )


def rows(found: list[Trial], group: str) -> Iterator[str]:
    names = dict.fromkeys(getattr(trial, group) for trial in found)
    for name in names:
        for segment in ("approach", "retraction"):
            own = [x for x in found if getattr(x, group) == name and x.segment == segment]
            good = [trial for trial in own if trial.result == "successful"]
            if good:
                yield row(name, segment, len(own), good)


def row(name: str, segment: str, count: int, good: list[Trial]) -> str:
    away = np.array([trial.away for trial in good])
    errors = np.array([trial.errors for trial in good])
    away[~(errors[:, 2] < SHOWN), 2] = np.nan
    inside = []
    rms = []
    for own in away.T:
        own = own[np.isfinite(own)]
        inside.append(f"{100 * np.mean(np.abs(own) < 2):.0f} % of {own.size}" if own.size else "-")
        rms.append(f"{np.sqrt(np.mean(own**2)):.2f}" if own.size else "-")
    far = np.sum(np.abs(away) > 3, axis=0)
    typical = np.nanmedian(errors, axis=0)
    return (
        f"| {name} | {segment} | {count} | {count - len(good)} | {' | '.join(inside)} "
        f"| {', '.join(rms)} | {', '.join(map(str, far))} "
        f"| {', '.join(f'{100 * size:.2g} %' for size in typical)} |"
    )


if __name__ == "__main__":
    sys.exit(main())

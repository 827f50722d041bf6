"""Pull-offs at ranges of adhesion that a grid does not resolve, extrapolated from longer ranges.

A sphere is extrapolated to the limit of Johnson, Kendall and Roberts, and a wave to that of
Johnson. Rough surfaces are extrapolated to the shortest range that a grid twice as fine resolves as
well, and compared with the pull-off on that grid. Without `--quick` it takes some five minutes on
two idle cores.
"""

import argparse
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js
from jaxstab.references import jkr, johnson

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from synthetic_curves import recorded

RESOLUTION = 8
# Works of adhesion of surfaces, over the modulus and the side: with less of it a contact on a grid
# of 64 x 64 points has one or two points where it is pulled off.
WORKS = 1e-3, 4e-3
HEAD = (
    "| contact | points | at the shortest range | extrapolated | error | power | off by |\n"
    "|---|---|---|---|---|---|---|"
)

CURVES = (
    "Fits of a contact of 8² points to retractions of synthetic force curves of the same contact, "
    "with noise, drift, tilt and offsets: how often the truth is within two standard errors, and "
    "the rms of deviations over standard errors."
)
CURVES_HEAD = "| parameter | within two errors | rms |\n|---|---|---|"
# In nm, nN and GPa.
TRUTH = {"work of adhesion": 0.05, "range": 6.0, "modulus": 0.1}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    parser.add_argument(
        "--quick", action="store_true", help="the wave and lines alone, in a minute"
    )
    parser.add_argument("--curves", type=int, help="fit so many synthetic force curves instead")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)
    # The tail of the exponential law reaches the edge of the window.
    warnings.simplefilter("ignore", js.exceptions.WindowWarning)
    lines = ["Pull-offs over those of the closed form or of the finer grid.", "", HEAD]
    table = rows(options.quick)
    if options.curves:
        lines = [CURVES, "", CURVES_HEAD]
        table = curves(options.curves)
    for line in table:
        lines.append(line)
        print(line, flush=True)
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def rows(is_quick: bool) -> Iterator[str]:
    yield wave(256)
    for seed in range(1, 6):
        yield rough((128,), seed, 1e-4)
    if is_quick:
        return
    for work in WORKS:
        for seed in range(5):
            yield rough((64, 64), seed, work)
    yield sphere(192)


def wave(number: int) -> str:
    wave = 0.01, 1.0, 1.0, 8e-5
    heights = wave[0] * (np.cos(2 * np.pi * np.arange(number) / number) - 1)
    solid = js.HalfSpace(js.Grid((number,), (1.0,)), wave[2])
    contact = js.Contact(solid, jnp.asarray(heights), js.potentials.Gaussian(wave[3], 1.0))
    expected = float(johnson.pull_off(*wave).mean_pressure)
    return row("Johnson's wave, to zero", str(number), contact, expected, 0.0)


def sphere(number: int) -> str:
    radius, modulus, work = 1.0, 1.0, 0.002
    # Without load the radius of the contact is 0.3.
    grid = js.Grid(number, (0.8, 0.8))
    heights = js.surfaces.paraboloid(grid, radius=radius)
    # On a grid its limit is nearer than that of a Gaussian, whose attraction is none at contact.
    law = js.potentials.Exponential(work, 1.0)
    contact = js.Contact(js.FreeHalfSpace(grid, modulus), heights, law)
    expected = float(jkr.pull_off(radius, modulus, work).force)
    return row("sphere, to zero", f"{number}²", contact, expected, 0.0)


def rough(shape: tuple[int, ...], seed: int, work: float) -> str:
    coarse, fine = (rough_contact(tuple(k * n for n in shape), seed, work) for k in (1, 2))
    shortest = float(js.resolved_range(fine, RESOLUTION))
    law = js.potentials.Gaussian(work, shortest)
    expected = pull_off(js.Contact(fine.solid, fine.heights, law))
    points = f"{shape[0]}²" if len(shape) == 2 else str(shape[0])
    name = f"rough {seed}, w = {work:g}, to a finer grid's range"
    return row(name, points, coarse, expected, shortest)


def rough_contact(shape: tuple[int, ...], seed: int, work: float) -> js.Contact:
    grid = js.Grid(shape, (1.0,) * len(shape))
    heights = js.surfaces.self_affine(grid, jax.random.key(seed), k_high=4, rms_height=0.02)
    return js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Gaussian(work, 1.0))


def pull_off(contact: js.Contact) -> float:
    return float(js.pull_off(contact).equilibrium.force)


def row(name: str, points: str, contact: js.Contact, expected: float, to: float) -> str:
    try:
        found = js.extrapolate(pull_off, contact, to=to)
    except js.exceptions.SolverError:
        # The values rise and fall, or tell of no limit.
        return f"| {name} | {points} | | refused | | | |"
    first, value, error = (
        float(x) / expected for x in (found.values[0], found.value, abs(found.error))
    )
    off = abs(value - 1)
    return (
        f"| {name} | {points} | {first:.4f} | {value:.4f} | {abs(error):.4f} "
        f"| {float(found.power):.2f} | {off:.4f} |"
    )


def tip(work: float, length: float, modulus: float) -> js.Contact:
    grid = js.Grid(8, (48.0, 48.0))
    law = js.potentials.Exponential(work, length)
    heights = js.surfaces.paraboloid(grid, 20.0)
    solid = js.FreeHalfSpace(grid, modulus)
    return js.Contact(solid, heights, law, unit="nm", pressure_unit="GPa")


def curves(count: int) -> Iterator[str]:
    """Yield for each parameter how many fits have the truth within two errors, and the rms."""
    # The slope of the force has steps. Beside them a spline through wider loads is off by as much
    # as the noise of a mean.
    indentation = np.linspace(8.0, -46.0, 541)
    loads = js.FarDisplacement(-indentation)
    states = js.sweep(tip(*TRUTH.values()), loads, order="continuation", stability=False)
    law = indentation[::-1], np.asarray(states.equilibrium.force)[::-1]
    # A failed fit has no deviation.
    deviations = np.full((count, len(TRUTH)), np.nan)
    for seed in range(count):
        random = np.random.default_rng(1000 + seed)
        curve = recorded(
            law,
            seed,
            noise=0.2,
            constant=1.0,
            reach=60.0,
            speed=50.0,
            contact=3 * random.normal(),
            drift=0.1 * random.normal(),
            tilt=2e-3 * random.normal(),
            offsets=tuple(0.5 * random.normal(size=2)),
        )
        part = js.lab.force_curves.means(curve)
        fit = js.calibrate(
            tip(0.06, 5.0, 0.12),
            js.FarDisplacement(part.tip_position),
            forces=part.force,
            weights=part.weights,
            load_error=part.drift_error,
            offset=True,
            baseline="linear",
            throw=False,
        )
        if fit.result == js.RESULTS.successful:
            found, errors = (jax.tree.leaves(x) for x in (fit.parameters, fit.standard_errors))
            deviations[seed] = (np.array(found) - [*TRUTH.values()]) / np.array(errors)
    for name, one in zip(TRUTH, deviations.T, strict=True):
        within = np.sum(np.abs(one) < 2)
        yield f"| {name} | {within} of {count} | {np.sqrt(np.nanmean(one**2)):.2f} |"


if __name__ == "__main__":
    main()

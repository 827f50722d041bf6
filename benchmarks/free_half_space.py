"""The half space under a single contact against closed forms, a peer, and the periodic one.

Hertz' sphere; a flat punch; Maugis' sphere under Dugdale's law, its pull-off under dead load and
through springs, its jump under a held far side, and the loop's loss; steps and time for the same
sphere, free and periodic; and the free system of Adhesion and ContactMechanics, whose L-BFGS-B is
stopped at about the same force. All run on the last core that is allowed; times are medians without
compilation.
"""

import os

# Before any library starts its threads.
os.environ["OMP_NUM_THREADS"] = "1"
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import argparse
import time
import warnings
from pathlib import Path
from statistics import median

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)
warnings.simplefilter("ignore", js.exceptions.WindowWarning)

NONE = js.potentials.Exponential(0.0, 1.0)
REPEATS = 5


def far_side(contact, equilibrium):
    """Return the displacement of the far side."""
    sunk = contact.solid.displacement(equilibrium.pressure)
    return float(jnp.mean(equilibrium.displacement - sunk))


def hertz_row(n):
    grid = js.Grid(n)
    contact = js.Contact(js.FreeHalfSpace(grid, 1.0), js.surfaces.paraboloid(grid, 1.0), NONE)
    held = js.equilibrate(contact, js.FarDisplacement(-0.04))
    exact = 4 / 3 * 0.04**1.5
    pressed = js.equilibrate(contact, js.MeanPressure(exact))
    errors = (
        held.force / exact - 1,
        np.sqrt(held.contact_area / np.pi) / 0.2 - 1,
        -far_side(contact, pressed) / 0.04 - 1,
    )
    return f"| {n}² | " + " | ".join(f"{100 * float(e):+.3f} %" for e in errors) + " |"


def punch_row(n):
    grid = js.Grid(n)
    # No deeper than need be, as digits are lost to it.
    heights = jnp.maximum(js.surfaces.flat_punch(grid, 0.25, 1e-3), -0.05)
    contact = js.Contact(js.FreeHalfSpace(grid, 1.0), heights, NONE)
    force = js.equilibrate(contact, js.FarDisplacement(-1e-3)).force
    return f"| {n}² | {force / 1e-3:.4f} | {100 * float(force / 1e-3 / 0.5 - 1):+.2f} % |"


# Maugis' sphere: its radius is 1.
WORK, MODULUS = 1e-3, 0.75
SPHERE = (1.0, MODULUS, WORK)
UNIT = js.references.jkr.units(*SPHERE)
JKR_LOSS = js.references.jkr.loop_loss(*SPHERE) / (UNIT.force * UNIT.displacement)


def maugis(parameter, n, window, smoothing=0.1):
    """Return the contact of a transition parameter in a window, the law's edge smoothed."""
    strength = strength_of(parameter)
    grid = js.Grid(n, [window, window])
    law = js.potentials.Dugdale(WORK, WORK / strength, smoothing)
    heights = js.surfaces.paraboloid(grid, 1.0)
    return js.Contact(js.FreeHalfSpace(grid, MODULUS), heights, law)


def strength_of(parameter):
    return parameter / float(js.references.maugis.transition_parameter(*SPHERE, 1.0))


def dead_row(parameter, n):
    exact = js.references.maugis.pull_off(*SPHERE, strength_of(parameter))
    # Nothing acts on the surface beyond the range of the law.
    contact = maugis(parameter, n, 2.35 * float(exact.outer_radius))
    start = js.equilibrate(contact, js.FarDisplacement(-0.9 * exact.displacement))
    pull = float(js.pull_off(contact, initial=start).equilibrium.force)
    return (
        f"| {parameter:g} | {n}² | {float(contact.resolution):.2g} | {pull / UNIT.force:.4f} | "
        f"{percent(pull, exact.force)} |"
    )


def held_row(parameter, n):
    exact = js.references.maugis.pull_off(*SPHERE, strength_of(parameter), np.inf)
    contact = maugis(parameter, n, 3.1 * float(exact.outer_radius))
    ends = js.FarDisplacement(-exact.displacement * jnp.array([0.93, 1.05]))
    # By default a path begins apart.
    pressed = js.equilibrate(contact, js.FarDisplacement(0.0))
    path = js.follow(contact, ends, initial=pressed)
    jump = path.jumps[int(jnp.argmax(path.jumps.dissipation))]
    place, force = -float(jump.load.value), float(jump.before.force)
    return (
        f"| {parameter:g} | {n}² | {float(contact.resolution):.2g} | {jump.kind.name} | "
        f"{place / UNIT.displacement:.4f} | {percent(place, exact.displacement)} | "
        f"{force / UNIT.force:.4f} | {percent(force, exact.force)} |"
    )


def loop_row(parameter, n, smoothing):
    exact = loss_of_loop(strength_of(parameter))
    contact = maugis(parameter, n, 2.8 * float(UNIT.contact_radius), smoothing)
    turns = js.FarDisplacement(UNIT.displacement * jnp.array([1.0, -0.05, 1.0]))
    path = js.follow(contact, turns, smallest_jump=1e-3, max_jumps=256)
    entry = float(path.jumps.load.value[0]) / UNIT.displacement
    loss, unit = float(path.dissipation), UNIT.force * UNIT.displacement
    return (
        f"| {parameter:g} | {n}² | {smoothing} | {float(contact.resolution):.2g} | {entry:.4f} | "
        f"{float(contact.potential.length) / UNIT.displacement:.4f} | {loss / unit:.4f} | "
        f"{exact / unit:.4f} | {percent(loss, exact)} |"
    )


def loss_of_loop(strength):
    """Return what Maugis' sphere loses between d = -w / s, where it jumps in, and its way out.

    Nothing attracts before, and right there the branch without contact turns back; so the loss is
    the area under the curve in contact.
    """
    last = js.references.maugis.pull_off(*SPHERE, strength, np.inf)
    radii = np.geomspace(last.contact_radius, 2 * UNIT.contact_radius, 20_001)
    curve = js.references.maugis.curve(radii, *SPHERE, strength)
    approach = np.linspace(last.displacement, -WORK / strength, 20_001)
    return -np.trapezoid(np.interp(approach, curve.displacement, curve.force), approach)


def spring_row(stiffness, n):
    strength = strength_of(1.0)
    contact = maugis(1.0, n, 8 * float(UNIT.contact_radius))
    force_per_length = stiffness * UNIT.force / UNIT.displacement
    pull = js.pull_off(contact, spring=force_per_length / float(contact.area))
    exact = js.references.maugis.pull_off(*SPHERE, strength, force_per_length)
    place, force = -float(pull.load.value), float(pull.equilibrium.force)
    # That of the spring's far end, which it is stretched to.
    exact_place = exact.displacement + exact.force / force_per_length
    return (
        f"| {stiffness:g} | {n}² | {pull.kind.name} | {force / UNIT.force:.4f} | "
        f"{percent(force, exact.force)} | {place / UNIT.displacement:.4f} | "
        f"{percent(place, exact_place)} |"
    )


def percent(value, exact):
    return f"{100 * (float(value) / float(exact) - 1):+.2f} %"


def steps_row(n):
    law = js.potentials.Exponential(2e-3, 0.02)
    window, doubled = js.Grid(n), js.Grid(2 * n)
    solids = js.HalfSpace(window, 1.0), js.FreeHalfSpace(window, 1.0), js.HalfSpace(doubled, 1.0)
    runs = []
    for solid in solids:
        contact = js.Contact(solid, js.surfaces.paraboloid(solid.grid, 1.0), law)
        runs.append(solved(contact, js.MeanPressure(0.01)))
    (_, periodic, _), (_, free, _), _ = runs
    each = [1e3 * seconds / steps for _, steps, seconds in runs]
    return (
        f"| {n}² | {periodic} | {free} | {free / periodic:.2f} | {each[0]:.2f} | {each[1]:.2f} | "
        f"{each[1] / each[0]:.1f} | {each[2]:.2f} | {each[2] / each[0]:.1f} |"
    )


def solved(contact, load):
    """Return the force at a load, the steps to it, and the seconds of them all."""
    seconds = []
    for _ in range(1 + REPEATS):
        start = time.perf_counter()
        state = jax.block_until_ready(js.equilibrate(contact, load))
        seconds.append(time.perf_counter() - start)
    return float(state.force), int(state.num_steps), median(seconds[1:])


def peer_row(n):
    from Adhesion.Interactions import Exponential
    from Adhesion.System import BoundedSmoothContactSystem
    from ContactMechanics import FreeFFTElasticHalfSpace
    from SurfaceTopography import Topography

    grid, law = js.Grid(n), (2e-3, 0.02)
    heights = js.surfaces.paraboloid(grid, 1.0)
    solid = js.FreeHalfSpace(grid, 1.0)
    contact = js.Contact(solid, heights, js.potentials.Exponential(*law))
    force, _, ours = solved(contact, js.FarDisplacement(-0.05))
    system = BoundedSmoothContactSystem(
        FreeFFTElasticHalfSpace((n, n), 1.0, (1.0, 1.0)),
        Exponential(*law),
        Topography(np.asarray(heights), (1.0, 1.0)),
    )
    options = {"gtol": 1e-5 / n**2, "ftol": 0, "maxiter": 10_000, "maxfun": 20_000}
    start = time.perf_counter()
    system.minimize_proxy(offset=0.05, options=options)
    theirs = time.perf_counter() - start
    difference = system.compute_normal_force() / force - 1
    return f"| {n}² | {ours:.3f} | {theirs:.2f} | {theirs / ours:.0f} | {difference:+.1e} |"


MAUGIS = [(1.0, 64), (1.0, 128), (2.0, 64), (2.0, 128), (5.0, 128), (5.0, 256)]

TABLES = {
    "Hertz' sphere, a = 0.2 in a window of 1": (
        ("points", "force", "radius", "displacement"),
        hertz_row,
        [(64,), (128,), (256,)],
    ),
    "A flat punch: stiffness, 2 E* a in closed form": (
        ("points", "stiffness", "error"),
        punch_row,
        [(64,), (128,), (256,)],
    ),
    "Maugis' sphere pulled off by a dead load, in units of pi w R": (
        ("lambda", "points", "resolution", "force", "error"),
        dead_row,
        MAUGIS,
    ),
    "Maugis' sphere, its far side held, where it jumps off, in units of d0 and of pi w R": (
        ("lambda", "points", "resolution", "jump", "place", "error", "force", "error"),
        held_row,
        MAUGIS,
    ),
    f"Its loop from afar and back, in units of F0 d0 (JKR's loses {JKR_LOSS:.4f})": (
        ("lambda", "points", "edge", "resolution", "in at", "Dugdale", "loss", "Dugdale", "error"),
        loop_row,
        [(2.0, 64, 0.1), (5.0, 128, 0.1), (5.0, 256, 0.1), (5.0, 256, 0.05), (5.0, 384, 0.05)],
    ),
    "Maugis' sphere at lambda = 1 pulled off through springs, in units of F0 / d0": (
        ("stiffness", "points", "jump", "force", "error", "place", "error"),
        spring_row,
        [(k, n) for k in (0.5, 2.0, 8.0) for n in (64, 128)],
    ),
    "Steps of an adhesive sphere under a held pressure, and milliseconds of each": (
        (
            "points",
            "periodic",
            "free",
            "ratio",
            "periodic [ms]",
            "free [ms]",
            "ratio",
            "periodic, 4 x the points [ms]",
            "ratio",
        ),
        steps_row,
        [(128,), (256,), (512,)],
    ),
    "Seconds to the force of an adhesive sphere, by jaxstab and by Adhesion": (
        ("points", "jaxstab [s]", "Adhesion [s]", "ratio", "force differs by"),
        peer_row,
        [(64,), (128,), (256,)],
    ),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="a file for the tables as well")
    arguments = parser.parse_args()
    lines = []
    for title, (header, row, cases) in TABLES.items():
        lines += [title, "", f"| {' | '.join(header)} |", "|" + "---|" * len(header)]
        for case in cases:
            lines.append(row(*case))
            print(lines[-1], flush=True)
        lines.append("")
    if arguments.out:
        arguments.out.write_text("\n".join(lines).rstrip("\n") + "\n")


if __name__ == "__main__":
    main()

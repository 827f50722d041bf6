"""Rings against closed forms, against squares, and their times.

Hertz' sphere, Sneddon's cone and a flat punch; Maugis' sphere under Dugdale's law, its pull-off
under a dead load and where it jumps under a held far side; a layer on
squares. Names of tables choose some of them. Times are medians without compilation.
"""

import argparse
import os
import time
import warnings
from pathlib import Path
from statistics import median

import jax
import jax.numpy as jnp
import numpy as np
from machine import machine

import jaxstab as js
from jaxstab.references import jkr, maugis

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)
warnings.simplefilter("ignore", js.exceptions.WindowWarning)

NONE = js.potentials.NoAdhesion()
REPEATS = 3
# A sphere of radius 1.
WORK, MODULUS = 1e-3, 0.75
SPHERE = (1.0, MODULUS, WORK)
UNIT = jkr.units(*SPHERE)
SMOOTHING = 0.05


def percent(value, exact, digits=2):
    return f"{100 * (float(value) / float(exact) - 1):+.{digits}f} %"


def half_space(num_points, radius, profile, law, modulus=1.0):
    """Return the contact of a tip on rings."""
    rings = js.Rings(num_points, radius)
    solid = js.solids.AxisymmetricHalfSpace(rings, modulus)
    return js.Contact(solid, profile(rings), law)


def paraboloid(grid):
    return js.surfaces.paraboloid(grid, 1.0)


def contact_radius(contact, state):
    return float(contact.grid.radius * jnp.sqrt(state.contact_area))


# Contact radii, over the radius of the disc, which end within rings or at their edges.
RADII = np.linspace(0.38, 0.42, 5)
SLOPE = 0.2
NUMBERS = (100, 200, 500, 1000)


def sphere_state(num_points, a):
    contact = half_space(num_points, 1.0, paraboloid, NONE)
    return contact, js.equilibrate(contact, js.FarDisplacement(-(a**2))), 4 / 3 * a**3


def cone_state(num_points, a):
    approach = np.pi / 2 * a * SLOPE
    contact = half_space(num_points, 1.0, lambda rings: js.surfaces.cone(rings, SLOPE), NONE)
    force = 2 * approach**2 / (np.pi * SLOPE)
    return contact, js.equilibrate(contact, js.FarDisplacement(-approach)), force


def punch_state(num_points, a):
    # The punch ends at the edge of a ring.
    edge = (round(a**2 * num_points) / num_points) ** 0.5
    contact = half_space(
        num_points, 1.0, lambda rings: jnp.where(rings.radii < edge, 0.0, -1.0), NONE
    )
    return contact, js.equilibrate(contact, js.FarDisplacement(-0.05)), 2 * edge * 0.05


SHAPES = {"sphere (Hertz)": sphere_state, "cone (Sneddon)": cone_state, "flat punch": punch_state}


def shape_rows():
    for name, solve in SHAPES.items():
        before = None
        for number in NUMBERS:
            forces, radii = [], []
            for a in RADII:
                contact, state, force = solve(number, a)
                forces.append(abs(float(state.force / force) - 1))
                edge = (round(a**2 * number) / number) ** 0.5 if solve is punch_state else a
                radii.append(abs(contact_radius(contact, state) / edge - 1))
            order = ""
            if before is not None:
                order = f"{np.log(before[1] / max(forces)) / np.log(number / before[0]):.1f}"
            before = number, max(forces)
            yield name, number, f"{max(forces):.1e}", order, f"{max(radii):.1e}"


def strength_of(parameter):
    return parameter / float(maugis.transition_parameter(*SPHERE, 1.0))


# The radius of the disc in units of a0, so that the attraction ends within it.
DISCS = {0.2: 6.0, 0.5: 4.0, 1.0: 3.0, 2.0: 2.5, 5.0: 2.3}


def dugdale(parameter, num_points):
    """Return Maugis' sphere on rings."""
    law = js.potentials.Dugdale(WORK, WORK / strength_of(parameter), SMOOTHING)
    radius = DISCS[parameter] * float(UNIT.contact_radius)
    return half_space(num_points, radius, paraboloid, law, MODULUS)


def dead_rows():
    for parameter, number in (
        (0.2, 200),
        (0.5, 200),
        (1.0, 200),
        (2.0, 200),
        (2.0, 400),
        (5.0, 400),
        (5.0, 800),
    ):
        contact = dugdale(parameter, number)
        exact = maugis.pull_off(*SPHERE, strength_of(parameter))
        pull = js.pull_off(contact)
        force = pull.equilibrium.force
        yield (
            parameter,
            number,
            f"{float(contact.resolution):.2g}",
            pull.kind.name,
            f"{float(force) / UNIT.force:.4f}",
            f"{exact.force / UNIT.force:.4f}",
            percent(force, exact.force),
        )


def held_rows():
    for parameter, number in ((1.0, 200), (2.0, 200), (2.0, 400)):
        contact = dugdale(parameter, number)
        exact = maugis.pull_off(*SPHERE, strength_of(parameter), np.inf)
        start = js.equilibrate(contact, js.FarDisplacement(-0.9 * exact.displacement))
        ends = js.FarDisplacement(-exact.displacement * jnp.array([0.9, 1.05]))
        path = js.follow(contact, ends, initial=start)
        jump = path.jumps[int(jnp.argmax(path.jumps.dissipation))]
        place, force = -float(jump.load.value), float(jump.before.force)
        yield (
            parameter,
            number,
            jump.kind.name,
            f"{place / UNIT.displacement:.4f}",
            percent(place, exact.displacement),
            f"{force / UNIT.force:.4f}",
            percent(force, exact.force),
        )


def layer_rows():
    for name, ratio, thickness in (("layer", 0.3, 0.2), ("incompressible layer", 0.5, 0.2)):
        rings = js.Rings(200, 0.6)
        layer = js.solids.Axisymmetric(rings, js.Layer(js.Grid(8), 1.0, ratio, thickness))
        contact = js.Contact(layer, paraboloid(rings), NONE)
        state = js.equilibrate(contact, js.FarDisplacement(-0.03))
        yield name, "200 rings", f"{float(state.force):.6f}", ""
        for n in (128, 256):
            grid = js.Grid(n, 1.6)
            solid = js.Layer(grid, 1.0, ratio, thickness)
            squares = js.Contact(solid, paraboloid(grid), NONE)
            # The base is held: the mean displacement is that under the mean pressure.
            other = js.equilibrate(squares, js.MeanPressure(float(state.force / grid.area)))
            base = float(jnp.mean(other.displacement)) - float(
                state.force / grid.area / solid.uniform_stiffness
            )
            yield name, f"{n}²", f"{float(state.force):.6f}", percent(-base, 0.03, 3)


def timed(call):
    """Return the median seconds of a call, without the first one."""
    seconds = []
    for _ in range(1 + REPEATS):
        start = time.perf_counter()
        jax.block_until_ready(jax.tree.leaves(call()))
        seconds.append(time.perf_counter() - start)
    return median(seconds[1:])


def time_rows():
    hertz = half_space(500, 1.0, paraboloid, NONE)
    law = js.potentials.Exponential(2e-3, 0.02)
    sticky = half_space(500, 1.0, paraboloid, law)
    small = half_space(200, 1.0, paraboloid, law)
    load = js.FarDisplacement(-0.1)
    runs = {
        "equilibrium, 500 rings, no adhesion": lambda: js.equilibrate(hertz, load),
        "equilibrium, 500 rings, exponential law": lambda: js.equilibrate(sticky, load),
        "pull_off, 200 rings, exponential law": lambda: js.pull_off(small),
    }
    for parameter in (1.0, 2.0):
        contact = dugdale(parameter, 200)
        far = 1.6 * WORK / strength_of(parameter) + 2 * float(UNIT.displacement)
        turns = js.FarDisplacement(jnp.array([far, -0.5 * float(UNIT.displacement), far]))
        runs[f"pull_off, 200 rings, Dugdale, lambda {parameter:g}"] = lambda c=contact: js.pull_off(
            c
        )
        runs[f"follow in and out, 200 rings, Dugdale, lambda {parameter:g}"] = (
            lambda c=contact, t=turns: js.follow(c, t)
        )
    for name, call in runs.items():
        before = os.getloadavg()[0]
        yield name, f"{timed(call):.3g}", f"{before:.1f}"


TABLES = {
    "shapes": (
        "Without adhesion: the largest errors of five approaches, and the order of convergence",
        ("tip", "rings", "force", "order", "contact radius"),
        shape_rows,
    ),
    "dead": (
        "Maugis' sphere pulled off by a dead load, in units of pi w R",
        ("lambda", "rings", "resolution", "kind", "force", "closed form", "error"),
        dead_rows,
    ),
    "held": (
        "Maugis' sphere, its far side held, where it jumps off, in units of d0 and of pi w R",
        ("lambda", "rings", "kind", "place", "error", "force", "error"),
        held_rows,
    ),
    "layers": (
        "A sphere on a layer, at one force: the approach on squares beside 0.03 on rings",
        ("solid", "points", "force", "approach"),
        layer_rows,
    ),
    "times": (
        "Seconds, and the load of the machine before each",
        ("call", "seconds", "load"),
        time_rows,
    ),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", help=f"some of {', '.join(TABLES)}; all by default")
    parser.add_argument("--output", type=Path, help="write the tables there too")
    arguments = parser.parse_args()
    lines = [machine(), ""]
    for name in arguments.tables or TABLES:
        title, header, rows = TABLES[name]
        lines += [title, "", f"| {' | '.join(header)} |", "|" + "---|" * len(header)]
        print(title, flush=True)
        for row in rows():
            lines.append(f"| {' | '.join(map(str, row))} |")
            print(lines[-1], flush=True)
        lines.append("")
    if arguments.output:
        arguments.output.write_text("\n".join(lines).rstrip("\n") + "\n")


if __name__ == "__main__":
    main()

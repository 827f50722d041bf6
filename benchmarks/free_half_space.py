"""The half space under a single contact against closed forms, and its steps beside a periodic one.

Hertz' sphere; a flat punch; Maugis' sphere under Dugdale's law, its pull-off under dead load and
its jump under a held far side; steps for the same sphere, free and periodic.
"""

import argparse
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.ResolutionWarning)

NONE = js.potentials.Exponential(0.0, 1.0)
# Of Maugis, in units of d0 and F0: parameter, jump under a held far side, force there.
JUMPS = {1.0: (0.9917, -0.8917), 2.0: (0.9386, -0.8401), 5.0: (0.9139, -0.8336)}


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


def maugis_row(parameter, n):
    work, modulus = 1e-3, 4 / 3
    a0, d0 = (np.pi * work / modulus) ** (1 / 3), (np.pi * work / modulus) ** (2 / 3)
    force0 = np.pi * work
    stress = parameter / 2 * (np.pi * work * modulus**2) ** (1 / 3)
    grid = js.Grid(n, [8 * a0, 8 * a0])
    law = js.potentials.Dugdale(work, work / stress)
    contact = js.Contact(js.FreeHalfSpace(grid, 1.0), js.surfaces.paraboloid(grid, 1.0), law)
    pull = float(js.pull_off(contact).equilibrium.force) / force0
    exact = -float(PULL_OFFS[parameter])
    path = js.follow(contact, js.FarDisplacement(jnp.array([0.0, 1.3 * d0])))
    jump = path.jumps[int(jnp.argmax(path.jumps.dissipation))]
    place, force = float(jump.load.value) / d0, float(jump.before.force) / force0
    place0, force1 = JUMPS[parameter]
    return (
        f"| {parameter:g} | {n}² | {float(contact.resolution):.2g} | {pull:.4f} | "
        f"{100 * (pull / exact - 1):+.2f} % | {jump.kind.name} | {place:.4f} | "
        f"{100 * (place / place0 - 1):+.2f} % | {force:.4f} | {100 * (force / force1 - 1):+.2f} % |"
    )


# Maugis' pull-offs under dead load, in units of F0.
PULL_OFFS = {1.0: 1.6007, 2.0: 1.5346, 5.0: 1.5063}


def steps_row(n):
    grid = js.Grid(n)
    heights = js.surfaces.paraboloid(grid, 1.0)
    law = js.potentials.Exponential(2e-3, 0.02)
    load = js.MeanPressure(0.01)
    solids = js.HalfSpace(grid, 1.0), js.FreeHalfSpace(grid, 1.0)
    contacts = [js.Contact(solid, heights, law) for solid in solids]
    periodic, free = (int(js.equilibrate(contact, load).num_steps) for contact in contacts)
    return f"| {n}² | {periodic} | {free} | {free / periodic:.2f} |"


DEAD, HELD = ("pull-off", "error"), ("jump", "place", "error", "force", "error")
MAUGIS = ("lambda", "points", "resolution", *DEAD, *HELD)
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
    "Maugis' sphere; forces in units of pi w R, displacements of d0": (
        MAUGIS,
        maugis_row,
        [(1.0, 64), (1.0, 128), (2.0, 128)],
    ),
    "Steps of an adhesive sphere under a held pressure": (
        ("points", "periodic", "free", "ratio"),
        steps_row,
        [(128,), (256,), (512,)],
    ),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, help="write the tables there too")
    arguments = parser.parse_args()
    lines = []
    for title, (header, row, cases) in TABLES.items():
        lines += [title, "", f"| {' | '.join(header)} |", "|" + "---|" * len(header)]
        for case in cases:
            lines.append(row(*case))
            print(lines[-1], flush=True)
        lines.append("")
    if arguments.output:
        arguments.output.write_text("\n".join(lines).rstrip("\n") + "\n")


if __name__ == "__main__":
    main()

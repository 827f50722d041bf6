"""Pull-offs and jumps against closed forms, at several resolutions of the grid.

Johnson's wave: tension and jump to full contact of a sinusoid with adhesion of hardly any range,
and the mean gap along the stable branch. Maugis' sphere: the pull-off of a paraboloid in a cell
large beside its contact, under Dugdale's law. Both under dead load.
"""

import argparse
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js
from jaxstab.references import jkr, johnson, maugis

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)

AMPLITUDE = 0.05


def wave(alpha, size, resolution):
    """Return Johnson's wave with an exponential law whose range the grid resolves as said."""
    grid = js.Grid((size,))
    (x,) = grid.coordinates
    work = (alpha * np.pi * AMPLITUDE) ** 2 / 2
    length = np.sqrt(resolution * work / (np.pi * size / 2))
    law = js.potentials.Exponential(work, length)
    heights = AMPLITUDE * jnp.cos(2 * np.pi * x)
    return js.Contact(js.HalfSpace(grid, 1.0), heights, law), (AMPLITUDE, 1.0, 1.0, work)


def state_at(contact, problem, fraction):
    """Return the equilibrium at the mean gap of a fraction of contact."""
    exact = johnson.curve(fraction, *problem)
    touches = np.cos(2 * np.pi * np.asarray(contact.grid.coordinates[0])) > np.cos(np.pi * fraction)
    start = np.where(touches, 0, contact.heights.max() - contact.heights)
    return js.equilibrate(contact, js.MeanGap(exact.mean_gap), initial=start)


def johnson_row(alpha, size, resolution):
    contact, problem = wave(alpha, size, resolution)
    unit = np.pi * AMPLITUDE
    off, full = johnson.pull_off(*problem), johnson.jump_to_full_contact(*problem)
    # From the middle of the stable branch to both of its ends.
    fractions = np.linspace(off.contact_fraction, full.contact_fraction, 400)
    begin = state_at(contact, problem, fractions[200])
    pull = js.pull_off(contact, initial=begin)
    up = js.MeanPressure(jnp.stack([begin.mean_pressure, full.mean_pressure + 0.2 * unit]))
    path = js.follow(contact, up, initial=begin)
    jump = path.jumps[int(jnp.argmax(path.jumps.dissipation))]
    curve = johnson.curve(fractions, *problem)
    # At its very end the gap goes with the root of the distance.
    last = off.mean_pressure + 0.98 * (full.mean_pressure - off.mean_pressure)
    below = path.load.value <= last
    gaps = np.interp(path.load.value[below], curve.mean_pressure, curve.mean_gap)
    gap_error = np.abs(path.equilibrium.mean_gap[below] - gaps).max() / AMPLITUDE
    error = float(pull.load.value / off.mean_pressure - 1)
    jump_error = float((jump.load.value - full.mean_pressure) / unit)
    return (
        f"| {alpha} | {size} | {float(contact.resolution):.2g} | "
        f"{float(pull.load.value) / unit:.5f} | {100 * error:+.2f} % | {pull.kind.name} | "
        f"{float(jump.load.value) / unit:.5f} | "
        f"{100 * jump_error / abs(full.mean_pressure / unit):+.2f} % | {100 * gap_error:.2f} % |"
    )


def maugis_row(parameter, size, smoothing=0.05, work=1e-4, cell=12.0):
    unit = jkr.units(1.0, 1.0, work)
    strength = parameter / float(maugis.transition_parameter(1.0, 1.0, work, 1.0))
    grid = js.Grid(size, cell * float(unit.contact_radius))
    law = js.potentials.Dugdale(work, work / strength, smoothing)
    contact = js.Contact(js.HalfSpace(grid, 1.0), js.surfaces.paraboloid(grid, 1.0), law)
    pull = js.pull_off(contact)
    force = float(pull.load.value * jnp.prod(grid.lengths) / unit.force)
    exact = float(maugis.pull_off(1.0, 1.0, work, strength).force / unit.force)
    return (
        f"| {parameter} | {size}² | {float(contact.resolution):.2g} | {force:.4f} | {exact:.4f} | "
        f"{100 * (force / exact - 1):+.2f} % | {pull.kind.name} |"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = []

    def say(line):
        rows.append(line)
        print(line, flush=True)

    say("Johnson's wave; pressures in units of p*, the gap's largest error in units of h")
    say("")
    say("| alpha | points | resolution | pull-off | error | kind | jump | error | gap |")
    say("|---|---|---|---|---|---|---|---|---|")
    for alpha in (0.1, 0.3, 0.5, 0.9):
        for size, resolution in ((1024, 9.0), (4096, 18.0), (16384, 36.0)):
            say(johnson_row(alpha, size, resolution))
    say("")
    say("Maugis' sphere; forces in units of pi w R")
    say("")
    say("| lambda | points | resolution | pull-off | closed form | error | kind |")
    say("|---|---|---|---|---|---|---|")
    for parameter in (0.5, 1.0, 2.0):
        for size in (128, 256, 512):
            say(maugis_row(parameter, size))
    say("")
    say("Johnson's wave, alpha = 0.5: the grid refined under one law")
    say("")
    say("| alpha | points | resolution | pull-off | error | kind | jump | error | gap |")
    say("|---|---|---|---|---|---|---|---|---|")
    for refinement in range(6):
        say(johnson_row(0.5, 256 * 2**refinement, 0.5 * 2**refinement))
    if options.out:
        options.out.write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()

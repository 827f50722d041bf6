"""Pull-offs of rough surfaces against bisection, and their derivatives against differences.

Twelve self-affine surfaces: two sizes, three laws, two of each. The bisection goes from state to
state by warm-started equilibria under ever smaller steps of the load.
"""

import argparse
import warnings
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)

ENERGY, RMS_HEIGHT = 0.02, 0.05
# Of differences, over the surface energy and the rms height.
STEP = 1e-6

LAWS = {
    "exponential": js.potentials.Exponential(ENERGY, 0.08),
    "Dugdale": js.potentials.Dugdale(ENERGY, 0.08),
    "Lennard-Jones": js.potentials.LennardJones(ENERGY, 0.08),
}


def surface(size, law, seed):
    grid = js.Grid(size)
    heights = js.surfaces.self_affine(
        grid, jax.random.key(seed), k_low=2, k_high=8, rms_height=RMS_HEIGHT
    )
    return js.Contact(js.HalfSpace(grid, 1.0), heights, law)


def bisected(contact, resolution=1e-9):
    """Return the largest tension that a warm-started equilibrium survives, by smaller steps."""
    state, value, step = js.equilibrate(contact, js.MeanPressure(0.0)), 0.0, -1e-3
    while abs(step) > resolution:
        new = js.equilibrate(contact, js.MeanPressure(value + step), initial=state, throw=False)
        if new.result == "successful":
            state, value = new, value + step
        else:
            step /= 2
    return value


def with_changes(contact, changes, point):
    """Return the contact with another surface energy, and another height of a point."""
    energy, height = changes
    contact = eqx.tree_at(lambda c: c.potential.surface_energy, contact, ENERGY + energy)
    return eqx.tree_at(lambda c: c.heights, contact, contact.heights.at[point].add(height))


def derivatives(contact, pull):
    """Return how far two derivatives are off differences of whole pull-offs, or a refusal."""
    gap = np.asarray(pull.equilibrium.gap)
    # A point near the edge of contact.
    point = np.unravel_index(np.argmin(np.where(gap > 0, gap, np.inf)), gap.shape)

    def value(changes):
        return js.pull_off(with_changes(contact, changes, point)).load.value

    try:
        rates = np.asarray(jax.grad(value)(jnp.zeros(2)))
    except js.exceptions.SolverError as error:
        return f"refused: {str(error).split(':')[1].strip()}"
    differences = []
    for i, step in enumerate((STEP * ENERGY, STEP * RMS_HEIGHT)):
        change = jnp.zeros(2).at[i].set(step)
        differences.append(float(value(change) - value(-change)) / (2 * step))
    return f"{np.abs(rates - differences).max() / np.linalg.norm(rates):.1e}"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = [
        "| law | points | seed | pull-off | kind | less bisection | derivatives less differences |",
        "|---|---|---|---|---|---|---|",
    ]
    print(*rows, sep="\n", flush=True)
    for size in (64, 128):
        for name, law in LAWS.items():
            for seed in (0, 1):
                contact = surface(size, law, seed)
                pull = js.pull_off(contact)
                value = float(pull.load.value)
                off = value / bisected(contact) - 1
                row = (
                    f"| {name} | {size}² | {seed} | {value:.8f} | {pull.kind.name} | {off:+.1e} | "
                    f"{derivatives(contact, pull)} |"
                )
                print(row, flush=True)
                rows.append(row)
    if options.out:
        options.out.write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()

"""Where jumps go: by conjugate gradients, as paths take them, and by overdamped relaxation.

Each jump of a loop is taken again by the gradient flow g' = -(K u + p0 + f'), cut at zero gap, in
small steps from the state that lost its stability, pushed along its mode by a millionth. A path
goes down by conjugate gradients instead. The same end means the same points in contact.
"""

import argparse
import warnings
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp

import jaxstab as js

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)

# A step of the flow over that at which its stiffest wave would grow.
SHARE = 0.5
NUM_STEPS = 400_000
PUSH = 1e-6


@partial(jax.jit, static_argnames="rate")
def relaxed(contact, load, gap, rate):
    """Return the gap that the flow ends at."""
    control = contact.control(load)
    balance = contact.balance(control)

    def goes_on(state):
        _, residual, count = state
        return (residual > 1e-7) & (count < NUM_STEPS)

    def step(state):
        gap, _, count = state
        now = balance(gap)
        stiffest = contact.solid.max_stiffness + jnp.max(jnp.abs(now.curvature))
        moving = control.moving(gap, now.net)
        new = control.admissible(gap - rate / stiffest * jnp.where(moving, now.net, 0))
        return new, now.residual, count + 1

    gap, residual, count = jax.lax.while_loop(goes_on, step, (gap, jnp.inf, 0))
    return gap, residual, count


def compare(contact, path):
    """Return for each jump how the flow ends: its energy and contact less those of the path."""
    for jump in path.jumps:
        size = float(jnp.std(contact.heights)) / float(jnp.abs(jump.mode).max())
        pushed = jnp.maximum(jump.before.gap + PUSH * size * jump.mode, 0)
        start = contact.control(jump.after.load).restore(pushed)
        gap, residual, count = relaxed(contact, jump.after.load, start, SHARE)
        # Its last part is soft and slow.
        end = js.equilibrate(contact, jump.after.load, initial=gap, throw=False)
        energy = float((end.energy - jump.after.energy) / jump.dissipation)
        points = int((end.in_contact != jump.after.in_contact).sum())
        yield jump, float(residual), int(count), energy, points


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--surfaces", type=int, default=5)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = [
        "| seed | jump at | kind | dissipation | flow's energy less the path's, over it | points |",
        "|---|---|---|---|---|---|",
    ]
    print(*rows, sep="\n")
    number = same = 0
    for seed in range(options.surfaces):
        grid = js.Grid(64)
        heights = js.surfaces.self_affine(
            grid, jax.random.key(seed), k_low=2, k_high=8, rms_height=0.05
        )
        law = js.potentials.Exponential(0.05, 0.04)
        contact = js.Contact(js.HalfSpace(grid, 1.0), heights, law)
        path = js.follow(contact, js.MeanGap(jnp.array([0.4, 0.02, 0.4])))
        for jump, _, _, energy, points in compare(contact, path):
            number, same = number + 1, same + (points == 0)
            row = (
                f"| {seed} | {float(jump.load.value):.6f} | {jump.kind.name} | "
                f"{float(jump.dissipation):.2e} | {energy:+.1e} | {points} |"
            )
            rows.append(row)
            print(row, flush=True)
    rows += ["", f"{same} of {number} jumps end at the same contact points."]
    print(rows[-1])
    if options.out:
        options.out.write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()

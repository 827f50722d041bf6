"""Cost of branches and transitions over that of a warm equilibrium, without compilation.

A rough contact at 128 x 128 points is followed through a loop. A warm equilibrium is that at a load
a thousandth further on, started from the state before. A state of a branch is timed with its index,
the count of negative eigenvalues. Transitions have 16 images. They lead from one side to the other
of each jump, a five-hundredth of the load before it. Seconds are medians, taken in one run.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp

import jaxstab as js

HEAD = "| what | number | seconds | over a warm equilibrium |\n|---|---|---|---|"


def main() -> None:
    options = parse_options()
    jax.config.update("jax_enable_x64", True)
    lines = [f"float64; {options.size}²\n", HEAD]
    lines += rows(options.size)
    print(*lines, sep="\n")
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    return parser.parse_args()


def rows(size: int) -> list[str]:
    grid = js.Grid(size)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=size // 8, rms_height=0.05)
    solid = js.HalfSpace(grid, youngs_modulus=1.0, poisson_ratio=0.0)
    contact = js.Contact(solid, heights, js.potentials.Exponential(0.06, 0.06))
    path = js.follow(contact, js.MeanGap(jnp.array([0.4, 0.01, 0.4])))
    jumps = [jump for jump in path.jumps if jump.dissipation > 0.01 * path.dissipation]

    warm, ways = [], []
    for jump in jumps:
        value = jump.load.value
        ahead = jnp.sign(jump.after.load.value - value)
        loads = [js.MeanGap(value - part * ahead * value) for part in (2e-3, 3e-3)]
        before = js.equilibrate(contact, loads[0], initial=jump.before)
        warm.append(seconds(lambda b=before, x=loads[1]: js.equilibrate(contact, x, initial=b))[0])
        took, way = seconds(
            lambda j=jump, x=loads[0]: js.transition(contact, x, j.before, j.after, throw=False)
        )
        if way.result == "successful":
            ways.append(took)
    ends = js.MeanGap(jnp.array([0.4, 0.05]))
    took, branch = seconds(lambda: js.continuation(contact, ends, max_states=60))
    states = len(branch.load.value)
    unit = median(warm)
    found = [
        ("a warm equilibrium", len(warm), unit),
        ("a state of a branch", states, took / states),
        (f"a transition ({len(ways)} of {len(jumps)} found)", len(ways), median(ways)),
    ]
    return [f"| {name} | {number} | {s:.3f} | {s / unit:.1f} |" for name, number, s in found]


def seconds(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return how long a call takes once it is compiled, and what it returns."""
    jax.block_until_ready(call())
    start = time.perf_counter()
    found = jax.block_until_ready(call())
    return time.perf_counter() - start, found


if __name__ == "__main__":
    main()

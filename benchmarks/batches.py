"""Time to equilibrium of many surfaces together, by `jax.vmap`, over that of one after another.

Both are compiled before they are timed; they run in turn, and medians are taken.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp

import jaxstab as js

SURFACES = 64
SIZES = (32, 64, 128)
REPEATS = 9
HEAD = "| points | law | in turn [s] | together [s] | ratio |\n|---|---|---|---|---|"
LAWS = {
    "no adhesion": js.potentials.NoAdhesion(),
    "adhesive": js.potentials.Exponential(surface_energy=2e-4, length=1e-2),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    lines = [f"{SURFACES} surfaces", "", HEAD]
    print(*lines, sep="\n")
    for n in SIZES:
        for name, law in LAWS.items():
            lines.append(row(n, name, law))
            print(lines[-1], flush=True)
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def row(n: int, name: str, law: js.potentials.Potential) -> str:
    grid = js.Grid(n)
    keys = jax.random.split(jax.random.key(0), SURFACES)
    heights = [js.surfaces.self_affine(grid, key, k_high=n // 4, rms_slope=0.1) for key in keys]
    load = js.MeanGap(js.surfaces.rms_height(heights[0]))

    @jax.jit
    def solve(heights: jax.Array) -> js.results.Equilibrium:
        contact = js.Contact(js.HalfSpace(grid, 1.0), heights, law)
        return js.equilibrate(contact, load, throw=False)

    together = jax.jit(jax.vmap(solve))
    stacked = jnp.stack(heights)
    runs: dict[str, Callable[[], object]] = {
        "in turn": lambda: [solve(h) for h in heights],
        "together": lambda: together(stacked),
    }
    for run in runs.values():
        jax.block_until_ready(run())
    seconds = [[seconds_of(run) for run in runs.values()] for _ in range(REPEATS)]
    apart, joint = (statistics.median(times) for times in zip(*seconds, strict=True))
    ratio = statistics.median(a / b for a, b in seconds)
    return f"| {n}² | {name} | {apart:.3f} | {joint:.3f} | {ratio:.2f} |"


def seconds_of(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - start


if __name__ == "__main__":
    main()

"""Cost of derivatives over that of the equilibrium itself, without compilation.

For a rough adhesive contact: the mean pressure alone; with its gradient with respect to every
height, the modulus and both parameters of the law, by one adjoint solve; and the energy with the
same gradient, by the envelope theorem, without a solve. They run in turn, seconds are of processor
time on one thread, and medians are taken of the ratios. Memory is what the compiled programs ask
for beside their input and output; the limit on the solver's steps is an input, so that it cannot
grow with them.
"""

import os

# Before any library starts its threads.
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import jax
import jax.numpy as jnp

import jaxstab as js

HEAD = (
    "|    n | steps | solve [s] | + gradient | gradient alone | energy + gradient | "
    "memory, solve [MB] | + gradient |\n"
    "|------|-------|-----------|------------|----------------|-------------------|"
    "--------------------|------------|"
)
GAMMA, RHO, YOUNGS_MODULUS = 2e-5, 1e-3, 1.0
MAX_STEPS = 10_000


def main() -> None:
    options = parse_options()
    jax.config.update("jax_enable_x64", True)
    lines = ["float64; one thread\n", HEAD]
    print(*lines, sep="\n")
    for n in options.sizes:
        lines.append(row(n, options.repeats))
        print(lines[-1], flush=True)
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[128, 256, 512, 1024])
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    return parser.parse_args()


def row(n: int, repeats: int) -> str:
    grid = js.Grid(n)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=32, rms_slope=0.1)
    load = js.MeanGap(js.surfaces.rms_height(heights))

    def solve(parameters: tuple, max_steps: int) -> js.results.Equilibrium:
        heights, modulus, energy, length = parameters
        law = js.potentials.Exponential(energy, length)
        contact = js.Contact(js.HalfSpace(grid, modulus), heights, law)
        solver = js.solvers.PreconditionedConjugateGradient(max_steps=max_steps)
        return js.equilibrate(contact, load, solver)

    parameters = heights, jnp.array(YOUNGS_MODULUS), jnp.array(GAMMA), jnp.array(RHO)

    def program(function: Callable) -> Callable:
        return jax.jit(function).lower(parameters, MAX_STEPS).compile()

    def pressure(parameters: tuple, max_steps: int) -> jax.Array:
        return solve(parameters, max_steps).mean_pressure

    def energy(parameters: tuple, max_steps: int) -> jax.Array:
        return solve(parameters, max_steps).energy

    gradient = jax.value_and_grad(pressure)
    programs = program(pressure), program(gradient), program(jax.value_and_grad(energy))
    times = [[seconds(p, parameters) for p in programs] for _ in range(repeats)]
    alone = median(t[0] for t in times)
    both, envelope = (median(t[i] / t[0] for t in times) for i in (1, 2))
    memory = [p.memory_analysis().temp_size_in_bytes / 1e6 for p in programs[:2]]
    steps = int(solve(parameters, MAX_STEPS).num_steps)
    return (
        f"| {n:4d} | {steps:5d} | {alone:9.4f} | {both:10.2f} | {both - 1:14.2f} | "
        f"{envelope:17.2f} | {memory[0]:18.1f} | {memory[1]:10.1f} |"
    )


def seconds(program: Callable, parameters: tuple) -> float:
    start = time.process_time()
    jax.block_until_ready(program(parameters, MAX_STEPS))
    return time.process_time() - start


if __name__ == "__main__":
    main()

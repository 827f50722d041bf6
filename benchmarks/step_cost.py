"""Time of one solver step over the time of the Fourier transforms in it, without compilation.

A transform is an application of K or of a preconditioner: one forward and one inverse Fourier
transform. The time of a step is that between two step limits, so that setting up is left out;
solver and transforms run in turn, and medians are printed.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

import jaxstab as js
from jaxstab.core.compile import program
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.eigenpair import Minimum

SIZES = (256, 512, 1024, 2048)
REPEATS = 9
# Steps after which solvers are stopped; the preconditioned one is not far from its end there.
FIRST, LAST = 50, 150
FIRST_PRECONDITIONED, LAST_PRECONDITIONED = 1, 21


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    print("   n  solver                            step [ms]  transforms [ms]  ratio")
    for n in SIZES:
        contact, load = adhesive_contact(n)
        equilibrium = js.equilibrate(contact, load)

        def find(solver, limit, contact=contact, load=load):
            return js.equilibrate(contact, load, solver(1e-300, limit), throw=False)

        hessian = contact.hessian(equilibrium.gap, contact.control(load))
        cone = AdmissibleCone(equilibrium.in_contact)
        starts = jax.random.normal(jax.random.key(1), (1, *contact.grid.shape))

        def minimum(limit, problem=(hessian, cone, starts)):
            return solved(js.ProximalIteration(1e-300, limit), *problem)

        limits = FIRST_PRECONDITIONED, LAST_PRECONDITIONED
        report(contact, partial(find, js.solvers.PreconditionedConjugateGradient), 3, limits)
        report(contact, partial(find, js.solvers.PolonskyKeerRey), 2, (FIRST, LAST))
        report(contact, minimum, 1, (FIRST, LAST), "ProximalIteration")


@program
def solved(solver: js.ProximalIteration, *problem: Any) -> Minimum:
    """Return the minimum that a solver finds, without the rest of a verdict."""
    return solver.solve(*problem)


def adhesive_contact(n: int) -> tuple[js.Contact, js.MeanGap]:
    """Return a rough contact of rms slope 0.1 on n x n points, about a tenth of it closed."""
    grid = js.Grid(n)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=32, rms_slope=0.1)
    potential = js.potentials.Exponential(surface_energy=2e-5, length=1e-3)
    contact = js.Contact(js.HalfSpace(grid, youngs_modulus=1.0), heights, potential)
    return contact, js.MeanGap(js.surfaces.rms_height(heights))


def report(
    contact: js.Contact,
    solve: Callable[[int], object],
    transforms_per_step: int,
    limits: tuple[int, int],
    name: str = "",
) -> None:
    first, last = limits
    count = (last - first) * transforms_per_step
    runs = [
        partial(solve, first),
        partial(solve, last),
        partial(transform, contact.heights, contact.solid.waves.multiplier, count),
    ]
    for run in runs:
        jax.block_until_ready(run())
    seconds = [[seconds_of(run) for run in runs] for _ in range(REPEATS)]
    steps = [1e3 * (long - short) / (last - first) for short, long, _ in seconds]
    bare = [1e3 * together / (last - first) for _, _, together in seconds]
    ratio = statistics.median(a / b for a, b in zip(steps, bare, strict=True))
    name = name or solve.args[0].__name__
    medians = statistics.median(steps), statistics.median(bare)
    print(
        f"{contact.grid.shape[0]:4d}  {name:32s} {medians[0]:10.3f} {medians[1]:16.3f} {ratio:6.2f}"
    )


def seconds_of(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - start


@partial(jax.jit, static_argnames="count")
def transform(field: jax.Array, multiplier: jax.Array, count: int) -> jax.Array:
    def pair(_: int, field: jax.Array) -> jax.Array:
        return jnp.fft.irfftn(multiplier * jnp.fft.rfftn(field), s=field.shape)

    return jax.lax.fori_loop(0, count, pair, field)


if __name__ == "__main__":
    main()

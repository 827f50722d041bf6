"""Time of one solver step over the time of the Fourier transforms in it, without compilation.

A projected-conjugate-gradient step applies K twice and a proximal step once; each application is
one forward and one inverse transform. Solver and transforms run in turn; medians are printed.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

import jaxstab as js

SIZES = (128, 256, 512)
REPEATS = 11
STEPS = 200


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    print("   n  solver               step [ms]  transforms [ms]  ratio")
    for n in SIZES:
        contact = unloading_contact(n)
        load = js.MeanGap(0.3)
        equilibrium = js.equilibrate(contact, load, throw=False)
        conjugate = partial(
            js.equilibrate, contact, load, js.PolonskyKeerRey(1e-300, STEPS), throw=False
        )
        proximal = partial(
            js.assess_stability, contact, equilibrium, js.ProximalIteration(1e-300, STEPS)
        )
        report(n, "PolonskyKeerRey", conjugate, contact, 2)
        report(n, "ProximalIteration", partial(proximal, throw=False), contact, 1)


def unloading_contact(n: int) -> js.Contact:
    """Return the rough contact of Rey & Bleyer's unloading study on n x n points."""
    grid = js.Grid(n)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), rms_height=0.1)
    potential = js.potentials.Exponential(surface_energy=1e-2, length=1.0)
    return js.Contact(js.HalfSpace(grid, youngs_modulus=1e-3), heights, potential)


def report(n: int, name: str, solve: Callable[[], object], contact: js.Contact, pairs: int) -> None:
    transforms = partial(transform, contact.heights, contact.solid.multiplier, pairs * STEPS)
    times: dict[Callable[[], object], list[float]] = {solve: [], transforms: []}
    for run in times:
        jax.block_until_ready(run())
    for _ in range(REPEATS):
        for run, seconds in times.items():
            start = time.perf_counter()
            jax.block_until_ready(run())
            seconds.append(1e3 * (time.perf_counter() - start) / STEPS)
    ratio = statistics.median(a / b for a, b in zip(*times.values(), strict=True))
    step, bare = (statistics.median(seconds) for seconds in times.values())
    print(f"{n:4d}  {name:18s} {step:10.3f} {bare:16.3f} {ratio:6.2f}", flush=True)


@partial(jax.jit, static_argnames="count")
def transform(field: jax.Array, multiplier: jax.Array, count: int) -> jax.Array:
    def pair(_: int, field: jax.Array) -> jax.Array:
        return jnp.fft.irfftn(multiplier * jnp.fft.rfftn(field), s=field.shape)

    return jax.lax.fori_loop(0, count, pair, field)


if __name__ == "__main__":
    main()

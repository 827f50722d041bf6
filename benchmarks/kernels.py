"""What a step of each solver asks of a device: counts, for which no accelerator is needed.

Counted in the programs that are made for CUDA: places where the host waits to read a predicate, a
number that must be one for a step; sums over fields; pairs of Fourier transforms. Kernels beside transforms
are those of the branch of an accelerator compiled for a CPU, which fuses less. The carry are the
bytes that the loop hands from step to step, over those of a field.
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
from step_cost import adhesive_contact

import jaxstab as js
from jaxstab.equilibrium.equilibrate import find
from jaxstab.stability.cones import AdmissibleCone
from jaxstab.stability.solvers.davidson import Davidson

sys.path.append(str(Path(__file__).parent.parent / "tests"))
from step_counts import as_on_an_accelerator, num_kernels, step_counts  # noqa: E402

POINTS = 64
COLUMNS = "solver", "waits", "sums", "pairs of transforms", "kernels", "carry"


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for name, run, depth in solvers(POINTS):
        with as_on_an_accelerator():
            counts = step_counts(run, platform="cuda", depth=depth)
            kernels = num_kernels(run, depth=depth)
        carry = counts["carry"] / (8 * POINTS**2)
        cells = counts["waits"], counts["sums"], counts["pairs"], kernels, f"{carry:.1f}"
        print(f"| {name} | {' | '.join(map(str, cells))} |", flush=True)


def solvers(n: int):
    """Yield the name of each solver, a function that runs it, and the loops around its own."""
    contact, load = adhesive_contact(n)
    contact, _ = contact.in_own_units()
    state = js.equilibrate(contact, load)
    hessian = contact.hessian(state.gap, contact.control(load))
    cone = AdmissibleCone(state.in_contact)
    starts = jax.random.uniform(jax.random.key(0), (12, n, n), minval=-1)
    for solver in (js.PreconditionedConjugateGradient(), js.PolonskyKeerRey(), js.SaddleNewton()):
        yield type(solver).__name__, lambda s=solver: find(contact, load, s, None), 0
    yield "Davidson", lambda: Davidson().solve(hessian, cone.hull, starts[:4]), 0
    for solver, depth in ((js.ProjectedLOBPCG(), 1), (js.ProximalIteration(), 0)):
        yield type(solver).__name__, lambda s=solver: s.solve(hessian, cone, starts), depth


if __name__ == "__main__":
    main()

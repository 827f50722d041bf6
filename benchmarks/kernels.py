"""What a step of each solver asks of a device: counts, for which no accelerator is needed.

Counted in the programs that are made for CUDA: places where the host waits to read a predicate, of
which a step should have none; sums over fields; pairs of Fourier transforms. Kernels beside
transforms are those of the branch of an accelerator compiled for a CPU, which fuses less. The carry
is the number of fields that the loop hands from step to step.
"""

import sys
from pathlib import Path

import jax

sys.path.append(str(Path(__file__).parent.parent / "tests"))
from step_counts import as_on_an_accelerator, num_kernels, solver_runs, step_counts

POINTS = 64
COLUMNS = "solver", "waits", "sums", "pairs of transforms", "kernels", "carry"


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for name, (run, depth) in solver_runs(POINTS).items():
        with as_on_an_accelerator():
            counts = step_counts(run, platform="cuda", depth=depth)
            kernels = num_kernels(run, depth=depth)
        carry = counts["carry"] / (8 * POINTS**2)
        cells = counts["waits"], counts["sums"], counts["pairs"], kernels, f"{carry:.1f}"
        print(f"| {name} | {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()

"""Verdicts on large grids with and without starts from a coarser grid.

Counted are applications of A and of the preconditioner, a pair of Fourier transforms each, of all
three numbers; on a coarser grid they count by its part of the points.
"""

import argparse
from pathlib import Path

import jax

import jaxstab as js
from jaxstab.stability import coarse_start

# Young's modulus, law and mean displacement.
CASES = {
    "stiff, in contact": (1.0, js.potentials.Exponential(1.0, 0.1), 0.5),
    "stiff, apart": (1.0, js.potentials.Exponential(1.0, 0.1), 0.8),
    "soft, two thirds in contact": (1e-3, js.potentials.Exponential(1e-2, 1.0), 0.1),
    "soft, under half in contact": (1e-3, js.potentials.Exponential(1e-2, 1.0), 0.5),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[512])
    parser.add_argument("--surfaces", type=int, default=2)
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    large, rows = coarse_start.LARGE, []
    for size in options.sizes:
        grid = js.Grid(size)
        for seed in range(options.surfaces):
            heights = js.surfaces.self_affine(grid, jax.random.key(seed), rms_height=0.1)
            for name, (modulus, law, displacement) in CASES.items():
                contact = js.Contact(js.HalfSpace(grid, modulus), heights, law)
                state = js.equilibrate(contact, js.MeanDisplacement(displacement))
                found = []
                for smallest in (large, grid.size + 1):
                    coarse_start.LARGE = smallest
                    jax.clear_caches()
                    found.append(js.assess_stability(contact, state))
                used, unused = (
                    sum(int(pair.num_applications) for pair in s.pairs.values()) for s in found
                )
                change = abs(found[1].cone.eigenvalue / found[0].cone.eigenvalue - 1)
                rows.append(
                    f"| {size}² | {seed} | {name} | {used} | {unused} | {unused / used:.1f} | "
                    f"{change:.0e} |"
                )
                print(rows[-1], flush=True)
    head = "| grid | surface | state | pairs | without | ratio | change of the eigenvalue |"
    if options.out:
        options.out.write_text("\n".join([head, "|" + "---|" * 7, *rows]) + "\n")


if __name__ == "__main__":
    main()

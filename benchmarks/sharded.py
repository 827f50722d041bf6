"""Fields spread over 1, 2, 4 and 8 virtual devices: what each holds, and what a step sends.

From the compiled programs of an equilibrium and of the lowest modes, in double precision. Memory is
that of arguments, results and all that is between, without scratch space of the Fourier transforms;
`together` is that times the number of devices, over what one device needs alone. A step is the body
of the program's main loop with one pass of each loop in it, and with all branches, of which a step
takes some: of the operations between devices there are the numbers by kind, and the bytes that a
device sends by `all-to-all`.
"""

import argparse
import re
from collections import Counter
from importlib import import_module
from math import prod
from pathlib import Path

import jax
import jax.numpy as jnp
from jax.sharding import NamedSharding, PartitionSpec

import jaxstab as js
from jaxstab.contact.hessian import Hessian
from jaxstab.stability.cones import Subspace
from jaxstab.stability.lowest_modes import BLOCK_SIZE

COUNTS = (1, 2, 4, 8)
KINDS = ("all-to-all", "all-reduce", "all-gather", "collective-permute")
BYTES = {"f64": 8, "c128": 16, "f32": 4, "c64": 8, "s32": 4, "s64": 8, "pred": 1}
HEAD = f"""| program | devices | MB on each | together | {" | ".join(KINDS)} | MB sent |
|---|---|---|---|{"---|" * len(KINDS)}---|"""


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=1024, help="along a side")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", max(COUNTS))
    tables = {
        count: {name: program.compile() for name, program in lowered(options.points, count).items()}
        for count in COUNTS
    }
    lines = [f"{options.points}² points", "", HEAD]
    for name, alone in tables[1].items():
        for count, compiled in tables.items():
            lines.append(row(name, count, compiled[name], memory(alone)))
    print(*lines, sep="\n")
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def lowered(n, count):
    """Return the programs by name, to be compiled."""
    mesh = jax.make_mesh((count,), ("x",), devices=jax.devices()[:count])
    grid = js.Grid(n, sharding=NamedSharding(mesh, PartitionSpec("x")) if count > 1 else None)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.1)
    law = js.potentials.Exponential(surface_energy=0.02, length=0.1)
    contact = js.Contact(js.HalfSpace(grid, youngs_modulus=1.0), heights, law)
    find = import_module("jaxstab.equilibrium.equilibrate").find
    on_space = import_module("jaxstab.stability.lowest_pair").on_space
    search = jax.jit(on_space)
    solver, load = js.solvers.PreconditionedConjugateGradient(), js.MeanGap(0.2)
    hessian, space = Hessian(contact.solid, heights), Subspace(heights > 0)
    starts = jnp.stack(BLOCK_SIZE * [heights])
    return {
        "equilibrium": jax.jit(find).lower(contact, load, solver, heights),
        "lowest modes": search.lower(js.solvers.Davidson(1e-7), hessian, space, starts),
    }


def memory(program):
    """Return the bytes that a program takes on each device."""
    figures = program.memory_analysis()
    parts = ("argument", "output", "temp")
    return sum(getattr(figures, f"{part}_size_in_bytes") for part in parts)


def row(name, count, program, alone):
    counts, sent = step(program.as_text(), count)
    taken = memory(program)
    kinds = " | ".join(str(counts[kind]) for kind in KINDS)
    return (
        f"| {name} | {count} | {taken / 1e6:.1f} | {count * taken / alone:.2f} | {kinds} | "
        f"{sent / 1e6:.1f} |"
    )


def step(text, count):
    """Return how many operations of each kind a step holds, and the bytes that a device sends."""
    computations = {
        match[1]: match[2]
        for match in re.finditer(r"^(?:ENTRY )?%([\w.-]+) [^\n]*\{\n(.*?)^\}", text, re.M | re.S)
    }
    bodies = [reached(computations, body) for body in re.findall(r"body=%([\w.-]+)", text)]
    # The main loop is the one that holds the others.
    lines = max(bodies, key=len).splitlines()
    found = [(kind, line) for line in lines for kind in KINDS if f" {kind}(" in line]
    sizes = [size_of(line.split(f" {kind}(")[0]) for kind, line in found if kind == KINDS[0]]
    # Of its parts each device keeps one.
    return Counter(kind for kind, _ in found), sum(sizes) * (count - 1) / count


def reached(computations, name):
    """Return the text of a computation and of all that it calls."""
    todo, seen = [name], []
    while todo:
        if (name := todo.pop()) in computations and name not in seen:
            seen.append(name)
            todo += re.findall(r"%([\w.-]+)", computations[name])
    return "\n".join(computations[name] for name in seen)


def size_of(shapes):
    """Return the bytes of all arrays that a line of a program names."""
    arrays = re.findall(r"(\w+)\[([\d,]*)\]", shapes)
    return sum(BYTES[kind] * prod(map(int, filter(None, n.split(",")))) for kind, n in arrays)


if __name__ == "__main__":
    main()

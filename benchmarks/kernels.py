"""What a step of each solver asks of a device: counts, for which no accelerator is needed.

Counted in the programs that are made for CUDA: places where the host waits to read a predicate, of
which a step should have none; sums over fields; pairs of Fourier transforms. Kernels beside
transforms are those of the branch of an accelerator compiled for a CPU, which fuses less. The carry
is the number of fields that the loop hands from step to step.
"""

import argparse
import re
import sys
from math import prod
from pathlib import Path

import jax

sys.path.append(str(Path(__file__).parent.parent / "tests"))
from step_counts import as_on_an_accelerator, measured_step, name_of, solver_runs, waits

POINTS = 64
# In HLO: operations that start no kernel.
FREE = {"parameter", "constant", "get-tuple-element", "tuple", "bitcast"}
NESTED = {"while", "conditional", "call"}
COLUMNS = (
    "a step of",
    "waits of the host",
    "sums over fields",
    "pairs of transforms",
    "other kernels, as compiled for a CPU",
    "fields handed on",
)


def costs(loop, step):
    """Return the numbers of waits, sums and pairs of transforms, and the bytes of the carry."""
    counts = (sum(map(is_counted, step)) for is_counted in (waits, is_sum, is_pair))
    return *counts, sum(bytes_of(result.type) for result in loop.results)


def is_sum(op):
    """Whether an operation leaves fewer numbers than it reads."""
    if name_of(op) not in ("reduce", "dot_general"):
        return False
    read, left = ([size_of(value.type) for value in side] for side in (op.operands, op.results))
    return max(left) < max(read)


def is_pair(op):
    return name_of(op) == "fft" and "type RFFT" in str(op.attributes["fft_type"])


def size_of(kind):
    return prod(map(int, re.findall(r"(\d+)x", str(kind))))


def bytes_of(kind):
    bits = int(re.search(r"(\d+)>", str(kind))[1])
    return size_of(kind) * max(bits // 8, 1)


def num_kernels(function, depth):
    """Return how many kernels a step starts beside its transforms, as compiled for this device."""
    text = jax.jit(function).lower().compile().as_text()
    parts = dict(re.findall(r"^(?:ENTRY )?%?([\w.-]+) \(.*?\{\n(.*?)^\}", text, re.M | re.S))

    def codes(part):
        """Yield the operations of a computation and of those it calls, with their operands."""
        for line in parts[part].splitlines():
            code = re.search(r" = .*? ([a-z][\w-]*)\(", line)[1]
            if code not in FREE:
                yield code, line
            if code in NESTED:
                called = re.findall(
                    r"(?:body|to_apply|\w+_computations?)=\{?(%[^,}]+(?:, %[^,}]+)*)", line
                )
                for name in ", ".join(called).split(", "):
                    yield from codes(name.lstrip("%"))

    step = re.search(r"^ENTRY %?([\w.-]+)", text, re.M)[1]
    for _ in range(depth + 1):
        bodies = [
            re.search(r"body=%?([\w.-]+)", line)[1]
            for code, line in codes(step)
            if code == "while" and "known_trip_count" not in line
        ]
        step = next(body for body in bodies if any(code == "fft" for code, _ in codes(body)))
    return sum(code not in {*NESTED, "fft"} for code, _ in codes(step))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    lines = [f"{POINTS}² points", "", f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    print(*lines, sep="\n")
    for name, (run, depth) in solver_runs(POINTS).items():
        with as_on_an_accelerator():
            *counts, carry = measured_step(costs, run, platform="cuda", depth=depth)
            kernels = num_kernels(run, depth)
        cells = *counts, kernels, f"{carry / (8 * POINTS**2):.1f}"
        lines.append(f"| `{name}` | {' | '.join(map(str, cells))} |")
        print(lines[-1], flush=True)
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

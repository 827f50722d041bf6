"""Seconds from a fresh process to its first verdict, and what they go into.

Each run is a process of its own: it imports JAX, then jaxstab, then does the README's example with
a law of its own, without and with a warm compilation cache. One more run counts the programs that
it compiles and lists the costliest. With `--before`, a clone of an earlier version, 0.3.0 or later,
runs in turn:

    git worktree add ../earlier v0.3.0
    python benchmarks/first_verdict.py --before ../earlier
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

import jaxstab as js

PROGRAM = """
import json, sys, time

marks = [time.perf_counter()]
mark = lambda: marks.append(time.perf_counter())

import jax, jax.numpy as jnp
mark()
import jaxstab as js
mark()
jax.config.update("jax_enable_x64", True)
grid = js.Grid(int(sys.argv[1]))
heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=16, rms_height=0.1)
solid = js.HalfSpace(grid, youngs_modulus=0.05, poisson_ratio=0.3)
contact = js.Contact(solid, heights, lambda gap: -0.01 * jnp.exp(-gap / 0.2))
mark()
equilibrium = jax.block_until_ready(js.equilibrate(contact, js.MeanGap(0.15)))
mark()
str(js.assess_stability(contact, equilibrium).verdict)
mark()
print(json.dumps([after - before for before, after in zip(marks, marks[1:])]))
"""
STAGES = ("import jax", "import jaxstab", "contact", "equilibrate", "assess_stability")


def main() -> None:
    options = parse_options()
    sources = {"": Path(js.__file__).parents[1]}
    if options.before:
        sources["before: "] = options.before
    runs = {f"{name}{cache}": [] for cache in ("no cache", "warm cache") for name in sources}
    with tempfile.TemporaryDirectory() as folder:
        warm = {name: str(Path(folder, str(i))) for i, name in enumerate(sources)}
        for name, source in sources.items():
            print("filling the cache", flush=True)
            run(options.size, source, warm[name])
        # In turn, so that all meet the same machine.
        for i in range(options.repeats):
            for name, source in sources.items():
                runs[f"{name}no cache"].append(run(options.size, source)[0])
                runs[f"{name}warm cache"].append(run(options.size, source, warm[name])[0])
            print(f"{i + 1} of {options.repeats} runs", flush=True)
        programs = {
            name: compilations(run(options.size, source, JAX_LOG_COMPILES="1")[1])
            for name, source in sources.items()
        }
    lines = report(options, runs, programs)
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=128, help="points a side")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--before", type=Path, help="a clone of an earlier version, run in turn")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    return parser.parse_args()


def run(
    size: int, source: Path, cache: str | None = None, **environment: str
) -> tuple[list[float], str]:
    """Return the seconds of each stage in a fresh process, and what it logged."""
    # Python's byte code is kept, as everywhere.
    left_out = "_CACHE_", "PYTHONDONTWRITEBYTECODE"
    kept = {key: x for key, x in os.environ.items() if not any(name in key for name in left_out)}
    if cache is not None:
        environment["JAX_COMPILATION_CACHE_DIR"] = cache
        environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
        environment["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
    command = [sys.executable, "-c", PROGRAM, str(size)]
    # There Python looks first.
    done = subprocess.run(
        command, cwd=source, env=kept | environment, capture_output=True, text=True
    )
    if done.returncode:
        raise RuntimeError(f"The example failed:\n{done.stderr}")
    return json.loads(done.stdout), done.stderr


def compilations(log: str) -> list[tuple[float, float, str]]:
    """Return the seconds that XLA and that lowering took, and the name, of every program."""
    lowering, xla = (
        [(float(seconds), name) for name, seconds in re.findall(pattern, log)]
        for pattern in (
            r"Finished jaxpr to MLIR module conversion (\S+) in ([\d.e+-]+) sec",
            r"Finished XLA compilation of (\S+) in ([\d.e+-]+) sec",
        )
    )
    # Those of one name are compiled in the order in which they were lowered.
    xla, lowering = (sorted(seconds, key=lambda pair: pair[1]) for seconds in (xla, lowering))
    if [name for _, name in lowering] != [name for _, name in xla]:
        raise RuntimeError("This JAX logs its compilations in another way: read them anew here.")
    pairs = zip(xla, lowering, strict=True)
    return sorted(((x, l, name) for (x, name), (l, _) in pairs), reverse=True)


def report(
    options: argparse.Namespace, runs: dict[str, list[list[float]]], programs: dict[str, list]
) -> list[str]:
    lines = [
        f"float64; {options.size}² points; medians of {options.repeats} processes, in seconds",
        "",
        f"| | {' | '.join(STAGES)} | from `import jax` to the verdict |",
        "|---|" + "---|" * (len(STAGES) + 1),
    ]
    totals = {name: median(sum(time[1:]) for time in times) for name, times in runs.items()}
    for name, times in runs.items():
        stages = [median(stage) for stage in zip(*times, strict=True)]
        cells = " | ".join(f"{seconds:.2f}" for seconds in (*stages, totals[name]))
        lines.append(f"| {name} | {cells} |")
    if options.before:
        cold = totals["before: no cache"]
        lines += [
            "",
            f"Over the earlier version without a cache: {totals['no cache'] / cold:.2f} without, "
            f"{totals['warm cache'] / cold:.2f} with a warm one.",
        ]
    for name, compiled in programs.items():
        in_xla, in_lowering = (sum(program[i] for program in compiled) for i in (0, 1))
        lines += [
            "",
            f"{name}{len(compiled)} programs are compiled, in {in_xla:.2f} s of XLA and "
            f"{in_lowering:.2f} s of lowering.",
        ]
    lines += ["", "The costliest:", "", "| program | XLA [s] | lowering [s] |", "|---|---|---|"]
    lines += [f"| `{name}` | {xla:.2f} | {low:.2f} |" for xla, low, name in programs[""][:10]]
    return lines


if __name__ == "__main__":
    main()

"""What a first call compiles: programs and their operations, and its seconds.

Each call runs in a process of its own: once to count the programs and the operations that XLA has
left in them, then without a compilation cache, with one, and a second time in the same process.
Beside the entry points stands a plain equilibrium in 30 lines of JAX, the least that the same
problem needs. The surface and the contact are made before; their programs count as the contact's.

    python benchmarks/programs.py --sizes 64 512
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import jaxstab as js

SETUP = """
import json, sys, time
import jax, jax.numpy as jnp
import jaxstab as js

jax.config.update("jax_enable_x64", True)
n = int(sys.argv[1])
grid = js.Grid(n)
heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=16, rms_height=0.1)
jax.block_until_ready(heights)
law = js.potentials.Exponential(surface_energy=0.01, length=0.2)


def contact():
    return js.Contact(js.HalfSpace(grid, youngs_modulus=0.05, poisson_ratio=0.3), heights, law)


@jax.jit
def plain(heights):
    k = jnp.hypot(jnp.fft.fftfreq(n, 1 / n)[:, None], jnp.arange(n // 2 + 1))
    K = 0.05 / (1 - 0.3**2) * jnp.pi * k
    apply = lambda u, symbol=K: jnp.fft.irfft2(symbol * jnp.fft.rfft2(u), u.shape)
    inverse = 1 / (K + K[1, 0] + 0.01)
    slope, curvature = jax.grad(law), jax.grad(jax.grad(law))

    def step(state):
        g, t, norm, _, count = state
        free = g > 0
        centred = lambda x: jnp.where(free, x - jnp.sum(x * free) / jnp.sum(free), 0)
        r = apply(g + heights) + jax.vmap(jax.vmap(slope))(g)
        r -= jnp.sum(r * free) / jnp.sum(free)
        missed = jnp.sqrt(jnp.mean(jnp.where(free, r, jnp.minimum(r, 0)) ** 2))
        z = centred(apply(jnp.where(free, r, 0), inverse))
        new = jnp.sum(r * z)
        t = z + jnp.where(norm > 0, new / norm, 0) * t
        bend = apply(t) + jax.vmap(jax.vmap(curvature))(g) * t
        g = jnp.maximum(g - jnp.sum(r * t) / jnp.sum(t * bend) * t, 0)
        return g * (0.15 / jnp.mean(g)), t, new, missed, count + 1

    g = jnp.max(heights) - heights
    start = g * (0.15 / jnp.mean(g)), 0 * g, jnp.array(0.0), jnp.array(jnp.inf), jnp.array(0)
    return jax.lax.while_loop(lambda s: (s[3] > 1e-10) & (s[4] < 300), step, start)[0]


def seconds():
    start = time.perf_counter()
    jax.block_until_ready(jax.tree.leaves(call()))
    return time.perf_counter() - start


"""
CALLS = {
    "a plain equilibrium": "plain(heights)",
    "a contact": "contact()",
    "`equilibrate`": "js.equilibrate(contact(), js.MeanGap(0.15))",
    "a verdict": "js.assess_stability(contact(), js.equilibrate(contact(), js.MeanGap(0.15)))",
    "`sweep`, 8 loads": "js.sweep(contact(), js.MeanGap(jnp.linspace(0.3, 0.1, 8)))",
    "`follow`": "js.follow(contact(), js.MeanPressure(jnp.array([0.0, -0.1])), throw=False)",
    "`pull_off`": "js.pull_off(contact())",
    "`critical_load`": "js.critical_load(contact(), js.MeanPressure(jnp.array([0.0, -0.1])))",
    "`continuation`": "js.continuation(contact(), js.MeanGap(jnp.array([0.5, 0.3])))",
    "gradient of `pull_off`": (
        "jax.grad(lambda w: js.pull_off(js.Contact(js.HalfSpace(grid, 0.05, 0.3), heights, "
        "js.potentials.Exponential(w, 0.2))).load.value)(0.01)"
    ),
}
# Others take minutes on larger grids.
ON_LARGE = ("a plain equilibrium", "a contact", "`equilibrate`", "a verdict")
LARGE = 512
COLUMNS = (
    *("points", "call", "programs", "operations", "largest"),
    *("first call [s]", "with a cache [s]", "second call [s]"),
)
# An instruction of XLA's text, in any computation of a program.
_OPERATION = re.compile(r"^\s+(?:ROOT )?%?[\w.-]+ = ", re.MULTILINE)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 512])
    parser.add_argument("--calls", nargs="+", help="words in the names of the calls to count")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    options = parser.parse_args()
    lines = [
        "float64",
        "",
        f"| {' | '.join(COLUMNS)} |",
        "|" + "---|" * len(COLUMNS),
    ]
    for n in options.sizes:
        for name, call in CALLS.items():
            asked = not options.calls or any(word in name for word in options.calls)
            if asked and (n < LARGE or name in ON_LARGE):
                lines.append(row(n, name, call))
                print(lines[-1], flush=True)
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


def row(n: int, name: str, call: str) -> str:
    counts = operations(n, call)
    first, second = timed(n, call)
    with tempfile.TemporaryDirectory() as folder:
        timed(n, call, folder)
        cached, _ = timed(n, call, folder)
    numbers = f"{len(counts)} | {sum(counts)} | {max(counts, default=0)}"
    return f"| {n}² | {name} | {numbers} | {first:.1f} | {cached:.1f} | {second:.2f} |"


def operations(n: int, call: str) -> list[int]:
    """Return the number of operations of each program that a first call compiles."""
    with tempfile.TemporaryDirectory() as folder:
        # The texts that XLA writes before the call are removed, in the same process.
        code = (
            "from pathlib import Path\n"
            f"for file in Path({folder!r}).glob('*.txt'): file.unlink()\n"
            "seconds()\n"
        )
        flags = f"--xla_dump_to={folder} --xla_dump_hlo_as_text"
        run(n, call, code, XLA_FLAGS=f"{os.environ.get('XLA_FLAGS', '')} {flags}")
        texts = Path(folder).glob("*after_optimizations.txt")
        return [len(_OPERATION.findall(text.read_text())) for text in texts]


def timed(n: int, call: str, cache: str | None = None) -> tuple[float, float]:
    """Return the seconds of a first and a second call."""
    environment = {}
    if cache is not None:
        environment["JAX_COMPILATION_CACHE_DIR"] = cache
        environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
        environment["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
    output = run(n, call, "print(json.dumps([seconds(), seconds()]))\n", **environment)
    first, second = json.loads(output.splitlines()[-1])
    return first, second


def run(n: int, call: str, code: str, **environment: str) -> str:
    kept = {key: x for key, x in os.environ.items() if "_CACHE_" not in key}
    program = f"{SETUP}call = lambda: {call}\n{code}"
    command = [sys.executable, "-c", program, str(n)]
    source = Path(js.__file__).parents[1]
    environment["TF_CPP_MIN_LOG_LEVEL"] = "3"
    done = subprocess.run(
        command, cwd=source, env=kept | environment, capture_output=True, text=True
    )
    if done.returncode:
        raise RuntimeError(f"The call failed:\n{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    main()

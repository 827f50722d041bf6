"""What an accelerator gives: are its numbers right, and how long does it take?

One command, of at most eight minutes. A contact's equilibrium, its three eigenvalues and verdict, a
gradient and a vmapped sweep are held against figures that a CPU found in double precision
(`--record` writes them). They may be off by the solvers' own tolerance times the condition number
of the Hessian, and eigenvalues by their own error as well.

Then seconds: of an equilibrium and its verdict on ever finer grids, also as pairs of Fourier
transforms and as copies of a field, whose times are measured beside them; of many small contacts
together, by `jax.vmap`, and one after another. The first call compiles.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

import jaxstab as js

HERE = Path(__file__).parent
FIGURES = HERE / "accelerator_figures.json"
PRECISIONS = ("float64", "float32")
TOLERANCES = js.PreconditionedConjugateGradient.default_tolerance
ENERGY, RANGE = 2e-3, 0.05
SIZES = (128, 512, 2048, 8192)
BATCHES = (1024,)
SMALL = 64
# Of the contacts of a batch, how many are timed one after another.
ALONE = 4
# Timed runs at most, and the seconds of them that suffice.
REPEATS, ENOUGH = 3, 2.0
SIZE_COLUMNS = (
    "points a side",
    "copy [GB/s]",
    "transform pair [ms]",
    *("compile [s]", "equilibrium [s]", "steps", "as pairs"),
    *("compile [s]", "verdict [s]", "pairs it counts", "as pairs", "as copies of a field"),
)
BATCH_COLUMNS = (
    "contacts",
    *("compile [s]", "equilibria together [s]", "a second", "one after another, a second"),
    *("compile [s]", "verdicts together [s]", "a second", "one after another, a second"),
)
# The cells of a table, and the seconds that went into compiling.
Row = tuple[list[str], float]


def main() -> None:
    options = parse_options()
    deadline = time.perf_counter() + options.seconds
    jax.config.update("jax_enable_x64", True)
    if options.record:
        figures, _ = figures_in("float64")
        FIGURES.write_text(json.dumps(figures, indent=1) + "\n")
        return
    device = jax.devices()[0].device_kind
    out = options.out or HERE / "results" / f"accelerator-{device.lower().replace(' ', '-')}.md"
    with out.open("w") as file:
        for line in report(options, device, deadline):
            print(line, flush=True)
            print(line, flush=True, file=file)
    print(f"written to {out}")


def parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--record", action="store_true", help="write the figures, on a CPU")
    parser.add_argument("--largest", type=int, default=SIZES[-1], help="points a side")
    parser.add_argument("--batch", type=int, default=BATCHES[-1], help="contacts at most")
    parser.add_argument("--seconds", type=float, default=450, help="start nothing that ends later")
    parser.add_argument("--out", type=Path, help="a file for the table")
    return parser.parse_args()


def report(options: argparse.Namespace, device: str, deadline: float) -> Iterator[str]:
    """Yield the lines of all tables as they come."""
    sizes = [n for n in SIZES if n <= options.largest]
    batches = sorted({min(count, options.batch) for count in BATCHES})
    yield (
        f"jaxstab {js.__version__}, jax {jax.__version__}; {device}; least of up to {REPEATS} runs"
    )
    yield from ("", "Against the figures of a CPU", "")
    yield from check_figures()
    for precision in PRECISIONS:
        yield from ("", f"One contact, {precision}", "")
        yield from table(SIZE_COLUMNS, sizes, partial(size_row, precision), deadline)
        yield from ("", f"Many contacts of {SMALL}² points, {precision}", "")
        yield from table(BATCH_COLUMNS, batches, partial(batch_row, precision), deadline)


def contact_of(n: int, dtype, key: int = 0, energy=ENERGY) -> tuple[js.Contact, js.MeanGap]:
    """Return a rough contact that is partly closed, and its load, in a precision."""
    grid = js.Grid(n, jnp.ones((), dtype))
    heights = js.surfaces.self_affine(grid, jax.random.key(key), k_high=16, rms_height=0.05)
    solid = js.HalfSpace(grid, jnp.ones((), dtype))
    law = js.potentials.Exponential(jnp.asarray(energy, dtype), jnp.array(RANGE, dtype))
    return js.Contact(solid, heights.astype(dtype), law), js.MeanGap(jnp.array(0.05, dtype))


def figures_in(precision: str) -> tuple[dict, dict]:
    """Return what is compared, and by how much each of it may be off."""
    dtype = jnp.dtype(precision)
    contact, load = contact_of(SMALL, dtype)
    equilibrium = js.equilibrate(contact, load)
    stability = js.assess_stability(contact, equilibrium)

    def mean_pressure(energy: jax.Array) -> jax.Array:
        contact, load = contact_of(SMALL, dtype, energy=energy)
        return js.equilibrate(contact, load, throw=False).mean_pressure

    def swept(value: jax.Array) -> jax.Array:
        return js.equilibrate(contact, js.MeanGap(value), throw=False).mean_pressure

    sweep = jax.jit(jax.vmap(swept))(jnp.array([0.03, 0.05, 0.1, 0.2], dtype))
    pairs = stability.pairs
    figures = {
        "mean pressure": equilibrium.mean_pressure,
        "energy": equilibrium.energy,
        "contact area": equilibrium.contact_area,
        **{name: pair.eigenvalue for name, pair in pairs.items()},
        "gradient": jax.grad(mean_pressure)(jnp.array(ENERGY, dtype)),
        **{f"sweep {i}": value for i, value in enumerate(sweep)},
    }
    figures = {name: float(value) for name, value in figures.items()}
    condition = contact.hessian(equilibrium.gap).bound / stability.critical.eigenvalue
    relative = float(TOLERANCES[precision] * condition)
    # Pressures are the difference of attraction and reaction.
    slack = {
        name: relative * (ENERGY / RANGE if name.startswith(("mean", "sweep")) else abs(value))
        for name, value in figures.items()
    }
    slack |= {name: slack[name] + float(pair.error) for name, pair in stability.pairs.items()}
    return figures | {"verdict": stability.verdict.name}, slack


def check_figures() -> Iterator[str]:
    """Yield a row for each figure: what it is in each precision, and whether it may be that."""
    expected = json.loads(FIGURES.read_text())
    yield "| figure | CPU | " + " | ".join(f"{p} | off by | may be" for p in PRECISIONS) + " |"
    yield "|---|---|" + "---|---|---|" * len(PRECISIONS)
    found = [figures_in(precision) for precision in PRECISIONS]
    verdict = expected.pop("verdict")
    for name, value in expected.items():
        cells = []
        for figures, slack in found:
            off = abs(figures[name] - value)
            mark = "" if off <= slack[name] else " **WRONG**"
            cells += [f"{figures[name]:.10g}", f"{off:.1e}{mark}", f"{slack[name]:.1e}"]
        yield f"| {name} | {value:.10g} | {' | '.join(cells)} |"
    marks = ["" if figures["verdict"] == verdict else "**WRONG**" for figures, _ in found]
    cells = (f"{figures['verdict']} | {m} | " for (figures, _), m in zip(found, marks, strict=True))
    yield f"| verdict | {verdict} | {'| '.join(cells)}|"


def table(
    columns: tuple[str, ...], cases: list[int], row: Callable[[int], Row], deadline: float
) -> Iterator[str]:
    """Yield a head and a row for each case, as time, memory and precision allow."""
    yield f"| {' | '.join(columns)} |"
    yield "|" + "---|" * len(columns)
    needed = 0.0
    for case in cases:
        start = time.perf_counter()
        cells, compiling = ["no time left"], 0.0
        if time.perf_counter() + needed < deadline:
            try:
                cells, compiling = row(case)
            except jax.errors.JaxRuntimeError as error:
                if "RESOURCE_EXHAUSTED" not in str(error):
                    raise
                cells = ["out of memory"]
            except js.SolverError:
                cells = ["not converged"]
            # Four times the points, and more steps.
            needed = compiling + 6 * (time.perf_counter() - start - compiling)
        padding = [""] * (len(columns) - 1 - len(cells))
        yield f"| {' | '.join([str(case), *cells, *padding])} |"


def size_row(precision: str, n: int) -> Row:
    """Return the cells of one grid, and the seconds of compiling."""
    contact, load = contact_of(n, jnp.dtype(precision))
    field = contact.heights
    copy = timed_inside(lambda x: x * 1.0001, field)
    pair = timed_inside(contact.solid.with_uniform_stiffness(0).apply, field)
    compiling, seconds, state = timed(lambda: js.equilibrate(contact, load))
    compiling_too, longer, stability = timed(lambda: js.assess_stability(contact, state))
    pairs = sum(int(pair.num_applications) for pair in stability.pairs.values())
    cells = [
        f"{2 * field.nbytes / copy / 1e9:.0f}",
        f"{1e3 * pair:.3f}",
        *(f"{compiling:.1f}", f"{seconds:.4f}", str(state.num_steps), f"{seconds / pair:.0f}"),
        *(f"{compiling_too:.1f}", f"{longer:.3f}", str(pairs), f"{longer / pair:.0f}"),
        f"{longer / copy:.0f}",
    ]
    return cells, compiling + compiling_too


def batch_row(precision: str, count: int) -> Row:
    """Return the cells of one size of batch, and the seconds of compiling."""
    dtype = jnp.dtype(precision)
    contact, load = contact_of(SMALL, dtype)
    surfaces = jax.vmap(lambda key: contact_of(SMALL, dtype, key)[0].heights)(jnp.arange(count))

    def equilibrium(heights: jax.Array) -> js.Equilibrium:
        rough = js.Contact(contact.solid, heights, contact.potential)
        return js.equilibrate(rough, load, throw=False)

    def verdict(heights: jax.Array, state: js.Equilibrium) -> jax.Array:
        rough = js.Contact(contact.solid, heights, contact.potential)
        return js.assess_stability(rough, state, throw=False).verdict.code

    solve, judge = jax.jit(jax.vmap(equilibrium)), jax.jit(jax.vmap(verdict))
    few = range(min(ALONE, count))
    compiling, seconds, states = timed(lambda: solve(surfaces))
    _, alone, apart = timed(lambda: [equilibrium(surfaces[i]) for i in few])
    compiling_too, longer, _ = timed(lambda: judge(surfaces, states))
    _, longer_alone, _ = timed(lambda: [verdict(surfaces[i], apart[i]) for i in few])
    cells = [
        *(f"{compiling:.1f}", f"{seconds:.4f}", f"{count / seconds:.1f}"),
        f"{len(few) / alone:.1f}",
        *(f"{compiling_too:.1f}", f"{longer:.3f}", f"{count / longer:.1f}"),
        f"{len(few) / longer_alone:.1f}",
    ]
    return cells, compiling + compiling_too


def timed(function: Callable) -> tuple[float, float, Any]:
    """Return the seconds of compiling, the least of some runs, and what they return."""
    times = []
    while len(times) < 2 or (len(times) <= REPEATS and sum(times[1:]) < ENOUGH):
        start = time.perf_counter()
        out = jax.block_until_ready(function())
        times.append(time.perf_counter() - start)
    least = min(times[1:])
    return max(times[0] - least, 0), least, out


def timed_inside(function: Callable, field: jax.Array, count: int = 20) -> float:
    """Return the seconds of one of many applications in one program."""
    loop = jax.jit(lambda x: jax.lax.fori_loop(0, count, lambda _, x: function(x), x))
    return timed(lambda: loop(field))[1] / count


if __name__ == "__main__":
    main()

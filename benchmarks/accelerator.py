"""What an accelerator gives: are its numbers right, and how long does it take?

One command, of at most eight minutes, or one for each `--precision`. A contact's equilibrium, its
three eigenvalues and verdict, a gradient and a vmapped sweep are held against figures that a CPU
found in double precision (`--record` writes them). They may be off by the solvers' own tolerance
times the condition number of the Hessian, and eigenvalues by their own error as well.

Then seconds: of an equilibrium and its verdict on ever finer grids, also as pairs of Fourier
transforms and as copies of a field, whose times are measured beside them; of a path and of an
evolution; of many small contacts together, by `jax.vmap`, and one after another. The first call
compiles. On a GPU a trace of `jax.profiler` tells which share of the time it works, how many
kernels it starts, and how often the host waits for a number.
"""

import argparse
import json
import tempfile
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
TOLERANCES = js.solvers.PreconditionedConjugateGradient.default_tolerance
ENERGY, RANGE = 2e-3, 0.05
SIZES = (128, 512, 2048, 8192)
# Points a side of small contacts, and how many of them together.
BATCHES = {64: 1024, 256: 64}
SMALL = 64
MARCHES = (64, 256)
# Of the contacts of a batch, how many are timed one after another.
ALONE = 4
# Timed runs at most, and the seconds of them that suffice.
REPEATS, ENOUGH = 3, 2.0
SIZE_COLUMNS = (
    "points a side",
    "copy [GB/s]",
    "transform pair [ms]",
    *("compile [s]", "equilibrium [s]", "steps", "as pairs", "busy", "kernels a step", "waits"),
    *("compile [s]", "verdict [s]", "pairs it counts", "as pairs", "as copies of a field"),
    *("busy", "kernels a pair", "waits"),
)
MARCH_COLUMNS = (
    "points a side",
    *("compile [s]", "path [s]", "states", "busy", "kernels a state", "waits"),
    *("compile [s]", "evolution [s]", "times", "busy", "kernels a time", "waits"),
)
BATCH_COLUMNS = (
    "points a side",
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
    parser.add_argument("--precision", choices=PRECISIONS, help="this alone, to do it in two runs")
    parser.add_argument("--largest", type=int, default=SIZES[-1], help="points a side")
    parser.add_argument("--batch", type=int, default=max(BATCHES.values()), help="contacts at most")
    parser.add_argument("--seconds", type=float, default=450, help="start nothing that ends later")
    parser.add_argument("--out", type=Path, help="a file for the table")
    return parser.parse_args()


def report(options: argparse.Namespace, device: str, deadline: float) -> Iterator[str]:
    """Yield the lines of all tables as they come."""
    sizes = [n for n in SIZES if n <= options.largest]
    batches = [n for n in BATCHES if n <= options.largest]
    marches = [n for n in MARCHES if n <= options.largest]
    precisions = (options.precision,) if options.precision else PRECISIONS
    yield (f"{device}; least of up to {REPEATS} runs")
    yield from ("", "Against the figures of a CPU", "")
    yield from check_figures(precisions)
    for precision in precisions:
        yield from ("", f"Many contacts, {precision}", "")
        row = partial(batch_row, precision, options.batch)
        yield from table(BATCH_COLUMNS, batches, row, deadline)
        yield from ("", f"A path to contact and back, and a relaxation in time, {precision}", "")
        yield from table(MARCH_COLUMNS, marches, partial(march_row, precision), deadline)
        yield from ("", f"One contact, {precision}", "")
        yield from table(SIZE_COLUMNS, sizes, partial(size_row, precision), deadline)


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


def check_figures(precisions: tuple[str, ...]) -> Iterator[str]:
    """Yield a row for each figure: what it is in each precision, and whether it may be that."""
    expected = json.loads(FIGURES.read_text())
    yield "| figure | CPU | " + " | ".join(f"{p} | off by | may be" for p in precisions) + " |"
    yield "|---|---|" + "---|---|---|" * len(precisions)
    found = [figures_in(precision) for precision in precisions]
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
            except js.exceptions.SolverError:
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
    work = device_work(lambda: js.equilibrate(contact, load), int(state.num_steps))
    judging = device_work(lambda: js.assess_stability(contact, state), pairs)
    cells = [
        f"{2 * field.nbytes / copy / 1e9:.0f}",
        f"{1e3 * pair:.3f}",
        *(f"{compiling:.1f}", f"{seconds:.4f}", str(state.num_steps), f"{seconds / pair:.0f}"),
        *work,
        *(f"{compiling_too:.1f}", f"{longer:.3f}", str(pairs), f"{longer / pair:.0f}"),
        f"{longer / copy:.0f}",
        *judging,
    ]
    return cells, compiling + compiling_too


def march_row(precision: str, n: int) -> Row:
    """Return the cells of a path and of an evolution, and the seconds of compiling."""
    dtype = jnp.dtype(precision)
    contact, load = contact_of(n, dtype)
    loads = js.MeanGap(load.value * jnp.array([4, 1, 4], dtype))
    solid = js.Viscoelastic(contact.solid, ratios=(jnp.ones((), dtype),), times=(1.0,))
    soft = js.Contact(solid, contact.heights, contact.potential)
    times = jnp.array([0, 0.5, 3], dtype)
    held = js.MeanGap(load.value * jnp.array([4, 1, 1], dtype))

    cells, compiling_all = [], 0.0
    for march in (lambda: js.follow(contact, loads), lambda: js.evolve(soft, held, times)):
        compiling, seconds, out = timed(march)
        number = len(out)
        cells += [f"{compiling:.1f}", f"{seconds:.3f}", str(number), *device_work(march, number)]
        compiling_all += compiling
    return cells, compiling_all


def batch_row(precision: str, most: int, n: int) -> Row:
    """Return the cells of a batch of contacts of n x n points, and the seconds of compiling."""
    dtype, count = jnp.dtype(precision), min(BATCHES[n], most)
    contact, load = contact_of(n, dtype)
    surfaces = jax.vmap(lambda key: contact_of(n, dtype, key)[0].heights)(jnp.arange(count))

    def equilibrium(heights: jax.Array) -> js.results.Equilibrium:
        rough = js.Contact(contact.solid, heights, contact.potential)
        return js.equilibrate(rough, load, throw=False)

    def verdict(heights: jax.Array, state: js.results.Equilibrium) -> jax.Array:
        rough = js.Contact(contact.solid, heights, contact.potential)
        return js.assess_stability(rough, state, throw=False).verdict.code

    solve, judge = jax.jit(jax.vmap(equilibrium)), jax.jit(jax.vmap(verdict))
    few = range(min(ALONE, count))
    compiling, seconds, states = timed(lambda: solve(surfaces))
    _, alone, apart = timed(lambda: [equilibrium(surfaces[i]) for i in few])
    compiling_too, longer, _ = timed(lambda: judge(surfaces, states))
    _, longer_alone, _ = timed(lambda: [verdict(surfaces[i], apart[i]) for i in few])
    cells = [
        str(count),
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


def device_work(function: Callable, number: int) -> tuple[str, str, str]:
    """Return the share of the time of a call that a GPU works, its kernels, and copies to the host.

    The kernels are counted for one of a number of steps. No cell is filled on a CPU.
    """
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        with jax.profiler.trace(folder):
            jax.block_until_ready(function())
            seconds = time.perf_counter() - start
        (file,) = Path(folder).glob("**/*.xplane.pb")
        planes = jax.profiler.ProfileData.from_file(str(file)).planes
        events = [
            (event.start_ns, event.start_ns + event.duration_ns, event.name)
            for plane in planes
            if plane.name.startswith("/device:GPU")
            for line in plane.lines
            if line.name.startswith("Stream")
            for event in line.events
        ]
    if not events:
        return "", "", ""
    busy = end = 0.0
    for begin, finish, _ in sorted(events):
        busy += max(finish - max(begin, end), 0)
        end = max(end, finish)
    kernels = sum(not name.startswith("Mem") for _, _, name in events)
    waits = sum(name.startswith("MemcpyD2H") for _, _, name in events)
    return f"{1e-9 * busy / seconds:.0%}", f"{kernels / max(number, 1):.0f}", str(waits)


def timed_inside(function: Callable, field: jax.Array, count: int = 20) -> float:
    """Return the seconds of one of many applications in one program."""
    loop = jax.jit(lambda x: jax.lax.fori_loop(0, count, lambda _, x: function(x), x))
    return timed(lambda: loop(field))[1] / count


if __name__ == "__main__":
    main()

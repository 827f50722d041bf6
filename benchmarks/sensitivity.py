"""The effect of each tuning constant: results, failures and cost with half and twice its value.

A tuning constant is a positive number that a module names, or a small table of such numbers. Each
of its values is tried in a process of its own, which multiplies the constant where it is defined,
so that everything follows that is made from it. The problems are lines and grids of up to 256
points: equilibria, verdicts, curves, paths, evolutions, transitions and fits, in float64. Constants
of a room are tried on the kinds of problems that come to it.

- Change of results: the largest over all problems, relative to the numbers of a result; "other" if
  there are more or fewer of them, such as another jump.
- Failures: problems with an error, or without a result.
- Steps: those that results count, or states.
- Calls: of compiled programs, of which searches run their outer steps.
- Seconds, with `--seconds`: of a processor for a second pass, compiled. They show the steps within
  programs, but need an idle core.

A constant has no effect if with both values no result changes by more than 1e-6, or the tolerance
of evolutions, failures are the same, and steps, calls and seconds change by less than 5 %. All of
it takes hours: with `--every 3` only each third problem is solved. The constants of a module are
scaled at once first: if they have no effect together, each is taken to have none and they are one
row, otherwise each is scaled alone.

    python benchmarks/sensitivity.py --only evolution branches
"""

import argparse
import ast
import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial, wraps
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROOMS = {
    "core": ("equilibria", "verdicts", "curves"),
    "potentials": ("equilibria", "paths"),
    "solids": ("equilibria", "evolutions"),
    "loads": ("equilibria", "paths"),
    "contact": ("equilibria", "verdicts", "paths"),
    "equilibrium": ("equilibria", "verdicts", "paths"),
    "stability": ("verdicts", "paths"),
    "calibration": ("fits",),
    "branches": ("curves", "paths"),
    "states": ("curves", "paths"),
    "evolution": ("evolutions",),
    "loading": ("paths",),
    "transitions": ("transitions",),
}
# Rooms whose numbers do not come to these problems: measurements, closed forms, files, figures.
APART = (
    "citations",
    "cli",
    "exceptions",
    "files",
    "lab",
    "observation",
    "plots",
    "references",
    "results",
    "solvers",
    "studies",
    "surfaces",
    "units",
)
# Numbers that are no choices: of physics, units, formats, closed forms, a path, a fit's functions.
GIVEN = (
    "_DIGEST",
    "_FOLDERS",
    "_GAS_CONSTANT",
    "_GRAVITY",
    "LENGTHS",
    "_PREFIXES",
    "_SI",
    "_STAIRCASE",
    "CREEP",
    "OSCILLATION",
    "RELAXATION",
)
FACTORS = 0.5, 2.0
UNCHANGED = {"evolutions": 1e-3}
ACCURACY = 1e-6
COST = 0.05
LIMIT = 300.0  # [s]
PACKAGE = Path(__file__).parents[1] / "jaxstab"
COSTS = "steps", "calls", "seconds"
COLUMNS = "module", "constant", "value", "results", "failures", *COSTS, "effect"


class Constant(NamedTuple):
    module: str
    name: str
    value: str


class Outcome(NamedTuple):
    """The numbers of a result, several arrays; how many steps it took, and whether it failed."""

    numbers: list[list[float]]
    steps: int
    has_failed: bool


# ------------------------------------------------------------------ constants


def constants_of(room: str) -> Iterator[Constant]:
    """Yield the constants of a room: up to eleven numbers, of which one at least is positive."""
    for file in sorted((PACKAGE / room).rglob("*.py")):
        module = ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts)
        for node in ast.parse(file.read_text()).body:
            if not (isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)):
                continue
            if not node.targets[0].id.isupper() or node.targets[0].id in GIVEN:
                continue
            numbers = [
                child.value
                for child in ast.walk(node.value)
                if isinstance(child, ast.Constant) and type(child.value) in (int, float)
            ]
            is_label = isinstance(node.value, ast.UnaryOp) or not any(numbers)
            if 0 < len(numbers) < 12 and not is_label:
                yield Constant(module, node.targets[0].id, ast.unparse(node.value))


def scaled(factor: float, value: Any) -> Any:
    """Return a number, or a table of numbers, times a factor."""
    if isinstance(value, dict):
        return {key: scaled(factor, each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return type(value)(scaled(factor, each) for each in value)
    if isinstance(value, bool) or not isinstance(value, int | float | np.ndarray | np.number):
        return value
    if isinstance(value, int):
        return max(1, int(factor * value))
    return factor * value


class Scaling(SourceFileLoader):
    """Finds one module, and multiplies some of its constants right after their definitions."""

    def __init__(self, module: str, names: list[str], factor: float):
        super().__init__(
            module, str(PACKAGE.parent.joinpath(*module.split(".")).with_suffix(".py"))
        )
        self.constants = names
        self.factor = factor

    def find_spec(self, module: str, path: Any, target: Any = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(module, path) if module == self.name else None
        if spec is not None:
            spec.loader = self
        return spec

    def get_code(self, fullname: str) -> Any:
        tree = ast.parse(Path(self.path).read_text())
        for constant in self.constants:
            names = [ast.unparse(getattr(node, "targets", [node])[0]) for node in tree.body]
            place = names.index(constant) + 1
            tree.body[place:place] = ast.parse(f"{constant} = _scaled({constant})").body
        return compile(tree, self.path, "exec")

    def exec_module(self, module: Any) -> None:
        module._scaled = partial(scaled, self.factor)
        super().exec_module(module)


# ------------------------------------------------------------------- problems


def problems(family: str) -> list[Callable[[], Outcome]]:
    """Return the problems of a kind."""
    import jax
    import jax.numpy as jnp

    import jaxstab as js

    def rough(grid: Any, seed: int, energy: float = 0.02, solid: Any = None) -> Any:
        """Return a rough contact of rms height 0.05."""
        waves = {"k_high": grid.shape[0] // 4, "rms_height": 0.05}
        heights = js.surfaces.self_affine(grid, jax.random.key(seed), **waves)
        law = js.potentials.Exponential(energy, 0.05)
        return js.Contact(solid or js.HalfSpace(grid, 1.0), heights, law)

    def outcome(result: Any, steps: Any, *numbers: Any) -> Outcome:
        """Return the outcome of a search, whose numbers are NaN where it failed."""
        arrays = [np.ravel(np.asarray(each, float)).tolist() for each in numbers]
        return Outcome(arrays, int(np.sum(steps)), bool(np.any(result.name != "successful")))

    def equilibrium(contact: Any, load: Any) -> Outcome:
        found = js.equilibrate(contact, load, throw=False)
        return outcome(
            found.result, found.num_steps, found.mean_pressure, found.energy, found.contact_area
        )

    def verdict(contact: Any, load: Any) -> Outcome:
        state = js.equilibrate(contact, load, throw=False)
        found = js.assess_stability(contact, state, throw=False)
        pairs = found.lower_bound, found.cone, found.critical
        return outcome(
            state.result,
            [pair.num_applications for pair in pairs],
            [pair.eigenvalue for pair in pairs],
            found.verdict.code,
        )

    def curve(contact: Any, load: Any) -> Outcome:
        found = js.continuation(contact, load, throw=False, max_states=100)
        turns = found.turns
        return outcome(found.result, len(found), turns.load.value, turns.kind.code, found.end.code)

    def critical_load(contact: Any, load: Any) -> Outcome:
        found = js.critical_load(contact, load, throw=False)
        return outcome(found.result, 0, found.load.value, found.kind.code)

    def path(contact: Any, load: Any) -> Outcome:
        found = js.follow(contact, load, throw=False)
        jumps = found.jumps
        lost = found.dissipation
        return outcome(found.result, len(found), lost, jumps.load.value, jumps.kind.code)

    def pull_off(contact: Any, spring: Any) -> Outcome:
        found = js.pull_off(contact, spring=spring, throw=False)
        return outcome(found.result, 0, found.load.value, found.kind.code)

    def evolution(contact: Any, load: Any, times: Any) -> Outcome:
        found = js.evolve(contact, load, times, throw=False)
        energies = found.work, found.viscous_dissipation, found.jump_dissipation
        return outcome(
            found.result, found.num_steps, found.mean_pressure, *energies, found.jump_times
        )

    def growth(contact: Any, load: Any) -> Outcome:
        found = js.evolve(contact, load, jnp.array([0.0, 1.0, 2.0]), throw=False)
        return outcome(found.result, found.num_steps, js.growth_rate(found))

    def lifetime(contact: Any, pressure: float) -> Outcome:
        return Outcome([[js.lifetime(contact, js.MeanPressure(pressure))]], 0, False)

    def transition(contact: Any) -> Outcome:
        found = js.follow(contact, js.MeanGap(jnp.array([0.3, 0.02])), throw=False)
        jump = found.jumps[int(np.argmax(found.jumps.dissipation))]
        before = js.MeanGap(jump.load.value + 0.002)
        over = js.transition(contact, before, jump.before, jump.after, throw=False)
        out = js.easiest_exit(contact, over.start, throw=False)
        barriers = over.there, over.back, out.there
        return outcome(over.result, out.result.name != "successful", *barriers)

    def fit(contact: Any, truth: Any, noise: float, **options: Any) -> Outcome:
        loads = js.MeanGap(jnp.linspace(0.02, 0.3, 16))
        curve = js.sweep(truth, loads, order="continuation").equilibrium.mean_pressure
        random = np.random.default_rng(0).normal(size=16)
        measured = curve + noise * jnp.std(curve) * random
        found = js.calibrate(contact, loads, measured, throw=False, **options)
        law, modulus = found.parameters
        return outcome(
            found.result, found.num_steps, law.surface_energy, law.length, modulus, found.loss
        )

    line = js.Grid((32,))
    square = js.Grid(16)
    down = jnp.array([0.3, 0.02])
    around = jnp.array([0.3, 0.02, 0.3])
    listed: list[Callable[[], Outcome]] = []

    def add(function: Callable[..., Outcome], *args: Any, **options: Any) -> None:
        listed.append(partial(function, *args, **options))

    if family == "equilibria":
        for seed in range(10):
            for gap in (0.01, 0.1, 0.3):
                add(equilibrium, rough(square, seed, 0.01 * (1 + seed % 4)), js.MeanGap(gap))
        free = js.FreeHalfSpace(js.Grid(8), 1.0)
        layer = js.Layer(square, 1.0, 0.3, 0.2)
        for seed in range(4):
            contact = rough(square, seed, solid=layer)
            add(equilibrium, contact, js.Spring(0.1 * seed, 2.0))
            add(equilibrium, rough(free.grid, seed, solid=free), js.MeanPressure(0.1 * seed))
            core = js.potentials.LennardJones(0.02, 0.05)
            hard = js.Contact(contact.solid, contact.heights, core)
            add(equilibrium, hard, js.MeanGap(0.05 * (1 + seed)))
    elif family == "verdicts":
        for seed in range(20):
            for gap in (0.02, 0.08, 0.14, 0.2, 0.3):
                add(verdict, rough(square, seed, 0.01 * (1 + seed % 6)), js.MeanGap(gap))
    elif family == "curves":
        for seed in range(8):
            contact = rough(line, seed, 0.03 + 0.01 * (seed % 4))
            add(curve, contact, js.MeanGap(down))
            add(critical_load, contact, js.MeanGap(down))
    elif family == "paths":
        for seed in range(8):
            contact = rough(line, seed, 0.02 + 0.01 * (seed % 5))
            add(path, contact, js.MeanGap(around))
            add(pull_off, contact, 5.0)
    elif family == "evolutions":
        times = jnp.array([0.0, 1.0, 2.0])
        solid = js.Viscoelastic(js.HalfSpace(line, 1.0), (2.0, 1.0), (0.1, 1.0))
        for seed in range(8):
            contact = rough(line, seed, 0.02 * (1 + seed), solid)
            add(evolution, contact, js.MeanGap(around), times)
        # A leg much longer than the relaxation times.
        add(evolution, contact, js.MeanGap(around), jnp.array([0.0, 1.0, 300.0]))
        # Between the loss of stability of the relaxed and of the glassy solid.
        flat = js.Contact(solid, jnp.zeros(line.shape), contact.potential)
        for gap in (0.09, 0.12):
            add(growth, flat, js.MeanGap(jnp.full(3, gap)))
        for seed in range(2):
            add(lifetime, rough(line, seed, 0.02, solid), -0.12 - 0.03 * seed)
    elif family == "transitions":
        for seed in range(6):
            add(transition, rough(line, seed, 0.03 + 0.01 * (seed % 3)))
    elif family == "fits":
        for seed in range(4):
            truth = rough(line, seed, 0.02)
            guess = js.potentials.Exponential(0.02 * 1.5 ** (seed - 1), 0.04)
            contact = js.Contact(truth.solid, truth.heights, guess)
            add(fit, contact, truth, 0.0)
            add(fit, contact, truth, 0.02, baseline=True)
    return listed


def solved(families: list[str], every: int, has_seconds: bool) -> dict[str, Any]:
    """Return the outcomes of every n-th problem of some kinds, and what they cost."""
    calls = count_calls()
    import jax

    import jaxstab as js

    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    listed = {family: problems(family)[::every] for family in families}

    def outcomes(family: str) -> list[Outcome]:
        found = []
        for problem in listed[family]:
            try:
                found.append(problem())
            except (js.exceptions.SolverError, ValueError):
                found.append(Outcome([], 0, True))
        return found

    calls.clear()
    found = {family: outcomes(family) for family in families}
    costs = {
        "steps": sum(steps for each in found.values() for _, steps, _ in each),
        "calls": len(calls),
    }
    if has_seconds:
        start = time.process_time()
        for family in families:
            outcomes(family)
        costs["seconds"] = time.process_time() - start
    return {"outcomes": found, "costs": costs}


def count_calls() -> list[str]:
    """Return a list to which each call of a compiled program is added, outside of a trace."""
    import jaxstab.core.compile as compiling
    from jaxstab.core.checks import is_transformed

    calls: list[str] = []
    program = compiling.program

    def counted(function: Callable, **options: Any) -> Callable:
        compiled = program(function, **options)

        @wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            if not is_transformed((args, kwargs)):
                calls.append(function.__name__)
            return compiled(*args, **kwargs)

        return call

    # Modules that are imported from here on take this one.
    compiling.program = counted
    return calls


# ---------------------------------------------------------------------- table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=ROOMS, default=[*ROOMS], metavar="ROOM")
    parser.add_argument("--constants", nargs="+", metavar="NAME", help="of the rooms, by name")
    parser.add_argument("--every", type=int, default=1, help="of so many problems solve one")
    parser.add_argument("--seconds", action="store_true")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    parser.add_argument("--solve", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.solve:
        families, factor, constants = json.loads(options.solve)
        for module, names in constants.items():
            sys.meta_path.insert(0, Scaling(module, names, factor))
        print(json.dumps(solved(families, options.every, options.seconds)))
        return
    lines = [
        f"| {' | '.join(COLUMNS)} |",
        "|" + "---|" * len(COLUMNS),
    ]
    with tempfile.TemporaryDirectory() as cache:
        for room in options.only:
            solve = partial(solve_apart, cache, options.every, options.seconds, ROOMS[room])
            solve(1.0, [])
            known = solve(1.0, [])
            chosen = [
                constant
                for constant in constants_of(room)
                if not options.constants or constant.name in options.constants
            ]
            for _, group in groupby(chosen, key=lambda constant: constant.module):
                for line in rows(known, solve, list(group)):
                    lines.append(line)
                    print(line, flush=True)
                    if options.out:
                        options.out.write_text("\n".join(lines) + "\n")


def solve_apart(
    cache: str,
    every: int,
    has_seconds: bool,
    families: tuple[str, ...],
    factor: float,
    constants: list[Constant],
) -> dict[str, Any] | None:
    """Return the outcomes of problems in a process of its own, or None if it has none."""
    names: dict[str, list[str]] = {}
    for constant in constants:
        names.setdefault(constant.module, []).append(constant.name)
    environment = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": cache,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.1",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        "TF_CPP_MIN_LOG_LEVEL": "3",
        # They compile fast, and the seconds are of one thread.
        "XLA_FLAGS": (
            "--xla_backend_optimization_level=0 --xla_cpu_multi_thread_eigen=false "
            "--xla_cpu_parallel_codegen_split_count=1 intra_op_parallelism_threads=1"
        ),
        "PYTHONPATH": str(PACKAGE.parent),
    }
    command = [sys.executable, __file__, "--solve", json.dumps([families, factor, names])]
    command += ["--every", str(every), *["--seconds"] * has_seconds]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=LIMIT, check=True
        )
    except (subprocess.TimeoutExpired, subprocess.CalledProcessError):
        if not constants:
            raise
        return None
    return json.loads(done.stdout.splitlines()[-1])


def rows(
    known: dict[str, Any],
    solve: Callable[[float, list[Constant]], dict[str, Any] | None],
    constants: list[Constant],
) -> Iterator[str]:
    """Yield the row of constants scaled at once or, if they have an effect, the row of each."""
    line, has_effect = row(constants, known, [solve(factor, constants) for factor in FACTORS])
    if not has_effect or len(constants) == 1:
        yield line
        return
    for one in constants:
        yield row([one], known, [solve(factor, [one]) for factor in FACTORS])[0]


def row(
    constants: list[Constant], known: dict[str, Any], tried: list[dict[str, Any] | None]
) -> tuple[str, bool]:
    """Return the row of constants, half and twice as large, and whether they have an effect."""
    results = []
    failures = [str(count_failures(known))]
    costs: dict[str, list[str]] = {name: [] for name in COSTS}
    has_effect = False
    for found in tried:
        if found is None:
            results.append("none")
            has_effect = True
            continue
        changes = {family: change_of(known, found, family) for family in known["outcomes"]}
        most = max(changes.values())
        results.append("other" if np.isinf(most) else f"{most:.0e}")
        has_effect |= any(
            change > UNCHANGED.get(family, ACCURACY) for family, change in changes.items()
        )
        failures.append(str(count_failures(found)))
        has_effect |= failures[-1] != failures[0]
        for name, cost in found["costs"].items():
            more = cost / max(known["costs"][name], 1e-9) - 1
            costs[name].append(f"{100 * more:+.0f} %")
            has_effect |= abs(more) > COST
    cells = [
        ", ".join(dict.fromkeys(one.module.removeprefix("jaxstab.") for one in constants)),
        ", ".join(f"`{one.name}`" for one in constants),
        ", ".join(f"`{one.value}`" for one in constants),
        *(", ".join(cell) for cell in (results, failures, *costs.values())),
        "yes" if has_effect else "none",
    ]
    return f"| {' | '.join(cells)} |", has_effect


def change_of(base: dict, found: dict, family: str) -> float:
    """Return the largest change of a result, relative to the array; infinite for others."""
    changes = [0.0]
    pairs = zip(base["outcomes"][family], found["outcomes"][family], strict=True)
    for (before, *_), (after, *_) in pairs:
        if [len(array) for array in before] != [len(array) for array in after]:
            return np.inf
        for one, other in zip(before, after, strict=True):
            changes.append(change_of_array(np.array(one, float), np.array(other, float)))
    return max(changes)


def change_of_array(before: np.ndarray, after: np.ndarray) -> float:
    if not np.array_equal(np.isfinite(before), np.isfinite(after)):
        return np.inf
    is_number = np.isfinite(before)
    moved = np.abs(after[is_number] - before[is_number])
    size = np.max(np.abs(before[is_number]), initial=0)
    return float(np.max(moved, initial=0)) / (float(size) or 1)


def count_failures(found: dict) -> int:
    return sum(has_failed for each in found["outcomes"].values() for _, _, has_failed in each)


if __name__ == "__main__":
    main()

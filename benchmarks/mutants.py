"""Small changes of the code, one at a time: which of them do the tests notice?

A change replaces an operator or a comparison by another one, a number by another one, or a minus by
a plus. Each meets, in a copy of the package, first the tests that run its line, then all tests of
its package and of the packages that use it most, those with its name and the quick ones first, up
to the first failure. A test that takes too long counts as one that fails. A change that all tests
pass has survived: either it changes no answer, or a test is missing.

Messages, annotations, decorators and the named constants of a module or a class that bound or tune
a search stay as they are: they may change without a change of an answer. The order of the draw
depends on the code, so that the same seed draws other changes once the code has changed.

    python benchmarks/mutants.py --sample 200
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from coverage import CoverageData

ROOT = Path(__file__).parents[1]
# The packages whose code is changed, and the folders of tests beside their own that run.
USERS = {
    "solids": ("contact", "equilibrium", "evolution"),
    "loads": ("equilibrium", "loading"),
    "potentials": ("contact", "equilibrium"),
    "contact": ("equilibrium", "stability"),
    "equilibrium": ("contact", "stability"),
    "stability": ("branches",),
    "branches": ("loading",),
}
OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.USub: ast.UAdd,
}
COMPARISONS = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
# Parts of names of numbers that bound or tune a search.
TUNING = ("max_", "tolerance", "num_steps")
# Functions whose arguments are messages, kinds of a value or options of Python's own.
UNCHANGED_CALLS = ("warn", "isinstance", "zip", "field", "ClassVar", "ContextVar")
# Seconds that a test may take.
LONGEST_TEST = 120
COLUMNS = ("file", "line", "change", "noticed by", "s")


class Change(NamedTuple):
    """A field of the node of a file's syntax tree (by its number), and the value that it gets."""

    path: Path
    node: int
    field: str
    value: object
    line: int
    before: str
    after: str

    def mutated(self) -> str:
        """Return the text of the changed file."""
        tree = ast.parse((ROOT / self.path).read_text())
        setattr(list(ast.walk(tree))[self.node], self.field, self.value)
        return ast.unparse(tree)

    def row(self, notice: str, seconds: float) -> str:
        name = self.path.relative_to("jaxstab")
        change = f"`{self.before}` to `{self.after}`".replace("|", "\\|")
        return f"| {name} | {self.line} | {change} | {notice} | {seconds:.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sample", type=int, default=200, help="the number of changes")
    parser.add_argument("--seed", type=int, default=0, help="of the order in which they are drawn")
    parser.add_argument("--room", choices=USERS, help="the only package to change")
    parser.add_argument("--out", type=Path, help="a file for the table as well")
    options = parser.parse_args()
    rooms = [options.room] if options.room else list(USERS)
    everything = [change for room in rooms for change in changes_of(room)]
    # A smaller sample is the beginning of a larger one.
    random.Random(options.seed).shuffle(everything)
    sample = everything[: options.sample]
    with tempfile.TemporaryDirectory() as folder:
        tests = Tests(Path(folder), rooms)
        rows, num_noticed = [], 0
        for change in sample:
            notice, seconds = tests.notice(change)
            num_noticed += notice is not None
            rows.append(change.row(notice or "**survived**", seconds))
            print(rows[-1], flush=True)
            if options.out:
                lines = report(rows, num_noticed, len(everything), options.seed)
                options.out.write_text("\n".join(lines) + "\n")


def report(rows: list[str], num_noticed: int, num_possible: int, seed: int) -> list[str]:
    return [
        f"{num_noticed} of {len(rows)} changes noticed, drawn from {num_possible} with the seed "
        f"{seed}",
        "",
        f"| {' | '.join(COLUMNS)} |",
        "|" + "---|" * len(COLUMNS),
        *rows,
    ]


def changes_of(room: str) -> list[Change]:
    """Return all changes of a package, in the order of its files and their lines."""
    files = sorted((ROOT / "jaxstab" / room).rglob("*.py"))
    return [change for file in files for change in changes_in(file)]


def changes_in(file: Path) -> Iterator[Change]:
    tree = ast.parse(file.read_text())
    number = {id(node): index for index, node in enumerate(ast.walk(tree))}
    parents = {id(part): node for node in ast.walk(tree) for part in ast.iter_child_nodes(node)}
    path = file.relative_to(ROOT)
    for node in changeable(tree):
        for field, value in replacements(node):
            # A number alone says little.
            shown = parents[id(node)] if isinstance(node, ast.Constant) else node
            before = ast.unparse(shown)
            kept = getattr(node, field)
            setattr(node, field, value)
            after = ast.unparse(shown)
            setattr(node, field, kept)
            yield Change(path, number[id(node)], field, value, node.lineno, before, after)


def changeable(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and those within it, except where a change would change no answer."""
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not is_unchanged(child):
                yield from changeable(child)


def is_unchanged(node: ast.AST) -> bool:
    match node:
        case ast.Raise() | ast.Assert() | ast.JoinedStr():
            return True
        case ast.FunctionDef(returns=ast.Name(id="str")):
            return True
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name in UNCHANGED_CALLS
        # A constant of the module, or an alias of types.
        case ast.Assign(targets=[ast.Name(id=name)], col_offset=0):
            return True
        case ast.AnnAssign(target=ast.Name(id=name), value=ast.Constant() | ast.UnaryOp()):
            return is_tuning(name)
        case ast.Assign(targets=[ast.Name(id=name)], value=ast.Constant()):
            return is_tuning(name)
        case ast.keyword(arg=str(name), value=ast.Constant(value=value)):
            return isinstance(value, bool) or is_tuning(name)
        case ast.Compare(left=left, comparators=[right]):
            return any(
                is_tuning(side.id.lower()) for side in (left, right) if isinstance(side, ast.Name)
            )
    return False


def is_tuning(name: str) -> bool:
    return any(part in name for part in TUNING)


def replacements(node: ast.AST) -> Iterator[tuple[str, object]]:
    match node:
        case ast.BinOp() | ast.BoolOp() | ast.UnaryOp():
            if type(node.op) in OPERATORS:
                yield "op", OPERATORS[type(node.op)]()
        case ast.Compare(ops=[op]):
            for other in COMPARISONS[type(op)]:
                yield "ops", [other()]
        case ast.Constant(value=bool(value)):
            yield "value", not value
        case ast.Constant(value=int(value)):
            yield "value", value + 1
        case ast.Constant(value=float(value)):
            yield "value", 2 * value if value else 1.0


class Tests:
    """The tests, in a copy of the repository, with the seconds and the lines of each."""

    def __init__(self, folder: Path, rooms: list[str]):
        self.folder = folder
        for name in ("jaxstab", "tests"):
            shutil.copytree(ROOT / name, folder / name)
        shutil.copy(ROOT / "pyproject.toml", folder)
        self.environment = os.environ | {"PYTHONPATH": str(folder)}
        # Each run reads the compiled code of all modules but the changed one.
        self.environment.pop("PYTHONDONTWRITEBYTECODE", None)
        programs = {
            "JAX_COMPILATION_CACHE_DIR": str(folder / "programs"),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
            "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
            "TF_CPP_MIN_LOG_LEVEL": "3",
        }
        for name, value in programs.items():
            self.environment.setdefault(name, value)
        folders = set(rooms) | {user for room in rooms for user in USERS[room]}
        measured = ("--junitxml=report.xml", "--cov=jaxstab", "--cov-context=test", "--cov-report=")
        if self.failure([f"tests/{name}" for name in sorted(folders)], *measured) is not None:
            raise RuntimeError(f"The unchanged code fails:\n{self.output}")
        self.read_measured()

    def read_measured(self) -> None:
        """Read the seconds of each test and the lines that it runs from the reports of a run."""
        self.seconds: dict[str, float] = {}
        for case in ElementTree.parse(self.folder / "report.xml").iter("testcase"):
            file = case.get("classname").replace(".", "/") + ".py"
            self.seconds[f"{file}::{case.get('name')}"] = float(case.get("time"))
        self.lines = CoverageData(str(self.folder / ".coverage"))
        self.lines.read()

    def notice(self, change: Change) -> tuple[str | None, float]:
        """Return the first test that fails under a change, or None, and the seconds it takes."""
        target = self.folder / change.path
        target.write_text(change.mutated())
        start = time.perf_counter()
        try:
            nearest = self.that_run(change)
            failure = self.failure(nearest) if nearest else None
            failure = failure or self.failure(self.of_users(change.path))
        finally:
            shutil.copy(ROOT / change.path, target)
        return failure, time.perf_counter() - start

    def that_run(self, change: Change) -> list[str]:
        """Return the tests that run the line of a change, except those that find it traced."""
        contexts = self.lines.contexts_by_lineno(str(self.folder / change.path))
        # A context is a test and its phase.
        tests = {context.rpartition("|")[0] for context in contexts.get(change.line, [])}
        tests &= self.seconds.keys()
        return in_order(change.path, {test: self.seconds[test] for test in tests})

    def of_users(self, module: Path) -> list[str]:
        """Return the files of tests of a module's package and then those of its users."""
        files = defaultdict(float)
        for test, seconds in self.seconds.items():
            files[test.partition("::")[0]] += seconds
        room = module.parts[1]
        return [
            file
            for folder in (room, *USERS[room])
            for file in in_order(module, files)
            if file.startswith(f"tests/{folder}/")
        ]

    def failure(self, tests: list[str], *options: str) -> str | None:
        """Run tests up to the first failure, and return its name."""
        options += ("-q", "-x", "-o", "addopts=", "-m", "not nightly", "--tb=no")
        limit = (f"faulthandler_timeout={LONGEST_TEST}", "faulthandler_exit_on_timeout=true")
        command = [sys.executable, "-m", "pytest", *options]
        command += [part for each in limit for part in ("-o", each)]
        done = subprocess.run(
            [*command, *tests],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
        )
        self.output = done.stdout + done.stderr
        if done.returncode == 0:
            return None
        words = [line.split() for line in done.stdout.splitlines()]
        named = [line[1] for line in words if line[:1] in (["FAILED"], ["ERROR"])]
        if named:
            return named[0].removeprefix("tests/")
        return "the time limit" if "Timeout (" in self.output else "import"


def in_order(module: Path, seconds: dict[str, float]) -> list[str]:
    """Return tests or their files, those with the name of a module and the quick ones first."""
    return sorted(seconds, key=lambda test: (module.stem not in test, seconds[test]))


if __name__ == "__main__":
    main()

"""The head of a table: of which tree it is, when, with which packages and on which machine.

A room is known by a fingerprint of its code, in which comments and docstrings do not count. A table
is old if the code of a room that it measures, or of its script, is another one by now. Where that
cannot change the table, a line below the head says why:

    - holds for loading 1a2b3c4d: a warning has another text
"""

import ast
import hashlib
import os
import platform
import re
import subprocess
import time
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import fft

from benchmarks.tables import Table

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
# Alone, a table of a tree that differs from a commit in these is of that commit.
_MADE = (":!benchmarks/results", ":!docs/_static", ":!paper/*.png", ":!*.md")
_PACKAGES = "jax", "numpy", "scipy"
_NUM_BYTES, _POINTS, _REPEATS = 2**27, 512, 10
_HEAD = re.compile(
    r"- jaxstab (?P<version>\S+), commit (?P<commit>\w+), (?P<state>clean|with other changes)\n"
    r"- (?P<date>[\d-]+), in (?P<seconds>\d+) s\n"
    r"- (?P<packages>Python .+)\n"
    r"- (?P<machine>.+ ms)\n"
    r"- of (?P<codes>.+)\n"
)
_HOLDS = re.compile(r"^- holds for (\S+) (\w{8}): \S.*$", re.MULTILINE)


class Head(NamedTuple):
    """What the head of a table says."""

    version: str
    commit: str
    state: str
    date: str
    seconds: str
    packages: str
    machine: str
    codes: str

    def __str__(self) -> str:
        return (
            f"- jaxstab {self.version}, commit {self.commit}, {self.state}\n"
            f"- {self.date}, in {self.seconds} s\n- {self.packages}\n- {self.machine}\n"
            f"- of {self.codes}\n"
        )


def head_of(text: str) -> Head | None:
    """Return the head that a table begins with, if it has one."""
    found = _HEAD.match(text)
    return found and Head(**found.groupdict())


def milliseconds(speed: str) -> float:
    """Return how long a `machine` takes to transform a field."""
    return float(speed.split()[-2])


def new_head(table: Table, speed: str, seconds: float) -> Head:
    """Return the head of a table that was made now, in so many seconds, on a `machine`."""
    packages = [f"{name} {version(name)}" for name in (*_PACKAGES, *table.peers.split())]
    state = "with other changes" if git("status", "--porcelain", "--", ".", *_MADE) else "clean"
    return Head(
        version=version("jaxstab"),
        commit=git("rev-parse", "--short=10", "HEAD"),
        state=state,
        date=f"{date.today()}",
        seconds=f"{seconds:.0f}",
        packages=", ".join([f"Python {platform.python_version()}", *packages]),
        machine=speed,
        codes=", ".join(f"{name} {code}" for name, code in codes_of(table).items()),
    )


def is_of_this_tree(head: Head | None) -> bool:
    """Whether a table is of the code as it is now, but for results and pages."""
    if head is None or head.state != "clean":
        return False
    differs = subprocess.run(
        ["git", "diff", "--quiet", head.commit, "--", ".", *_MADE], cwd=ROOT, capture_output=True
    )
    return differs.returncode == 0


def changes_since(text: str, table: Table) -> list[str]:
    """Return the lines that would say of each code changed since that the table holds for it."""
    head = head_of(text)
    if head is None:
        return ["no head"]
    known = dict(item.split() for item in head.codes.split(", "))
    known |= dict(_HOLDS.findall(text))
    return [
        f"- holds for {name} {code}: why"
        for name, code in codes_of(table).items()
        if known.get(name) != code
    ]


def codes_of(table: Table) -> dict[str, str]:
    """Return the fingerprint of each room that a table measures, and of its script."""
    rooms = {name: sorted((ROOT / "jaxstab" / name).rglob("*.py")) for name in table.rooms.split()}
    files = {**rooms, table.script: [ROOT / table.script]}
    return {name: _fingerprint(paths) for name, paths in files.items()}


def _fingerprint(paths: list[Path]) -> str:
    codes = [(path.name, _code(ast.parse(path.read_text()))) for path in paths]
    return hashlib.sha256(repr(codes).encode()).hexdigest()[:8]


def _code(node: Any) -> Any:
    """Return a syntax tree without docstrings, and without what only some Pythons note in it."""
    if isinstance(node, list):
        return [_code(entry) for entry in node]
    if not isinstance(node, ast.AST):
        return node
    fields = {name: value for name, value in ast.iter_fields(node) if value not in (None, [])}
    documented = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef
    if isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None:
        fields["body"] = node.body[1:]
    return type(node).__name__, [(name, _code(value)) for name, value in fields.items()]


def machine() -> str:
    """Return the processor and its cores, and how fast one copies memory and transforms a field."""
    source = np.ones(_NUM_BYTES // 8)
    target = np.empty_like(source)
    field = np.random.default_rng(0).normal(size=(_POINTS, _POINTS))
    # Each byte is read and written.
    speed = 2e-9 * _NUM_BYTES / _least_seconds(lambda: np.copyto(target, source))
    transform = 1e3 * _least_seconds(lambda: fft.irfft2(fft.rfft2(field)))
    return (
        f"{_processor()}, {os.cpu_count()} cores, of which one copies {speed:.1f} GB/s read and "
        f"written, and transforms {_POINTS}² points in {transform:.1f} ms"
    )


def _least_seconds(run: Any) -> float:
    seconds = []
    for _ in range(_REPEATS):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def _processor() -> str:
    cpus = Path("/proc/cpuinfo")
    named = re.search(r"model name\s*: (.+)", cpus.read_text()) if cpus.exists() else None
    return named[1] if named else platform.processor() or platform.machine()


def git(*words: str) -> str:
    """Return what a command of git says of this repository."""
    return subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()

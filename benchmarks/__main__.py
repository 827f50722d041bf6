"""Make the tables and figures of the documentation from this tree: `python -m benchmarks`.

Without names all are made that are not yet of this tree, one after another; a run that was stopped
goes on where it was when it is started again. Named ones are made in any case. Before it begins it
tells how long each will take on this machine, by the head of the last table. `--list` tells only
that.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from os import environ
from pathlib import Path

from benchmarks.heads import (
    RESULTS,
    ROOT,
    head_of,
    is_of_this_tree,
    machine,
    milliseconds,
    new_head,
)
from benchmarks.tables import TABLES, Table


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description=__doc__.splitlines()[0]
    )
    parser.add_argument("names", nargs="*", metavar="name", help="tables; by default all old ones")
    parser.add_argument("--list", action="store_true", help="tell what there is and how long")
    parser.add_argument("--folder", type=Path, help="files of instruments, for force_curves")
    options = parser.parse_args()
    if unknown := set(options.names) - set(TABLES):
        parser.error(f"no such table: {', '.join(sorted(unknown))}; there are {', '.join(TABLES)}")
    if "force_curves" in options.names and not options.folder:
        parser.error("force_curves needs --folder")
    speed = machine()
    print(speed, flush=True)
    chosen = options.names or [name for name, table in TABLES.items() if is_due(name, table)]
    for name in TABLES if options.list else chosen:
        print(f"{name:24s} {expected_seconds(name, speed):>9s}  {state_of(name)}", flush=True)
    if options.list:
        return
    failed = [name for name in chosen if not make(name, speed, options.folder)]
    if failed:
        sys.exit(f"not made: {', '.join(failed)}")


def is_due(name: str, table: Table) -> bool:
    return not table.needs and not is_of_this_tree(head_of(text_of(name)))


def text_of(name: str) -> str:
    path = RESULTS / f"{name}.md"
    return path.read_text() if path.exists() else ""


def expected_seconds(name: str, speed: str) -> str:
    """Return the seconds of the last table, times the ratio of the two machines' transforms."""
    head = head_of(text_of(name))
    if head is None:
        return "? s"
    return f"{float(head.seconds) * milliseconds(speed) / milliseconds(head.machine):.0f} s"


def state_of(name: str) -> str:
    """Return of which tree a table is, and what it needs."""
    head, needs = head_of(text_of(name)), TABLES[name].needs
    if head is None:
        state = "of an unknown tree" if text_of(name) else "never made"
    elif is_of_this_tree(head):
        state = "of this tree"
    else:
        state = f"of {head.commit}, {head.state}"
    return f"{state}; by name alone: needs {needs}" if needs else state


def make(name: str, speed: str, folder: Path | None) -> bool:
    """Run a script and write its table below a head; tell whether it ended well."""
    table = TABLES[name]
    if missing := [peer for peer in table.peers.split() if not is_installed(peer)]:
        print(f"{name}: install {', '.join(missing)}", flush=True)
        return False
    print(f"\n{name}", flush=True)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        body = Path(scratch, "table.md")
        words = table.command.format(folder=folder).split()
        # Scripts that only draw have no table of their own.
        is_drawn = table.script.startswith(("docs/", "paper/"))
        out = [] if is_drawn else ["--out", f"{body}"]
        ended = subprocess.run(
            [sys.executable, *words, *out], cwd=ROOT, env={**environ, "PYTHONPATH": f"{ROOT}"}
        )
        if ended.returncode:
            print(f"{name}: ended with {ended.returncode}", flush=True)
            return False
        text = "" if is_drawn else body.read_text()
    head = new_head(table, speed, time.perf_counter() - start)
    files = sorted(path for pattern in table.figures.split() for path in ROOT.glob(pattern))
    drawn = "".join(f"- draws {path.relative_to(ROOT).as_posix()}\n" for path in files)
    (RESULTS / f"{name}.md").write_text(f"{head}{drawn}\n{text}")
    return True


def is_installed(peer: str) -> bool:
    return find_spec(peer) is not None


if __name__ == "__main__":
    main()

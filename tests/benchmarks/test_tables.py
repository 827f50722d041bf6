"""Each table of the documentation says of which tree it is, and none is older than its rooms."""

import ast
import re
import textwrap
from pathlib import Path

import pytest

from benchmarks import __main__ as runner
from benchmarks import heads
from benchmarks.tables import TABLES, Table

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"
# Tables that have no head, or are of an older tree, until they are made again. Each line goes with
# its table; a line for a table that is up to date fails.
WAITING = {
    **dict.fromkeys(
        (
            "accelerator-nvidia-h200",
            "adverse_equilibria",
            "eigenvalues",
            "free_half_space",
            "mutants",
            "peers",
            "robustness",
        ),
        "made by its script alone, before tables had heads",
    ),
    **dict.fromkeys(("pictures", "paper_figures"), "not yet made by one command"),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_is_of_the_code_that_it_measures(name):
    path = RESULTS / f"{name}.md"
    text = path.read_text() if path.exists() else ""
    head = heads.head_of(text)
    changes = heads.changes_since(text, TABLES[name])
    if name in WAITING:
        assert changes or head.state != "clean", f"{name} is up to date: its line in WAITING can go"
        return
    assert not changes, f"run `python -m benchmarks {name}`, or say in the table why it holds"
    assert head.state == "clean"


def test_every_table_and_every_figure_is_known():
    assert {path.stem for path in RESULTS.glob("*.md")} <= set(TABLES)
    assert set(WAITING) <= set(TABLES)
    made = {
        path
        for table in TABLES.values()
        for one in table.figures.split()
        for path in ROOT.glob(one)
    }
    files = [*(ROOT / "docs" / "_static").rglob("*.*"), *(ROOT / "paper").glob("*.png")]
    assert {path for path in files if path.suffix != ".css"} == made
    pages = [*ROOT.glob("docs/**/*.md"), ROOT / "README.md"]
    included = {
        name
        for page in pages
        for name in re.findall(r"benchmarks/results/([\w-]+)\.md", page.read_text())
    }
    assert included <= set(TABLES)


def test_rooms_and_scripts_of_tables_are_there():
    for name, table in TABLES.items():
        assert (ROOT / table.script).is_file(), name
        assert all((ROOT / "jaxstab" / room).is_dir() for room in table.rooms.split()), name
    run = {table.script for table in TABLES.values()}
    for path in (ROOT / "benchmarks").glob("*.py"):
        code = path.read_text()
        writes = '"--out"' in code or "make_tables(" in code
        if writes and path.name not in ("__main__.py", "chosen_tables.py"):
            assert f"benchmarks/{path.name}" in run, f"{path.name} is in no table"


CODE = '''
"""A module."""

def area(radius):
    """Return an area."""
    return f"{3 * radius:.1f}"
'''


def fingerprint(tmp_path, code):
    path = tmp_path / "module.py"
    path.write_text(textwrap.dedent(code))
    return heads._fingerprint([path])


def test_a_comment_or_a_docstring_is_no_change_of_code(tmp_path):
    code = fingerprint(tmp_path, CODE)
    told = CODE.replace("Return an area", "Return the area of a disc")
    assert fingerprint(tmp_path, told.replace("    return", "    # Roughly.\n    return")) == code
    assert fingerprint(tmp_path, CODE.replace('    """Return an area."""\n', "")) == code
    assert fingerprint(tmp_path, CODE.replace("3 *", "4 *")) != code
    assert fingerprint(tmp_path, CODE.replace("area", "surface")) != code


def test_fingerprints_are_the_same_in_every_python(tmp_path):
    assert fingerprint(tmp_path, CODE) == "017a8484"


def test_a_table_is_old_once_a_room_has_changed(monkeypatch):
    table = TABLES["pull_offs"]
    head = heads.new_head(table, "a machine, which transforms 512² points in 4.0 ms", 12.3)
    text = f"{head}\n| a |\n|---|\n| 1 |\n"
    assert heads.head_of(text) == head and heads.changes_since(text, table) == []
    codes = {**heads.codes_of(table), "loading": "12345678"}
    monkeypatch.setattr(heads, "codes_of", lambda table: codes)
    (line,) = heads.changes_since(text, table)
    assert line.startswith("- holds for loading 12345678: ")
    # A reason is asked for.
    assert heads.changes_since(text + line.removesuffix("why"), table) == [line]
    assert heads.changes_since(f"{text}{line.removesuffix('why')}names alone\n", table) == []
    assert heads.changes_since("| a |\n|---|\n", table) == ["no head"]


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """A repository with a room, a script that makes a table of it, and one that fails."""
    room = tmp_path / "jaxstab" / "loading" / "path.py"
    script = tmp_path / "benchmarks" / "jumps.py"
    for path in (room, script, script.parent / "results" / "old.md"):
        path.parent.mkdir(parents=True, exist_ok=True)
    room.write_text("STEPS = 3\n")
    script.write_text("import sys\nopen(sys.argv[2], 'w').write('| a |\\n|---|\\n| 1 |\\n')\n")
    script.with_name("fails.py").write_text("raise SystemExit(3)\n")
    monkeypatch.setattr(heads, "ROOT", tmp_path)
    monkeypatch.setattr(runner, "ROOT", tmp_path)
    monkeypatch.setattr(runner, "RESULTS", tmp_path / "benchmarks" / "results")
    tables = {name: Table(f"benchmarks/{name}.py", "loading") for name in ("fails", "jumps")}
    monkeypatch.setattr(runner, "TABLES", tables)
    monkeypatch.setattr(runner, "machine", lambda: "a machine, and transforms in 4.0 ms")
    for name in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{name}_NAME", "A")
        monkeypatch.setenv(f"GIT_{name}_EMAIL", "a@example.org")
    heads.git("init", "-q")
    commit()
    return tmp_path


def commit():
    heads.git("add", ".")
    heads.git("commit", "-q", "-m", "A tree")


def test_a_run_goes_on_with_what_is_not_of_this_tree(clone, monkeypatch, capfd):
    monkeypatch.setattr("sys.argv", ["benchmarks"])
    with pytest.raises(SystemExit, match="not made: fails"):
        runner.main()
    table = clone / "benchmarks" / "results" / "jumps.md"
    text = table.read_text()
    assert heads.head_of(text).state == "clean" and text.endswith("\n\n| a |\n|---|\n| 1 |\n")
    assert re.search(r"jumps +\? s +never made", capfd.readouterr().out)
    # The results that a run has written, and pages that quote them, are no other tree.
    (clone / "README.md").write_text("One.\n")
    commit()
    table.write_text(f"{text}kept\n")
    with pytest.raises(SystemExit, match=r"not made: fails$"):
        runner.main()
    assert table.read_text() == f"{text}kept\n"
    # A name is made again in any case.
    monkeypatch.setattr("sys.argv", ["benchmarks", "jumps"])
    runner.main()
    assert heads.head_of(table.read_text()).state == "clean" and "kept" not in table.read_text()
    (clone / "jaxstab" / "loading" / "path.py").write_text("STEPS = 4\n")
    assert not heads.is_of_this_tree(heads.head_of(text))
    runner.main()
    assert heads.head_of(table.read_text()).state == "with other changes"
    # On a machine half as fast it takes twice as long.
    table.write_text(text.replace("in 0 s", "in 30 s"))
    assert runner.expected_seconds("jumps", "a machine, and transforms in 8.0 ms") == "60 s"


def test_heads_are_written_in_one_place():
    for table in TABLES.values():
        tree = ast.parse((ROOT / table.script).read_text())
        names = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        assert "__version__" not in names, table.script

"""The README's example and the pages of the documentation, run as a reader would."""

import linecache
import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
import SurfaceTopography

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
SLOW = (
    "barriers",
    "energies",
    "extending",
    "fits",
    "force_curve",
    "model",
    "scan",
    "studies",
    "units",
)
PAGES = [
    pytest.param(path, marks=[pytest.mark.nightly] * (path.stem in SLOW), id=path.stem)
    for path in sorted(DOCS.rglob("*.md"))
    if "```python" in path.read_text()
]
# A block of Python, and the block of text after it, if there is one, which is what it prints.
BLOCK = re.compile(r"^```python\n(.*?)^```\n(?:\n^```text\n(.*?)^```)?", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"-{3,}|[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")


def test_the_readmes_examples_run_and_reach_a_verdict(capsys, tmp_path, monkeypatch):
    first, scan = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    names = {}
    exec(first, names)
    assert re.search(r"(stable|held_by_contact): ", capsys.readouterr().out)
    monkeypatch.chdir(tmp_path)
    SurfaceTopography.Topography(names["heights"], (1.0, 1.0), unit="µm").to_x3p("scan.x3p")
    exec(scan, names)
    assert re.search(r"verdict +(stable|held_by_contact)\n", capsys.readouterr().out)
    plt.close("all")


@pytest.mark.parametrize("path", PAGES)
def test_a_pages_blocks_run_in_order_and_print_what_it_shows(path, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace = {}
    for number, (code, shown) in enumerate(BLOCK.findall(path.read_text())):
        # With a source to be found, as that of a notebook's cell is.
        name = f"<{path.stem} {number}>"
        linecache.cache[name] = (len(code), None, code.splitlines(keepends=True), name)
        exec(compile(code, name, "exec"), namespace)
        printed = capsys.readouterr().out
        # Digits differ between machines.
        assert not shown or words(printed) == words(shown)
    plt.close("all")


def words(text):
    return NUMBER.sub("#", text).split()


def test_the_reference_has_all_that_is_public_once():
    public_names = load(DOCS / "_extensions" / "public_names.py")
    pages = {path.stem: path.read_text() for path in (DOCS / "api").glob("*.md")}
    names = [
        name
        for page in pages.values()
        for entry in public_names.entries_of(page)
        for name in public_names.names_of(entry)
    ]
    assert len(set(names)) == len(names)
    missing = set(public_names.everything()) - set(names)
    assert not missing, "give these a line in a `public` directive of a page in docs/api"
    for name in names:
        assert public_names.resolve(name).__doc__
    assert set(pages["index"].split()) >= set(pages) - {"index"}


def load(path):
    """Return a module that is in no package."""
    spec = spec_from_file_location(path.stem, path)
    assert spec and spec.loader
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

"""The README's example and the pages of the documentation, run as a reader would."""

import inspect
import linecache
import re
import shutil
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
import SurfaceTopography
from printed import differences, words

import jaxstab as js

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
SLOW = (
    "barriers",
    "choosing",
    "derivatives",
    "devices",
    "energies",
    "extending",
    "fits",
    "force_curve",
    "humidity",
    "loop",
    "metals",
    "model",
    "modulus",
    "paper",
    "particles",
    "pillars",
    "points",
    "results",
    "scan",
    "seal",
    "solid",
    "speed",
    "sticky",
    "studies",
    "time",
    "units",
    "wafers",
)
PAGES = [
    pytest.param(path, marks=[pytest.mark.nightly] * (path.stem in SLOW), id=path.stem)
    for path in sorted(DOCS.rglob("*.md"))
    if "```python" in path.read_text()
]
# A block of Python, and the block of text after it, if there is one, which is what it prints. A
# comment between them, as "% within 0.01, counts within 0.5", states how far numbers may be off,
# relative to each: those with a point, and integers, such as numbers of steps.
BLOCK = re.compile(
    r"^```python\n(.*?)^```\n"
    r"(?:\n(?:% (?:within ([^\s,]+))?(?:, )?(?:counts within (\S+))?\n)?^```text\n(.*?)^```)?",
    re.DOTALL | re.MULTILINE,
)


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


@pytest.mark.nightly
@pytest.mark.parametrize("path", PAGES)
def test_a_pages_blocks_run_in_order_and_print_what_it_shows(path, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # The file that a page offers.
    shutil.copy(ROOT / "tests" / "lab" / "force_curves" / "spot3-0192.jpk-force", tmp_path)
    namespace = {}
    for number, (code, *tolerances, shown) in enumerate(BLOCK.findall(path.read_text())):
        # With a source to be found, as that of a notebook's cell is.
        name = f"<{path.stem} {number}>"
        linecache.cache[name] = (len(code), None, code.splitlines(keepends=True), name)
        exec(compile(code, name, "exec"), namespace)
        printed = capsys.readouterr().out
        if shown:
            assert words(printed) == words(shown)
            assert not differences(printed, shown, *(float(x or 0) for x in tolerances)), printed
    plt.close("all")


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


def test_signatures_as_help_prints_them_are_short():
    public_names = load(DOCS / "_extensions" / "public_names.py")
    public = public_names.everything()
    functions = {name: item for name, item in public.items() if inspect.isroutine(item)}
    assert {"jaxstab.calibrate", "jaxstab.sweep"} <= set(functions)
    lengths = {name: len(str(inspect.signature(item))) for name, item in functions.items()}
    # `calibrate` has 15 arguments, the others fewer.
    too_long = {name: n for name, n in lengths.items() if n > 450}
    assert list(too_long) == ["jaxstab.calibrate"] and too_long["jaxstab.calibrate"] < 600


def test_each_result_has_a_cause_a_cure_and_a_page():
    page = (DOCS / "endings.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \|(.+)\|(.+)\|(.+)\|$", page, re.MULTILINE)
    assert sorted(name for name, *_ in rows) == sorted(js.RESULTS.names)
    for name, cause, cure, more in rows:
        assert cause.strip() and cure.strip(), name
        (target,) = re.findall(r"\]\(([\w.]+)[#)]", more)
        assert (DOCS / target).is_file(), name


def load(path):
    """Return a module that is in no package."""
    spec = spec_from_file_location(path.stem, path)
    assert spec and spec.loader
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

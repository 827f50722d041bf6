"""The table of tuning constants: which there are, how they are scaled, and how results compare."""

import re
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

FILE = Path(__file__).parents[2] / "benchmarks" / "sensitivity.py"


@pytest.fixture(scope="module")
def sensitivity():
    spec = spec_from_file_location("sensitivity", FILE)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_constants_are_the_positive_numbers_that_a_module_names(sensitivity):
    found = {(each.module, each.name) for each in sensitivity.constants_of("transitions")}
    assert ("jaxstab.transitions.saddle", "_APART") in found
    # Labels, zero or below, are no sizes.
    assert ("jaxstab.transitions.branch_pass", "_DETACHED") not in found
    assert ("jaxstab.transitions.branch_pass", "_UNKNOWN") not in found


def test_every_room_is_listed_or_apart(sensitivity):
    rooms = {path.name for path in sensitivity.PACKAGE.iterdir() if path.is_dir()}
    assert {*sensitivity.ROOMS, *sensitivity.APART} == rooms - {"__pycache__"}
    assert not {*sensitivity.ROOMS} & {*sensitivity.APART}


# A name in capitals at the margin, and its value on one line or in brackets.
DEFINITION = re.compile(
    r"^(_?[A-Z][A-Z0-9_]+)(?::[^=\n]*)? = (.*[\[({]\n(?: .*\n)*[\])}].*|.*)$", re.MULTILINE
)
NO_NUMBER = re.compile(r"""#.*|"[^"]*"|\[\d\]""")
POSITIVE = re.compile(r"(?<![\w.-])(?:[1-9]|0?\.\d)")


def test_the_list_names_every_constant_of_the_sources_and_no_other(sensitivity):
    listed, defined = set(), set()
    for room in sensitivity.ROOMS:
        listed |= {(each.module, each.name) for each in sensitivity.constants_of(room)}
        for file in (sensitivity.PACKAGE / room).rglob("*.py"):
            parts = file.relative_to(sensitivity.PACKAGE.parent).with_suffix("").parts
            for name, value in DEFINITION.findall(file.read_text()):
                if POSITIVE.search(NO_NUMBER.sub("", value)) and name not in sensitivity.GIVEN:
                    defined.add((".".join(parts), name))
    assert len(listed) > 200
    assert listed == defined


@pytest.mark.parametrize(
    ("value", "half"),
    [
        (3.0, 1.5),
        (5, 2),
        (1, 1),
        ({"float64": 1e-3, "float32": 1e-2}, {"float64": 5e-4, "float32": 5e-3}),
        ((0.1, 4), (0.05, 2)),
        ("field", "field"),
    ],
)
def test_numbers_and_tables_are_halved_and_nothing_else(sensitivity, value, half):
    assert sensitivity.scaled(0.5, value) == half


def test_constants_are_scaled_where_they_are_defined_and_where_they_are_imported():
    code = (
        f"import sys; sys.path.insert(0, {str(FILE.parent)!r})\n"
        "from sensitivity import Scaling\n"
        "sys.meta_path.insert(0, Scaling('jaxstab.evolution.legs', ['RTOL', '_GROWTH'], 2.0))\n"
        "import jaxstab.evolution\n"
        "lifetime = sys.modules['jaxstab.evolution.lifetime']\n"
        "legs = sys.modules['jaxstab.evolution.legs']\n"
        "print(legs.RTOL['float64'], lifetime.RTOL['float64'], legs._GROWTH, legs._CAUTION)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    from jaxstab.evolution import legs

    doubled = 2 * legs.RTOL["float64"]
    others = str(2 * legs._GROWTH), str(legs._CAUTION)
    assert done.stdout.split() == [str(doubled), str(doubled), *others]


def test_a_change_is_relative_to_its_array_and_another_number_of_results_is_another(sensitivity):
    def outcomes(*arrays):
        return {"outcomes": {"paths": [[[*map(list, arrays)], 3, False]]}}

    base = outcomes([1.0, 200.0], [1e-6, np.nan])
    change = sensitivity.change_of
    assert change(base, outcomes([1.0, 200.0], [1e-6, np.nan]), "paths") == 0
    assert change(base, outcomes([1.0, 202.0], [1e-6, np.nan]), "paths") == pytest.approx(0.01)
    assert change(base, outcomes([1.0, 200.0], [2e-6, np.nan]), "paths") == pytest.approx(1)
    assert change(base, outcomes([1.0, 200.0], [1e-6, 1.0]), "paths") == np.inf
    assert change(base, outcomes([1.0], [1e-6, np.nan]), "paths") == np.inf


def listed_in(table, constants):
    """Return the constants of the rows of a table, and the names and values that are none.

    A row with several constants names each of their modules once.
    """
    listed, unknown = set(), []
    for line in table.splitlines():
        cells = line.strip("| ").split(" | ")
        if "`" not in line or len(cells) < 3:
            continue
        modules = [f"jaxstab.{module}" for module in cells[0].split(", ")]
        names, values = (cell.strip("`").split("`, `") for cell in cells[1:3])
        for name, value in zip(names, values, strict=True):
            found = {(module, name, value) for module in modules} & constants
            listed |= found
            if not found:
                unknown.append((cells[0], name, value))
    return listed, unknown


def test_the_published_table_has_every_constant_with_its_value_and_no_other(sensitivity):
    constants = {
        tuple(each) for room in sensitivity.ROOMS for each in sensitivity.constants_of(room)
    }
    table = (FILE.parent / "results" / "sensitivity.md").read_text()
    rows = table[table.index("| module | constant | value |") :]
    listed, unknown = listed_in(rows, constants)
    assert not unknown
    assert listed == constants

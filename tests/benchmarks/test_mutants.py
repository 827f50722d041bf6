"""The changes that the benchmark of mutants makes, on a module of a few lines."""

import sys
from importlib import import_module
from pathlib import Path

import pytest

MODULE = '''"""A module, of 1 line."""

_FACTOR = 2.0


def pull(gap: float | None, rate: float = 0.5) -> float:
    """Return 2 of them."""
    if gap < 0:
        raise ValueError(f"The gap is {gap + 1}: give at least 0.")
    return -rate * gap if rate > 0 and gap else 3.0


def shown(gap: float) -> str:
    return f"{2 * gap}" * 2
'''
CHANGES = [
    ("gap < 0", "gap <= 0"),
    ("gap < 0", "gap > 0"),
    ("gap < 0", "gap < 1"),
    ("-rate * gap", "-rate / gap"),
    ("-rate", "+rate"),
    ("rate > 0 and gap", "rate > 0 or gap"),
    ("rate > 0", "rate >= 0"),
    ("rate > 0", "rate < 0"),
    ("rate > 0", "rate > 1"),
]


@pytest.fixture
def mutants(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    module = import_module("mutants")
    monkeypatch.setattr(module, "ROOT", tmp_path)
    yield module
    sys.modules.pop("mutants")


def test_operators_comparisons_numbers_and_signs_change_one_at_a_time(mutants, tmp_path):
    folder = tmp_path / "jaxstab" / "loads"
    folder.mkdir(parents=True)
    (folder / "pull.py").write_text(MODULE)
    changes = mutants.changes_of("loads")
    found = [(change.before, change.after) for change in changes]
    assert set(CHANGES) <= set(found)
    # The number that is returned, and the default of the rate, are shown with what is around them.
    others = [after for before, after in found if (before, after) not in CHANGES]
    assert len(others) == 2 and "rate: float=1.0" in others[0] and others[1].endswith("else 6.0")
    texts = [change.mutated() for change in changes]
    assert len(set(texts)) == len(texts)
    # All but the changed line is the module.
    whole = mutants.ast.unparse(mutants.ast.parse(MODULE)).splitlines()
    for change, text in zip(changes, texts, strict=True):
        lines = text.splitlines()
        assert sum(one != other for one, other in zip(lines, whole, strict=True)) == 1
        assert any(change.after in line or "6.0" in line for line in lines)

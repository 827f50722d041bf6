"""The examples of docstrings, run one by one after the lines of the page that explains them."""

import doctest
import inspect
import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from printed import differences, words

DOCS = Path(__file__).parents[2] / "docs"
# Searches compile for seconds, and are tested daily in their own rooms.
SEARCHES = re.compile(
    r"js\.(calibrate|continuation|critical_load|detachment|easiest_exit|evolve|first_jump|follow"
    r"|lab\.(fit_viscoelastic|modulus_over_depth|report)|lifetime|pull_off|transition)\b"
)


def everything():
    """Return all that is public, but for modules, by its dotted name without the package's."""
    path = DOCS / "_extensions" / "public_names.py"
    spec = spec_from_file_location("public_names_of_examples", path)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return {name.removeprefix("jaxstab."): item for name, item in module.everything().items()}


PUBLIC = everything()
EXAMPLES = [
    pytest.param(name, marks=[pytest.mark.nightly] * bool(SEARCHES.search(item.__doc__)))
    for name, item in PUBLIC.items()
    if ">>>" in (item.__doc__ or "")
]


@pytest.fixture(scope="module")
def names():
    """What the page of functions and classes has examples begin with."""
    (lines,) = re.findall(
        r"```python\n(.*?)```", (DOCS / "api" / "index.md").read_text(), re.DOTALL
    )
    found = {}
    exec(lines, found)
    return found


class Checker(doctest.OutputChecker):
    """Compares words, and numbers within a margin."""

    def check_output(self, want, got, optionflags):
        return words(got) == words(want) and not differences(got, want)


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_prints_what_it_shows(name, names, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    example = doctest.DocTestParser().get_doctest(
        inspect.getdoc(PUBLIC[name]), dict(names), name, None, None
    )
    lines = []
    doctest.DocTestRunner(Checker(), verbose=False).run(example, out=lines.append)
    plt.close("all")
    assert not lines, "".join(lines)


def test_every_public_name_has_an_example():
    assert {case.values[0] for case in EXAMPLES} == {*PUBLIC}

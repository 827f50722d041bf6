"""The version stands in pyproject.toml; its copies agree."""

import json
import re
import sys
import tomllib
from datetime import date
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
VERSION = PROJECT["version"]
NAME = re.compile(r"[\w-]+")
TEXTS = ("benchmarks", "docs", "paper")
# The names of packages that conda-forge calls otherwise.
CONDA_NAMES = {"matplotlib": "matplotlib-base", "typing-extensions": "typing_extensions"}


def test_the_citation_is_of_the_software_and_its_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == VERSION and citation["type"] == "software"
    # A preferred citation would be cited instead of the software.
    assert "preferred-citation" not in citation
    assert isinstance(citation["date-released"], date)
    titles = [source["title"] for source in citation["references"]]
    assert "Stability analysis of rough surfaces in adhesive normal contact" in titles


def test_the_changelog_begins_with_the_version():
    changelog = (ROOT / "CHANGELOG.md").read_text()
    assert re.search(r"^## (\S+)", changelog, re.MULTILINE).group(1) == VERSION


def test_the_conda_recipe_has_the_version_and_the_dependencies():
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text())
    assert recipe["context"]["version"] == VERSION
    needed = {f"python {PROJECT['requires-python']}"}
    for line in PROJECT["dependencies"]:
        name, bounds = re.fullmatch(r"([\w-]+)(.*)", line).groups()
        needed.add(f"{CONDA_NAMES.get(name, name)} {bounds}")
    least = recipe["context"]["python_min"]
    run = [line.replace("${{ python_min }}", least) for line in recipe["requirements"]["run"]]
    assert set(run) == needed


def test_the_conda_recipe_has_what_conda_forge_asks_for():
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text())
    assert "python ${{ python_min }}.*" in recipe["requirements"]["host"]
    tests = recipe["tests"][0]["python"]
    assert tests["pip_check"] and "${{ python_min }}.*" in tests["python_version"]
    assert recipe["about"]["homepage"].startswith("https://")
    assert (ROOT / recipe["about"]["license_file"]).is_file()


def test_binder_installs_what_the_notebooks_import():
    extras = re.search(r"\[(.+)\]", (ROOT / "binder" / "requirements.txt").read_text()).group(1)
    lines = [*PROJECT["dependencies"]]
    for extra in extras.split(","):
        lines += PROJECT["optional-dependencies"][extra]
    installed = {NAME.match(line)[0].lower() for line in lines}
    # These are installed with JAX.
    installed |= {NAME.match(line)[0].lower() for line in requires("jax") or []}
    owners = packages_distributions()
    scripts = {path.stem for path in (ROOT / "benchmarks").glob("*.py")}
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        code = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")
        for module in set(re.findall(r"^ *(?:import|from) (\w+)", code, re.MULTILINE)):
            names = {name.lower() for name in owners.get(module, [])}
            is_ours = module in (*sys.stdlib_module_names, *scripts, "jaxstab")
            assert is_ours or names & installed, f"{path.name} imports {module}"


def test_settings_that_the_texts_name_are_read():
    named = [ROOT.glob("*.md"), *((ROOT / folder).rglob("*.[mp][dy]") for folder in TEXTS)]
    read = [(ROOT / "jaxstab").rglob("*.py"), (ROOT / "notebooks").glob("*.ipynb")]
    known = {name for files in read for path in files for name in settings(path)}
    assert known
    for path in (path for files in named for path in files):
        assert settings(path) <= known or path.name == "CHANGELOG.md", path


def settings(path):
    return set(re.findall(r"JAXSTAB_[A-Z]\w*", path.read_text()))


def test_actions_are_pinned_to_commits():
    for path in (ROOT / ".github" / "workflows").glob("*.yml"):
        for line in re.findall(r"uses: (.+)", path.read_text()):
            is_pinned = re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v[\d.]+", line)
            # Of this one a recent version is needed, and no commit of one was at hand.
            assert is_pinned or line == "pypa/gh-action-pypi-publish@release/v1"


def test_the_paper_has_the_length_and_the_sections_that_the_journal_asks_for():
    text = (ROOT / "paper" / "paper.md").read_text().split("---", 2)[2]
    assert 750 <= len(text.split()) <= 1750
    sections = re.findall(r"^# (.+)", text, re.MULTILINE)
    assert sections[:4] == [
        "Summary",
        "Statement of need",
        "State of the field",
        "Software design",
    ]
    assert {"Research impact statement", "AI usage disclosure", "References"} <= set(sections)

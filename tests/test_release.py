"""The version stands in pyproject.toml; its copies agree."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
VERSION = PROJECT["version"]
# The names of packages that conda-forge calls otherwise.
CONDA_NAMES = {"matplotlib": "matplotlib-base", "typing-extensions": "typing_extensions"}


def test_the_citation_names_the_version():
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.search(r"^version: (.+)$", citation, re.MULTILINE).group(1) == VERSION


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
    assert set(recipe["requirements"]["run"]) == needed


def test_actions_are_pinned_to_commits():
    for path in (ROOT / ".github" / "workflows").glob("*.yml"):
        for line in re.findall(r"uses: (.+)", path.read_text()):
            is_pinned = re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v[\d.]+", line)
            # Of this one a recent version is needed, and no commit of one was at hand.
            assert is_pinned or line == "pypa/gh-action-pypi-publish@release/v1"

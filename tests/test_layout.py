"""The house: its rooms, and the page that draws its floors."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "jaxstab"


def drawn():
    """Return the sets of packages that the page draws, a floor each, from the top."""
    page = (ROOT / "CONTRIBUTING.md").read_text()
    floors = {}
    for floor, packages in re.findall(r"^\| (\d+) \| (`.+?`) \|", page, re.MULTILINE):
        floors.setdefault(int(floor), set()).update(re.findall(r"`(\w+)`", packages))
    assert list(floors) == sorted(floors, reverse=True)
    return list(floors.values())


def contracted():
    """Return the sets of packages that the contract on imports puts on floors, from the top."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contract = settings["tool"]["importlinter"]["contracts"][0]
    floors = [set(re.findall(r"jaxstab\.(\w+)", layer)) for layer in contract["layers"]]
    return [floor for floor in floors if floor != {"__main__"}]


def test_the_page_draws_the_floors_of_the_contract():
    assert drawn() == contracted()


def test_the_root_holds_rooms_alone_and_each_has_a_floor():
    entries = [path for path in PACKAGE.iterdir() if path.name != "__pycache__"]
    assert {path.name for path in entries if path.is_file()} == {
        "__init__.py",
        "__init__.pyi",
        "__main__.py",
        "py.typed",
    }
    rooms = {path.name for path in entries if path.is_dir()}
    assert rooms == set().union(*contracted())

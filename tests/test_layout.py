"""The house: its rooms, and the page that draws its floors."""

import ast
import importlib
import re
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

import jaxstab as js

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


def used(text):
    """Yield the modules and names of jaxstab that a module takes, and whether each is public."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for name in node.names:
                if name.name.split(".")[0] == "jaxstab":
                    yield name.name, (name.name, name.asname) == ("jaxstab", "js")
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            if node.level or module.split(".")[0] != "jaxstab":
                continue
            if module.split(".")[:2] == ["jaxstab", "lab"]:
                continue
            room = importlib.import_module(module)
            public = room.__all__ if hasattr(room, "__path__") and hasattr(room, "__all__") else []
            for name in node.names:
                yield f"{module}.{name.name}", name.name in public
        elif isinstance(node, ast.Attribute):
            chain = ast.unparse(node)
            # What an object of the laboratory keeps to itself, and names as `__name__`.
            is_own = re.match(r"(self|cls)\.", chain) or node.attr.startswith("__")
            is_private = node.attr.startswith("_") and not is_own
            yield chain, not is_private and is_public(chain)


def is_public(chain):
    """Whether a chain of attributes that begins at js leaves modules by their public names."""
    if not re.fullmatch(r"js(\.\w+)+", chain):
        return True
    item = js
    for name in chain.split(".")[1:]:
        if not isinstance(item, ModuleType):
            break
        if name not in item.__all__:
            return False
        item = getattr(item, name)
    return True


@pytest.mark.parametrize("path", sorted((PACKAGE / "lab").rglob("*.py")), ids=lambda x: x.stem)
def test_the_laboratory_is_written_with_public_names_alone(path):
    private = [name for name, is_allowed in used(path.read_text()) if not is_allowed]
    assert not private


@pytest.mark.parametrize(
    "text",
    [
        "import jaxstab.core.units",
        "import jaxstab",
        "from jaxstab.core.units import Units",
        "from jaxstab.surfaces import faults",
        "from jaxstab.cli import report",
        "import jaxstab as js\njs.surfaces.faults.rms",
        "import jaxstab as js\njs.core",
        "contact._padded",
    ],
)
def test_a_private_name_in_the_laboratory_is_found(text):
    assert not all(is_allowed for _, is_allowed in used(text))

"""The house: the page that draws it, and its floors."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "jaxstab"


def drawn():
    """Return the files that the page draws, by their folders."""
    page = (ROOT / "CONTRIBUTING.md").read_text()
    tree = re.search(r"^jaxstab/\n(.*?)^```", page, re.DOTALL | re.MULTILINE).group(1)
    folders, rooms = [], {}
    for line in tree.splitlines():
        indent, name, files = re.fullmatch(r"( +)([\w/]+)/ +(.*)", line).groups()
        folders[len(indent) // 2 - 1 :] = [name]
        rooms["/".join(folders)] = files.split()
    return rooms


def test_the_page_draws_every_file():
    rooms = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.parent != PACKAGE and path.stem != "__init__":
            rooms.setdefault(path.parent.relative_to(PACKAGE).as_posix(), []).append(path.stem)
    assert drawn() == rooms


def test_the_root_holds_rooms_alone():
    entries = [path for path in PACKAGE.iterdir() if path.name != "__pycache__"]
    assert {path.name for path in entries if path.is_file()} == {
        "__init__.py",
        "__init__.pyi",
        "__main__.py",
        "py.typed",
    }
    rooms = {path.name for path in entries if path.is_dir()}
    assert rooms == {room for room in drawn() if "/" not in room}

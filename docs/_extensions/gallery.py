"""The notebooks as pages and as cards: copied as they are stored, never executed."""

import base64
import json
import re
import shutil
from pathlib import Path
from typing import Any

CARD = """:::{{grid-item-card}} {title}
:link: _notebooks/{stem}
:link-type: doc
:img-top: _notebooks/{stem}.png

{text}
:::
"""


def collect(notebooks: Path, target: Path) -> None:
    """Copy notebooks, with their pictures and a page of cards, into a folder made anew."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir()
    cards, contents = [], [":::{toctree}", ":hidden:", ""]
    for path in sorted(notebooks.glob("*.ipynb"), key=_place):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        shutil.copy(path, target)
        pictures = _pictures(cells)
        # The card shows the one with the largest file, other pages show them by their numbers.
        (target / f"{path.stem}.png").write_bytes(max(pictures, key=len))
        for number, picture in enumerate(pictures, start=1):
            (target / f"{path.stem}_{number}.png").write_bytes(picture)
        title, text = _introduction(cells)
        cards.append(CARD.format(title=title, text=text, stem=path.stem))
        contents.append(f"_notebooks/{path.stem}")
    (target / "cards.md").write_text(
        "\n".join([":::::{grid} 1 1 2 2", ":gutter: 3", "", *cards, ":::::", "", *contents, ":::"]),
        encoding="utf-8",
    )


def _place(path: Path) -> tuple[bool, str]:
    """Return a key that sorts the first contact before the others."""
    return path.stem != "first_contact", path.stem


def _introduction(cells: list[dict[str, Any]]) -> tuple[str, str]:
    """Return the title of a notebook and its first paragraph."""
    heading, text, *_ = re.split(r"\n\s*\n", "".join(cells[0]["source"]))
    return heading.lstrip("# "), text.replace("\n", " ")


def _pictures(cells: list[dict[str, Any]]) -> list[bytes]:
    """Return the pictures of a notebook in their order."""
    outputs = [output for cell in cells for output in cell.get("outputs", [])]
    pictures = [x["data"]["image/png"] for x in outputs if "image/png" in x.get("data", {})]
    return [base64.b64decode("".join(picture)) for picture in pictures]

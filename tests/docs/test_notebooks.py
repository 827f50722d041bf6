"""The notebooks, run as a reader would."""

import os
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))


@pytest.mark.nightly
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_from_a_clean_kernel_at_a_small_size(path, monkeypatch):
    monkeypatch.setitem(os.environ, "JAXSTAB_NOTEBOOK_SIZE", "32")
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=600, kernel_name="python3").execute()
    codes = [cell for cell in notebook.cells if cell.cell_type == "code"]
    pictures = sum("image/png" in output.get("data", {}) for c in codes for output in c.outputs)
    assert pictures >= 4


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_with_its_outputs_in_order(path):
    cells = nbformat.read(path, as_version=4).cells
    codes = [cell for cell in cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in codes] == list(range(1, len(codes) + 1))
    assert not any(output.output_type == "error" for cell in codes for output in cell.outputs)


@pytest.mark.parametrize(
    "name", ["ageing", "memory", "viscous_or_multistable", "thermal_pull_off", "stickiness"]
)
def test_a_study_quotes_the_stored_outputs_of_its_notebook(name):
    root = Path(__file__).parents[2]
    page = (root / "docs" / f"{name}.md").read_text(encoding="utf-8")
    cells = nbformat.read(root / "notebooks" / f"{name}.ipynb", as_version=4).cells
    outputs = [output for cell in cells for output in cell.get("outputs", [])]
    printed = "".join(output.get("text", "") for output in outputs).splitlines()
    quoted = "\n".join(re.findall(r"^```text\n(.*?)^```", page, re.DOTALL | re.MULTILINE))
    # The table of what is known is written by hand.
    measured = re.sub(
        r"^## Known, found, new$.*?(?=^## )", "", page, flags=re.DOTALL | re.MULTILINE
    )
    tables = re.findall(r"^\|.*\|$", measured, re.MULTILINE)
    lines = [line for line in quoted.splitlines() + tables if line]
    assert len(lines) > 40
    assert [line for line in lines if line not in printed] == []
    shown = {int(number) for number in re.findall(rf"_notebooks/{name}_(\d+)\.png", page)}
    pictures = sum("image/png" in output.get("data", {}) for output in outputs)
    assert shown == set(range(1, pictures + 1))

"""The README's example and the notebooks, run as a reader would."""

import os
import re
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import pytest
import SurfaceTopography
from nbclient import NotebookClient

ROOT = Path(__file__).parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def test_the_readmes_examples_run_and_reach_a_verdict(capsys, tmp_path, monkeypatch):
    first, scan = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    names = {}
    exec(first, names)
    assert re.search(r"(stable|held_by_contact): ", capsys.readouterr().out)
    monkeypatch.chdir(tmp_path)
    SurfaceTopography.Topography(names["heights"], (1.0, 1.0), unit="µm").to_x3p("scan.x3p")
    exec(scan, names)
    assert re.search(r"verdict +(stable|held_by_contact)\n", capsys.readouterr().out)
    plt.close("all")


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

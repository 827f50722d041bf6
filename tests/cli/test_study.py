"""The command `jaxstab study`."""

from pathlib import Path

import numpy as np
import pytest
import xarray
from distributed import LocalCluster
from logged_study import SCRIPT, runs

from jaxstab.__main__ import main


def test_the_command_line_begins_goes_on_and_sums_up(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("script.py").write_text(SCRIPT)
    for _ in range(2):
        main(["study", "script.py", "--path", "study"])
        said = capsys.readouterr()
        assert "30 cases: 25 successful, 5 failed" in said.out
        first = "The first that failed, seed=3, energy=0.0: ValueError: no contact at 0.0"
        assert first in said.out
        assert str(tmp_path / "study") in said.out and "30/30" not in said.err
    assert sum(runs(tmp_path).values()) == 30
    text = "import jax.numpy as jnp\naxes = {'x': [1.0, 2.0]}\n"
    Path("batch.py").write_text(text + "def case(x):\n    return {'root': jnp.sqrt(x)}\n")
    main(["study", "batch.py", "--path", "batch", "--batch", "2", "--version", "3"])
    assert len(list(Path("batch").glob("*.nc"))) == 2
    assert '"version": "3"' in Path("batch/study.json").read_text()
    with pytest.raises(SystemExit):
        main(["study", "batch.py", "--path", "batch"])
    *_, before, now, advice = capsys.readouterr().err.splitlines()
    assert (before, now) == ('- "version": "3",', '+ "version": null,')
    assert "--accept-changes records the change" in advice


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("axes = {'seed': [1]}", 2, "study.py defines no `case`"),
        ("def case(seed): return {'a': 1}", 2, "study.py defines no `axes`"),
        ("axes = 1 / 0", 2, "study.py, line 1: ZeroDivisionError: division by zero"),
        ("axes = (", 2, "study.py: SyntaxError"),
        ("import sys\nsys.exit()", 2, "study.py, line 2: SystemExit"),
        ("axes = {'y': [1]}\ndef case(x): return {'a': 1}", 2, "The axes give the case y"),
        ("axes = {'x': [1, 2]}\ndef case(x): return {'a': 1 / 0}", 1, "every case failed"),
        (
            "import signal\naxes = {'x': [1, 2]}\n"
            "def case(x): signal.raise_signal(signal.SIGINT); return {'a': 1}",
            130,
            "interrupted, 1 of 2 cases are done",
        ),
        (None, 2, "there is no file study.py"),
    ],
)
@pytest.mark.usefixtures("interruptible")
def test_the_command_line_says_in_a_line_what_is_wrong(
    text, code, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        Path("study.py").write_text(text)
    with pytest.raises(SystemExit) as ended:
        main(["study", "study.py", "--path", "study"])
    assert ended.value.code == code
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("jaxstab") and message in last


def test_the_command_line_runs_on_a_scheduler(tmp_path, monkeypatch, capsys):
    text = f"where = {str(tmp_path / 'log')!r}\n" + SCRIPT.replace('open("log"', "open(where")
    (tmp_path / "script.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    command = ["study", "script.py", "--path", "study", "--scheduler"]
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster:
        main([*command, cluster.scheduler_address])
    assert "30 cases: 25 successful, 5 failed" in capsys.readouterr().out
    assert len(runs(tmp_path)) == 30
    with pytest.raises(SystemExit):
        main([*command, "nowhere"])
    assert "No Dask scheduler answers at nowhere" in capsys.readouterr().err


STACKS = """
import jax, jaxstab as js
from jaxstab.solids import Crystal, Film, Layered

grid = js.Grid(8)
heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=2, rms_height=0.02)
axes = {"thickness": [0.02, 0.1], "modulus": [0.5]}


def case(thickness, modulus):
    solid = Layered(grid, [Film((modulus, 0.3), thickness)], Crystal((3.0, 1.2, 1.5)))
    return {"work": js.surfaces.effective_work_of_adhesion(solid, heights, 0.1)}
"""


@pytest.mark.nightly
def test_a_study_of_stacks_is_the_same_alone_and_in_batches(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("stacks.py").write_text(STACKS)
    for batch in ("1", "2"):
        main(["study", "stacks.py", "--path", batch, "--batch", batch])
        assert "2 cases: 2 successful" in capsys.readouterr().out
    alone, together = (
        [float(xarray.open_dataset(file).work.item()) for file in sorted(Path(path).glob("*.nc"))]
        for path in ("1", "2")
    )
    np.testing.assert_allclose(alone, together, rtol=1e-12)
    assert alone[0] != alone[1]

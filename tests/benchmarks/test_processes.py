"""A contact over several processes: its numbers, and how they end when one of them fails."""

import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import jaxstab as js

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no collectives on its CPUs")


@pytest.fixture(scope="module")
def processes():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "benchmarks")
        patch.setenv("PYTHONPATH", str(ROOT))
        yield import_module("processes")


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("points", "turns", "kinds"),
    [
        (32, (0.133, 0.132), ["fold"]),
        (256, (0.14, 0.09, 0.12), ["fold", "fold", "release"]),
    ],
)
def test_two_processes_find_what_one_finds(processes, points, turns, kinds):
    several = processes.found_by(2, 1, points, turns)
    (one,) = processes.found_by(1, 2, points, turns)
    alone = processes.found_for(processes.contact_on(js.Grid(points)))
    for each in several:
        assert each["path_kinds"].tolist() == kinds
        assert each["verdict"] == "held_by_contact"
        # Only the exchange differs.
        assert processes.difference(each, one) <= 1e-12
        assert processes.difference(each, alone) <= 1e-12


@pytest.mark.parametrize(
    ("end", "how"),
    [("os.kill(os.getpid(), 9)", "SIGKILL"), ("raise ValueError('no gap')", "exit status 1")],
)
def test_a_process_that_fails_ends_the_others(processes, end, how):
    waiting = [sys.executable, "-c", "import time; time.sleep(600)"]
    failing = [sys.executable, "-c", f"import os; print('at step 3', flush=True); {end}"]
    begin = time.monotonic()
    with pytest.raises(RuntimeError, match=rf"these failed: 1 by {how}\.[^$]*at step 3"):
        processes.run_together([waiting, failing])
    assert time.monotonic() - begin < 60


@pytest.mark.nightly
@pytest.mark.parametrize("number", [0, 1])
def test_a_process_notices_that_the_other_is_gone(processes, tmp_path, number):
    files = [tmp_path / "first.npz", tmp_path / "second.npz"]
    started = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        for command in processes.commands(files, 1, 128, processes.TURNS)
    ]
    try:
        # The first line of each says that it is connected.
        for process in started:
            assert "connected" in process.stdout.readline()
        started[number].kill()
        text, _ = started[1 - number].communicate(timeout=120)
    finally:
        for process in started:
            process.kill()
            process.wait()
    assert started[1 - number].returncode != 0
    assert "another task died" in text


def test_numbers_that_differ_are_seen(processes):
    found = {"gap": np.ones(3), "verdict": np.array("stable")}
    assert processes.difference(found, found) == 0
    assert processes.difference(found | {"gap": np.array([1, 1, 1 + 1e-9])}, found) > 9e-10
    assert processes.difference(found | {"gap": np.ones(2)}, found) == np.inf
    assert np.isnan(processes.difference(found | {"gap": np.full(3, np.nan)}, found))
    assert processes.difference(found | {"verdict": np.array("unstable")}, found) == np.inf

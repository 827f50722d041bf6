"""Studies: nothing done is lost or run again, whatever happens to the process."""

import errno
import os
import signal
import subprocess
import sys
import time
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest
import xarray
import zarr
from logged_study import runs, script_in, wait_until

import jaxstab as js
from jaxstab.__main__ import main

# Starts a process for each folder that it reads, without the time that imports take.
STARTER = """\
import os, signal, sys
import jaxstab, xarray, zarr

signal.signal(signal.SIGCHLD, signal.SIG_IGN)
for folder in sys.stdin:
    if process := os.fork():
        print(process, flush=True)
        continue
    os.chdir(folder.strip())
    sys.path.insert(0, folder.strip())
    from script import axes, case
    if os.path.exists("dies_at"):
        left = [int(open("dies_at").read())]

        def replace(*paths, replace=os.replace):
            left[0] -= 1
            os._exit(9) if left[0] < 0 else replace(*paths)

        os.replace = replace
    dataset = jaxstab.study(case, axes, "study.zarr")
    with open("returned", "w") as file:
        file.write(str(int((dataset.result != "missing").sum())))
    os._exit(0)
"""


class Started:
    """A process that runs the study of a folder."""

    def __init__(self, starter, folder):
        starter.stdin.write(f"{folder}\n")
        starter.stdin.flush()
        self.folder = folder
        self.process = int(starter.stdout.readline())

    def kill(self):
        os.kill(self.process, signal.SIGKILL)
        wait_until(lambda: not self.is_alive())

    def is_alive(self):
        try:
            os.kill(self.process, 0)
        except ProcessLookupError:
            return False
        return True

    def num_returned(self):
        """Wait for the end and return how many done cases the study returned."""
        wait_until(lambda: not self.is_alive())
        return int((self.folder / "returned").read_text())


@pytest.fixture(scope="module")
def start_in():
    command = [sys.executable, "-c", STARTER]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as starter:
        yield lambda folder: Started(starter, folder)


@pytest.fixture
def script(tmp_path):
    return script_in(tmp_path)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """The data set of a study that ran in one go, in this process."""
    folder = script_in(tmp_path_factory.mktemp("uninterrupted"))
    with chdir(folder):
        main(["study", "script.py", "--path", "study.zarr"])
    return without_times(folder)


def without_times(folder):
    dataset = xarray.open_zarr(folder / "study.zarr").load()
    assert np.isfinite(dataset["seconds"]).all()
    return dataset.drop_vars("seconds").drop_attrs()


def test_killed_again_and_again_a_study_ends_as_if_it_had_run_in_one_go(
    script, start_in, uninterrupted
):
    generator, kills = np.random.default_rng(0), 5
    for _ in range(kills):
        before = sum(runs(script).values())
        process = start_in(script)
        wait_until(lambda before=before: sum(runs(script).values()) > before)
        time.sleep(0.03 * generator.random())
        process.kill()
    assert len(runs(script)) < 30 and not (script / "returned").exists()
    assert start_in(script).num_returned() == 30
    # Only what was in hand when it was killed ran again.
    count = sum(runs(script).values())
    assert len(runs(script)) == 30 and count <= 30 + kills
    xarray.testing.assert_identical(without_times(script), uninterrupted)
    assert start_in(script).num_returned() == 30
    assert sum(runs(script).values()) == count


@pytest.mark.parametrize("write", [1, 6, 13, 17, 22, 28])
def test_a_process_may_die_at_any_write(write, script, start_in, uninterrupted):
    # Of the metadata, of coordinates, of the first cases and of what they return.
    (script / "dies_at").write_text(str(write))
    process = start_in(script)
    wait_until(lambda: not process.is_alive())
    (script / "dies_at").unlink()
    assert not (script / "returned").exists()
    assert start_in(script).num_returned() == 30
    assert len(runs(script)) == 30 and sum(runs(script).values()) <= 31
    xarray.testing.assert_identical(without_times(script), uninterrupted)


@pytest.mark.parametrize("left", ["driver", "claims"])
def test_a_half_written_store_and_half_written_cases_are_as_if_they_were_not(
    left, script, start_in, uninterrupted
):
    # As a process leaves it, one of jaxstab 0.1.0 too, that dies before the store is whole.
    store = script / "study.zarr"
    (store / "result").mkdir(parents=True)
    (store / "result" / left).touch()
    zarr.create_group(store, attributes={"title": "half"})
    zarr.create_array(store, name="seed", shape=(3,), dtype=int)
    assert start_in(script).num_returned() == 30
    xarray.testing.assert_identical(without_times(script), uninterrupted)
    # As one leaves it that dies while it writes a case: outputs, no mark.
    (store / "result" / "c.1.1").unlink()
    (store / "field" / "c.1.1.0.0").write_bytes(b"half")
    (store / "result" / "c.1.1.part").write_bytes(b"half")
    # And one that dies as it adds values to an axis.
    zarr.open_array(store / "energy", mode="r+").resize((9,))
    zarr.open_array(store / "area", mode="r+").resize((6, 9))
    assert start_in(script).num_returned() == 30
    assert sum(runs(script).values()) == 31
    xarray.testing.assert_identical(without_times(script), uninterrupted)


def test_an_extension_that_was_not_finished_is_taken_back(tmp_path):
    def case(seed, energy):
        if seed == 1:
            raise ValueError("no outputs are known yet")
        return {"sum": seed + energy}

    path = tmp_path / "study.zarr"
    js.study(case, {"seed": [1], "energy": [0.5]}, path)
    zarr.open_array(path / "energy", mode="r+").resize((3,))
    zarr.open_array(path / "result", mode="r+").resize((1, 3))
    js.study(case, {"seed": [1, 2], "energy": [0.5]}, path)
    stored = xarray.open_zarr(path)
    assert dict(stored.sizes) == {"seed": 2, "energy": 1}
    np.testing.assert_array_equal(stored["sum"], [[np.nan], [2.5]])


def test_a_full_disk_says_what_is_stored_and_the_same_call_goes_on(tmp_path, monkeypatch):
    def case(seed):
        with open(log, "a") as file:
            file.write(f"{seed}\n")
        return {"field": np.full(3, seed)}

    log, path = str(tmp_path / "log"), tmp_path / "study.zarr"
    write = Path.write_bytes

    def write_if_there_is_room(self, data):
        if len(list(path.glob("field/c.*"))) == 3:
            write(self, data[:1])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self))
        return write(self, data)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", write_if_there_is_room)
        message = (
            r"No space left on device: 2 of 5 cases are in .*study.zarr.*"
            "run the same call to continue"
        )
        with pytest.raises(OSError, match=message):
            js.study(case, {"seed": range(5)}, path)
    dataset = js.study(case, {"seed": range(5)}, path)
    np.testing.assert_array_equal(dataset["field"], np.full((3, 5), range(5)).T)
    # The case in hand when the disk was full is the only one that ran twice.
    assert sorted(runs(tmp_path).values()) == [1, 1, 1, 1, 2]


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_ends_after_the_case_in_hand_with_a_warning(tmp_path):
    def case(seed):
        if seed == 2:
            signal.raise_signal(signal.SIGINT)
        return {"a": seed}

    path = tmp_path / "study.zarr"
    with pytest.warns(js.StudyInterrupted, match=r"3 of 5 cases are in .*study.zarr"):
        dataset = js.study(case, {"seed": range(5)}, path)
    assert list(dataset["result"]) == [*["successful"] * 3, *["missing"] * 2]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    dataset = js.study(case, {"seed": range(5)}, path)
    np.testing.assert_array_equal(dataset["a"], range(5))


def test_a_store_reads_without_jaxstab(script, start_in):
    assert start_in(script).num_returned() == 30
    code = (
        "import sys, xarray; data = xarray.open_zarr('study.zarr')\n"
        "print(int((data.verdict == 'stable').sum()), float(data.area.sel(seed=0, energy=0.5)),"
        "'jaxstab' in sys.modules)"
    )
    command = [sys.executable, "-W", "error", "-c", code]
    said = subprocess.run(command, cwd=script, capture_output=True, text=True)
    expected = np.random.default_rng([0, 2]).random((8, 8)).mean()
    assert said.stdout.split() == ["25", str(expected), "False"], said.stderr

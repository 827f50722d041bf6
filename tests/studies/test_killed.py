"""Studies that are killed, interrupted, or run by two calls at once."""

import errno
import os
import signal
import time

import numpy as np
import psutil
import pytest
from logged_study import assert_same, runs, started, wait_until

import jaxstab as js


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    process = started(folder, "script.py", "0")
    assert process.wait() == 0, process.stderr.read()
    return folder / "study"


def finished(folder):
    """Return the content of the files of finished cases, by their names."""
    return {file.name: file.read_bytes() for file in (folder / "study").glob("*.nc")}


@pytest.mark.parametrize(
    ("processes", "target"),
    [
        ("0", "driver"),
        *(pytest.param("2", x, marks=pytest.mark.nightly) for x in ("worker", "group", "driver")),
    ],
)
def test_killed_again_and_again_a_study_ends_as_if_it_had_run_in_one_go(
    processes, target, undisturbed, tmp_path
):
    generator = np.random.default_rng(0)
    for _ in range(2):
        before, done = sum(runs(tmp_path).values()), finished(tmp_path)
        process = started(tmp_path, "script.py", processes)
        wait_until(lambda before=before: sum(runs(tmp_path).values()) > before + 2)
        time.sleep(0.03 * generator.random())
        workers = psutil.Process(process.pid).children()
        if target == "worker":
            workers[-1].kill()
            time.sleep(0.05)
        if target == "group":
            os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        process.communicate()
        # Its workers end by themselves.
        assert not psutil.wait_procs(workers, timeout=60)[1]
        assert done.items() <= finished(tmp_path).items()
    assert len(finished(tmp_path)) < 30
    done = finished(tmp_path)
    process = started(tmp_path, "script.py", processes)
    assert process.wait() == 0, process.stderr.read()
    # Failed cases alone are completed by the outputs of others.
    changed = {
        name for name, content in finished(tmp_path).items() if done.get(name, content) != content
    }
    assert len(changed) <= 5
    # Only those in hand ran again.
    assert len(runs(tmp_path)) == 30 and sum(runs(tmp_path).values()) <= 30 + 6
    assert_same(tmp_path / "study", undisturbed)


@pytest.mark.nightly
def test_two_calls_of_one_study_at_once_do_no_harm(undisturbed, tmp_path):
    processes = [started(tmp_path, "script.py", "0") for _ in range(2)]
    for process in processes:
        assert process.wait() == 0, process.stderr.read()
    assert_same(tmp_path / "study", undisturbed)
    assert len(runs(tmp_path)) == 30


def test_files_that_a_killed_process_leaves_are_removed_once_they_are_old(tmp_path):
    def case(seed):
        return {"a": seed}

    path = tmp_path / "study"
    js.study(case, {"seed": [1]}, path)
    for name, age in ((".a.part", 7200), (".b.begun", 7200), (".c.part", 0), (".mine", 7200)):
        (path / name).touch()
        os.utime(path / name, (time.time() - age,) * 2)
    js.study(case, {"seed": [1]}, path)
    assert {x.name for x in path.glob(".*")} == {".c.part", ".mine"}


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS])
def test_a_full_disk_or_a_read_only_one_leaves_nothing_torn(code, tmp_path, monkeypatch):
    def case(seed):
        with open(log, "a") as file:
            file.write(f"{seed}\n")
        return {"field": np.full(3, seed)}

    log, path, flush = str(tmp_path / "log"), tmp_path / "study", os.fsync

    def flush_if_there_is_room(number):
        if len(list(path.glob("*.nc"))) == 2:
            raise OSError(code, os.strerror(code))
        flush(number)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", flush_if_there_is_room)
        message = rf"{os.strerror(code)}: 2 of 5 cases are in .*study. Mend this, then call"
        with pytest.raises(OSError, match=message):
            js.study(case, {"seed": range(5)}, path)
    assert {file.suffix for file in path.iterdir()} == {".nc", ".json"}
    study = js.study(case, {"seed": range(5)}, path)
    np.testing.assert_array_equal(study["field"], np.full((3, 5), range(5)).T)
    # The case in hand when the disk was full is the only one that ran twice.
    assert sorted(runs(tmp_path).values()) == [1, 1, 1, 1, 2]


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_ends_after_the_case_in_hand_with_a_warning(tmp_path):
    def case(seed):
        if seed == 2:
            signal.raise_signal(signal.SIGINT)
        return {"a": seed}

    path = tmp_path / "study"
    with pytest.warns(
        js.exceptions.StudyInterrupted, match=r"3 of 5 cases are in .*study. The same call"
    ):
        study = js.study(case, {"seed": range(5)}, path)
    assert list(study["result"]) == [*["successful"] * 3, *["missing"] * 2]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    study = js.study(case, {"seed": range(5)}, path)
    np.testing.assert_array_equal(study["a"], range(5))


@pytest.mark.nightly
@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_ends_a_study_in_many_processes_after_the_cases_in_hand(tmp_path):
    command = ["-m", "jaxstab", "study", "script.py", "--path", "study", "--workers", "2"]
    process = started(tmp_path, *command)
    wait_until(lambda: sum(runs(tmp_path).values()) >= 5)
    # As a terminal does, to all of them.
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130, said
    done = len(finished(tmp_path))
    assert f"interrupted, {done} of 30 cases are done." in said.decode()
    assert 5 <= done == sum(runs(tmp_path).values()) < 30
    # In this process alone it goes on.
    assert started(tmp_path, *command[:-2]).wait() == 0
    assert set(runs(tmp_path).values()) == {1} and len(runs(tmp_path)) == 30

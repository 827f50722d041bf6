"""Studies on executors: the store is that of one process, whatever becomes of the workers."""

import errno
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from collections import Counter
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from functools import partial

import jax
import numpy as np
import pytest
import xarray
from logged_study import contents, runs, wait_until

import jaxstab as js
from jaxstab.__main__ import main
from jaxstab.studies.lock import held

AXES = {"seed": range(6), "energy": np.arange(5) / 4}
SPAWNED = multiprocessing.get_context("spawn")


def case_in(folder, dies=lambda count: None, dying=2):
    """Return a case that leaves a line in a log, and one that comes to an end at times."""
    log = str(folder / "log")

    def case(seed, energy):
        with open(log, "a") as file:
            file.write(f"{seed} {energy}\n")
        if seed == 3:
            raise ValueError(f"no contact at {energy}")
        with open(log) as file:
            count = file.read().splitlines().count(f"{seed} {energy}")
        if seed == dying and energy == 0.5:
            dies(count)
        field = np.random.default_rng([seed, int(4 * energy)]).random((8, 8))
        return {"area": field.mean(), "field": field, "verdict": "stable", "number": seed}

    return case


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The contents of a store that one process has filled."""
    folder = tmp_path_factory.mktemp("alone")
    js.study(case_in(folder), AXES, folder / "study.zarr")
    return contents(folder / "study.zarr")


@pytest.fixture(scope="module")
def pool():
    with ProcessPoolExecutor(2, SPAWNED) as pool:
        yield pool


@pytest.fixture(scope="module")
def client():
    from distributed import Client, LocalCluster

    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0"}
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        yield client


@pytest.mark.parametrize("kind", ["number", "pool", "client"])
def test_many_processes_fill_the_store_of_one_bit_for_bit(kind, alone, request, tmp_path):
    path = tmp_path / "study.zarr"
    executor = 2 if kind == "number" else request.getfixturevalue(kind)
    for _ in range(2):
        dataset = js.study(case_in(tmp_path), AXES, path, executor=executor)
        assert contents(path) == alone
    assert len(runs(tmp_path)) == 30 and set(runs(tmp_path).values()) == {1}
    assert (dataset.seconds > 0).all() and int((dataset.result == "failed").sum()) == 5
    # Nothing of the work is left.
    left = {file.name for file in (path / "result").iterdir()}
    assert {name for name in left if not name.startswith("c.")} == {
        "driver",
        "driver.lock",
        "outputs.json",
        "zarr.json",
    }
    # Values are added by another engine, and by none.
    more = {"seed": range(7), "energy": [0.5]}
    assert (js.study(case_in(tmp_path), more, path).number.sel(seed=6) == 6).all()


@pytest.mark.parametrize("kind", [pytest.param("pool", marks=pytest.mark.nightly), "client"])
def test_batches_run_in_other_processes(kind, request, tmp_path):
    def case(x):
        return {"square": x**2}

    executor, axes = request.getfixturevalue(kind), {"x": np.arange(10.0)}
    squares = js.study(case, axes, tmp_path / "batches.zarr", batch=4, executor=executor)
    np.testing.assert_array_equal(squares.square, np.arange(10.0) ** 2)
    path = tmp_path / "untraced.zarr"
    with pytest.raises(ValueError, match="cannot be run in batches"):
        js.study(lambda x: {"x": float(x)}, axes, path, batch=2, executor=executor)


def killed(count, times=1):
    """Let the process of a case be killed."""
    if count <= times:
        os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("kind", [pytest.param("number", marks=pytest.mark.nightly), "client"])
def test_what_a_killed_worker_had_in_hand_is_dealt_again(kind, alone, request, tmp_path):
    executor = 2 if kind == "number" else request.getfixturevalue(kind)
    js.study(case_in(tmp_path, killed), AXES, tmp_path / "study.zarr", executor=executor)
    assert contents(tmp_path / "study.zarr") == alone
    count = runs(tmp_path)
    # At most what the other process had in hand ran twice too.
    assert len(count) == 30 and count["2 0.5"] == 2 and sum(count.values()) <= 32


@pytest.mark.parametrize("kind", [pytest.param("number", marks=pytest.mark.nightly), "client"])
def test_a_case_that_ends_its_process_three_times_has_failed(kind, request, tmp_path):
    executor = 2 if kind == "number" else request.getfixturevalue(kind)
    case, path = case_in(tmp_path, lambda count: os._exit(1)), tmp_path / "study.zarr"
    dataset = js.study(case, AXES, path, executor=executor).load()
    failed = dataset.sel(seed=2, energy=0.5)
    assert failed.result == "failed"
    assert failed.error == "The process of this case died 3 times."
    assert runs(tmp_path)["2 0.5"] == 3 and int((dataset.result == "successful").sum()) == 24


def test_a_case_that_exits_has_failed_and_the_others_go_on(pool, tmp_path):
    for path, executor in (("pool.zarr", pool), ("here.zarr", None)):
        case = case_in(tmp_path, lambda count: sys.exit("bye"))
        dataset = js.study(case, AXES, tmp_path / path, executor=executor)
        assert dataset.error.sel(seed=2, energy=0.5) == "SystemExit: bye"
        assert int((dataset.result == "successful").sum()) == 24


@pytest.mark.nightly
def test_an_executor_that_is_broken_says_how_to_go_on(alone, tmp_path):
    case, path = case_in(tmp_path, killed), tmp_path / "study.zarr"
    message = r"A process of the executor died.* of 30 cases are in .*study.zarr. Run the same call"
    with ProcessPoolExecutor(2, SPAWNED) as pool, pytest.raises(RuntimeError, match=message):
        js.study(case, AXES, path, executor=pool)
    before, done = runs(tmp_path), xarray.open_zarr(path).load()
    js.study(case, AXES, path)
    assert contents(path) == alone
    for seed, energy in np.argwhere((done.result != "missing").values):
        name = f"{seed} {AXES['energy'][energy]}"
        assert runs(tmp_path)[name] == before[name]


class Losing(Executor):
    """Loses all that it is given."""

    def submit(self, function, /, *values, **more):
        future = Future()
        future.set_exception(ConnectionError("no worker"))
        return future


def test_an_executor_that_runs_nothing_is_an_error(tmp_path):
    message = r"lost its tasks 6 times.*ConnectionError: no worker.*0 of 30 cases are in"
    with pytest.raises(RuntimeError, match=message):
        js.study(case_in(tmp_path), AXES, tmp_path / "study.zarr", executor=Losing())
    assert not runs(tmp_path)


def test_a_full_disk_of_a_worker_says_what_is_stored_and_the_same_call_goes_on(
    pool, alone, tmp_path
):
    def full(count):
        if count == 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    case, path = case_in(tmp_path, full), tmp_path / "study.zarr"
    message = (
        r"No space left on device: \d+ of 30 cases are in .*study.zarr.*"
        "run the same call to continue"
    )
    with pytest.raises(OSError, match=message):
        js.study(case, AXES, path, executor=pool)
    js.study(case, AXES, path, executor=pool)
    assert contents(path) == alone
    assert Counter(runs(tmp_path).values()) == {1: 29, 2: 1}


def test_what_no_store_can_hold_is_refused_by_the_first_case(pool, tmp_path):
    with pytest.raises(TypeError, match="The case returned int"):
        js.study(lambda seed: seed, {"seed": range(9)}, tmp_path / "study.zarr", executor=pool)


def test_what_cannot_be_sent_to_another_process_is_refused(tmp_path):
    acquire = partial(min, threading.Lock().acquire)

    def case(seed):
        return {"a": acquire(seed)}

    with pytest.raises(TypeError, match=r"cannot be pickled for other processes.*lock"):
        js.study(case, {"seed": [1]}, tmp_path / "study.zarr", executor=1)


def test_a_second_driver_is_told_who_has_the_store(tmp_path):
    path, said = tmp_path / "study.zarr", []

    def case(seed):
        return {"twice": 2 * seed}

    js.study(case, {"seed": [1]}, path)
    with held(path), pytest.raises(ValueError, match=f"is being run by process {os.getpid()} on"):
        js.study(case, {"seed": [1, 2]}, path)

    def again(seed):
        with pytest.raises(ValueError, match="is being run by process") as refused:
            js.study(again, {"seed": range(2)}, tmp_path / "again.zarr")
        said.append(str(refused.value))
        return {"seed_again": seed}

    thread = threading.Thread(
        target=js.study, args=(again, {"seed": range(2)}, tmp_path / "again.zarr")
    )
    thread.start()
    thread.join()
    assert len(said) == 2
    assert js.study(case, {"seed": [1, 2]}, path).twice.values.tolist() == [2, 4]


SCRIPT = """\
import time
import numpy as np
import jaxstab as js

def case(seed, energy):
    with open("log", "a") as log:
        log.write(f"{seed} {energy}\\n")
    time.sleep(0.02)
    return {"field": np.random.default_rng([seed, int(4 * energy)]).random((8, 8))}

axes = {"seed": range(6), "energy": np.arange(5) / 4}

if __name__ == "__main__":
    js.study(case, axes, "study.zarr", executor=2)
"""


def started(folder, *command):
    # In a group of its own, as a shell starts it.
    return subprocess.Popen(
        [sys.executable, *command], cwd=folder, start_new_session=True, stderr=subprocess.PIPE
    )


def wait_for_runs(folder, number):
    wait_until(lambda: sum(runs(folder).values()) >= number)


def children(process):
    """Return the processes that another has started."""
    listed = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True).stdout
    pairs = [tuple(map(int, line.split())) for line in listed.splitlines()]
    return [child for child, parent in pairs if parent == process]


def is_alive(process):
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(process)], capture_output=True)
    return state.stdout.strip() not in (b"", b"Z", b"Zs")


@pytest.mark.nightly
def test_killed_with_and_without_its_workers_a_study_ends_as_if_it_had_run_in_one_go(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    path, finished = tmp_path / "study.zarr", {}
    for kills_all in (False, True):
        process = started(tmp_path, "script.py")
        wait_for_runs(tmp_path, sum(runs(tmp_path).values()) + 5)
        workers = children(process.pid)
        if kills_all:
            os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        process.communicate()
        # Its workers end by themselves.
        wait_until(lambda workers=workers: not any(map(is_alive, workers)))
        finished |= {file.name: runs(tmp_path) for file in path.glob("result/c.*")}
    assert 0 < len(finished) < 30
    before = runs(tmp_path)
    process = started(tmp_path, "script.py")
    assert process.wait() == 0, process.stderr.read()
    process.stderr.close()
    energies = np.arange(5) / 4
    for name in finished:
        seed, energy = map(int, name.split(".")[1:])
        assert runs(tmp_path)[f"{seed} {energies[energy]}"] == before[f"{seed} {energies[energy]}"]
    stored = xarray.open_zarr(path)
    assert (stored.result == "successful").all()
    for seed, energy in [(0, 0), (5, 4)]:
        expected = np.random.default_rng([seed, energy]).random((8, 8))
        np.testing.assert_array_equal(stored.field[seed, energy], expected)


@pytest.mark.nightly
@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_ends_a_study_in_many_processes_after_the_cases_in_hand(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    command = ["-m", "jaxstab", "study", "script.py", "--path", "study.zarr", "--workers", "2"]
    process = started(tmp_path, *command)
    wait_for_runs(tmp_path, 5)
    # As a terminal does, to all of them.
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130, said
    results = xarray.open_zarr(tmp_path / "study.zarr").result
    done = int((results == "successful").sum())
    assert f"interrupted, {done} of 30 cases are done." in said.decode()
    assert 5 <= done == sum(runs(tmp_path).values()) < 30
    # In this process alone it goes on.
    process = started(tmp_path, *command[:-2])
    assert process.wait() == 0
    process.stderr.close()
    assert set(runs(tmp_path).values()) == {1} and len(runs(tmp_path)) == 30


def test_the_command_line_runs_on_a_scheduler(client, tmp_path, monkeypatch, capsys):
    text = f"where = {str(tmp_path / 'log')!r}\n" + SCRIPT.replace('open("log"', "open(where")
    (tmp_path / "script.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    command = ["study", "script.py", "--path", "study.zarr", "--scheduler"]
    main([*command, client.scheduler.address])
    assert "30 cases: 30 successful" in capsys.readouterr().out
    assert len(runs(tmp_path)) == 30
    with pytest.raises(SystemExit):
        main([*command, "nowhere"])
    assert "No Dask scheduler answers at nowhere" in capsys.readouterr().err


def test_processes_share_compiled_programs_under_the_same_limit(tmp_path):
    def case(seed):
        import jax

        return {"size": jax.config.values["jax_compilation_cache_max_size"]}

    before = jax.config.values["jax_compilation_cache_max_size"]
    jax.config.update("jax_compilation_cache_max_size", 123_456_789)
    try:
        dataset = js.study(case, {"seed": [0]}, tmp_path / "study.zarr", executor=1)
    finally:
        jax.config.update("jax_compilation_cache_max_size", before)
    assert dataset["size"] == 123_456_789


@pytest.mark.parametrize(
    ("executor", "kind"), [(0, ValueError), (1.5, TypeError), ("dask", TypeError)]
)
def test_what_is_no_executor_is_refused_before_anything_is_written(executor, kind, tmp_path):
    with pytest.raises(kind, match=r"executor is (0|1\.5|of type str)"):
        js.study(case_in(tmp_path), AXES, tmp_path / "study.zarr", executor=executor)
    assert not list(tmp_path.iterdir())

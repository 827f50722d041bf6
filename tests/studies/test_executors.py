"""Studies on executors: the folder is that of one process, whatever becomes of the workers."""

import multiprocessing
import os
import signal
import sys
import threading
from collections import Counter
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from logged_study import assert_same, case_in, runs

import jaxstab as js

AXES = {"seed": range(6), "energy": np.arange(5) / 4}
SPAWNED = multiprocessing.get_context("spawn")


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The folder that one process has filled."""
    folder = tmp_path_factory.mktemp("alone")
    js.study(case_in(folder), AXES, folder / "study")
    return folder / "study"


@pytest.fixture(scope="module")
def pool():
    with ProcessPoolExecutor(1, SPAWNED) as pool:
        yield pool


@pytest.fixture(scope="module")
def client():
    from distributed import Client, LocalCluster

    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0"}
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        yield client


@pytest.mark.parametrize(
    "kind",
    [
        "number",
        "threads",
        *(pytest.param(x, marks=pytest.mark.nightly) for x in ("pool", "client")),
    ],
)
def test_many_processes_fill_the_folder_of_one_bit_for_bit(kind, alone, request, tmp_path):
    path = tmp_path / "study"
    executors = {"number": 2, "threads": ThreadPoolExecutor(2)}
    executor = executors.get(kind) or request.getfixturevalue(kind)
    for _ in range(2):
        study = js.study(case_in(tmp_path), AXES, path, executor=executor)
        assert_same(path, alone)
    assert len(runs(tmp_path)) == 30 and set(runs(tmp_path).values()) == {1}
    assert (study["seconds"] > 0).all() and int((study["result"] == "failed").sum()) == 5
    # Nothing of the work is left.
    assert {file.suffix for file in path.iterdir()} == {".nc", ".json"}
    # Values are added by another engine, and by none.
    more = {"seed": range(7), "energy": [0.5]}
    assert (js.study(case_in(tmp_path), more, path)["number"].sel(seed=6) == 6).all()


def test_batches_run_in_other_processes(pool, tmp_path):
    axes = {"x": np.arange(10.0)}
    study = js.study(lambda x: {"y": x**2}, axes, tmp_path / "y", batch=4, executor=pool)
    np.testing.assert_array_equal(study["y"], np.arange(10.0) ** 2)
    assert len(set(study["seconds"].values)) == 3
    with pytest.warns(UserWarning, match="one by one"):
        js.study(lambda x: {"a": float(x)}, axes, tmp_path / "a", batch=2, executor=pool)


def killed(count, times=1):
    """Let the process of a case be killed."""
    if count <= times:
        os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["number", "client"])
def test_the_case_of_a_killed_worker_runs_again(kind, alone, request, tmp_path):
    executor = 2 if kind == "number" else request.getfixturevalue(kind)
    js.study(case_in(tmp_path, killed), AXES, tmp_path / "study", executor=executor)
    assert_same(tmp_path / "study", alone)
    count = runs(tmp_path)
    assert len(count) == 30 and count["2 0.5"] == 2 and sum(count.values()) == 31


@pytest.mark.parametrize("kind", ["number", pytest.param("client", marks=pytest.mark.nightly)])
def test_a_case_that_ends_its_process_three_times_has_failed(kind, request, tmp_path):
    executor = 2 if kind == "number" else request.getfixturevalue(kind)
    case, path = case_in(tmp_path, lambda count: os._exit(1)), tmp_path / "study"
    study = js.study(case, AXES, path, executor=executor)
    failed = study.sel(seed=2, energy=0.5)
    assert failed["result"] == "failed"
    assert failed["error"] == "The process of this case died 3 times."
    # No other case has paid for it.
    assert Counter(runs(tmp_path).values()) == {1: 29, 3: 1}
    assert int((study["result"] == "successful").sum()) == 24


@pytest.mark.nightly
def test_a_batch_that_ends_its_process_is_run_one_by_one(tmp_path):
    def case(x):
        import jax

        def die(x):
            if x == 2:
                os._exit(1)
            return x

        shape = jax.ShapeDtypeStruct((), float)
        return {"y": jax.pure_callback(die, shape, x, vmap_method="sequential")}

    study = js.study(case, {"x": np.arange(5.0)}, tmp_path / "study", executor=1, batch=5)
    assert study["result"].values.tolist() == ["successful"] * 2 + ["failed"] + ["successful"] * 2


def test_a_case_that_exits_has_failed_and_the_others_go_on(pool, tmp_path):
    for path, executor in (("pool", pool), ("here", None)):
        case = case_in(tmp_path, lambda count: sys.exit("bye"))
        study = js.study(case, AXES, tmp_path / path, executor=executor)
        assert study["error"].sel(seed=2, energy=0.5) == "SystemExit: bye"
        assert int((study["result"] == "successful").sum()) == 24


class Losing(Executor):
    """Loses all that it is given."""

    def submit(self, function, /, *values, **more):
        future = Future()
        future.set_exception(ConnectionError("no worker"))
        return future


def test_an_executor_that_runs_nothing_is_an_error(tmp_path):
    message = r"lost a task 3 times.*ConnectionError: no worker.*0 of 30 cases are in"
    with pytest.raises(RuntimeError, match=message):
        js.study(case_in(tmp_path), AXES, tmp_path / "study", executor=Losing())
    assert not runs(tmp_path)


def test_outputs_and_functions_that_cannot_travel_are_refused(pool, tmp_path):
    acquire = partial(min, threading.Lock().acquire)
    with pytest.raises(TypeError, match="The case returned int"):
        js.study(lambda seed: seed, {"seed": range(9)}, tmp_path / "int", executor=pool)
    with pytest.raises(TypeError, match=r"cannot pickle.*lock"):
        js.study(lambda seed: {"a": acquire(seed)}, {"seed": [1]}, tmp_path / "lock", executor=1)


@pytest.mark.parametrize("context", [multiprocessing.get_context("fork"), multiprocessing])
def test_an_executor_that_forks_is_refused(context, tmp_path, monkeypatch):
    # As by default before Python 3.14.
    monkeypatch.setattr(multiprocessing, "get_start_method", lambda **_: "fork")
    forking = ProcessPoolExecutor(1, context)
    with forking, pytest.raises(ValueError, match=r"forks.*mp_context=.*spawn"):
        js.study(lambda x: {"y": x}, {"x": [1.0]}, tmp_path, executor=forking)


def test_a_case_whose_own_disk_is_full_has_failed_alone(tmp_path):
    def case(x):
        if x == 1:
            raise OSError(28, "No space left on device")
        return {"y": 2 * x}

    # A mark that another process has left, of a case that has ended since.
    found = js.study(case, {"x": [0.0, 1.0, 2.0]}, tmp_path, version=1)
    done = next(file for file in tmp_path.glob("*.nc"))
    done.with_suffix(".abcdef.begun").write_bytes(b".")
    again = js.study(case, {"x": [0.0, 1.0, 2.0]}, tmp_path, version=1)
    for study in (found, again):
        assert study["result"].values.tolist() == ["successful", "failed", "successful"]
        assert "No space left" in study["error"].values[1]
        np.testing.assert_array_equal(study["y"], [0, np.nan, 4])
    assert {file.suffix for file in tmp_path.iterdir()} == {".nc", ".json"}

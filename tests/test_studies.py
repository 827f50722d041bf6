"""Studies: nothing done is lost or run again, whatever happens to the processes."""

import errno
import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from collections import Counter
from contextlib import chdir
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
import zarr

import jaxstab as js
from jaxstab.__main__ import main
from jaxstab.studies.queue import start

# Every case leaves a line, and has an output of several chunks.
SCRIPT = """\
import sys, time
import numpy as np

def case(seed, energy):
    with open("log", "a") as log:
        log.write(f"{seed} {energy}\\n")
    time.sleep(0.003)
    if seed == 3:
        raise ValueError(f"no contact at {energy}")
    field = np.random.default_rng([seed, int(4 * energy)]).random((8, 8))
    return {"area": field.mean(), "field": field, "verdict": "stable", "number": seed}

axes = {"seed": range(6), "energy": np.arange(5) / 4}
"""
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


def runs(folder):
    """Return how often each case ran."""
    log = folder / "log"
    return Counter(log.read_text().splitlines()) if log.exists() else Counter()


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


def wait_until(holds, seconds=60):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.002)


@pytest.fixture
def script(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    return tmp_path


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """The data set of a study that ran in one go, in this process."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    (folder / "script.py").write_text(SCRIPT)
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


def test_processes_share_a_store_and_take_over_from_one_that_dies(script, start_in, uninterrupted):
    # Begun at the same moment, which makes one store.
    one, *others = [start_in(script) for _ in range(3)]
    wait_until(lambda: sum(runs(script).values()) > 8)
    one.kill()
    # What each returns is complete, also of what others ran.
    assert [other.num_returned() for other in others] == [30, 30]
    assert len(runs(script)) == 30 and sum(runs(script).values()) <= 31
    xarray.testing.assert_identical(without_times(script), uninterrupted)


def test_a_half_written_store_and_half_written_cases_are_as_if_they_were_not(
    script, start_in, uninterrupted
):
    # As a process leaves it that dies before the store is whole.
    store = script / "study.zarr"
    (store / "result").mkdir(parents=True)
    (store / "result" / "claims").touch()
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


def test_cases_are_those_of_a_plain_loop_with_verdicts_as_words(tmp_path):
    grid = js.Grid(16)

    def case(seed, energy):
        heights = js.surfaces.self_affine(grid, jax.random.key(seed), k_high=4, rms_height=0.1)
        law = js.potentials.Exponential(energy, 0.2)
        contact = js.Contact(js.HalfSpace(grid, 0.05), heights, law)
        state = js.equilibrate(contact, js.MeanGap(0.15), throw=False)
        stability = js.assess_stability(contact, state, throw=False)
        return {
            "ended": state.result,
            "verdict": stability.verdict,
            "gap": state.gap,
            "touches": state.in_contact,
            "steps": state.num_steps,
        }

    energies = [0.005, 0.02]
    js.study(case, {"seed": range(2), "energy": energies}, tmp_path / "study.zarr")
    stored = xarray.open_zarr(tmp_path / "study.zarr")
    assert (stored["result"] == "successful").all() and (stored["seconds"] > 0).all()
    for seed in range(2):
        for energy in energies:
            one, expected = stored.sel(seed=seed, energy=energy), case(seed, energy)
            assert one["ended"] == expected["ended"].name == "successful"
            assert one["verdict"] == expected["verdict"].name
            for name in ("gap", "touches", "steps"):
                np.testing.assert_array_equal(one[name], expected[name])
                assert one[name].dtype == expected[name].dtype
    assert set(stored["verdict"].values.ravel()) == {"stable", "held_by_contact"}
    assert "equilibrate" in stored.attrs["source"] and "jaxlib" in stored.attrs["versions"]


def test_values_are_added_to_axes_and_left_out_and_come_in_the_order_asked_for(tmp_path):
    def case(seed, energy):
        with open(log, "a") as file:
            file.write(f"{seed} {energy}\n")
        return {"product": seed * energy}

    log, path = str(tmp_path / "log"), tmp_path / "study.zarr"
    js.study(case, {"seed": [1, 2], "energy": [0.5, 0.25]}, path)
    dataset = js.study(case, {"seed": [3, 1], "energy": [0.25, 0.75]}, path)
    expected = ["1 0.5", "1 0.25", "2 0.5", "2 0.25", "3 0.25", "3 0.75", "1 0.75"]
    assert runs(tmp_path) == Counter(expected)
    assert list(dataset["seed"]) == [3, 1] and list(dataset["energy"]) == [0.25, 0.75]
    np.testing.assert_array_equal(dataset["product"], [[0.75, 2.25], [0.25, 0.75]])
    stored = xarray.open_zarr(path)
    assert list(stored["seed"]) == [1, 2, 3] and list(stored["energy"]) == [0.5, 0.25, 0.75]
    assert int((stored["result"] == "missing").sum()) == 2
    assert np.isnan(stored["product"].sel(seed=2, energy=0.75))


def test_listed_combinations_and_random_keys_and_words_are_axes(tmp_path):
    def listed(law, key):
        return {"draw": jax.random.normal(key), "length": len(law)}

    keys = jax.random.split(jax.random.key(7), 3)
    rows = [{"law": law, "key": key} for law, key in zip(["a", "bb", "a"], keys, strict=True)]
    js.study(listed, rows[:2], tmp_path / "listed.zarr")
    dataset = js.study(listed, rows[::-1], tmp_path / "listed.zarr")
    assert dataset["draw"].dims == ("case",) and list(dataset["law"]) == ["a", "bb", "a"]
    np.testing.assert_array_equal(dataset["draw"], jax.vmap(jax.random.normal)(keys)[::-1])
    assert {"law", "key"} <= set(xarray.open_zarr(tmp_path / "listed.zarr").coords)
    product = js.study(listed, {"law": ["bb", "a"], "key": keys}, tmp_path / "product.zarr")
    np.testing.assert_array_equal(product["draw"], [dataset["draw"][::-1]] * 2)
    np.testing.assert_array_equal(product["length"], [[2] * 3, [1] * 3])
    assert len(set(product["key"].values.tolist())) == 3


def test_a_case_that_raises_or_returns_something_else_is_recorded_and_the_rest_goes_on(tmp_path):
    def case(kind):
        if kind == "raises":
            raise RuntimeError("it broke")
        field = np.arange(3 if kind == "longer" else 2)
        more = {"more": 1} if kind == "more" else {}
        return {"field": field + (0.5 if kind == "fraction" else 0), "flag": True, **more}

    kinds = ["raises", "plain", "longer", "more", "fraction"]
    dataset = js.study(case, {"kind": kinds}, tmp_path / "study.zarr")
    assert list(dataset["result"]) == ["failed", "successful", "failed", "failed", "failed"]
    errors = dict(zip(kinds, dataset["error"].values.tolist(), strict=True))
    assert errors["raises"] == "RuntimeError: it broke" and errors["plain"] == ""
    assert "field is int64 of shape (3,) in this case, int64 of shape (2,)" in errors["longer"]
    assert "returned field, flag, more, cases before it field, flag" in errors["more"]
    assert "float64" in errors["fraction"]
    np.testing.assert_array_equal(dataset["field"][1], [0, 1])
    assert (dataset["field"][0] == np.iinfo(np.int64).min).all()


@pytest.mark.parametrize(
    ("outputs", "message"),
    [
        (None, "returned NoneType"),
        ({}, "return a dict"),
        ({"result": 1}, "`result`, which the study holds"),
        ({"seed": 1}, "`seed`, which the study holds"),
        ({"a/b": 1}, "'a/b'"),
        ({"a": None}, "a is NoneType"),
        ({"a": {"b": 1}}, "a is dict"),
    ],
)
def test_outputs_that_no_store_can_hold_are_refused_at_the_first_case(outputs, message, tmp_path):
    def case(seed):
        return outputs

    with pytest.raises((TypeError, ValueError), match=message):
        js.study(case, {"seed": range(3)}, tmp_path / "study.zarr")


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ({}, "no axis"),
        ([], "no axis"),
        (3, "The axes are int"),
        ({"seed": []}, "shape (0,)"),
        ({"seed": 3}, "shape ()"),
        ({"seed": [[1, 2]]}, "shape (1, 2)"),
        ({"seed": [1.0, float("nan")]}, "NaN"),
        ({"seed": [1, 2, 1]}, "seed has 1 twice"),
        ({"seed": [None]}, "seed is object"),
        ({"result": [1]}, "cannot be named result"),
        ({"energy": [1]}, "missing a required argument: 'seed'"),
        ({"seed": [1], "energy": [1]}, "the axes give seed, energy"),
        ([{"seed": 1}, {"energy": 1}], "Combination 1 has energy"),
        ([{"seed": np.arange(2)}], "seed holds arrays"),
    ],
)
def test_axes_that_make_no_sense_are_refused_before_anything_is_written(axes, message, tmp_path):
    def case(seed):
        return {"a": seed}

    with pytest.raises((TypeError, ValueError), match=re.escape(message)):
        js.study(case, axes, tmp_path / "study.zarr")
    assert not list(tmp_path.iterdir())


def test_what_exists_and_is_no_study_is_left_alone(tmp_path):
    def case(seed):
        return {"a": seed}

    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "mine").touch()
    for name in ("file", "folder"):
        with pytest.raises(ValueError, match="is no study"):
            js.study(case, {"seed": [1]}, tmp_path / name)
    assert [x.name for x in (tmp_path / "folder").iterdir()] == ["mine"]
    with pytest.raises(ValueError, match="batch is 0"):
        js.study(case, {"seed": [1]}, tmp_path / "new", batch=0)


def test_other_axes_than_those_of_the_store_are_refused(tmp_path):
    def case(seed, energy=1):
        return {"a": seed}

    path = tmp_path / "study.zarr"
    js.study(case, {"seed": [1, 2]}, path)
    for axes in ({"seed": [1], "energy": [1]}, {"energy": [1], "seed": [1]}, [{"seed": 1}]):
        with pytest.raises(ValueError, match=r"has the axes seed, this study|another path"):
            js.study(case, axes, path)
    with pytest.raises(ValueError, match=r"seed is float64, in .* it is int64"):
        js.study(case, {"seed": [1.0, 2.0]}, path)


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
            r"No space left on device: 2 of 5 cases are in .*study.zarr.*the same call goes on"
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


def test_a_batch_is_what_its_cases_are_alone(tmp_path):
    def case(key, energy):
        draw = jax.random.normal(key, (4,))
        word = js.VERDICTS.where(draw.sum() > 0, "stable", "unstable")
        return {"field": energy * draw, "verdict": word}

    axes = {"key": jax.random.split(jax.random.key(1), 5), "energy": [1.0, 2.0]}
    alone = js.study(case, axes, tmp_path / "alone.zarr").load()
    # Of which 4 do not divide the 10 cases.
    together = js.study(case, axes, tmp_path / "together.zarr", batch=4).load()
    assert set(alone["verdict"].values.ravel()) == {"stable", "unstable"}
    np.testing.assert_array_equal(alone["verdict"], together["verdict"])
    np.testing.assert_allclose(alone["field"], together["field"], rtol=1e-14)
    assert len(set(together["seconds"].values.ravel())) == 3


def test_one_that_fails_in_a_batch_leaves_the_others(tmp_path):
    def case(x):
        return {"root": eqx.error_if(jnp.sqrt(x), x < 0, "x is negative")}

    dataset = js.study(case, {"x": [4.0, -1.0, 9.0]}, tmp_path / "study.zarr", batch=3)
    assert list(dataset["result"]) == ["successful", "failed", "successful"]
    assert "x is negative" in str(dataset["error"].values[1])
    np.testing.assert_array_equal(dataset["root"], [2, np.nan, 3])


def test_a_function_that_cannot_be_traced_is_refused_in_batches(tmp_path):
    def case(x):
        return {"a": float(x)}

    with pytest.raises(ValueError, match=r"cannot be run in batches.*or use batch=1"):
        js.study(case, {"x": [1.0, 2.0]}, tmp_path / "study.zarr", batch=2)
    with pytest.raises(ValueError, match=r"x are words.*use batch=1"):
        js.study(case, {"x": ["1", "2"]}, tmp_path / "words.zarr", batch=2)
    np.testing.assert_array_equal(
        js.study(case, {"x": [1.0, 2.0]}, tmp_path / "study.zarr")["a"], [1, 2]
    )


def test_cases_are_dealt_to_all_devices_and_zarr_is_imported_late(tmp_path):
    (tmp_path / "script.py").write_text(
        textwrap.dedent("""
            import jax, jax.numpy as jnp, sys, time, jaxstab
            assert not {"zarr", "xarray"} & set(sys.modules)
            def case(seed):
                x = jnp.ones(2) * seed
                time.sleep(0.02)
                return {"device": next(iter(x.devices())).id, "x": x}
            study = jaxstab.study(case, {"seed": range(12)}, "study.zarr")
            assert (study.x == study.seed).all() and (study.result == "successful").all()
            print(sorted(set(study.device.values.tolist())))
        """)
    )
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=2"
    environment = {**os.environ, "XLA_FLAGS": flags}
    command = [sys.executable, "script.py"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.stdout == "[0, 1]\n", done.stderr


def test_tasks_of_an_array_start_far_from_each_other():
    places = sorted(start({"SLURM_ARRAY_TASK_ID": str(task)}) for task in range(1, 33))
    assert min(np.diff(places)) > 0.3 / 32 and max(np.diff(places)) < 2 / 32
    assert start({}) == 0


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


def test_without_the_packages_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxstab\[studies\]'"):
        js.study(lambda seed: {"a": seed}, {"seed": [1]}, tmp_path / "study.zarr")


def test_the_command_line_begins_goes_on_and_sums_up(script, capsys, monkeypatch):
    monkeypatch.chdir(script)
    for _ in range(2):
        main(["study", "script.py", "--path", "study.zarr"])
        said = capsys.readouterr()
        assert "30 cases: 25 successful, 5 failed" in said.out
        first = "The first that failed, energy=0.0, seed=3: ValueError: no contact at 0.0"
        assert first in said.out
        assert str(script / "study.zarr") in said.out and "30/30" in said.err
        assert "failed=5" in said.err
    assert sum(runs(script).values()) == 30
    text = "import jax.numpy as jnp\naxes = {'x': [1.0, 2.0]}\n"
    Path("batch.py").write_text(text + "def case(x):\n    return {'root': jnp.sqrt(x)}\n")
    main(["study", "batch.py", "--path", "batch.zarr", "--batch", "2"])
    np.testing.assert_allclose(xarray.open_zarr("batch.zarr")["root"], np.sqrt([1, 2]))


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("axes = {'seed': [1]}", 2, "study.py defines no `case`"),
        ("def case(seed): return {'a': 1}", 2, "study.py defines no `axes`"),
        ("axes = 1 / 0", 2, "study.py, line 1: ZeroDivisionError: division by zero"),
        ("axes = (", 2, "study.py: SyntaxError"),
        ("axes = {'y': [1]}\ndef case(x): return {'a': 1}", 2, "the axes give y"),
        ("axes = {'x': [1, 2]}\ndef case(x): return {'a': 1 / 0}", 1, "every case failed"),
        (
            "import signal\naxes = {'x': [1, 2]}\n"
            "def case(x): signal.raise_signal(signal.SIGINT); return {'a': 1}",
            130,
            "interrupted, 1 of 2 cases are done",
        ),
        (None, 2, "study.py is no file of Python"),
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
        main(["study", "study.py", "--path", "study.zarr"])
    assert ended.value.code == code
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("jaxstab: ") and message in last

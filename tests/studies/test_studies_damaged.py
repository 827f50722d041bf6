"""Damaged stores and failed cases: an error or another run, never a wrong number."""

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import xarray
from logged_study import runs

import jaxstab as js
from jaxstab.__main__ import main

AXES = {"a": [1, 2, 3], "b": [0.0], "word": ["x", "yy"]}


@pytest.fixture
def case(tmp_path):
    log = str(tmp_path / "log")

    def case(a, b, word):
        with open(log, "a") as file:
            file.write(f"{a} {b} {word}\n")
        return {"sum": 2 * a + b, "field": np.full((2, 2), a), "twice": 2 * word}

    return case


def drop(path):
    shutil.rmtree(path) if path.is_dir() else path.unlink()


@pytest.mark.parametrize("name", AXES)
@pytest.mark.parametrize("damage", ["folder", "chunk", "half"])
def test_an_axis_of_which_a_part_is_lost_is_an_error_until_it_is_put_back(
    name, damage, case, tmp_path
):
    path, copy = tmp_path / "study.zarr", tmp_path / "copy"
    js.study(case, AXES, path)
    expected = xarray.open_zarr(path).load()
    shutil.copytree(path / name, copy)
    chunk = path / name / "c" / "0"
    if damage == "half":
        chunk.write_bytes(chunk.read_bytes()[: chunk.stat().st_size // 2])
    else:
        drop({"folder": path / name, "chunk": chunk}[damage])
    for _ in range(2):
        message = rf"The axis {name} in .*study.zarr is damaged.*put the folder .*{name} back"
        with pytest.raises(ValueError, match=message):
            js.study(case, AXES, path)
    shutil.copytree(copy, path / name, dirs_exist_ok=True)
    assert set(js.study(case, AXES, path)["result"].values.ravel()) == {"successful"}
    xarray.testing.assert_identical(xarray.open_zarr(path).load(), expected)
    assert sum(runs(tmp_path).values()) == 6


def test_an_extended_axis_must_be_whole_too(tmp_path):
    def case(a):
        return {"twice": 2 * a}

    path, number = tmp_path / "study.zarr", 1030
    js.study(case, {"a": range(2)}, path)
    js.study(case, {"a": range(number)}, path)
    chunks = sorted((path / "a").glob("c/*"))
    assert len(chunks) == 2
    dataset = js.study(case, {"a": range(number)}, path)
    np.testing.assert_array_equal(dataset["twice"], 2 * np.arange(number))
    chunks[1].unlink()
    with pytest.raises(ValueError, match=r"The axis a in .*files are missing"):
        js.study(case, {"a": range(3)}, path)


@pytest.mark.parametrize(
    ("lost", "again"),
    [
        ("sum/c.1.0.0", ["2 0.0 x"]),
        ("field/c.1.0.0.0.0", ["2 0.0 x"]),
        ("twice/c.2.0.1", ["3 0.0 yy"]),
        ("seconds/c.0.0.0", ["1 0.0 x"]),
        ("error/c.0.0.0", ["1 0.0 x"]),
        ("result/c.0.0.0", ["1 0.0 x"]),
        ("field/zarr.json", []),
        ("sum", [f"{a} 0.0 {word}" for a in AXES["a"] for word in AXES["word"]]),
    ],
)
def test_a_case_of_which_a_file_is_lost_is_run_again_and_no_other(lost, again, case, tmp_path):
    path = tmp_path / "study.zarr"
    js.study(case, AXES, path)
    expected, before = xarray.open_zarr(path).load().drop_vars("seconds"), runs(tmp_path)
    drop(path / lost)
    dataset = js.study(case, AXES, path)
    assert runs(tmp_path) - before == Counter(again)
    np.testing.assert_array_equal(dataset["sum"][:, 0, 0], [2, 4, 6])
    stored = xarray.open_zarr(path).load().drop_vars("seconds")
    xarray.testing.assert_identical(stored, expected)


def test_a_number_that_is_cut_short_is_run_again(case, tmp_path):
    path = tmp_path / "study.zarr"
    js.study(case, AXES, path)
    (path / "field" / "c.1.0.0.0.0").write_bytes(b"half of it")
    dataset = js.study(case, AXES, path)
    np.testing.assert_array_equal(dataset["field"][1, 0, 0], np.full((2, 2), 2))
    assert runs(tmp_path)["2 0.0 x"] == 2 and sum(runs(tmp_path).values()) == 7


@pytest.mark.parametrize("text", [None, "", "{}", '{"zarr_format": 3'])
def test_a_store_without_its_metadata_is_not_begun_anew(text, case, tmp_path):
    path = tmp_path / "study.zarr"
    js.study(case, AXES, path)
    copy = (path / "zarr.json").read_text()
    (path / "zarr.json").unlink() if text is None else (path / "zarr.json").write_text(text)
    with pytest.raises(ValueError, match=r"holds cases, but its file zarr.json is lost or damaged"):
        js.study(case, {**AXES, "a": [3, 2, 1]}, path)
    (path / "zarr.json").write_text(copy)
    dataset = js.study(case, {**AXES, "a": [3, 2, 1]}, path)
    np.testing.assert_array_equal(dataset["sum"][:, 0, 0], [6, 4, 2])
    assert sum(runs(tmp_path).values()) == 6


SCRIPT = """\
from pathlib import Path

axes = {"seed": range(4)}

def case(seed):
    with open("log", "a") as log:
        log.write(f"{seed}\\n")
    if seed == 1 or (seed == 2 and not Path("mended").exists()):
        raise OSError(f"seed {seed} was out of reach")
    return {"seed_again": seed}
"""


def test_failed_cases_are_run_again_when_asked_once_a_call(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("script.py").write_text(SCRIPT)
    command = ["study", "script.py", "--path", "study.zarr"]
    for _ in range(2):
        main(command)
        said = capsys.readouterr().out
        assert "2 successful, 2 failed" in said and "--retry" in said
    assert runs(tmp_path) == {"0": 1, "1": 1, "2": 1, "3": 1}
    Path("mended").touch()
    main([*command, "--retry"])
    assert "3 successful, 1 failed" in capsys.readouterr().out
    assert runs(tmp_path) == {"0": 1, "1": 2, "2": 2, "3": 1}
    dataset = xarray.open_zarr("study.zarr")
    assert list(dataset["error"].values) == ["", "OSError: seed 1 was out of reach", "", ""]
    np.testing.assert_array_equal(dataset["seed_again"][[0, 2, 3]], [0, 2, 3])

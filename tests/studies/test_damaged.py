"""Damage to files of a study: each is named, and its case runs again; no number is wrong."""

import warnings

import h5py
import numpy as np
import pytest
import xarray
from logged_study import assert_same, contents, runs

import jaxstab as js

AXES = {"seed": range(3), "law": ["a", "bb"]}


def case_in(folder):
    log = str(folder / "log")

    def case(seed, law):
        with open(log, "a") as file:
            file.write(f"{seed} {law}\n")
        return {"field": np.arange(4.0) + seed, "word": law, "flag": seed > 0}

    return case


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    js.study(case_in(folder), AXES, folder / "study")
    return folder / "study"


def flip(file, others):
    content = bytearray(file.read_bytes())
    content[content.index(np.arange(4.0)[2:3].tobytes()) + 7] ^= 1
    file.write_bytes(content)


def swap(file, others):
    mine = file.read_bytes()
    file.write_bytes(others[0].read_bytes())
    others[0].write_bytes(mine)


DAMAGES = {
    "cut": lambda file, others: file.write_bytes(file.read_bytes()[:-100]),
    "emptied": lambda file, others: file.write_bytes(b""),
    "flipped": flip,
    "replaced": lambda file, others: file.write_bytes(others[0].read_bytes()),
    "swapped": swap,
    "renamed": lambda file, others: file.rename(file.with_name("copy of a case.nc")),
    "folder": lambda file, others: (
        file.unlink(),
        file.mkdir(),
        (file / "notes").write_text("mine"),
    ),
    "foreign": lambda file, others: xarray.Dataset({"field": ("x", [1.0])}).to_netcdf(file),
    "unchecked": lambda file, others: xarray.load_dataset(file).to_netcdf(file, engine="h5netcdf"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_named_and_its_case_runs_again(damage, undisturbed, tmp_path):
    number = 3
    case, path = case_in(tmp_path), tmp_path / "study"
    expected = js.study(case, AXES, path).drop_vars("seconds")
    files = sorted(path.glob("*.nc"))
    DAMAGES[damage](files[number], files[number + 1 :])
    name = "copy of a case.nc" if damage == "renamed" else files[number].name
    with pytest.warns(UserWarning, match="are damaged") as said:
        study = js.study(case, AXES, path).drop_vars("seconds")
    assert name in str(said[0].message)
    xarray.testing.assert_identical(study, expected)
    assert_same(path, undisturbed)
    assert sum(runs(tmp_path).values()) == 6 + (2 if damage == "swapped" else 1)
    # Nothing is thrown away, and the next call finds nothing.
    assert len(list(path.glob("*.damaged"))) == (2 if damage == "swapped" else 1)
    with warnings.catch_warnings(action="error"):
        js.study(case, AXES, path)


def test_a_deleted_file_runs_again_and_files_of_others_are_left_alone(undisturbed, tmp_path):
    case, path = case_in(tmp_path), tmp_path / "study"
    js.study(case, AXES, path)
    next(path.glob("*.nc")).unlink()
    (path / "notes.txt").write_text("mine")
    with warnings.catch_warnings(action="error"):
        js.study(case, AXES, path)
    assert_same(path, undisturbed)
    assert sum(runs(tmp_path).values()) == 7 and (path / "notes.txt").read_text() == "mine"


def test_a_file_in_use_or_unreadable_is_not_taken_for_damaged(undisturbed, tmp_path, monkeypatch):
    case, path = case_in(tmp_path), tmp_path / "study"
    js.study(case, AXES, path)
    names = sorted(x.name for x in path.iterdir())
    with h5py.File(next(path.glob("*.nc"))), warnings.catch_warnings(action="error"):
        js.study(case, AXES, path)

    def refuse(*_, **__):
        raise OSError(24, "Too many open files")

    monkeypatch.setattr("pathlib.Path.read_bytes", refuse)
    with pytest.raises(OSError, match="Too many open files"):
        js.study(case, AXES, path)
    assert sorted(x.name for x in path.iterdir()) == names


def test_a_file_runs_no_code(undisturbed):
    content = b"".join(file.read_bytes() for file in undisturbed.iterdir())
    assert b"pickle" not in content and not list(undisturbed.glob("*.pkl"))
    assert {file.suffix for file in undisturbed.iterdir()} == {".nc", ".json"}
    assert len(contents(undisturbed)) == 6

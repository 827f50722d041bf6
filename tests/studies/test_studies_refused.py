"""Studies that are refused, and why: their outputs, axes, paths, and packages that are missing."""

import re
import sys

import equinox as eqx
import numpy as np
import pytest

import jaxstab as js


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
        ({"a": np.ma.array([1, 2], mask=[0, 1])}, "a is a masked array of int64"),
        ({"a": [np.ma.array([True], mask=[True])]}, "a is a masked array of bool"),
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


def test_without_the_packages_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxstab\[studies\]'"):
        js.study(lambda seed: {"a": seed}, {"seed": [1]}, tmp_path / "study.zarr")


class Counted(eqx.Module):
    """Something that can be called, and is no function."""

    factor: float

    def __call__(self, x):
        return {"x": self.factor * x}


def test_what_is_no_function_and_names_that_are_taken_are_refused(tmp_path):
    with pytest.raises(TypeError, match="The case is of type Counted: give a function"):
        js.study(Counted(2.0), {"x": [1.0]}, tmp_path / "study.zarr")
    with pytest.raises(ValueError, match="returned `case`, which the study holds by itself"):
        js.study(lambda x: {"case": x}, {"x": [1.0]}, tmp_path / "study.zarr")

"""`study.json`: a folder takes the cases of one function and one set of axes."""

import json
import os
import sys
from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from logged_study import runs

import jaxstab as js

AXES = {"seed": [1, 2]}


def logged(log, is_changed=False):
    def case(seed):
        with open(log, "a") as file:
            file.write(f"{seed}\n")
        return {"product": 2 * seed}

    def changed(seed):
        return {**case(seed), "product": 3 * seed}

    return changed if is_changed else case


def test_another_function_version_or_package_is_refused_with_the_difference(tmp_path, monkeypatch):
    log, path = tmp_path / "log", tmp_path / "study"
    js.study(logged(log), AXES, path, version=1)
    before = sorted(x.read_bytes() for x in path.iterdir())
    for case, version, said in [
        (logged(log, True), 1, '+  "        return {**case(seed), \\"product\\": 3 * seed}"'),
        (logged(log), 2, '- "version": 1,\n+ "version": 2,\nGive another folder'),
    ]:
        with pytest.raises(ValueError, match="begun with another case") as refused:
            js.study(case, {"seed": [1, 2, 3]}, path, version=version)
        assert said in str(refused.value)
    with monkeypatch.context() as patch:
        patch.setattr("jaxstab.core.optional_packages.version", lambda name: f"{name}-9")
        with pytest.raises(ValueError, match=r'\+  "numpy": "numpy-9"'):
            js.study(logged(log), AXES, path, version=1)
    assert sorted(x.read_bytes() for x in path.iterdir()) == before
    study = js.study(logged(log, True), {"seed": [1, 2, 3]}, path, version=2, accept_changes=True)
    assert study["product"].values.tolist() == [2, 4, 9]
    assert runs(tmp_path) == {"1": 1, "2": 1, "3": 1}
    record = json.loads((path / "study.json").read_text())
    assert "3 * seed" in record["source"][-1] and record["version"] == 2
    assert '+ "version": 2,' in record["changes"][0]["changed"]
    # A version may be of any kind.
    js.study(logged(log), AXES, tmp_path / "array", version=np.arange(2))
    with pytest.raises(ValueError, match=r'\+ "version": "\[1 2\]"'):
        js.study(logged(log), AXES, tmp_path / "array", version=np.arange(1, 3))
    # From now on it is the study of this case.
    js.study(logged(log, True), AXES, path, version=2)


def test_other_axes_are_refused_with_both_sets_of_names(tmp_path):
    def case(seed, energy=1):
        return {"a": seed}

    path = tmp_path / "study"
    js.study(case, AXES, path)
    more = {"seed": [1], "energy": [1.0]}
    for axes, said in [(more, "seed, energy on seed, energy"), ([{"seed": 1}], "seed on case")]:
        message = f"has axes seed on seed, not {said}: give another folder"
        with pytest.raises(ValueError, match=message):
            js.study(case, axes, path, accept_changes=True)


def test_partial_functions_and_callable_modules_are_cases(tmp_path):
    class Scaled(eqx.Module):
        factor: float

        def __call__(self, seed):
            return {"product": self.factor * seed}

    assert js.study(Scaled(2.0), AXES, tmp_path / "module")["product"].values.tolist() == [2, 4]

    def case(seed, factor):
        return {"product": factor * seed}

    for call in (partial(case, factor=2), eqx.filter_jit(partial(case, factor=2))):
        path = tmp_path / type(call).__name__
        assert js.study(call, AXES, path)["product"].values.tolist() == [2, 4]
    with pytest.raises(ValueError, match=r"'factor': 2.*\n\+.*'factor': 3"):
        js.study(partial(case, factor=3), AXES, tmp_path / "partial")


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray])
def test_every_number_of_an_array_that_a_partial_function_holds_is_compared(kind, tmp_path):
    def case(heights, seed):
        return {"sum": seed * heights.sum()}

    heights = np.zeros(2000)
    study = js.study(partial(case, kind(heights)), AXES, tmp_path / "study")
    assert study["sum"].values.tolist() == [0, 0]
    js.study(partial(case, kind(heights)), {"seed": [1, 2, 3]}, tmp_path / "study")
    # Its text, which NumPy shortens, is the same.
    heights[1000] = 1e-12
    with pytest.raises(ValueError, match=r"\n\+.*# of float64 \(2000,\) "):
        js.study(partial(case, kind(heights)), AXES, tmp_path / "study")


def test_a_function_without_source_needs_a_version(tmp_path):
    space = {}
    exec("def case(seed): return {'a': seed}", space)
    with pytest.raises(ValueError, match=r"source of the case is not found.*`version`"):
        js.study(space["case"], AXES, tmp_path / "study")
    js.study(space["case"], AXES, tmp_path / "study", version="first")
    with pytest.raises(ValueError, match=r'"version": "first",\n\+ "version": "second"'):
        js.study(space["case"], AXES, tmp_path / "study", version="second")


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    case = logged(tmp_path / "log")
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "mine").touch()
    with pytest.raises(ValueError, match="is no study, it holds mine"):
        js.study(case, AXES, tmp_path / "folder")
    for path, said in ((tmp_path / "file", "File exists"), (tmp_path / "file/study", "Not a dir")):
        with pytest.raises(OSError, match=said):
            js.study(case, AXES, path)
    assert [x.name for x in (tmp_path / "folder").iterdir()] == ["mine"]


@pytest.mark.parametrize("damage", ["lost", "empty", "cut", "other"])
def test_a_damaged_record_is_named_and_written_anew_when_asked(damage, tmp_path):
    case, path = logged(tmp_path / "log"), tmp_path / "study"
    js.study(case, AXES, path)
    record = path / "study.json"
    content = record.read_text()
    record.unlink()
    if damage != "lost":
        record.write_text({"empty": "", "cut": content[:50], "other": "[1]"}[damage])
    with pytest.raises(ValueError, match=r"study.json is damaged(.*\n)*.*accept_changes=True"):
        js.study(case, AXES, path)
    js.study(case, AXES, path, accept_changes=True)
    assert {**json.loads(record.read_text()), "changes": []} == json.loads(content)
    assert sum(runs(tmp_path).values()) == 2


def test_arguments_that_make_no_sense_are_refused(tmp_path):
    call = {"case": logged(tmp_path / "log"), "axes": AXES, "path": tmp_path / "study"}
    for name, value in [("batch", 0), ("executor", 0), ("executor", 1.5), ("executor", "dask")]:
        with pytest.raises(ValueError, match=f"{name} is '?{value}"):
            js.study(**call, **{name: value})
    with pytest.raises(TypeError, match="3 is not a callable object"):
        js.study(3, AXES, tmp_path / "study")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("package", ["h5netcdf", "dask"])
def test_without_the_packages_the_extra_is_named(package, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=r"pip install 'jaxstab\[studies\]'"):
        js.study(logged(os.devnull), AXES, tmp_path / "study")
    assert not list(tmp_path.iterdir())

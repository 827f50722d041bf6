"""A study is known again by what its case computes, and by nothing else."""

import json
import shutil
import subprocess
import sys
import textwrap
from importlib.util import module_from_spec, spec_from_file_location
from itertools import combinations
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
import xarray

import jaxstab as js
from jaxstab.core.public_names import first_module
from jaxstab.studies import identity
from jaxstab.studies.identity import identity_of

MODULE = """
import dataclasses
import functools
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

SCALE = 2.0
TABLE = np.arange(3.0)
UNUSED = 1


class Law(eqx.Module):
    energy: float

    def __call__(self, gap):
        return -self.energy * jnp.exp(-gap)


LAW = Law(0.5)


def once(function):
    @functools.wraps(function)
    def called(*values):
        return function(*values)

    return called


def helper(x):
    # A comment.
    return SCALE * x + TABLE.sum()


helper.offset = 5
helper.itself = helper


@once
def limited(x):
    return min(x, limited.limit)


limited.limit = 7
jitted = jax.jit(lambda x: x)
jitted.shift = 1


def made(power):
    def case(seed, shift=1):
        \"\"\"What it does.\"\"\"
        attributes = helper.offset + jitted(jitted.shift)
        return {"a": helper(seed) ** power + limited(LAW(shift)) + attributes}

    return case


case = made(3)
"""
CHANGES = [
    ("SCALE = 2.0", "SCALE = 3.0", "SCALE"),
    ("np.arange(3.0)", "np.arange(3.0) + 1", "TABLE"),
    ("* x + TABLE", "* x - TABLE", "helper"),
    ("made(3)", "made(4)", "power"),
    ("shift=1", "shift=2", "case"),
    ("** power", "** power + 1", "case"),
    ("-self.energy * jnp", "self.energy * jnp", "Law.__call__"),
    ("Law(0.5)", "Law(0.6)", "LAW"),
    ("helper.offset = 5", "helper.offset = 6", "helper.offset"),
    ("helper.itself = helper", "helper.itself = None", "helper.itself"),
    ("return function(*values)", "return -function(*values)", "called, once"),
    ("limited.limit = 7", "limited.limit = 8", "limited.limit"),
    ("jitted.shift = 1", "jitted.shift = 2", ".*shift"),
    ("UNUSED = 1", "UNUSED = 2", ""),
    ("UNUSED = 1", "UNUSED = 1  # A comment.", ""),
    ("# A comment.", "# Another.", "helper"),
    ("What it does.", "What it really does.", "case"),
    ("    return SCALE * x + TABLE", "    return (SCALE  *  x)  + TABLE", "helper"),
]


@pytest.mark.parametrize(("old", "new", "changed"), CHANGES, ids=[x[1][:20] for x in CHANGES])
def test_a_change_of_what_a_case_is_made_of_is_refused_and_no_other(old, new, changed, tmp_path):
    text = MODULE.replace('\\"', '"')
    assert text.count(old) == 1
    one = module_of(tmp_path / "one.py", text)
    other = module_of(tmp_path / "other.py", text.replace(old, new))
    js.study(one.case, {"seed": [1]}, tmp_path / "study.zarr")
    if not changed:
        js.study(other.case, {"seed": [1, 2]}, tmp_path / "study.zarr")
        return
    with pytest.raises(ValueError, match=rf"study.zarr was begun .*: {changed} changed. Give"):
        js.study(other.case, {"seed": [1, 2]}, tmp_path / "study.zarr")


def test_a_changed_case_can_be_accepted_which_the_store_records(tmp_path):
    text, path = "SCALE = 2\ndef case(seed):\n    return {'a': SCALE * seed}\n", tmp_path / "s.zarr"
    one = module_of(tmp_path / "one.py", text)
    other = module_of(tmp_path / "other.py", text.replace("SCALE =", "UNIT, SCALE = 1,"))
    third = module_of(tmp_path / "third.py", text.replace("SCALE = 2", "SCALE = 3"))
    js.study(one.case, {"seed": [1]}, path)
    js.study(other.case, {"seed": [1, 2]}, path, accept_changes=True)
    assert "accepted_changes" not in xarray.open_zarr(path).attrs
    for seeds in ([3], [4]):
        dataset = js.study(third.case, {"seed": seeds}, path, accept_changes=True)
    # From now on it is the new one's.
    with pytest.raises(ValueError, match=r"SCALE changed.*accept_changes=True goes on"):
        js.study(one.case, {"seed": [5]}, path)
    (change,) = json.loads(dataset.attrs["accepted_changes"])
    assert change["changed"] == ["SCALE"] and "SCALE * seed" in change["source"]
    assert xarray.open_zarr(path)["a"].values.tolist() == [2, 4, 9, 12]


def test_other_versions_are_another_study(tmp_path, monkeypatch):
    def case(seed):
        return {"a": seed}

    js.study(case, {"seed": [1]}, tmp_path / "study.zarr")
    monkeypatch.setattr(identity, "version", lambda name: "9" if name == "jaxlib" else "1")
    with pytest.raises(ValueError, match="version of jaxlib"):
        js.study(case, {"seed": [1]}, tmp_path / "study.zarr")


OLD = Path(__file__).with_name("study_by_0_1_0.zarr")


def test_a_store_of_jaxstab_0_1_0_goes_on_once_that_is_accepted(tmp_path):
    def case(seed, law):
        return {"number": 2 * seed, "verdict": "stable"}

    path, axes = tmp_path / "study.zarr", {"seed": [0, 1, 2, 3], "law": ["x", "yy"]}
    shutil.copytree(OLD, path)
    with pytest.raises(ValueError, match=r"was begun by an earlier jaxstab.*accept_changes=True"):
        js.study(case, axes, path)
    dataset = js.study(case, axes, path, accept_changes=True)
    # Those that were done did not run again.
    assert dataset.number.values.tolist() == [[7, 7], [8, 8], [4, 4], [6, 6]]
    stored = xarray.open_zarr(path)
    assert (stored.where(stored.result == "successful").verdict == "stable").all()
    assert json.loads(stored.attrs["accepted_changes"])[0]["changed"]


def module_of(path, text):
    path.write_text(text)
    spec = spec_from_file_location(path.stem, path)
    module = sys.modules[path.stem] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_fingerprint_is_the_same_in_every_process(tmp_path):
    text = MODULE.replace('\\"', '"') + textwrap.dedent("""
        SET = {"a", "b", "c", "d", "e"}
        COMPILED = jax.jit(helper)
        WITH_BARE_LAW = js.potentials.as_module(lambda gap: -SCALE * jnp.exp(-gap), float)
        def with_more(seed):
            return {"a": len(SET) + COMPILED(seed) + WITH_BARE_LAW(seed) + len(Path(".").name)}
    """)
    text = "from pathlib import Path\nimport jax\nimport jaxstab as js\n" + text
    here = module_of(tmp_path / "module.py", text)
    code = (
        "import jax; jax.config.update('jax_enable_x64', True); import module, json\n"
        "from jaxstab.studies.identity import identity_of\n"
        "print(json.dumps([identity_of(module.case), identity_of(module.with_more)]))"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert said.returncode == 0, said.stderr
    assert json.loads(said.stdout) == [identity_of(here.case), identity_of(here.with_more)]


def test_another_precision_is_another_study(tmp_path):
    def case(seed):
        return {"a": jnp.asarray(1.0) * seed}

    js.study(case, {"seed": [1]}, tmp_path / "study.zarr")
    with jax.enable_x64(False), pytest.raises(ValueError, match="jax_enable_x64 changed"):
        js.study(case, {"seed": [1]}, tmp_path / "study.zarr")


def test_what_cannot_be_known_again_is_refused_with_the_cure(tmp_path):
    names = {}
    exec("def case(seed):\n    return {'a': seed}", names)
    with pytest.raises(ValueError, match=r"source of `case` is not found.*write it in a file"):
        js.study(names["case"], {"seed": [1]}, tmp_path / "study.zarr")
    thing = object()
    with pytest.raises(TypeError, match=r"refers to `thing`.*builtins.object"):
        js.study(lambda seed: {"a": thing}, {"seed": [1]}, tmp_path / "study.zarr")
    text = "def case(seed):\n    return {'a': seed}\n"
    module = module_of(tmp_path / "edited.py", text)
    (tmp_path / "edited.py").write_text(text.replace("seed}", "seed + 1}"))
    with pytest.raises(ValueError, match=r"`case` differs from its source in .*edited.py"):
        js.study(module.case, {"seed": [1]}, tmp_path / "study.zarr")
    assert not (tmp_path / "study.zarr").exists()


def test_names_in_text_are_warned_of(tmp_path):
    text = "SCALE = 2\n\ndef case(seed):\n    return {'a': eval('SCALE * seed')}\n"
    module = module_of(tmp_path / "evaluating.py", text)
    with pytest.warns(
        UserWarning, match="`case` calls `eval`: a study cannot detect changes"
    ) as said:
        js.study(module.case, {"seed": [1]}, tmp_path / "study.zarr")
    assert [warning.filename for warning in said] == [__file__]


def test_lambdas_on_one_line_are_told_apart():
    lambdas = lambda x: {"y": 2 * x}, lambda x: {"y": 3 * x}, lambda x: (lambda y: {"y": y})(x)
    identities = [identity_of(function) for function in lambdas]
    assert identities == [identity_of(function) for function in lambdas]
    assert all(one != other for one, other in combinations(identities, 2))
    inner = [function(1) for function in (lambda x: lambda y: 2 * y, lambda x: lambda y: 3 * y)]
    assert identity_of(inner[0]) != identity_of(inner[1])


def test_what_has_moved_is_known_by_where_it_lay_first():
    assert first_module(js.HalfSpace) == "jaxstab.elasticity.half_space"
    assert first_module(js.VERDICTS) == "jaxstab.results"
    # Nothing else of the same name.
    names = js.pull_off, js.references.jkr.pull_off, js.references.johnson.pull_off
    assert [first_module(value).rpartition(".")[2] for value in names] == [
        "pull_off",
        "jkr",
        "johnson",
    ]

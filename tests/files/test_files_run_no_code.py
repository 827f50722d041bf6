"""Files written to make a reader run code, which they must not."""

import json
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
from saved import assert_same_bits, contact_and_state, rewrite

import jaxstab as js
from jaxstab.__main__ import main

# A module that leaves a trace when it is imported.
TRAP = """
import pathlib
pathlib.Path(__file__).with_suffix(".sprung").touch()
import equinox as eqx, jax
class Law(eqx.Module):
    depth: jax.Array
    def __call__(self, gap):
        return -self.depth * jax.numpy.exp(-gap / 0.2)
"""


@pytest.fixture(scope="module")
def original(hertz, tmp_path_factory):
    sweep = js.sweep(hertz, js.MeanDisplacement(np.array([1.2, 1.31])))
    return js.save(tmp_path_factory.mktemp("original") / "run.nc", hertz, sweep)


@pytest.fixture
def saved(original, tmp_path):
    return Path(shutil.copy(original, tmp_path))


@pytest.fixture
def trap(tmp_path, monkeypatch):
    """A folder of modules on the path, and the record of their imports."""
    folder = tmp_path / "trap"
    (folder / "trapped").mkdir(parents=True)
    for name in ("trap_module", "trapped/__init__", "trapped/inside"):
        (folder / f"{name}.py").write_text(TRAP)
    monkeypatch.syspath_prepend(folder)
    yield folder
    assert not list(folder.rglob("*.sprung"))
    assert not [name for name in sys.modules if name.startswith("trap")]


def classes_of(path):
    """Return every class that a file names."""
    found = set()

    def look(part):
        if isinstance(part, dict):
            found.update({part["class"]} if "class" in part else ())
            part = list(part.values())
        for inner in part if isinstance(part, list) else []:
            look(inner)

    with h5netcdf.File(path) as file:
        look(json.loads(file.attrs["structure"]))
    return found


@pytest.mark.parametrize(
    "name",
    [
        "trapped.inside:Law",
        pytest.param("trap_module:Law", marks=pytest.mark.nightly),
        pytest.param("trapped:inside.Law", marks=pytest.mark.nightly),
    ],
)
def test_no_class_of_a_file_imports_its_module(saved, trap, tmp_path, name):
    names = classes_of(saved)
    assert len(names) > 7
    module = name.partition(":")[0]
    for i, one in enumerate(sorted(names)):
        path = tmp_path / f"{i}.nc"
        path.write_bytes(saved.read_bytes())
        rewrite(path, f'"{one}"', f'"{name}"')
        message = f"names the class {name}, and a file imports no.* `import {module}` before"
        if "Exponential" in one:
            # The rest serves for figures without its law, which says how to get it.
            contact, _ = js.load(path)
            message = f"`{name}` the file holds values only.*Import {module} before jaxstab.load"
            with pytest.raises(ValueError, match=message):
                contact.potential(0.1)
        else:
            with pytest.raises(ValueError, match=message):
                js.load(path)


def run_in(folder, *arguments):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "jaxstab", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment)


def test_no_command_imports_what_a_file_names_in_the_folder_it_runs_in(saved, trap):
    rewrite(saved, "jaxstab:HalfSpace", "trap_module:Law")
    run = run_in(trap, "info", str(saved))
    assert run.returncode == 2
    assert "import trap_module" in run.stderr and "--import" in run.stderr


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        # An attribute that a module makes when it is asked for, by an import.
        ("jaxstab:History", "jaxstab:references.Law", "is not found"),
        ("jaxstab:History", "os:system", r"no equinox\.Module"),
        ("jaxstab:History", "builtins:eval", r"no equinox\.Module"),
        ("jaxstab:History", "subprocess:Popen", r"no equinox\.Module"),
        ("jaxstab:History", "jaxstab.files.records:import_module", "is not found"),
        (
            "jaxstab:History",
            "jaxstab:History.__init__.__globals__",
            "is not found",
        ),
        ("jaxstab:History", "", "names the class"),
        ('"RESULTS"', '"jax"', "jax of the file is no enumeration"),
        ('"RESULTS"', '"Enumeration.promote"', "is no enumeration"),
        ('"RESULTS"', '"__builtins__"', "is no enumeration"),
        ('"class": "jaxstab:History"', '"class": ["os"]', "cannot be read"),
        ('{"tuple": ', '{"set": ', "cannot be read"),
    ],
)
def test_nothing_else_that_a_file_names_is_called(saved, old, new, message, monkeypatch):
    monkeypatch.delitem(sys.modules, "jaxstab.references", raising=False)
    monkeypatch.delitem(vars(js), "references", raising=False)
    rewrite(saved, old, new)
    with pytest.raises(ValueError, match=message):
        js.load(saved)
    assert "jaxstab.references" not in sys.modules


def test_a_class_comes_back_once_its_module_is_imported(tmp_path, monkeypatch, capsys):
    (tmp_path / "my_laws.py").write_text(TRAP)
    monkeypatch.syspath_prepend(tmp_path)
    import my_laws

    contact, state = contact_and_state(my_laws.Law(np.array(0.01)))
    path = js.save(tmp_path / "own.nc", contact, state)
    assert_same_bits((contact, state), js.load(path))
    monkeypatch.delitem(sys.modules, "my_laws")
    with pytest.raises(ValueError, match="Import my_laws before"):
        js.equilibrate(js.load(path)[0], state.load)
    main(["info", str(path), "--import", "my_laws"])
    said = capsys.readouterr().out
    assert "Law(" in said and "LostFunction" not in said


class Trap:
    """An object whose pickle runs a command when it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("write", [np.save, np.savez])
def test_a_pickle_in_an_array_is_not_loaded(tmp_path, write):
    with (tmp_path / "a.npy").open("wb") as file:
        write(file, np.array([[Trap(tmp_path / "sprung"), 1], [2, 3]], object))
    with pytest.raises(ValueError, match=r"a\.npy: .*more than plain arrays"):
        js.surfaces.read(tmp_path / "a.npy", (1, 1))
    assert not (tmp_path / "sprung").exists()
    pickle.loads(pickle.dumps(Trap(tmp_path / "sprung")))
    assert (tmp_path / "sprung").exists()

"""Compiled programs, kept from one process to the next."""

import json
import os
import subprocess
import sys
import warnings

import jax
import pytest

from jaxstab.core import cache

SCRIPT = """
import json, jax
counts = {"cache_hits": 0, "cache_misses": 0}

def count(event, **_):
    name = event.rpartition("/")[2]
    counts[name] = counts.get(name, 0) + 1

jax.monitoring.register_event_listener(count)
import jaxstab as js
grid = js.Grid(8)
law = js.potentials.Exponential(0.05, 0.1)
contact = js.Contact(js.HalfSpace(grid, 1.0), js.surfaces.sinusoid(grid, 0.05), law)
pressure = float(js.equilibrate(contact, js.MeanGap(0.1)).mean_pressure)
print(json.dumps([pressure, counts["cache_hits"], counts["cache_misses"]]))
"""


def started(folder, **variables):
    """Return a process that solves, with a cache of its own in a folder."""
    kept = {name: value for name, value in os.environ.items() if "_CACHE_" not in name}
    environment = kept | {"XDG_CACHE_HOME": str(folder)} | variables
    command = [sys.executable, "-c", SCRIPT]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def ended(process):
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    return json.loads(out)


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="the user's folder is set by a variable there")
def test_a_program_is_compiled_by_one_process_alone_also_where_several_start_at_once(tmp_path):
    first = [ended(process) for process in [started(tmp_path, JAXSTAB_CACHE="1") for _ in "123"]]
    pressure, hits, misses = ended(started(tmp_path, JAXSTAB_CACHE="1"))
    assert hits > 0 and misses == 0
    assert all(others == pressure for others, _, _ in first)
    (folder,) = (tmp_path / "jaxstab").iterdir()
    assert folder.name.startswith(jax.lib.__version__)
    alone, hits, misses = ended(started(tmp_path / "none", JAXSTAB_CACHE="0"))
    assert alone == pressure and hits == misses == 0
    assert not (tmp_path / "none").exists()


@pytest.fixture
def unset(monkeypatch, tmp_path):
    """JAX as where the user has set no cache."""
    before = {name: jax.config.values[name] for name in jax.config.values if "_cache_" in name}
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    yield tmp_path
    for name, value in before.items():
        if jax.config.values[name] != value:
            jax.config.update(name, value)


def test_a_folder_that_cannot_be_used_is_no_error(unset, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(os, "access", lambda *_: False)
        cache.keep_programs(by_default=True)
    full = type("Usage", (), {"free": 10**6})
    with monkeypatch.context() as patched:
        patched.setattr(cache.shutil, "disk_usage", lambda _: full)
        cache.keep_programs(by_default=True)
    (unset / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(unset / "file"))
    cache.keep_programs(by_default=True)
    assert jax.config.values["jax_compilation_cache_dir"] is None


def test_what_the_user_has_set_stands(unset):
    jax.config.update("jax_compilation_cache_dir", str(unset / "mine"))
    cache.keep_programs(by_default=True)
    assert jax.config.values["jax_compilation_cache_dir"] == str(unset / "mine")


def test_a_warning_tells_once_that_no_program_can_be_used(unset):
    rejected, useful = cache._Watch(unset), cache._Watch(unset)
    useful("/jax/compilation_cache/cache_hits")
    with pytest.warns(UserWarning, match="JAXSTAB_CACHE=0") as given:
        for _ in range(100):
            rejected("/jax/compilation_cache/cache_misses")
    assert len(given) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(100):
            useful("/jax/compilation_cache/cache_misses")

import os
import sys
from pathlib import Path

import jax
import jaxlib.version
import pytest

from jaxstab.cli import compilation_cache

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="there a variable names the user's cache folder"
)


@pytest.fixture
def unset(monkeypatch, tmp_path):
    """JAX without a cache, and a new folder for the user's caches."""
    before = {name: x for name, x in jax.config.values.items() if "_cache_" in name}
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    yield tmp_path
    for name, value in before.items():
        jax.config.update(name, value)


def cache_folder():
    compilation_cache.use_compilation_cache()
    return jax.config.values["jax_compilation_cache_dir"]


def test_the_folder_is_private_and_named_by_jaxlib(unset):
    folder = Path(cache_folder())
    assert folder.parent == unset / "jaxstab" and folder.name.startswith(jaxlib.version.__version__)
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_folder_that_others_can_write_is_made_private(unset):
    folder = Path(cache_folder())
    folder.chmod(0o777)
    jax.config.update("jax_compilation_cache_dir", None)
    cache_folder()
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_folder_of_another_user_is_not_used(unset, monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(compilation_cache.Path, "chmod", refuse)
    assert cache_folder() is None


def test_a_folder_that_cannot_be_made_is_not_used(unset, monkeypatch):
    (unset / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(unset / "file"))
    assert cache_folder() is None


def test_a_cache_that_the_user_has_set_stands(unset):
    jax.config.update("jax_compilation_cache_dir", str(unset / "mine"))
    assert cache_folder() == str(unset / "mine")
    assert os.listdir(unset) == []


def test_a_large_cache_is_begun_anew(unset, monkeypatch):
    folder = Path(cache_folder())
    (folder / "program").write_bytes(100 * b"x")
    for size, left in [(100, ["program"]), (99, [])]:
        jax.config.update("jax_compilation_cache_dir", None)
        monkeypatch.setattr(compilation_cache, "MAX_SIZE", size)
        cache_folder()
        assert os.listdir(folder) == left

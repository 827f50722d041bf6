"""Compiled programs, kept from one process to the next in the user's cache folder."""

import hashlib
import os
import platform
import shutil
import sys
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

import jax
import jax.monitoring
import jaxlib.version

from jaxstab.core.warn import warn

# With a limit JAX locks the folder, so that no process reads what another one is writing [bytes].
_MAX_SIZE = 900_000_000
# The programs without a hit after which those in the folder are taken to be of no use.
_MANY = 20


# What JAX has to be told, here and in other processes that are to share the folder: the size too.
SETTINGS = (
    "jax_compilation_cache_dir",
    "jax_compilation_cache_max_size",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)
# Earlier ones report each program from a cache, at length, as made for another machine.
_IS_QUIET = jax.__version_info__ >= (0, 12)


def keep_programs(by_default: bool = _IS_QUIET) -> None:
    """Let JAX keep all that it compiles, if the environment variable JAXSTAB_CACHE is not 0.

    Nothing is done where the user has set JAX's cache, or where the folder cannot be used.

    Arguments:
        by_default: whether to, if the variable is not set.
    """
    is_wanted = os.environ.get("JAXSTAB_CACHE", str(int(by_default))) != "0"
    is_set = jax.config.values["jax_compilation_cache_dir"] is not None
    if is_set or not is_wanted or find_spec("filelock") is None:
        return
    folder = _user_folder() / "jaxstab" / _machine()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        has_room = shutil.disk_usage(folder).free > _MAX_SIZE
    except OSError:
        return
    if not (has_room and os.access(folder, os.W_OK)):
        return
    for name, value in zip(SETTINGS, (str(folder), _MAX_SIZE, 0, -1), strict=True):
        jax.config.update(name, value)
    with os.scandir(folder) as files:
        # There may be tens of thousands.
        kept = list(islice((file for file in files if file.name.endswith("-cache")), _MANY))
    if len(kept) == _MANY:
        jax.monitoring.register_event_listener(_Watch(folder))


class _Watch:
    """Warns once if none of the programs that are kept can be used."""

    def __init__(self, folder: Path):
        self._folder = folder
        self._num_hits = self._num_misses = 0

    def __call__(self, event: str, **_: str | int) -> None:
        self._num_hits += event == "/jax/compilation_cache/cache_hits"
        self._num_misses += event == "/jax/compilation_cache/cache_misses"
        if self._num_misses == _MANY and self._num_hits == 0:
            self._num_misses += 1
            warn(
                f"None of the compiled programs kept in {self._folder} can be used: they were "
                "made with other flags of XLA, or JAX rejects them on this processor. If this "
                "comes back, set the environment variable JAXSTAB_CACHE=0 to keep none."
            )


def _machine() -> str:
    """Return a name for this jaxlib and this kind of processor."""
    processor, info = platform.machine(), Path("/proc/cpuinfo")
    if info.exists():
        # The first will do: to ask for those of all cores takes long where there are hundreds.
        with info.open() as lines:
            processor += next((line for line in lines if line.startswith(("flags", "Feat"))), "")
    else:
        processor += platform.processor()
    return f"{jaxlib.version.__version__}-{hashlib.sha256(processor.encode()).hexdigest()[:12]}"


def _user_folder() -> Path:
    """Return the folder of the user's caches."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")

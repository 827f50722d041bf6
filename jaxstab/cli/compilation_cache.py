"""JAX's compilation cache, in the user's cache folder."""

import hashlib
import os
import platform
import shutil
import sys
from pathlib import Path

import jax
import jaxlib.version

# A larger cache is deleted [bytes].
MAX_SIZE = 1_000_000_000


def use_compilation_cache() -> None:
    """Turn JAX's compilation cache on, in a folder that only the user can read or write.

    Nothing is done if the user has set a cache, or if the folder cannot be used.
    """
    if jax.config.values["jax_compilation_cache_dir"] is not None:
        return
    folder = _user_caches() / "jaxstab" / f"{jaxlib.version.__version__}-{_processor()}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        # This fails for another user's folder.
        folder.chmod(0o700)
        if sum(file.stat().st_size for file in folder.iterdir()) > MAX_SIZE:
            shutil.rmtree(folder)
            folder.mkdir(mode=0o700)
    except OSError:
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _processor() -> str:
    """Return a name of the kind of processor, whose programs another kind cannot run."""
    name = platform.machine() + platform.processor()
    info = Path("/proc/cpuinfo")
    if info.exists():
        with info.open() as lines:
            name += next((line for line in lines if line.startswith(("flags", "Feat"))), "")
    return hashlib.sha256(name.encode()).hexdigest()[:12]


def _user_caches() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")

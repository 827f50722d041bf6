"""The texts of programs in a folder: what JAX makes of Python functions, before it is compiled.

A text is found by a name, that is made of all that the text follows from: the function, the
structure and shapes of its arguments, the formula of a law, the settings of JAX, and the code of
jaxstab, on disk and in memory. Where something else may matter, there is no name: for a class, a
primitive or a custom derivative rule of the user's, and for code that was changed while it ran.
"""

import hashlib
import os
import pickle
import platform
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import suppress
from datetime import datetime
from functools import cache
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import jax.extend.core.primitives
import jaxlib.version
import numpy as np

from jaxstab.core.closures import Formula

_PACKAGE = __name__.partition(".")[0]
# What functions and classes of these do follows from the versions.
_KNOWN = {_PACKAGE, "builtins", "collections", "equinox", "functools", "jax", "jaxlib", "numpy"}
# Those that modules of jaxstab may refer to besides.
_IMPORTED = _KNOWN | {*sys.stdlib_module_names, "jaxtyping", "optax", "scipy", "tqdm"}
_PRIMITIVES = set(map(id, vars(jax.extend.core.primitives).values()))
# Of all texts together [bytes].
_MAX_SIZE = 100_000_000
_DIGEST_SIZE = hashlib.sha256().digest_size
_STARTED = datetime.now()


class Unknown(Exception):
    """What only this process knows."""


def folder() -> Path | None:
    """Return the folder of texts, None if none are to be kept."""
    folder = jax.config.values["jax_compilation_cache_dir"]
    is_off = not jax.config.values["jax_enable_compilation_cache"]
    is_off |= os.environ.get("JAXSTAB_CACHE") == "0"
    if not folder or "://" in folder or is_off or not _can_write():
        return None
    return Path(folder) / _PACKAGE


@cache
def _can_write() -> bool:
    # JAX writes and reads texts by it.
    return find_spec("flatbuffers") is not None


def name_of(function: Any, *parts: Any) -> str | None:
    """Return the name for a function and all that its text follows from, None if it has none."""
    file = BytesIO()
    pickler = _NamePickler(file)
    # Else equal parts are written in two ways: as one object, or as two.
    pickler.fast = True
    try:
        if not _is_own(function) or "<" in function.__qualname__ or _is_edited():
            return None
        pickler.dump((function.__module__, function.__qualname__, parts, _versions()))
        state = repr(list(_state({function.__module__, *pickler.modules})))
    except Exception:
        # What cannot be pickled says so by errors of many kinds.
        return None
    return hashlib.sha256(file.getvalue() + state.encode()).hexdigest()


@cache
def _versions() -> tuple[str, ...]:
    source = hashlib.sha256()
    for path in _files():
        source.update(path.read_bytes())
    packages = [module.__version__ for module in (jax, jaxlib.version, eqx, np)]
    return source.hexdigest(), platform.python_version(), *packages


def _is_edited() -> bool:
    """Return whether the source is not that which was loaded, or is not there."""
    times = [os.stat(path).st_mtime for path in _files()]
    return not times or max(times) > _STARTED.timestamp()


@cache
def _files() -> list[Path]:
    return sorted(Path(__file__).parents[1].rglob("*.py"))


def _state(names: Iterable[str]) -> Iterator[Any]:
    """Yield what modules of jaxstab, and those that they refer to, hold in memory.

    It differs from what their source says where somebody has replaced a function or a constant.
    """
    left, seen = sorted(set(filter(_is_own_name, names))), set()
    while left:
        module = left.pop()
        seen.add(module)
        for key, value in vars(sys.modules[module]).items():
            if key.startswith("__"):
                continue
            yield module, key, *_told(value)
            if isinstance(value, type) and value.__module__ == module:
                for name, attribute in vars(value).items():
                    yield module, key, name, *_told(attribute)
            home = value.__name__ if isinstance(value, ModuleType) else _home(value)
            if home not in seen and home not in left and _is_own_name(home):
                left.append(home)


def _told(value: Any) -> Iterator[Any]:
    """Yield what tells a value from another that replaces it."""
    if isinstance(value, property):
        value = value.fget
    if isinstance(value, classmethod | staticmethod):
        value = value.__func__
    if isinstance(value, tuple):
        for part in value:
            yield from _told(part)
    elif isinstance(value, bool | int | float | complex | str | bytes | None):
        yield value
    elif hasattr(value, "__qualname__") and (home := _home(value)) != "None":
        if home.partition(".")[0] not in _IMPORTED:
            raise Unknown(value)
        yield f"{home}:{value.__qualname__}"
    else:
        yield type(value).__qualname__


def _home(value: Any) -> str:
    return str(getattr(value, "__module__", None))


def _is_own(value: Any) -> bool:
    return _is_own_name(_home(value))


def _is_own_name(module: str) -> bool:
    return module.partition(".")[0] == _PACKAGE and module in sys.modules


class Pickler(pickle.Pickler):
    """Writes what each process knows, and refuses all else.

    Attributes:
        modules: where the functions and classes lie that it has written.
    """

    def __init__(self, file: BytesIO):
        super().__init__(file)
        self.modules: set[str] = set()

    def reducer_override(self, value: Any) -> Any:
        """Refuse a value, or write it by its name if it is a constant."""
        is_named = isinstance(value, type) or callable(value)
        is_known = _home(value).partition(".")[0] in _KNOWN
        if isinstance(value, Formula) or (is_named and not is_known):
            raise Unknown(value)
        if is_named:
            self.modules.add(_home(value))
        return _constant(value) or NotImplemented


class _NamePickler(Pickler):
    """Writes a law as what it computes."""

    def reducer_override(self, value: Any) -> Any:
        """Write laws and JAX's own primitives, refuse those of others."""
        if isinstance(value, Formula):
            raise Unknown(value)
        if isinstance(value, jax.extend.core.Primitive):
            if id(value) not in _PRIMITIVES:
                raise Unknown(value)
            return str, (value.name,)
        return super().reducer_override(value)


def _constant(value: Any) -> str | None:
    """Return the name of a constant of equinox, which compares these by identity."""
    module = type(value).__module__
    if not module.startswith("equinox."):
        return None
    return next((name for name, other in vars(sys.modules[module]).items() if other is value), None)


def read(path: Path) -> bytes | None:
    """Return what is in a file, None if that is not what was written."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    with suppress(OSError):
        # The files read last are the last to be dropped.
        path.touch()
    digest, text = content[:_DIGEST_SIZE], content[_DIGEST_SIZE:]
    return text if digest == hashlib.sha256(text).digest() else None


def write(path: Path, text: bytes) -> None:
    """Write a file, whole or not at all."""
    if len(text) > _MAX_SIZE:
        return
    part = path.with_name(f"{path.name}.{os.getpid()}.{threading.get_ident()}")
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        _drop_oldest(path.parent, _MAX_SIZE - len(text))
        try:
            part.write_bytes(hashlib.sha256(text).digest() + text)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


def _drop_oldest(folder: Path, max_size: int) -> None:
    """Delete the files that were not read for longest, until the rest take no more room."""
    files = []
    for path in folder.iterdir():
        # Another process may have deleted it.
        with suppress(FileNotFoundError):
            files.append((path.stat(), path))
    size = sum(stat.st_size for stat, _ in files)
    for stat, path in sorted(files, key=lambda file: file[0].st_mtime):
        if size <= max_size:
            return
        path.unlink(missing_ok=True)
        size -= stat.st_size

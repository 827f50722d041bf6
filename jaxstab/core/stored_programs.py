"""Programs, traced and lowered, kept in JAX's cache folder for later processes.

JAX keeps what its compiler makes of a program's text, and to have the text takes longer than to
load what was made of it. Here texts are kept. The name of one is made of all that it follows from:
the source of jaxstab, the function, the structure and shapes of its arguments, the formula of a
law, the settings of JAX. Where something else may matter, such as a class of the user's or a custom
derivative rule, nothing is kept.
"""

import hashlib
import inspect
import os
import pickle
import platform
import sys
from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, partial
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from tempfile import mkstemp
from typing import Any

import equinox as eqx
import jax
import jaxlib.version
import numpy as np
from jax import export
from jax.tree_util import PyTreeDef, register_static

from jaxstab.core.closures import Formula

_PACKAGE = __name__.partition(".")[0]
# Whose functions and classes do what follows from the versions of the packages.
_KNOWN = {_PACKAGE, "builtins", "collections", "equinox", "functools", "jax", "jaxlib", "numpy"}
# Of all texts together [bytes].
_MAX_SIZE = 100_000_000
# The text of a program that can have none.
_NONE = b""
_DIGEST_SIZE = hashlib.sha256().digest_size
# Where these are on, `jax.jit` looks at the results or does not compile.
_WATCHED = ("jax_debug_nans", "jax_debug_infs", "jax_disable_jit")


class StoredProgram:
    """A function compiled by `jax.jit`, whose text is looked for before it is traced."""

    def __init__(
        self, function: Callable[..., Any], compiler_options: dict[str, Any], **options: Any
    ):
        """Take a function, and the options of `jax.jit`."""
        self._function = function
        self._compiled = partial(jax.jit, compiler_options=compiler_options)
        self._jit: Any = self._compiled(function, **options)
        self._programs: dict[Hashable, _Program] = {}
        names = list(inspect.signature(function).parameters)
        static = options.get("static_argnames", ())
        self._static = {static} if isinstance(static, str) else set(static)
        if "static_argnums" in options:
            self._static.add(names[options["static_argnums"]])
        self._static |= {place for place, name in enumerate(names) if name in self._static}

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Return what the function returns."""
        if not can_compile_ahead():
            return self._jit(*args, **kwargs)
        leaves, structure = jax.tree.flatten(self._marked(args, kwargs))
        program = self._program(structure, leaves)
        return jax.tree.unflatten(program.out, program.compiled(*leaves))

    def ahead(self, *args: Any, **kwargs: Any) -> Any:
        """Begin to compile, and return the shapes of what the function returns.

        Some or all arguments may be shapes.
        """
        leaves, structure = jax.tree.flatten(self._marked(args, kwargs))
        program = self._program(structure, leaves)
        program.compile_ahead()
        return jax.tree.unflatten(program.out, program.shapes)

    def clear_cache(self) -> None:
        """Drop what is compiled."""
        self._jit.clear_cache()
        self._programs.clear()

    def _marked(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """Return the arguments as a pytree of those that are not static."""
        marked = {
            key: _Static(arg) if key in self._static else arg
            for key, arg in [*enumerate(args), *kwargs.items()]
        }
        return [marked[i] for i in range(len(args))], {name: marked[name] for name in kwargs}

    def _program(self, structure: PyTreeDef, leaves: list[Any]) -> "_Program":
        """Return the program for arguments of some structure, and leaves of some shapes."""
        shapes = [_shape(leaf) for leaf in leaves]
        kind = structure, tuple((leaf.shape, leaf.dtype, leaf.weak_type) for leaf in shapes)
        kind = *kind, _settings()
        if kind not in self._programs:
            self._programs[kind] = self._lowered(kind, structure, shapes)
        return self._programs[kind]

    def _lowered(
        self, kind: tuple[Any, ...], structure: PyTreeDef, shapes: list[jax.ShapeDtypeStruct]
    ) -> "_Program":
        """Return the program by its text in the folder, or else by one that is left there."""
        folder, name = _folder(), self._name(*kind)
        if folder is None or name is None:
            return self._traced(structure, shapes)[1]
        text = _read(folder / name)
        if text is None:
            text, program = self._text(structure, shapes)
            _write(folder / name, text)
            if text == _NONE:
                return program
        elif text == _NONE:
            return self._traced(structure, shapes)[1]
        out, code = pickle.loads(text)
        call = export.deserialize(code).call
        compiled = self._compiled(_named(lambda *leaves: call(*leaves), self._function))
        return _Program(compiled.trace(*shapes), out)

    def _traced(self, structure: PyTreeDef, shapes: list[jax.ShapeDtypeStruct]) -> Any:
        """Return the function on the leaves of its arguments, and its program."""
        out = []

        def on_leaves(*leaves: Any) -> list[Any]:
            args, kwargs = jax.tree.map(
                lambda arg: arg.value if isinstance(arg, _Static) else arg,
                jax.tree.unflatten(structure, leaves),
                is_leaf=lambda arg: isinstance(arg, _Static),
            )
            found, tree = jax.tree.flatten(self._function(*args, **kwargs))
            out.append(tree)
            return found

        compiled = self._compiled(_named(on_leaves, self._function))
        return compiled, _Program(compiled.trace(*shapes), *out)

    def _text(
        self, structure: PyTreeDef, shapes: list[jax.ShapeDtypeStruct]
    ) -> tuple[bytes, "_Program"]:
        """Return the text of a program, and the program.

        The text is empty where it does more than to compute, or where JAX cannot write it.
        """
        compiled, program = self._traced(structure, shapes)
        if not program.traced.jaxpr.effects:
            # What JAX cannot write, it says by errors of many kinds.
            with suppress(Exception):
                code = export.export(compiled)(*shapes).serialize()
                return _written((program.out, bytes(code)), _Pickler), program
        return _NONE, program

    def _name(self, structure: PyTreeDef, shapes: Any, settings: Any) -> str | None:
        """Return a name that no other program has, None if there can be none."""
        module, function = self._function.__module__, self._function.__qualname__
        if not _is_known(self._function) or "<" in function:
            return None
        named = module, function, structure, list(map(str, shapes)), settings, _versions()
        try:
            return hashlib.sha256(_written(named, _NamePickler)).hexdigest()
        except _CANNOT_PICKLE:
            return None


class _Program:
    """A program on the leaves of its arguments.

    Attributes:
        traced: the program, before it is compiled.
        out: the structure of what it returns.
    """

    def __init__(self, traced: Any, out: PyTreeDef):
        self.traced, self.out = traced, out
        self._future: Future[Any] | None = None

    @property
    def shapes(self) -> list[jax.ShapeDtypeStruct]:
        """The shapes of the leaves of what it returns."""
        return list(map(_shape_of, self.traced.jaxpr.out_avals))

    def compile_ahead(self) -> None:
        """Begin to compile it in another thread."""
        if self._future is None:
            # Settings that hold in this thread alone are those of what is traced and lowered.
            self._future = _threads().submit(self.traced.lower().compile)

    @cached_property
    def compiled(self) -> Callable[..., list[Any]]:
        """The program, compiled."""
        if self._future is not None:
            return self._future.result()
        return self.traced.lower().compile()


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(2, thread_name_prefix=_PACKAGE)


def _shape(leaf: Any) -> jax.ShapeDtypeStruct:
    return leaf if isinstance(leaf, jax.ShapeDtypeStruct) else _shape_of(jax.typeof(leaf))


def _shape_of(aval: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(aval.shape, aval.dtype, weak_type=aval.weak_type)


@register_static
@dataclass(frozen=True)
class _Static:
    """A static argument."""

    value: Any


def _folder() -> Path | None:
    """Return the folder of texts, None if none are to be kept."""
    folder = jax.config.values["jax_compilation_cache_dir"]
    is_off = not jax.config.values["jax_enable_compilation_cache"]
    is_off |= os.environ.get("JAXSTAB_CACHE") == "0"
    if not folder or "://" in folder or is_off or not _can_write():
        return None
    return Path(folder) / _PACKAGE


def can_compile_ahead() -> bool:
    """Return whether programs may be compiled ahead of time: JAX finds one device, a CPU.

    Results by a text are bound to a device.
    """
    is_watched = any(getattr(jax.config, name) for name in _WATCHED)
    return not is_watched and [device.platform for device in jax.devices()] == ["cpu"]


@cache
def _can_write() -> bool:
    # JAX writes and reads texts by it.
    return find_spec("flatbuffers") is not None


def _settings() -> tuple[Hashable, ...]:
    return tuple(getattr(jax.config, name) for name in _names_of_settings())


@cache
def _names_of_settings() -> list[str]:
    """Return the names of all settings of JAX, save those of its cache."""
    names = [name for name in jax.config.values if "cache" not in name]
    return [name for name in names if hasattr(jax.config, name)]


@cache
def _versions() -> tuple[str, ...]:
    """Return what tells which code makes the texts."""
    source = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        source.update(path.read_bytes())
    packages = [module.__version__ for module in (jax, jaxlib.version, eqx, np)]
    return source.hexdigest(), platform.python_version(), *packages


def _is_known(value: Any) -> bool:
    return (getattr(value, "__module__", None) or "").partition(".")[0] in _KNOWN


_CANNOT_PICKLE = pickle.PicklingError, AttributeError, TypeError


class _Pickler(pickle.Pickler):
    """Writes what each process knows, and refuses all else."""

    def reducer_override(self, value: Any) -> Any:
        is_named = isinstance(value, type) or callable(value)
        if isinstance(value, Formula) or (is_named and not _is_known(value)):
            raise pickle.PicklingError(f"{value!r} is not known to all processes.")
        return _constant(value) or NotImplemented


class _NamePickler(_Pickler):
    """Writes a law as what it computes."""

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, Formula):
            return tuple, (value.structure,)
        return super().reducer_override(value)


def _constant(value: Any) -> str | None:
    """Return the name of a constant of equinox, which compares these by identity."""
    module = type(value).__module__
    if not module.startswith("equinox."):
        return None
    return next((name for name, other in vars(sys.modules[module]).items() if other is value), None)


def _written(value: Any, kind: type[_Pickler]) -> bytes:
    file = BytesIO()
    pickler = kind(file)
    # What is one object and what are two that are equal depends on what was done before.
    pickler.fast = True
    pickler.dump(value)
    return file.getvalue()


def _named(function: Callable[..., Any], like: Callable[..., Any]) -> Callable[..., Any]:
    function.__name__ = like.__name__
    return function


def _read(path: Path) -> bytes | None:
    """Return what is in a file, None if that is not what was written."""
    try:
        content = path.read_bytes()
        # The files read last are the last to be dropped.
        path.touch()
    except OSError:
        return None
    digest, text = content[:_DIGEST_SIZE], content[_DIGEST_SIZE:]
    return text if digest == hashlib.sha256(text).digest() else None


def _write(path: Path, text: bytes) -> None:
    """Write a file, whole or not at all."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        _drop_oldest(path.parent, _MAX_SIZE - len(text))
        number, name = mkstemp(dir=path.parent)
        try:
            with os.fdopen(number, "wb") as file:
                file.write(hashlib.sha256(text).digest() + text)
            os.replace(name, path)
        finally:
            Path(name).unlink(missing_ok=True)


def _drop_oldest(folder: Path, max_size: int) -> None:
    """Delete the files that were not read for longest, until the rest take no more room."""
    with os.scandir(folder) as entries:
        files = [(entry.stat(), entry.path) for entry in entries]
    size = sum(stat.st_size for stat, _ in files)
    for stat, path in sorted(files, key=lambda file: file[0].st_mtime):
        if size <= max_size:
            return
        # Another process may have deleted it.
        Path(path).unlink(missing_ok=True)
        size -= stat.st_size

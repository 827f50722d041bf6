"""Programs that start outside of a trace: compiled ahead of time, side by side if need be.

JAX keeps compiled code by a program's text, and to make the text takes longer than to load the
code. So the texts are kept too (`program_texts`), and a process traces nothing that an earlier one
has traced.
"""

import inspect
import pickle
from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, partial
from io import BytesIO
from typing import Any

import jax
import jax.numpy as jnp
from jax import export
from jax.core import ShapedArray
from jax.tree_util import PyTreeDef, register_static

from jaxstab.core import program_texts

# Stands for the text where a program can have none.
_NO_TEXT = b""
# Settings under which `jax.jit` looks at results, or does not compile.
_WATCHED = ("jax_debug_nans", "jax_debug_infs", "jax_disable_jit")


def can_compile_ahead() -> bool:
    """Return whether programs are compiled ahead of time: where JAX finds one device, a CPU."""
    is_watched = any(getattr(jax.config, name) for name in _WATCHED)
    return not is_watched and [device.platform for device in jax.devices()] == ["cpu"]


class StoredProgram:
    """A function as `jax.jit` compiles it, whose text is kept for later processes."""

    def __init__(
        self, function: Callable[..., Any], compiler_options: dict[str, Any], **options: Any
    ):
        """Take a function, and the options of `jax.jit`."""
        self._function = function
        self._compiled = partial(jax.jit, compiler_options=compiler_options)
        self._jit: Any = self._compiled(function, **options)
        self._programs: dict[Hashable, _Program] = {}
        _all.append(self)
        names = list(inspect.signature(function).parameters)
        static = options.get("static_argnames", ())
        self._static = {static} if isinstance(static, str) else set(static)
        if "static_argnums" in options:
            self._static.add(names[options["static_argnums"]])
        self._static |= {place for place, name in enumerate(names) if name in self._static}

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Return what the function returns; no number in it is weakly typed."""
        if not can_compile_ahead():
            return self._jit(*args, **kwargs)
        leaves, structure = jax.tree.flatten(self._marked(args, kwargs))
        program = self._program(structure, leaves)
        return jax.tree.unflatten(program.out, program.compiled(*leaves))

    def ahead(self, *args: Any, **kwargs: Any) -> Any:
        """Begin to compile, and return the shapes of what the function returns.

        Arguments may be shapes, all or some of them.
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
            key: _Static(arg, type(arg).__name__) if key in self._static else arg
            for key, arg in [*enumerate(args), *kwargs.items()]
        }
        return [marked[i] for i in range(len(args))], {name: marked[name] for name in kwargs}

    def _program(self, structure: PyTreeDef, leaves: list[Any]) -> "_Program":
        """Return the program for arguments of some structure, and leaves of some shapes."""
        _drop_with_jax()
        kind = structure, tuple(map(_shape, leaves)), _settings()
        if kind not in self._programs:
            self._programs[kind] = self._lowered(*kind)
        return self._programs[kind]

    def _lowered(self, structure: PyTreeDef, shapes: Any, settings: Any) -> "_Program":
        """Return the program, by its text if that is kept, which otherwise it is from now on."""
        folder, inputs = program_texts.folder(), [_input(*shape) for shape in shapes]
        name = folder and program_texts.name_of(
            self._function, structure, [list(map(str, shape)) for shape in shapes], settings
        )
        if folder is None or name is None:
            return self._traced(structure, inputs)[1]
        text, program = program_texts.read(folder / name), None
        if text is None:
            text, program = self._text(structure, inputs)
            if text is not None:
                program_texts.write(folder / name, text)
        if text:
            # Whatever is wrong with a text, the program can be traced anew.
            with suppress(Exception):
                out, code = pickle.loads(text)
                call = export.deserialize(code).call
                compiled = self._compiled(_named(lambda *leaves: call(*leaves), self._function))
                return _Program(compiled.trace(*inputs), out)
        return program or self._traced(structure, inputs)[1]

    def _traced(self, structure: PyTreeDef, inputs: list[Any]) -> tuple[Any, "_Program"]:
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
            # A text would lose that a number is weakly typed.
            return [jnp.asarray(leaf, leaf.dtype) if _shape(leaf)[2] else leaf for leaf in found]

        compiled = self._compiled(_named(on_leaves, self._function))
        return compiled, _Program(compiled.trace(*inputs), *out)

    def _text(self, structure: PyTreeDef, inputs: list[Any]) -> tuple[bytes | None, "_Program"]:
        """Return the text of a program, if it can be had this time, and the program."""
        compiled, program = self._traced(structure, inputs)
        if program.traced.jaxpr.effects:
            # The Python functions that it calls are no part of a text.
            return _NO_TEXT, program
        file = BytesIO()
        try:
            code = export.export(compiled)(*inputs).serialize()
            program_texts.Pickler(file).dump((program.out, bytes(code)))
        except (MemoryError, OSError, RecursionError):
            return None, program
        except Exception:
            # What JAX cannot write, it says by errors of many kinds.
            return _NO_TEXT, program
        return file.getvalue(), program


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
        return [_input(*_shape(aval)) for aval in self.traced.jaxpr.out_avals]

    def compile_ahead(self) -> None:
        """Begin to compile it in another thread."""
        if self._future is None and "compiled" not in vars(self):
            # Here, since another thread may have other settings.
            lowered = self.traced.lower()
            # A process that ends takes no more tasks.
            with suppress(RuntimeError):
                self._future = _threads().submit(lowered.compile)

    @cached_property
    def compiled(self) -> Callable[..., list[Any]]:
        """The program, compiled."""
        future, self._future = self._future, None
        return self.traced.lower().compile() if future is None else future.result()


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(2, thread_name_prefix="jaxstab")


@register_static
@dataclass(frozen=True)
class _Static:
    """A static argument, which is not one of another type that equals it."""

    value: Any
    kind: str


def _shape(leaf: Any) -> tuple[tuple[int, ...], Any, bool]:
    """Return the shape and the dtype of a leaf, and whether it is weakly typed."""
    is_shape = isinstance(leaf, jax.ShapeDtypeStruct | ShapedArray)
    aval = leaf if is_shape else jax.typeof(leaf)
    return aval.shape, aval.dtype, bool(getattr(aval, "weak_type", False))


def _input(shape: tuple[int, ...], dtype: Any, is_weak: bool) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, dtype, weak_type=is_weak)


def _named(function: Callable[..., Any], like: Callable[..., Any]) -> Callable[..., Any]:
    function.__name__ = like.__name__
    return function


def _settings() -> tuple[Hashable, ...]:
    return tuple(getattr(jax.config, name) for name in _names_of_settings())


@cache
def _names_of_settings() -> list[str]:
    """Return the names of all settings of JAX, save those of its cache."""
    names = [name for name in jax.config.values if "cache" not in name]
    return [name for name in names if hasattr(jax.config, name)]


_all: list[StoredProgram] = []


def _drop_with_jax() -> None:
    """Drop all that is compiled, if `jax.clear_caches` has been called."""
    if _probe._cache_size() == 0:  # pyright: ignore[reportAttributeAccessIssue]
        for program in _all:
            program.clear_cache()
        _probe()


@jax.jit
def _probe() -> None:
    """Do nothing, but be dropped with all that JAX has compiled."""

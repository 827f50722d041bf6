"""The identity of a case, from the text of its functions and the values that they use."""

import dis
import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from hashlib import sha256
from importlib.metadata import version
from pathlib import PurePath
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxstab.core.closures import is_bare
from jaxstab.core.public_names import first_module
from jaxstab.core.warn import warn

_PACKAGES = ("jaxstab", "jax", "jaxlib", "equinox", "numpy")
_PLAIN = None | bool | int | float | complex | str | bytes | range | slice | PurePath | np.dtype
_GLOBAL = {"LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"}
# Functions of Python that take names from text.
_BY_TEXT = {"eval", "exec", "globals"}


def identity_of(case: Callable[..., Any]) -> dict[str, str]:
    """Return digests of a case and of all that it refers to in its own module, by name.

    Of functions the text counts, with defaults, attributes and the values that they close over; of
    values the type and the content; of other modules the names. Versions and the precision count
    too. It warns of functions that take names from text, which cannot be followed.

    Raises:
        TypeError: for a value whose content cannot be read.
        ValueError: where the source of a function is not found, or is no longer what runs.
    """
    reader = _Reader(getattr(inspect.unwrap(innermost(case)), "__globals__", {}))
    reader.add(getattr(case, "__name__", "case"), case)
    precision = {"jax_enable_x64": str(jax.config.values["jax_enable_x64"])}
    return reader.parts | {f"version of {name}": x for name, x in versions().items()} | precision


def versions() -> dict[str, str]:
    """Return the versions of the packages on which numbers depend."""
    return {name: version(name) for name in _PACKAGES}


def innermost(case: Any) -> Any:
    """Return the function within partial functions and methods."""
    names = {partial: "func", MethodType: "__func__"}
    while name := next((name for kind, name in names.items() if isinstance(case, kind)), None):
        case = getattr(case, name)
    return case


def source_of(case: Callable[..., Any]) -> str:
    """Return the text of the function of a case."""
    return _text_of(inspect.unwrap(innermost(case)))


def _text_of(function: FunctionType) -> str:
    code, name = function.__code__, function.__qualname__
    try:
        lines, _ = inspect.findsource(code)
    except (OSError, TypeError):
        raise ValueError(
            f"The source of `{name}` is not found, and a store identifies its study by it: write "
            "it in a file or in a cell of a notebook."
        ) from None
    if not _is_current(code, "".join(lines)):
        raise ValueError(
            f"`{name}` differs from its source in {code.co_filename}: import it anew, or restart "
            "Python."
        )
    if code.co_name == "<lambda>":
        return f"lambda {', '.join(inspect.signature(function).parameters)}: {_body(code, lines)}"
    return inspect.cleandoc("\n" + "".join(inspect.getblock(lines[code.co_firstlineno - 1 :])))


class _Reader:
    """Describes values, and collects digests of all that they refer to.

    Arguments:
        names: the globals of the module that counts as one's own.
    """

    def __init__(self, names: dict[str, Any]):
        self.names = names
        self.parts: dict[str, str] = {}
        # What functions and classes, which collect themselves, are described as.
        self._seen: dict[int, str] = {}

    def add(self, name: str, value: Any) -> None:
        """Collect a value under a name."""
        described = self.described(name, value)
        if described not in self._seen.values() and self.parts.get(name) != _digest(described):
            self.parts[self._free(name)] = _digest(described)

    def described(self, name: str, value: Any) -> str:
        """Return a description of a value; `name` is its name in errors."""
        if isinstance(value, _PLAIN | Enum):
            return f"{type(value).__name__} {value!r}"
        if isinstance(value, np.ndarray | np.generic | jax.Array):
            return _array_text(value)
        if isinstance(value, ModuleType):
            return f"module {value.__name__}"
        if isinstance(value, type):
            return self._class(value)
        if callable(value) and self._is_own(inspect.unwrap(value)):
            return self._wrapped(name, value)
        parts = _parts_of(value)
        if parts is not None:
            described = [self.described(name, part) for part in parts]
            is_set = isinstance(value, set | frozenset)
            return f"{self._class(type(value))} {sorted(described) if is_set else described}"
        if callable(value) and hasattr(value, "__name__"):
            return f"{first_module(value)}.{value.__name__}"
        raise TypeError(
            f"The case refers to `{name}`, and a study cannot detect changes of it: "
            f"it is {type(value).__module__}.{type(value).__qualname__}. Refer to its numbers, as "
            "NumPy arrays for instance, or make it inside of the function."
        )

    def _is_own(self, value: Any) -> bool:
        return isinstance(value, FunctionType) and value.__globals__ is self.names

    def _wrapped(self, name: str, value: Any) -> str:
        """Describe a function and all its wrappers, with the attributes set on them."""
        while id(value) not in self._seen:
            self._seen[id(value)] = f"wrapper {name}"
            if self._is_own(value):
                self._function(value)
            # What JAX and Equinox set themselves is not the caller's.
            hidden = "__" if isinstance(value, FunctionType) else "_"
            attributes = {} if is_dataclass(value) else getattr(value, "__dict__", {})
            for key in sorted(key for key in attributes if not key.startswith(hidden)):
                self.add(f"{name}.{key}", attributes[key])
            value = getattr(value, "__wrapped__", value)
        return self._seen[id(inspect.unwrap(value))]

    def _function(self, function: FunctionType) -> None:
        name = self._free(function.__code__.co_qualname.rpartition("<locals>.")[-1])
        self._seen[id(function)] = f"function {name}"
        # Until the rest is known, so that no other has the name.
        self.parts[name] = ""
        text = _text_of(function)
        defaults = [function.__defaults__, function.__kwdefaults__]
        self.parts[name] = _digest(text + self.described(f"{name}: default", defaults))
        cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        for variable, cell in cells:
            self.add(variable, cell.cell_contents)
        decorators = set(re.findall(r"^\s*@(\w+)", text, re.MULTILINE))
        for variable in sorted(_global_names(function.__code__) | decorators):
            if variable in self.names:
                self.add(variable, self.names[variable])
            elif variable in _BY_TEXT:
                warn(
                    f"`{name}` calls `{variable}`: a study cannot detect changes of objects that a "
                    "text names. Refer to them by name in the code."
                )

    def _class(self, kind: type) -> str:
        if kind.__module__ != self.names.get("__name__"):
            return f"class {first_module(kind)}.{kind.__qualname__}"
        if id(kind) in self._seen:
            return self._seen[id(kind)]
        name = kind.__qualname__.rpartition("<locals>.")[-1]
        self._seen[id(kind)] = f"class {name}"
        texts = [self._class(base) for base in kind.__bases__]
        texts += sorted(vars(kind).get("__annotations__", {}))
        for key, value in sorted(vars(kind).items()):
            function = _method(value)
            if isinstance(function, FunctionType):
                # What dataclasses write themselves has no source.
                if function.__code__.co_filename != "<string>":
                    texts.append(f"{key} {self.described(f'{name}.{key}', function)}")
            elif not key.startswith(("__", "_abc")) and not inspect.isdatadescriptor(value):
                texts.append(f"{key} {self.described(f'{name}.{key}', value)}")
        self.parts[name] = _digest(str(texts))
        return self._seen[id(kind)]

    def _free(self, name: str) -> str:
        """Return a name that no other value has: names of lambdas and closures recur."""
        numbered = (f"{name} ({i})" for i in range(2, len(self.parts) + 3))
        return name if name not in self.parts else next(x for x in numbered if x not in self.parts)


def _parts_of(value: Any) -> list[Any] | None:
    """Return the parts of a value, None if they are unknown."""
    if isinstance(value, Mapping):
        return [part for pair in value.items() for part in pair]
    if isinstance(value, tuple | list | set | frozenset):
        return list(value)
    if is_bare(value):
        return [value.captured, value.formula.function]
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords]
    if isinstance(value, MethodType):
        return [value.__func__, value.__self__]
    if is_dataclass(value):
        names = [field.name for field in fields(value) if hasattr(value, field.name)]
        return [(name, getattr(value, name)) for name in names]
    return None


def _method(value: Any) -> Any:
    """Return the function of a method, however it is wrapped."""
    for attribute in ("__func__", "fget", "method", "__wrapped__"):
        value = getattr(value, attribute, value)
    return value


def _global_names(code: CodeType) -> set[str]:
    instructions = (x for inner in _codes(code) for x in dis.get_instructions(inner))
    return {x.argval for x in instructions if x.opname in _GLOBAL}


def _is_current(code: CodeType, text: str) -> bool:
    """Whether a file, which may have been edited since it was imported, still says this."""
    # Pytest rewrites what asserts.
    if any("@pytest_ar" in inner.co_names for inner in _codes(code)):
        return True
    try:
        return code in _codes(compile(text, code.co_filename, "exec", dont_inherit=True))
    except SyntaxError:
        return False


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _body(code: CodeType, lines: list[str]) -> str:
    """Return the text of a lambda, of which a line can hold several."""
    places: Any = [x for x in code.co_positions() if None not in x and x[2] != x[3]]
    (first, start), (last, end) = min(x[::2] for x in places), max(x[1::2] for x in places)
    text = "".join(lines[first - 1 : last]).encode()
    return text[start : len(text) - len(lines[last - 1].encode()) + end].decode()


def _array_text(array: Any) -> str:
    is_key = jnp.issubdtype(array.dtype, jax.dtypes.prng_key)
    values = np.asarray(jax.random.key_data(array) if is_key else array)
    if values.dtype.hasobject:
        return f"array {values.shape} {values.tolist()!r}"
    return f"array {array.dtype} {values.shape} {sha256(values.tobytes()).hexdigest()}"


def _digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:32]

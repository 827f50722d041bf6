"""What a function computes, in a form that is the same in every process: is it still the same?"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from hashlib import sha256
from pathlib import PurePath
from types import FunctionType, MethodType, ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxstab.core.closures import is_bare
from jaxstab.core.names import first_module
from jaxstab.core.warn import warn
from jaxstab.studies.cases import Case
from jaxstab.studies.definitions import definition, global_names, plain

_PLAIN = None | bool | int | float | complex | str | bytes | range | slice | PurePath | np.dtype


# Functions of Python that take names from text.
_BY_TEXT = {"eval", "exec", "globals"}


def fingerprint(function: Callable[..., Any]) -> dict[str, str]:
    """Return digests of a function and of all that it refers to in its own module, by name.

    Of functions the syntax counts, with defaults, attributes and what they close over; of values
    the type and the content; of what comes from other modules the name; and the precision of JAX.
    It warns of functions that take names from text, where nothing can follow them.

    Raises:
        TypeError: for a value of which the content cannot be told.
        ValueError: where the source of a function is not found, or is no longer what runs.
    """
    reader = _Reader(getattr(inspect.unwrap(innermost(function)), "__globals__", {}))
    reader.add(getattr(function, "__name__", "case"), function)
    reader.parts["jax_enable_x64"] = str(jax.config.values["jax_enable_x64"])
    return reader.parts


def source_of(function: Callable[..., Any]) -> str:
    """Return the lines that a function is written on."""
    return definition(inspect.unwrap(innermost(function)))[1]


def differences(one: Mapping[str, str], other: Mapping[str, str]) -> list[str]:
    """Return the names of what differs between two fingerprints."""
    return [name for name in {**one, **other} if one.get(name) != other.get(name)]


def innermost(function: Any) -> Any:
    """Return the function within ready-made cases, partial functions and methods."""
    names = {Case: "build", partial: "func", MethodType: "__func__"}
    while name := next((name for kind, name in names.items() if isinstance(function, kind)), None):
        function = getattr(function, name)
    return function


class _Reader:
    """Describes values, and collects digests of what they refer to.

    Arguments:
        names: the globals of the module that counts as one's own.
    """

    def __init__(self, names: dict[str, Any]):
        self.names = names
        self.parts: dict[str, str] = {}
        self._seen: dict[int, str] = {}
        self._with_attributes: set[int] = set()

    def add(self, name: str, value: Any) -> None:
        """Collect a value under a name."""
        described = self.described(name, value)
        # Functions and classes have collected themselves.
        if described not in (f"function {name}", f"class {name}"):
            digest = _digest(described)
            if self.parts.get(name) != digest:
                self.parts[self._free(name)] = digest

    def described(self, name: str, value: Any) -> str:
        """Return all that a value is; `name` is what to call it by in an error."""
        if isinstance(value, _PLAIN | Enum):
            return f"{type(value).__name__} {value!r}"
        if isinstance(value, Mapping):
            pairs = [
                (self.described(name, key), self.described(f"{name}[{key!r}]", x))
                for key, x in value.items()
            ]
            return f"{type(value).__name__} {pairs}"
        if isinstance(value, tuple | list | set | frozenset):
            parts = [self.described(f"{name}[{i}]", x) for i, x in enumerate(value)]
            parts = sorted(parts) if isinstance(value, set | frozenset) else parts
            return f"{type(value).__name__} {parts}"
        if isinstance(value, np.ndarray | np.generic | jax.Array):
            return _array_text(value)
        if is_bare(value):
            return self._described_parts(name, [value.captured, value.formula.function])
        if isinstance(value, partial):
            return self._described_parts(name, [value.func, value.args, value.keywords])
        if isinstance(value, MethodType):
            return self._described_parts(name, [value.__func__, value.__self__])
        if isinstance(value, ModuleType):
            return f"module {value.__name__}"
        if isinstance(value, type):
            return self._class(value)
        function = inspect.unwrap(value) if callable(value) else value
        if isinstance(function, FunctionType) and function.__globals__ is self.names:
            described = self._function(function)
            self._attributes(name, value)
            return described
        if is_dataclass(value):
            names = [field.name for field in fields(value) if hasattr(value, field.name)]
            inner = {field: getattr(value, field) for field in names}
            return f"{self._class(type(value))} {self.described(name, inner)}"
        if callable(value) and hasattr(value, "__name__"):
            return f"{first_module(value)}.{value.__name__}"
        raise TypeError(
            f"The case refers to `{name}`, of which a study cannot tell whether it has changed: "
            f"it is {type(value).__module__}.{type(value).__qualname__}. Refer to its numbers, as "
            "NumPy arrays for instance, or make it inside of the function."
        )

    def _described_parts(self, name: str, parts: list[Any]) -> str:
        return str([self.described(name, part) for part in parts])

    def _function(self, function: FunctionType) -> str:
        if id(function) in self._seen:
            return self._seen[id(function)]
        name = self._free(function.__qualname__.rpartition("<locals>.")[-1])
        self._seen[id(function)] = f"function {name}"
        self.parts[name] = ""
        node, _ = definition(function)
        defaults = [function.__defaults__ or (), function.__kwdefaults__ or {}]
        texts = [plain(node), self._described_parts(f"{name}: default", defaults)]
        self.parts[name] = _digest(str(texts))
        cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        for variable, cell in cells:
            self.add(variable, _content(cell))
        for variable in global_names(function, node):
            if variable in self.names:
                self.add(variable, self.names[variable])
            elif variable in _BY_TEXT:
                warn(
                    f"`{name}` calls `{variable}`: of what it refers to by names in text a study "
                    "cannot tell whether it has changed. Refer to it by name in the code."
                )
        return self._seen[id(function)]

    def _attributes(self, name: str, function: Any) -> None:
        """Collect what was set on a function and on those that it is wrapped in."""
        while function is not None and id(function) not in self._with_attributes:
            self._with_attributes.add(id(function))
            # What JAX and Equinox set themselves is not the caller's.
            hidden = "__" if isinstance(function, FunctionType) else "_"
            attributes = {} if is_dataclass(function) else getattr(function, "__dict__", {})
            for key, value in sorted(attributes.items()):
                if not key.startswith(hidden):
                    self.add(f"{name}.{key}", value)
            function = getattr(function, "__wrapped__", None)

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


def _method(value: Any) -> Any:
    """Return the function of a method, however it is wrapped."""
    for attribute in ("__func__", "fget", "method", "__wrapped__"):
        value = getattr(value, attribute, value)
    return value


def _content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:
        return None


def _array_text(array: Any) -> str:
    is_key = jnp.issubdtype(array.dtype, jax.dtypes.prng_key)
    values = np.asarray(jax.random.key_data(array) if is_key else array)
    if values.dtype.hasobject:
        return f"array {values.shape} {values.tolist()!r}"
    return f"array {array.dtype} {values.shape} {sha256(values.tobytes()).hexdigest()}"


def _digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:32]

"""Pytrees as named arrays and a structure in JSON, and back.

Classes of jaxstab are kept by their public name, others by their import path. So one's own laws,
solids and loads come back too, in a program that has imported their module; a file imports nothing.
Bare functions have no path: of these only the name is kept.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, NoReturn

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, PyTree

import jaxstab
from jaxstab import potentials, results, solids, solvers
from jaxstab.core.closures import BareFunction
from jaxstab.core.enumeration import Enumeration
from jaxstab.core.grid import Mesh
from jaxstab.core.history import History
from jaxstab.core.units import Units, declared_dimensions

# A structure is JSON, as Python objects.
Structure = Any
# These parts of a path are left out of names.
_SILENT = {"contact", "equilibrium", "stability", "observables", "value", "table", "code"}
_SINGULAR = {"jumps": "jump", "turns": "turn", "minima": "minimum"}
# Totals of a path get the prefix "total", beside the sums up to each state.
_TOTALS = {("work",), ("dissipation",)}
# Files know classes of this package by these names of modules, so that inner modules can move. Each
# stands for the rooms beside it, the first one for the root too.
_PACKAGE = jaxstab.__name__
_PUBLIC = {
    _PACKAGE: (results, solvers, solids),
    potentials.__name__: (potentials,),
    solids.__name__: (solids,),
}


class LostFunction(eqx.Module):
    """A function, of a law or a solid, of which a file holds the name but no formula."""

    name: str = eqx.field(static=True)

    def __call__(self, *arguments: object) -> NoReturn:
        """Raise `ValueError`, since nothing is known but values."""
        module, is_class, _ = self.name.partition(":")
        cure = "Give a law"
        if is_class:
            cure = f"Import {module} before jaxstab.load, or give a law"
        raise ValueError(
            f"Of `{self.name}` the file holds values only, no formula. {cure} to "
            "jaxstab.load(path, potential=...); for a solid, build the contact anew."
        )


@dataclass(frozen=True)
class NamedArray:
    """An array of a pytree.

    Attributes:
        values: numbers or words.
        dims: the names of its axes.
        path: the fields that lead to it.
        dimension: the dimension that its field declares, "" for none.
    """

    values: np.ndarray
    dims: tuple[str, ...]
    path: tuple[str, ...]
    dimension: str


class Recorder:
    """The arrays of pytrees by name, `records`, and the columns of histories, `indicators`."""

    def __init__(self, grid: Mesh):
        self.grid = grid
        self.records: dict[str, NamedArray] = {}
        self.indicators: dict[str, list[str]] = {}

    def structure(
        self,
        value: PyTree,
        path: tuple[str, ...],
        axes: tuple[str, ...] = (),
        axes_of: Mapping[str, tuple[str, ...]] | None = None,
        dimensions: Sequence[str] = (),
    ) -> Structure:
        """Record the arrays of a pytree at a path of fields, and return its structure.

        All of its arrays have the given leading axes, except for the given fields.
        """
        dimension = (*dimensions, "")[0]
        if value is None or isinstance(value, jax.sharding.Sharding):
            # Restored arrays lie on one device.
            return None
        if isinstance(value, Enumeration):
            array = self._array(value.name, path, axes, dimension)
            return {"members": type(value).__name__, **array}
        if isinstance(value, jax.Array | np.ndarray | np.generic):
            return self._array(value, path, axes, dimension)
        if isinstance(value, bool | int | float | str):
            return {"value": value}
        if isinstance(value, Units):
            return {"units": list(value)}
        if type(value) in (tuple, list):
            parts = [
                self.structure(x, (*path, str(i)), axes, None, dimensions[i:])
                for i, x in enumerate(value)
            ]
            return {type(value).__name__: parts}
        if isinstance(value, dict):
            parts = {key: self.structure(x, (*path, key), axes) for key, x in value.items()}
            return {"dict": parts}
        if isinstance(value, BareFunction):
            return {"function": repr(value)}
        kind = type(value).__qualname__
        if "<locals>" in kind or not isinstance(value, eqx.Module):
            return {"function": kind}
        parts = {field.name: getattr(value, field.name) for field in fields(value)}

        def has_parts(part: object) -> bool:
            return isinstance(part, eqx.Module) and not isinstance(part, Enumeration)

        # A module's own arrays have a name before those of its parts: its result is `result`.
        contents = {
            name: self.structure(
                part,
                (*path, name),
                (axes_of or {}).get(name, axes),
                None,
                declared_dimensions(type(value)).get(name, ()),
            )
            for name, part in sorted(parts.items(), key=lambda item: has_parts(item[1]))
        }
        if isinstance(value, History):
            self.indicators[contents["table"]["array"]] = ["step", *value.names]
        return {"class": _name_of(type(value)), "fields": contents}

    def _array(
        self,
        array: Array | np.ndarray | np.generic,
        path: tuple[str, ...],
        axes: tuple[str, ...],
        dimension: str,
    ) -> Structure:
        values = np.asarray(array)
        words = [_SINGULAR.get(word, word) for word in path]
        if path in _TOTALS and not axes:
            words.insert(0, "total")
        name = "_".join([word for word in words if word not in _SILENT]) or path[-1]
        dims = (*axes, *self._own_dims(name, path, values.shape[len(axes) :]))
        record = NamedArray(values, dims, path, dimension)
        if name in self.records and not _is_same(self.records[name], record):
            name = "_".join(words)
        # A field `k_0` and the first of a tuple `k` have one name.
        while name in self.records and not _is_same(self.records[name], record):
            name += "_"
        self.records[name] = record
        return {"array": name}

    def _own_dims(
        self, name: str, path: tuple[str, ...], shape: tuple[int, ...]
    ) -> tuple[str, ...]:
        if path[-2:] == ("history", "table"):
            return ("record", f"{name}_indicator")
        sides = len(self.grid.shape)
        if shape[-sides:] == self.grid.shape:
            own = tuple(f"{name}_{i}" for i in range(len(shape) - sides))
            return (*own, *self.grid.sides[:sides])
        if path[-2:] == ("grid", "lengths") and len(shape) == 1:
            return ("side",)
        return tuple(f"{name}_{i}" for i in range(len(shape)))


def restore(structure: Structure, arrays: Mapping[str, np.ndarray]) -> PyTree:
    """Return the pytree of a structure and its arrays."""
    if structure is None:
        return None
    match structure:
        case {"members": str(name), "array": str(array)}:
            members = _public(f"{_PACKAGE}:{name}")
            if not (isinstance(members, type) and issubclass(members, Enumeration)):
                raise ValueError(f"{name} of the file is no enumeration of jaxstab.")
            return members(_codes_of(_find_array(array, arrays), members.names.tolist()))
        case {"array": str(name)}:
            return jax.device_put(_find_array(name, arrays))
        case {"value": bool() | int() | float() | str() as value}:
            return value
        case {"units": list(parts)}:
            return Units(*parts)
        case {"tuple": list(parts)}:
            return tuple(restore(part, arrays) for part in parts)
        case {"list": list(parts)}:
            return [restore(part, arrays) for part in parts]
        case {"dict": dict(parts)}:
            return {key: restore(part, arrays) for key, part in parts.items()}
        case {"function": str(name)}:
            return LostFunction(name)
        case {"class": str(path), "fields": dict(contents)}:
            return _module(path, contents, arrays)
    raise ValueError("The structure of the file cannot be read: it was changed.")


def _module(path: str, contents: dict[str, Structure], arrays: Mapping[str, np.ndarray]) -> PyTree:
    """Return a module of a class, which is neither imported nor called."""
    found = _class(path)
    defaults = {field.name: field.default for field in fields(found)}
    # A file may be older than a field that has a default.
    absent = {name: default for name, default in defaults.items() if name not in contents}
    if MISSING in absent.values() or not set(contents) <= set(defaults):
        raise ValueError(
            f"{path} has the fields {', '.join(defaults)}, in the file "
            f"{', '.join(contents)}: it was written with another version of the class."
        )
    module = object.__new__(found)
    found_fields = {name: restore(part, arrays) for name, part in contents.items()}
    for name, value in {**absent, **found_fields}.items():
        object.__setattr__(module, name, value)
    return module


def lost_classes(structure: Structure) -> list[str]:
    """Return the classes of a structure that cannot be found."""
    lost = []
    for path in [part["class"] for part in _parts(structure) if "class" in part]:
        try:
            _class(path)
        except ValueError:
            lost.append(path)
    return lost


def _find_array(name: str, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    if name not in arrays:
        raise ValueError(f"The file lacks {name}: it was changed since it was written.")
    return arrays[name]


def _class(path: str) -> type:
    """Return a class of a module that the program has imported.

    A file can name anything, and to import it would run its code.
    """
    module, _, name = path.partition(":")
    is_own = module.partition(".")[0] == _PACKAGE
    if not is_own and module not in sys.modules:
        raise ValueError(
            f"The file names the class {path}, and a file imports no module: if you trust it, "
            f"write `import {module}` before jaxstab.load, or give the option --import."
        )
    found: object
    if is_own:
        found = _public(path)
    else:
        found = sys.modules[module]
        for part in name.split("."):
            # `getattr` may import, a look-up in `__dict__` cannot.
            found = getattr(found, "__dict__", {}).get(part)
    if found is None:
        raise ValueError(f"The class {path} of the file is not found: define it.")
    if not (isinstance(found, type) and issubclass(found, eqx.Module)):
        raise ValueError(f"{path} of the file is no equinox.Module.")
    return found


def _name_of(kind: type) -> str:
    """Return "module:name" of a class: where it is public, or where it lies."""
    names = [f"{module}:{kind.__qualname__}" for module in (*_PUBLIC, kind.__module__)]
    return next((name for name in names if _public(name) is kind), names[-1])


def _public(path: str) -> object:
    """Return the object of a public "module:name", None if there is none."""
    name, _, word = path.partition(":")
    if name == _PACKAGE and word in jaxstab.__all__:
        return getattr(jaxstab, word)
    return next((vars(room)[word] for room in _PUBLIC.get(name, ()) if word in vars(room)), None)


def _codes_of(words: np.ndarray, names: list[str]) -> np.ndarray:
    unknown = set(words.ravel().tolist()) - set(names)
    if unknown:
        raise ValueError(f"{', '.join(unknown)} in the file is not one of {', '.join(names)}.")
    numbers = [names.index(word) for word in words.ravel().tolist()]
    return np.array(numbers, np.int32).reshape(words.shape)


def _is_same(one: NamedArray, other: NamedArray) -> bool:
    # A sweep and its equilibria hold the same load.
    same_kind = one.dims == other.dims and one.values.dtype == other.values.dtype
    return "load" in one.path and same_kind and one.values.tobytes() == other.values.tobytes()


def functions_of(structure: Structure) -> list[str]:
    """Return the names of the bare functions in a structure."""
    return [part["function"] for part in _parts(structure) if set(part) == {"function"}]


def _parts(structure: Structure) -> Iterator[dict[str, Structure]]:
    """Yield a structure and its nested structures."""
    if isinstance(structure, dict):
        yield structure
        structure = list(structure.values())
    if isinstance(structure, list):
        for part in structure:
            yield from _parts(part)

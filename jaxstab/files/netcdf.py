"""Results on disk, as NetCDF."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self, cast, overload, runtime_checkable

import jax
import numpy as np
from jax.typing import DTypeLike

import jaxstab
from jaxstab import loading
from jaxstab.contact import Contact
from jaxstab.core import checked_netcdf
from jaxstab.core.checked_netcdf import Attributes, Content, Damaged, Variable
from jaxstab.core.checks import require_kind
from jaxstab.core.optional_packages import NETCDF, require_packages
from jaxstab.core.warn import warn
from jaxstab.evolution import Evolution
from jaxstab.files.dataset import FORMAT, Result, common_attributes, to_dataset
from jaxstab.files.records import LostFunction, Structure, functions_of, lost_classes, restore
from jaxstab.files.tabulated_law import require_same_law
from jaxstab.potentials import Potential, as_module

if TYPE_CHECKING:
    import xarray

# The first bytes of a NetCDF file.
_MAGIC = b"\x89HDF"
# The attribute that names the class of an object written alone.
_CLASS = "class"
_PACKAGE = jaxstab.__name__


@runtime_checkable
class _Described(Protocol):
    """An object that a data set describes whole, such as the fit of a force curve."""

    def to_dataset(self) -> xarray.Dataset: ...

    @classmethod
    def from_dataset(cls, dataset: xarray.Dataset) -> Self: ...


@overload
def save(path: str | Path, contact: Contact, result: Result, *, fields: bool = True) -> Path: ...
@overload
def save(path: str | Path, contact: _Described) -> Path: ...
def save(
    path: str | Path,
    contact: Contact | _Described,
    result: Result | None = None,
    *,
    fields: bool = True,
) -> Path:
    """Write a contact and a result as NetCDF: the data set of `to_dataset`.

    A force curve or its fit is written alone, as in `jaxstab.save("fit.nc", fit)`.

    A law that is an `equinox.Module` is restored from the path of its class and its numbers. A
    bare function is kept only as a table of its values, and a warning says so.

    Arguments:
        path: the file; it must not exist yet.
        contact: the contact problem, or a force curve or its fit, without a result.
        result, fields: as in `to_dataset`.

    Returns:
        The path of the file, which is written completely or not at all.

    Raises:
        ValueError: if the name does not end in .nc, and as `to_dataset`.
        TypeError: for something that is not the path of a file.
        FileExistsError: if the file exists.
        OSError: if the disk is full or cannot be written to.
        ImportError: without xarray, h5netcdf and h5py.

    Example:
        >>> path = js.save("state.nc", contact, state)
        >>> print(path)
        state.nc
    """
    example = 'jaxstab.save("run.nc", contact, result)'
    require_kind(path, str | os.PathLike, f"no path: give the file first, as in {example}.")
    path = Path(path)
    if path.suffix != ".nc":
        raise ValueError(f"{path} does not end in .nc.")
    require_packages("NetCDF files", "data", *NETCDF)
    if isinstance(contact, _Described):
        if result is not None:
            raise TypeError(
                f"A {type(contact).__name__} is written alone: give no result beside it."
            )
        dataset = contact.to_dataset().assign_attrs(
            **common_attributes(), **_class_attribute(contact)
        )
    else:
        dataset = to_dataset(contact, cast(Any, result), fields=fields)
    lost = functions_of(json.loads(dataset.attrs.get("structure", "null")))
    if lost:
        warn(
            f"{path.name} holds values of `{lost[0]}`, no formula: to go on from it, give a law to "
            "jaxstab.load(path, potential=...), or write it, and a solid, as an equinox.Module of "
            "numbers and arrays that can be imported."
        )
    # Taken first, so that no other run can take the name.
    try:
        path.open("xb").close()
    except FileExistsError:
        left = "exists"
        if path.is_file() and not path.stat().st_size:
            left = "is empty, perhaps left by a process that was killed"
        raise FileExistsError(f"{path} {left}: delete it, or give another name.") from None
    variables = {
        str(name): Variable(tuple(map(str, array.dims)), array.values, array.attrs)
        for name, array in dataset.variables.items()
    }
    try:
        content = Content(variables, dataset.attrs)
        checked_netcdf.write(path, content, may_be_renamed=True)
    except BaseException:
        path.unlink()
        raise
    return path


def load(path: str | Path, *, potential: Potential | None = None) -> Any:
    """Return the contact and the result that `save` wrote, to the last bit, on one device.

    A force curve or a fit that was written alone is returned alone.

    Loading runs no code: your own classes are restored if their module has been imported.

    Arguments:
        path: the file.
        potential: the law, if the file has only values of it, or its class is not imported.

    Returns:
        The contact, and the equilibrium, stability, sweep, path, critical load, branch, evolution,
        transition, detachment or observables. Without its law the contact serves for figures; a
        solver that needs the law raises an error.

    Raises:
        ValueError: for a file of another kind, of another format or without fields; for a file in
            double precision while JAX is set to single; for a law that disagrees with the file; for
            a class that is not imported, or of another version.
        FileNotFoundError: if there is no such file.
        ImportError: without xarray, h5netcdf and h5py.

    Example:
        >>> path = js.save("state.nc", contact, state)
        >>> contact, state = js.load(path)
        >>> f"{state.mean_pressure:.4f}"
        '-0.1768'
    """
    path = Path(path)
    require_packages("NetCDF files", "data", *NETCDF)
    if not path.exists():
        raise FileNotFoundError(f"There is no file {path}.")
    try:
        variables, attributes = checked_netcdf.read(path, may_be_renamed=True)
    except Damaged:
        # It may be of another program or format.
        _require_format(path, _attributes_of(path))
        raise ValueError(f"{path} was changed since it was written, or is damaged.") from None
    _require_format(path, attributes)
    if _CLASS in attributes:
        import xarray

        kind = _described_class(path, attributes[_CLASS])
        return kind.from_dataset(xarray.Dataset(variables, attrs=attributes))
    arrays = {name: variable.values for name, variable in variables.items()}
    structure = json.loads(attributes["structure"])
    is_double = any(a.dtype.kind in "fiu" and a.dtype.itemsize == 8 for a in arrays.values())
    if is_double and jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        raise ValueError(
            f"{path} is in double precision, which JAX would round to single: first of all, "
            'call jax.config.update("jax_enable_x64", True).'
        )
    fields = structure["contact"]["fields"]
    law = fields["potential"]
    fields["potential"] = None
    contact = restore(structure["contact"], arrays)
    law = _law(law, arrays, potential, contact.heights.dtype)
    object.__setattr__(contact, "potential", law)
    if not isinstance(law, LostFunction):
        require_same_law(contact, arrays, path)
    result = restore(structure["result"], arrays)
    if isinstance(result, Evolution):
        result = replace(result, contact=contact)
    if isinstance(result, loading.Path) and result.last_indentation is not None:
        result = replace(result, contact=contact.with_indentation(result.last_indentation))
    return contact, result


def attributes_of(path: str | Path) -> Attributes | None:
    """Return the attributes of a file that `save` wrote, None for any other file."""
    with Path(path).open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            return None
    attributes = _attributes_of(Path(path))
    if "versions" not in attributes:
        return None
    return attributes


def _attributes_of(path: Path) -> Attributes:
    """Return the attributes of a NetCDF file; `ValueError` if it is damaged where they are read."""
    require_packages("NetCDF files", "data", *NETCDF)
    try:
        return checked_netcdf.attributes_of(path)
    except OSError as error:
        message = f"{path} is no readable NetCDF file, or it is damaged."
        raise ValueError(message) from error


def _class_attribute(described: _Described) -> dict[str, str]:
    """Return the attribute that names a class by the package that its module lies in."""
    kind = type(described)
    return {_CLASS: f"{kind.__module__.rpartition('.')[0]}:{kind.__name__}"}


def _described_class(path: Path, name: str) -> type[_Described]:
    """Return a public class of this package by its name in a file."""
    module, _, word = name.partition(":")
    found = None
    if module.split(".")[0] == _PACKAGE and find_spec(module) is not None:
        room = import_module(module)
        found = getattr(room, word) if word in room.__all__ else None
    if not (isinstance(found, type) and issubclass(found, _Described)):
        raise ValueError(f"{path} names {name}, which is no class of jaxstab for files.")
    return found


def _require_format(path: Path, attributes: Attributes) -> None:
    if "versions" not in attributes:
        raise ValueError(f"{path} was not written by jaxstab.save.")
    if "structure" not in attributes and _CLASS not in attributes:
        raise ValueError(
            f"{path} was written with fields=False, so it cannot become a result: open it with "
            "xarray.open_dataset."
        )
    # Files written before version 0.3.0 have no number.
    number = int(attributes.get("format", 1))
    if number != FORMAT:
        raise ValueError(
            f"{path} is of format {number}, and this version reads format {FORMAT}: compute it "
            "anew, or read it with the version that wrote it, "
            f"jaxstab {json.loads(attributes['versions'])['jaxstab']}."
        )


def _law(
    structure: Structure,
    arrays: Mapping[str, np.ndarray],
    given: Potential | None,
    dtype: DTypeLike,
) -> Potential:
    if given is not None:
        return as_module(given, dtype)
    lost = functions_of(structure) + lost_classes(structure)
    if lost:
        return LostFunction(lost[0])
    return restore(structure, arrays)

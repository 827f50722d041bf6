"""NetCDF files in which every changed byte is found when they are read."""

import hashlib
import io
import json
import math
from collections.abc import Mapping
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxstab.core.atomic_write import write_whole

# The bytes of a digest of the whole file, behind those that HDF5 reads.
_DIGEST = 16
# The data type of words in NumPy.
_WORDS = "|O"
# Arrays of more numbers are compressed, those of fewer bytes in one piece.
_LARGE = 1000
_HUGE = 2**28
# The attribute of a file with the layout of its variables.
_LAYOUT = "layout"

Attributes = Mapping[str, Any]


class Damaged(OSError):
    """A file that is not, or no longer, the one that was written."""


class Variable(NamedTuple):
    """An array with the names of its dimensions and its attributes, its unit for instance."""

    dims: tuple[str, ...]
    values: np.ndarray
    attrs: Mapping[str, Any] = {}


Variables = dict[str, Variable]


class Content(NamedTuple):
    """The variables of a file, and its own attributes."""

    variables: Variables
    attrs: Attributes


def write(path: Path, content: Content, *, may_be_renamed: bool = False) -> None:
    """Write variables to a file; one that is named as its dimension is its coordinate.

    Unless the file may be renamed, it can be read under this name alone.
    """
    h5py = _h5py()
    stored = {}
    layout = {}
    for name, (dims, values, attrs) in content.variables.items():
        if values.dtype.kind == "b":
            values = values.astype("i1")
            attrs = {**attrs, "dtype": "bool"}
        if values.dtype.kind == "U":
            # HDF5 holds no zero byte and no half of a character, as in names of files.
            words = [x.replace("\0", r"\0").encode(errors="backslashreplace") for x in values.flat]
            # All engines of xarray read words of any length, not all of them words of fixed length.
            values = np.array(words, h5py.string_dtype()).reshape(values.shape)
        stored[name] = np.ascontiguousarray(values).reshape(values.shape)
        layout[name] = dims, values.shape, values.dtype.str, attrs
    # In memory first: on a full disk HDF5 ends the process. Closed as a file: before HDF5 2.0 the
    # image of an open one has a checksum that is wrong.
    image = io.BytesIO(_empty(json.dumps(layout), json.dumps(content.attrs)))
    with h5py.File(image, "r+") as file:
        for name, values in stored.items():
            if values.size:
                h5py.h5d.open(file.id, name.encode()).write(h5py.h5s.ALL, h5py.h5s.ALL, values)
    written = image.getvalue()
    write_whole(path, written + _digest(path, written, may_be_renamed))


def read(path: Path, largest: float = math.inf, *, may_be_renamed: bool = False) -> Content:
    """Return the content of a file, arrays of more bytes as zeros that take no memory.

    Raises:
        Damaged: if it is not as `write` wrote it.
        OSError: if it is not there, or cannot be read for another reason.
    """
    h5py = _h5py()
    variables = {}
    content = b""
    if not path.is_dir():
        content = path.read_bytes()
    image = content[:-_DIGEST]
    digest = content[-_DIGEST:]
    if _digest(path, image, may_be_renamed) != digest:
        raise Damaged(f"{path} is damaged, renamed or of another kind: its digest differs.")
    with h5py.File(h5py.h5f.open_file_image(image)) as file:
        for name, (dims, shape, dtype, attrs) in json.loads(file.attrs[_LAYOUT]).items():
            num_bytes = math.prod(shape) * np.dtype(dtype).itemsize
            is_read = num_bytes <= largest or dims == [name]
            values: Any = np.empty(shape, dtype) if is_read else np.zeros((), dtype)
            if dtype == _WORDS:
                values = np.array(file[name].asstr()[()]).astype(str)
            elif not is_read:
                values = np.broadcast_to(values, shape)
            elif num_bytes:
                h5py.h5d.open(file.id, name.encode()).read(h5py.h5s.ALL, h5py.h5s.ALL, values)
            # An attribute of this name of the user's own is no type of the numbers.
            if dtype == "|i1" and attrs.get("dtype") == "bool":
                values = values.astype(attrs.pop("dtype"))
            variables[name] = Variable(tuple(dims), values, attrs)
        return Content(variables, _attributes(file))


def attributes_of(path: Path) -> Attributes:
    """Return the attributes of a NetCDF file, of another program's too, which are not checked.

    Raises:
        OSError: if it is none, or damaged where it is read.
    """
    try:
        with _h5py().File(path) as file:
            return _attributes(file)
    except (KeyError, RuntimeError, UnicodeDecodeError) as error:
        raise OSError(str(error)) from error


def _attributes(file: Any) -> Attributes:
    """Return the attributes of an open file, without those of its format."""
    attrs = {name: x for name, x in file.attrs.items() if name[0] != "_" and name != _LAYOUT}
    # A number is stored as an array of one, and by older versions of h5netcdf as it is.
    is_number = {
        n for n, x in attrs.items() if isinstance(x, np.ndarray | np.generic) and x.size == 1
    }
    return {name: x.item() if name in is_number else x for name, x in attrs.items()}


@lru_cache(maxsize=64)
def _empty(layout: str, attributes: str) -> bytes:
    """Return a file with its structure, most of the work, and without its numbers."""
    import h5netcdf

    variables = json.loads(layout)
    image = io.BytesIO()
    pairs = [zip(dims, shape, strict=True) for dims, shape, *_ in variables.values()]
    text = layout.encode()
    # For other programs, which do not look at the digest: the first format with checksums of its
    # structure, to which Fletcher-32 adds checksums of the numbers.
    with h5netcdf.File(image, "w", libver=("v110", "v110")) as file:
        file.dimensions = {name: size for pair in pairs for name, size in pair}
        file.attrs.update(json.loads(attributes))
        file.attrs[_LAYOUT] = np.array(text, _h5py().string_dtype("utf-8", len(text)))
        for name, (dims, shape, dtype, attrs) in variables.items():
            options: dict[str, Any] = {}
            stored = np.dtype(dtype)
            size = math.prod(shape)
            if dtype == _WORDS:
                stored = _h5py().string_dtype()
            elif size and shape:
                options = {"chunks": True, "fletcher32": True}
                if size * stored.itemsize < _HUGE:
                    options["chunks"] = tuple(shape)
                if size > _LARGE:
                    options |= {"compression": "gzip", "compression_opts": 1, "shuffle": True}
            file.create_variable(name, dims, stored, **options).attrs.update(attrs)
    return image.getvalue()


def _h5py() -> Any:
    return import_module("h5py")


def _digest(path: Path, content: bytes, may_be_renamed: bool) -> bytes:
    key = b""
    if not may_be_renamed:
        key = path.name.encode()[:64]
    return hashlib.blake2b(content, key=key, digest_size=_DIGEST).digest()

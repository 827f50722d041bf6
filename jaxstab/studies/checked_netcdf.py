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

# The bytes of a digest of the whole file and its name, behind those that HDF5 reads.
_DIGEST = 16
# The data type of words in NumPy.
_WORDS = "|O"


class Damaged(OSError):
    """A file that is not, or no longer, the one that was written under its name."""


class Variable(NamedTuple):
    """An array with the names of its dimensions and its attributes, its unit for instance."""

    dims: tuple[str, ...]
    values: np.ndarray
    attrs: Mapping[str, Any] = {}


Variables = dict[str, Variable]


def write(path: Path, variables: Variables) -> None:
    """Write variables to a file; one that is named as its dimension is its coordinate."""
    h5py = _h5py()
    stored = {}
    layout = {}
    for name, (dims, values, attrs) in variables.items():
        if values.dtype.kind == "b":
            values = values.astype("i1")
            attrs = {**attrs, "dtype": "bool"}
        if values.dtype.kind == "U":
            # HDF5 holds no zero byte and no half of a character, as in names of files.
            words = [x.replace("\0", r"\0").encode(errors="backslashreplace") for x in values.flat]
            # All engines of xarray read words of any length, not all of them words of fixed length.
            values = np.array(words, h5py.string_dtype()).reshape(values.shape)
        stored[name] = np.ascontiguousarray(values)
        layout[name] = dims, values.shape, values.dtype.str, attrs
    image = h5py.h5f.open_file_image(_empty(json.dumps(layout)), h5py.h5f.ACC_RDWR)
    for name, values in stored.items():
        if values.size:
            h5py.h5d.open(image, name.encode()).write(h5py.h5s.ALL, h5py.h5s.ALL, values)
    h5py.h5f.flush(image)
    content = image.get_file_image()
    write_whole(path, content + _digest(path, content))


def read(path: Path, largest: float = math.inf) -> Variables:
    """Return the variables of a file, arrays of more bytes as zeros that take no memory.

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
    if _digest(path, image) != digest:
        raise Damaged(f"{path} is damaged, renamed or of another kind: its digest differs.")
    with h5py.File(h5py.h5f.open_file_image(image)) as file:
        for name, (dims, shape, dtype, attrs) in json.loads(file.attrs["layout"]).items():
            num_bytes = math.prod(shape) * np.dtype(dtype).itemsize
            is_read = num_bytes <= largest or dims == [name]
            values: Any = np.empty(shape, dtype) if is_read else np.zeros((), dtype)
            if dtype == _WORDS:
                values = file[name].asstr()[()].astype(str)
            elif not is_read:
                values = np.broadcast_to(values, shape)
            elif num_bytes:
                h5py.h5d.open(file.id, name.encode()).read(h5py.h5s.ALL, h5py.h5s.ALL, values)
            # An attribute of this name of the user's own is no type of the numbers.
            if dtype == "|i1" and attrs.get("dtype") == "bool":
                values = values.astype(attrs.pop("dtype"))
            variables[name] = Variable(tuple(dims), values, attrs)
    return variables


@lru_cache(maxsize=64)
def _empty(layout: str) -> bytes:
    """Return a file with its structure, most of the work, and without its numbers."""
    import h5netcdf

    variables = json.loads(layout)
    image = io.BytesIO()
    text = layout.encode()
    pairs = [zip(dims, shape, strict=True) for dims, shape, *_ in variables.values()]
    # The first format with checksums of its structure; Fletcher-32 adds checksums of numbers.
    with h5netcdf.File(image, "w", libver=("v110", "v110")) as file:
        file.dimensions = {name: size for pair in pairs for name, size in pair}
        file.attrs["layout"] = np.array(text, _h5py().string_dtype("utf-8", len(text)))
        for name, (dims, shape, dtype, attrs) in variables.items():
            options: dict[str, Any] = {}
            stored = np.dtype(dtype)
            if dtype == _WORDS:
                stored = _h5py().string_dtype()
            elif 0 not in shape:
                options = {"chunks": True, "fletcher32": True}
                if math.prod(shape) * stored.itemsize < 2**28:
                    options["chunks"] = tuple(shape)
            file.create_variable(name, dims, stored, **options).attrs.update(attrs)
    return image.getvalue()


def _h5py() -> Any:
    return import_module("h5py")


def _digest(path: Path, content: bytes) -> bytes:
    return hashlib.blake2b(content, key=path.name.encode()[:64], digest_size=_DIGEST).digest()

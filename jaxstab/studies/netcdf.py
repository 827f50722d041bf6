"""NetCDF files in which every changed byte is found when they are read."""

import hashlib
import io
import itertools
import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

# The first format of HDF5 that checks all but the numbers, for which there is Fletcher-32.
_FORMAT = ("v110", "v110")
# The bytes of a digest of the whole file, behind what HDF5 reads of it.
_DIGEST = 16
# Arrays of more bytes lie in several chunks.
_LARGEST_CHUNK = 2**28
# A dimension without a coordinate is an array of this kind that is not stored.
_NO_VARIABLE = ">f4"
_ID, _IDS = b"_Netcdf4Dimid", b"_Netcdf4Coordinates"
_HIDDEN = {b"CLASS", b"NAME", b"REFERENCE_LIST", b"DIMENSION_LIST", b"_Encoding", _ID, _IDS}


class Variable(NamedTuple):
    """An array with the names of its dimensions and its attributes, its unit for instance."""

    dims: tuple[str, ...]
    values: np.ndarray
    attrs: Mapping[str, Any] = {}


Variables = Mapping[str, Variable]


def encode(variables: Variables, auxiliary: tuple[str, ...] = ()) -> memoryview:
    """Return the bytes of a file.

    Arguments:
        variables: its variables by name; one that is named as its dimension is its coordinate.
        auxiliary: the names of further coordinates.
    """
    encoded = {name: _encoded(*variable) for name, variable in variables.items()}
    layout = tuple(
        (name, dims, values.shape, values.dtype, tuple(attrs.items()))
        for name, (dims, values, attrs) in encoded.items()
    )
    image = io.BytesIO(_empty(layout, auxiliary))
    with _opened(image, "r+") as file:
        for name, variable in encoded.items():
            if variable.values.size:
                file[name].write_direct(np.ascontiguousarray(variable.values))
    digest = _digest(image.getbuffer())
    image.seek(0, io.SEEK_END)
    image.write(digest)
    return image.getbuffer()


def decode(path: Path, largest: float, wanted: str) -> Variables:
    """Return the variables of a file; of those of more bytes, values of the wanted one only.

    Raises:
        OSError, RuntimeError, KeyError, ValueError: if the file is damaged.
    """
    # Python opens the file, so that errors of HDF5 are those of its content. Each call of its
    # plain interface takes a third of the time of the usual one.
    hdf5 = _hdf5()
    content = path.read_bytes() if largest == np.inf else b""
    if content and _digest(content[:-_DIGEST]) != content[-_DIGEST:]:
        raise ValueError("its digest is another one")
    with (
        io.BytesIO(content) if content else path.open("rb") as stream,
        _opened(stream, "r") as file,
    ):
        # Beside variables a file has the type of complex numbers, if there are some.
        stored = [name for name in file.id if not name.startswith(b"_PFNC")]
        datasets = {name.decode(): hdf5.h5d.open(file.id, name) for name in stored}
        scales = {name: x for name, x in datasets.items() if hdf5.h5a.exists(x, b"CLASS")}
        names = {int(_attribute(x, _ID)): name for name, x in scales.items()}
        return {
            name: _decoded(name, dataset, names, np.inf if name == wanted else largest)
            for name, dataset in datasets.items()
            if not (name in scales and dataset.dtype == _NO_VARIABLE)
        }


def _encoded(dims: tuple[str, ...], values: np.ndarray, attrs: Mapping[str, Any]) -> Variable:
    """Return words as arrays of letters, and booleans as integers, as xarray writes them."""
    if values.dtype.kind == "b":
        return Variable(dims, values.astype("i1"), {**attrs, "dtype": "bool"})
    if values.dtype.kind != "U":
        return Variable(dims, values, attrs)
    words = np.char.encode(values, "utf-8")
    length = max(words.dtype.itemsize, 1)
    letters = np.ascontiguousarray(words, f"S{length}").view("S1").reshape(*values.shape, length)
    return Variable((*dims, f"{length} letters"), letters, {**attrs, "_Encoding": "utf-8"})


def _decoded(name: str, dataset: Any, names: Mapping[int, str], largest: float) -> Variable:
    hdf5, keys = _hdf5(), []
    hdf5.h5a.iterate(dataset, keys.append)
    ids = _attribute(dataset, _IDS) if _IDS in keys else None
    dims = (name,) if ids is None else tuple(names[i] for i in ids.tolist())
    attrs = {key.decode(): _attribute(dataset, key) for key in keys if key not in _HIDDEN}
    dtype = attrs.pop("dtype", dataset.dtype)
    if dataset.dtype != "S1" and math.prod(dataset.shape) * dataset.dtype.itemsize > largest:
        return Variable(dims, np.broadcast_to(np.zeros((), dtype), dataset.shape), attrs)
    values = np.empty(dataset.shape, dataset.dtype)
    dataset.read(hdf5.h5s.ALL, hdf5.h5s.ALL, values)
    if dataset.dtype == "S1":
        words = values.view(f"S{dataset.shape[-1]}")[..., 0]
        return Variable(dims[:-1], np.char.decode(words, "utf-8"), attrs)
    return Variable(dims, values.astype(dtype, copy=False), attrs)


def _attribute(dataset: Any, key: bytes) -> Any:
    attribute = _hdf5().h5a.open(dataset, key)
    value: Any = np.empty(attribute.shape, attribute.dtype)
    attribute.read(value)
    value = value[0] if value.shape == (1,) and key != _IDS else value
    return value.item().decode() if value.dtype.kind == "S" else value


@lru_cache(maxsize=8)
def _empty(layout: tuple[Any, ...], auxiliary: tuple[str, ...]) -> bytes:
    """Return a file with its structure, most of the work, and without its numbers."""
    import h5netcdf

    def stored(value: Any) -> Any:
        """Return words of fixed length, which have checksums; others have none."""
        text = value.encode() if isinstance(value, str) else b""
        length = max(len(text), 2)
        return np.array(text, _hdf5().string_dtype("utf-8", length)) if text else value

    image = io.BytesIO()
    with h5netcdf.File(image, "w", libver=_FORMAT) as file:
        pairs = [zip(dims, shape, strict=True) for _, dims, shape, *_ in layout]
        file.dimensions = dict(itertools.chain(*pairs))
        if auxiliary:
            file.attrs["coordinates"] = stored(" ".join(auxiliary))
        for name, dims, shape, dtype, attrs in layout:
            chunks = shape if math.prod(shape) * dtype.itemsize < _LARGEST_CHUNK else True
            checked = {"chunks": chunks, "fletcher32": True} if 0 not in shape else {}
            variable = file.create_variable(name, dims, dtype, **checked)
            for key, value in attrs:
                variable.attrs[key] = stored(value)
    return image.getvalue()


def _digest(content: bytes | memoryview) -> bytes:
    return hashlib.blake2b(content, digest_size=_DIGEST).digest()


def _opened(file: Any, mode: str) -> Any:
    return _hdf5().File(file, mode, libver=_FORMAT)


def _hdf5() -> Any:
    import h5py

    return h5py

"""The metadata of a store: which axes it has, and which arrays with a chunk to a case.

What counts is the metadata in the one file at its root, which is replaced as a whole: what was
begun before it and not finished, since the process died, is as if it had never been. Whoever calls
these functions keeps others out.
"""

import json
import platform
import warnings
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from jaxstab.studies.axes import Axis, rows_of
from jaxstab.studies.fingerprint import differences
from jaxstab.studies.outputs import MARKS, MISSING, Form

_PACKAGES = ("jaxstab", "jax", "jaxlib", "equinox", "numpy", "zarr")
_WORD = Form(np.dtype(str), ())
MARK_FORMS = {"result": _WORD, "seconds": Form(np.dtype(float), ()), "error": _WORD}
_ROOT = "zarr.json"
# The least length of a chunk of coordinates.
_COORDINATES = 1024


def opened(path: Path) -> Any:
    """Return the group of Zarr as its root knows it, None where that is not finished.

    What is left of changes that did not reach the root is taken back, and folders that are lost
    are made anew, empty.

    Raises:
        ValueError: where there are cases, but the root is lost.
    """
    import zarr

    # Of a process that died as it wrote the root.
    for part in path.glob("*.partial"):
        part.unlink()
    root = path / _ROOT
    group: Any = None
    if _read_json(root).get("consolidated_metadata"):
        group = zarr.open_group(path, mode="r+", use_consolidated=True)
    elif any(path.glob(f"{MARKS[0]}/c.*")):
        raise ValueError(
            f"{path} holds cases, but its file {_ROOT} is lost or damaged: put it back from a "
            "copy, or give another path."
        )
    else:
        root.unlink(missing_ok=True)
    for metadata in path.glob(f"*/{_ROOT}"):
        if group is None or metadata.parent.name not in group:
            metadata.unlink()
    for name, array in group.arrays() if group is not None else ():
        if tuple(_read_json(path / name / _ROOT).get("shape", ())) != array.shape:
            (path / name).mkdir(exist_ok=True)
            array.resize(array.shape)
    return group


def create(path: Path, axes: Sequence[Axis], identity: Mapping[str, str], source: str) -> Any:
    """Return the group of a new store, which has no cases.

    Arguments:
        path: the folder.
        axes: the axes.
        identity: the fingerprint of the function.
        source: its text.
    """
    import zarr

    versions = {name: version(name) for name in _PACKAGES} | {"python": platform.python_version()}
    attributes = {
        "title": "Study of adhesive contacts, by jaxstab",
        "source": source,
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": json.dumps(versions),
        "fingerprint": json.dumps(identity),
        "coordinates": " ".join(_names(axes)),
    }
    group = zarr.create_group(path, attributes=attributes)
    for axis in axes:
        for name, column in axis.columns.items():
            group.create_array(
                name,
                shape=column.shape,
                chunks=(max(len(column), _COORDINATES),),
                dtype=str if column.dtype.kind == "U" else column.dtype,
                dimension_names=(axis.name,),
            )
            _written(path, name)[:] = column
    shape = tuple(map(len, axes))
    for name, form in MARK_FORMS.items():
        missing = {"result": MISSING, "error": ""}.get(name, np.nan)
        _create_array(group, axes, shape, name, form, missing)
    return _finished(path)


def extend(path: Path, group: Any, axes: Sequence[Axis]) -> Any:
    """Return the group of a store with the values of the axes that it did not have yet."""
    shape, is_longer = [], False
    for axis in axes:
        known = set(rows_of(_stored(path, group, axis)))
        new = [i for i, row in enumerate(axis.rows()) if row not in known]
        shape.append(len(known) + len(new))
        is_longer |= bool(new)
        for name, column in axis.columns.items() if new else ():
            group[name].resize((shape[-1],))
            # The part that the root knows is not touched.
            _written(path, name)[len(known) :] = column[new]
    if not is_longer:
        return group
    for name, array in group.arrays():
        if name not in _names(axes):
            array.resize((*shape, *array.shape[len(shape) :]))
    return _finished(path)


def add_outputs(path: Path, group: Any, axes: Sequence[Axis], forms: Mapping[str, Form]) -> None:
    """Give a store an array for each output."""
    for name, form in forms.items():
        _create_array(group, axes, group["result"].shape, name, form, form.missing)
    _finished(path)


def forms_of(group: Any, axes: Sequence[Axis]) -> dict[str, Form]:
    """Return the forms of the outputs, none where they are not known yet."""
    return {
        name: Form(_dtype(array), array.shape[len(axes) :])
        for name, array in group.arrays()
        if name not in (*_names(axes), *MARKS)
    }


def positions_of(path: Path, group: Any, axis: Axis) -> list[int]:
    """Return where the values of an axis lie in a store."""
    where = {row: i for i, row in enumerate(rows_of(_stored(path, group, axis)))}
    return [where[row] for row in axis.rows()]


def require_same(path: Path, group: Any, axes: Sequence[Axis], identity: Mapping[str, str]) -> None:
    """Raise `ValueError` where a store has other axes or was begun with another function."""
    dimensions = [axis.name for axis in axes]
    names = group.attrs["coordinates"].split()
    if (list(group["result"].metadata.dimension_names), names) != (dimensions, _names(axes)):
        raise ValueError(
            f"{path} has the axes {_listed(group['result'].metadata.dimension_names, names)}, this "
            f"study {_listed(dimensions, _names(axes))}: give those, or another path."
        )
    changed = differences(json.loads(group.attrs["fingerprint"]), identity)
    if changed:
        raise ValueError(
            f"{path} was begun with another case: {', '.join(changed)} changed. Give another path, "
            "or what it was: the attribute `source` of the store shows the function, but of values "
            "that it refers to only whether they changed is known."
        )


def _names(axes: Sequence[Axis]) -> list[str]:
    return [name for axis in axes for name in axis.columns]


def _listed(dimensions: Sequence[str], names: Sequence[str]) -> str:
    return ", ".join(names) + (" as a list" if list(dimensions) != list(names) else "")


def _create_array(
    group: Any, axes: Sequence[Axis], shape: tuple[int, ...], name: str, form: Form, missing: Any
) -> None:
    group.create_array(
        name,
        shape=(*shape, *form.shape),
        chunks=(*(1 for _ in shape), *(max(n, 1) for n in form.shape)),
        dtype=str if form.dtype.kind == "U" else form.dtype.newbyteorder("<"),
        fill_value=missing,
        compressors=None,
        # No folder to a case.
        chunk_key_encoding={"name": "default", "separator": "."},
        dimension_names=(
            *(axis.name for axis in axes),
            *(f"{name}_{i}" for i in range(len(form.shape))),
        ),
    )


def _stored(path: Path, group: Any, axis: Axis) -> dict[str, np.ndarray]:
    """Return what a store has of an axis.

    Raises:
        ValueError: for values of another kind, or where a part of the axis is lost.
    """
    for name, column in axis.columns.items():
        stored = _dtype(group[name])
        if stored != column.dtype and stored.kind + column.dtype.kind != "UU":
            raise ValueError(
                f"{name} is {column.dtype}, in {path} it is {stored}: give the same kind."
            )
    return {name: _whole(path, name, group[name]) for name in axis.columns}


def _written(path: Path, name: str) -> Any:
    """Return an axis to write to: all of it is kept, also zeros, which Zarr leaves out."""
    import zarr

    with zarr.config.set({"array.write_empty_chunks": True}):
        return zarr.open_array(path / name, mode="r+")


def _whole(path: Path, name: str, array: Any) -> np.ndarray:
    """Return the values along an axis; Zarr reads those that are lost as zeros."""
    try:
        if array.nchunks_initialized == array.nchunks:
            return np.asarray(array[:])
        reason = "files are missing"
    except (RuntimeError, ValueError) as error:
        reason = str(error)
    raise ValueError(
        f"The axis {name} in {path} is damaged ({reason}), so that cases cannot be told apart: put "
        f"the folder {path / name} back from a copy, or give another path."
    )


def _read_json(path: Path) -> dict[str, Any]:
    """Return what a file of metadata says, nothing where it is lost or damaged."""
    try:
        return json.loads(path.read_bytes())
    except (FileNotFoundError, ValueError):
        return {}


def _dtype(array: Any) -> np.dtype:
    return array.dtype if array.dtype.kind in "biufc" else np.dtype(str)


def _finished(path: Path) -> Any:
    """Return a group once its root knows what was changed."""
    import zarr

    with warnings.catch_warnings():
        # That other readers may not know of it: they read the metadata of each array.
        warnings.filterwarnings("ignore", "Consolidated metadata")
        return zarr.consolidate_metadata(path)

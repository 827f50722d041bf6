"""The metadata of a store: which axes it has, and which arrays with a chunk to a case.

Only the metadata in the one file at its root counts, and that file is replaced as a whole. So
changes that a dying process left unfinished have no effect. Callers of these functions hold the
store alone.
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
from jaxstab.studies.identity import versions
from jaxstab.studies.outputs import MARKS, MISSING, Form

_WORD = Form(np.dtype(str), ())
MARK_FORMS = {"result": _WORD, "seconds": Form(np.dtype(float), ()), "error": _WORD}
_ROOT = "zarr.json"
_IDENTITY, _CHANGES = "identity", "accepted_changes"
# With a word for what is missing, which no case returns, xarray reads words as those of Python.
_AS_WORDS = {"missing_value": "\N{SYMBOL FOR NULL}"}
# The length of a chunk of coordinates.
_COORDINATES = 1024


def known(path: Path) -> Any:
    """Return the group of Zarr as its root knows it, None where that is not finished."""
    import zarr

    if not _read_json(path / _ROOT).get("consolidated_metadata"):
        return None
    return zarr.open_group(path, mode="r+", use_consolidated=True)


def begin(
    path: Path,
    axes: Sequence[Axis],
    identity: Mapping[str, str],
    source: str,
    accept_changes: bool = False,
) -> Any:
    """Return the group of a store, new or extended, that has the values of axes.

    Arguments:
        path: the folder.
        axes: the axes.
        identity: the identity of the case.
        source: the text of its function.
        accept_changes: continue with another case, and record the changes.

    Raises:
        ValueError: for a store that has other axes, was begun with another case, or is damaged.
    """
    group = _repaired(path)
    if group is None:
        return _extended(path, _created(path, axes, identity, source), axes)
    _require_same_axes(path, group, axes)
    began = json.loads(group.attrs.get(_IDENTITY, "{}"))
    changed = [name for name in {**began, **identity} if began.get(name) != identity.get(name)]
    if changed and not accept_changes:
        reason = f"was begun with another case: {', '.join(changed)} changed"
        if not began:
            reason = "was begun by an earlier jaxstab, with another digest of cases"
        raise ValueError(
            f"{path} {reason}. Give another path, or the earlier case (the attribute `source` "
            "of the store shows its function). If both compute the same, accept_changes=True goes "
            "on, and records the change."
        )
    if changed:
        _accept(path, group, identity, source, changed)
    return _extended(path, group, axes)


def _repaired(path: Path) -> Any:
    """Return the group of a store, None where it is to be begun.

    Changes that did not reach the root are undone, and lost folders are made anew, empty.
    """
    # Of a process that died as it wrote the root.
    for part in path.glob("*.partial"):
        part.unlink()
    group = known(path)
    if group is None:
        if any(path.glob(f"{MARKS[0]}/c.*")):
            raise ValueError(
                f"{path} holds cases, but its file {_ROOT} is lost or damaged: put it back from a "
                "copy, or give another path."
            )
        (path / _ROOT).unlink(missing_ok=True)
    for metadata in path.glob(f"*/{_ROOT}"):
        if group is None or metadata.parent.name not in group:
            metadata.unlink()
    for name, array in group.arrays() if group is not None else ():
        if tuple(_read_json(path / name / _ROOT).get("shape", ())) != array.shape:
            (path / name).mkdir(exist_ok=True)
            array.resize(array.shape)
    return group


def _created(path: Path, axes: Sequence[Axis], identity: Mapping[str, str], source: str) -> Any:
    import zarr

    packages = {**versions(), "zarr": version("zarr"), "python": platform.python_version()}
    attributes = {
        "title": "Study of adhesive contacts, by jaxstab",
        "source": source,
        "started": _now(),
        "versions": json.dumps(packages),
        _IDENTITY: json.dumps(identity),
        "coordinates": " ".join(_names(axes)),
    }
    group = zarr.create_group(path, attributes=attributes)
    for axis in axes:
        for name, column in axis.columns.items():
            group.create_array(
                name,
                shape=(0,),
                chunks=(_COORDINATES,),
                dtype=str if column.dtype.kind == "U" else column.dtype,
                dimension_names=(axis.name,),
                attributes=_attributes(column.dtype),
            )
    for name, form in MARK_FORMS.items():
        missing = {"result": MISSING, "error": ""}.get(name, np.nan)
        _create_array(group, axes, tuple(0 for _ in axes), name, form, missing)
    return group


def _extended(path: Path, group: Any, axes: Sequence[Axis]) -> Any:
    """Return the group of a store with the values of the axes that it did not have yet."""
    import zarr

    shape, is_longer = [], False
    for axis in axes:
        known = set(rows_of(_stored(path, group, axis)))
        new = [i for i, row in enumerate(axis.rows()) if row not in known]
        shape.append(len(known) + len(new))
        is_longer |= bool(new)
        for name, column in axis.columns.items() if new else ():
            group[name].resize((shape[-1],))
            # All of it, also zeros, which Zarr leaves out; the part that the root knows stays.
            with zarr.config.set({"array.write_empty_chunks": True}):
                zarr.open_array(path / name, mode="r+")[len(known) :] = column[new]
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


def _require_same_axes(path: Path, group: Any, axes: Sequence[Axis]) -> None:
    dimensions = [axis.name for axis in axes]
    names = group.attrs["coordinates"].split()
    if (list(group["result"].metadata.dimension_names), names) != (dimensions, _names(axes)):
        raise ValueError(
            f"{path} has the axes {_listed(group['result'].metadata.dimension_names, names)}, this "
            f"study {_listed(dimensions, _names(axes))}: give those, or another path."
        )


def _accept(
    path: Path, group: Any, identity: Mapping[str, str], source: str, changed: list[str]
) -> None:
    """Record that a store continues with another case."""
    change = {"when": _now(), "changed": changed, "source": source, "versions": versions()}
    changes = [*json.loads(group.attrs.get(_CHANGES, "[]")), change]
    for _, array in group.arrays():
        array.attrs.update(_attributes(array.dtype))
    group.attrs.update({_IDENTITY: json.dumps(identity), _CHANGES: json.dumps(changes)})
    _finished(path)


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
        attributes=_attributes(form.dtype),
        # No folder to a case.
        chunk_key_encoding={"name": "default", "separator": "."},
        dimension_names=(
            *(axis.name for axis in axes),
            *(f"{name}_{i}" for i in range(len(form.shape))),
        ),
    )


def _stored(path: Path, group: Any, axis: Axis) -> dict[str, np.ndarray]:
    """Return the values of an axis in a store.

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
    """Return the content of a metadata file, empty if it is lost or damaged."""
    try:
        return json.loads(path.read_bytes())
    except (FileNotFoundError, ValueError):
        return {}


def _attributes(dtype: np.dtype) -> dict[str, Any]:
    return {} if dtype.kind in "biufc" else _AS_WORDS


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _dtype(array: Any) -> np.dtype:
    return array.dtype if array.dtype.kind in "biufc" else np.dtype(str)


def _finished(path: Path) -> Any:
    """Return a group after its root records the changes."""
    import zarr

    with warnings.catch_warnings():
        # That other readers may not know of it: they read the metadata of each array.
        warnings.filterwarnings("ignore", "Consolidated metadata")
        return zarr.consolidate_metadata(path)

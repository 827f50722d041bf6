"""A store of cases: Zarr, with a chunk to a case, so that no two writers ever meet.

What counts is the metadata in the one file at its root, which is replaced as a whole: what was
begun before it and not finished, since the process died, is as if it had never been.
"""

import json
import os
import platform
import warnings
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from jaxstab.studies.axes import LISTED, Axis, Index, rows_of
from jaxstab.studies.claims import Claims
from jaxstab.studies.fingerprint import differences
from jaxstab.studies.outputs import (
    MARKS,
    MISSING,
    Form,
    decoded_word,
    encoded,
    form_of,
    require_forms,
)

_PACKAGES = ("jaxstab", "jax", "jaxlib", "equinox", "numpy", "zarr")
_WORD = Form(np.dtype(str), ())
_MARK_FORMS = {"result": _WORD, "seconds": Form(np.dtype(float), ()), "error": _WORD}
_ROOT = "zarr.json"
# The least length of a chunk of coordinates.
_COORDINATES = 1024


def claims_file(path: Path) -> Path:
    """Return the file of claims of a store, beside the marks of cases that are done.

    Raises:
        ValueError: for a file or a folder that is something else.
    """
    file = path / MARKS[0] / "claims"
    entries = {entry.name for entry in path.iterdir()} if path.is_dir() else set()
    is_free = not path.exists() or (path.is_dir() and entries <= {MARKS[0]})
    if not is_free and not file.exists():
        raise ValueError(f"{path} exists and is no study: give another path.")
    file.parent.mkdir(parents=True, exist_ok=True)
    return file


class Store:
    """The cases of a study on disk.

    Arguments:
        path: the folder; made where it is not there.
        axes: the axes asked for; those of the store are extended to hold them.
        claims: the claims of this process.
        identity: the fingerprint of the function.
        source: the text of the function.

    Raises:
        ValueError: if the store is that of another function, or has other axes.
    """

    def __init__(
        self,
        path: Path,
        axes: Sequence[Axis],
        claims: Claims,
        identity: Mapping[str, str],
        source: str,
    ):
        self.path = path
        self.axes = axes
        self._claims = claims
        self._names = [name for axis in axes for name in axis.columns]
        with claims.whole():
            group = self._group()
            self._forget_unfinished(group)
            if group is None:
                self._create(identity, source)
            else:
                self._require_same(group, identity)
                self._extend(group)
            group = self._group()
            assert group is not None
            self._positions = [self._positions_of(group, axis) for axis in axes]
            self._forms = self._forms_of(group)

    @property
    def has_forms(self) -> bool:
        """Whether the outputs of a case are known."""
        return bool(self._forms)

    def index(self, place: Index) -> Index:
        """Return where a place on the axes asked for lies in the store."""
        return tuple(p[i] for p, i in zip(self._positions, place, strict=True))

    def result(self, index: Index) -> str | None:
        """Return the result of a case, or None where it is not done."""
        try:
            chunk = self._chunk("result", index, 0).read_bytes()
        except FileNotFoundError:
            return None
        return decoded_word(chunk) if chunk else None

    def require_forms(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Raise `ValueError` where outputs are not those of other cases; the first settle them."""
        if not self._forms:
            with self._claims.whole():
                group = self._group()
                self._forget_unfinished(group)
                self._forms = self._forms_of(group) or self._settled(group, arrays)
        require_forms(arrays, self._forms)

    def write(
        self,
        index: Index,
        result: str,
        seconds: float,
        error: str = "",
        arrays: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        """Store a case; its result, by which it counts as done, comes last."""
        for name, array in (arrays or {}).items():
            self._write(name, index, array, self._forms[name])
        marks = {"error": error, "seconds": seconds, "result": result}
        for name, value in marks.items():
            self._write(name, index, np.asarray(value), _MARK_FORMS[name])

    def dataset(self) -> Any:
        """Return what was asked for, in its order; numbers are read as they are looked at."""
        import xarray

        dataset = xarray.open_zarr(self.path, chunks=None, consolidated=True)
        dataset = dataset.isel(
            {axis.name: p for axis, p in zip(self.axes, self._positions, strict=True)}
        )
        # As Python's own words, which xarray can mask and join.
        words = {
            name: x.astype(object) for name, x in dataset.items() if x.dtype.kind not in "biufc"
        }
        return dataset.assign(words)

    def _write(self, name: str, index: Index, array: np.ndarray, form: Form) -> None:
        if array.size == 0:
            return
        path = self._chunk(name, index, len(form.shape))
        # Under one name, so that what a process leaves that dies is written over.
        part = path.with_name(f"{path.name}.part")
        part.write_bytes(encoded(array, form))
        os.replace(part, path)

    def _chunk(self, name: str, index: Index, ndim: int) -> Path:
        return self.path / name / ".".join(["c", *map(str, index), *("0" * ndim)])

    def _group(self) -> Any:
        """Return the group of Zarr as its root knows it, None where that is not finished."""
        import zarr

        root = self.path / _ROOT
        if not root.exists() or not json.loads(root.read_bytes()).get("consolidated_metadata"):
            return None
        return zarr.open_group(self.path, mode="r+", use_consolidated=True)

    def _forget_unfinished(self, group: Any) -> None:
        # Zarr's, of a process that died as it wrote the root.
        for part in self.path.glob("*.partial"):
            part.unlink()
        for metadata in self.path.glob(f"*/{_ROOT}"):
            if group is None or metadata.parent.name not in group:
                metadata.unlink()
        if group is None:
            (self.path / _ROOT).unlink(missing_ok=True)

    def _create(self, identity: Mapping[str, str], source: str) -> None:
        import zarr

        versions = {name: version(name) for name in _PACKAGES} | {
            "python": platform.python_version()
        }
        group = zarr.create_group(
            self.path,
            attributes={
                "title": "Study of adhesive contacts, by jaxstab",
                "source": source,
                "started": datetime.now(UTC).isoformat(timespec="seconds"),
                "versions": json.dumps(versions),
                "fingerprint": json.dumps(identity),
                "coordinates": " ".join(self._names),
            },
        )
        for axis in self.axes:
            for name, column in axis.columns.items():
                array = group.create_array(
                    name,
                    shape=column.shape,
                    chunks=(max(len(column), _COORDINATES),),
                    dtype=str if column.dtype.kind == "U" else column.dtype,
                    dimension_names=(axis.name,),
                )
                array[:] = column
        shape = tuple(map(len, self.axes))
        for name, form in _MARK_FORMS.items():
            missing = {"result": MISSING, "error": ""}.get(name, np.nan)
            self._create_array(group, name, form, shape, missing)
        self._consolidate()

    def _create_array(
        self, group: Any, name: str, form: Form, shape: tuple[int, ...], missing: Any
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
                *(axis.name for axis in self.axes),
                *(f"{name}_{i}" for i in range(len(form.shape))),
            ),
        )

    def _settled(self, group: Any, arrays: Mapping[str, np.ndarray]) -> dict[str, Form]:
        """Return the forms of the first outputs, for which the store is given arrays."""
        forms = {name: form_of(array) for name, array in arrays.items()}
        for name, form in forms.items():
            self._create_array(group, name, form, group["result"].shape, form.missing)
        self._consolidate()
        return forms

    def _forms_of(self, group: Any) -> dict[str, Form]:
        """Return the forms of the outputs."""
        ndim = len(self.axes)
        return {
            name: Form(_dtype(array), array.shape[ndim:])
            for name, array in group.arrays()
            if name not in (*self._names, *MARKS)
        }

    def _require_same(self, group: Any, identity: Mapping[str, str]) -> None:
        axes = group["result"].metadata.dimension_names
        names = group.attrs["coordinates"].split()
        if list(axes) != [axis.name for axis in self.axes] or names != self._names:
            raise ValueError(
                f"{self.path} has the axes {', '.join(names)}"
                f"{' as a list' if axes == (LISTED,) else ''}, this study "
                f"{', '.join(self._names)}: give those, or another path."
            )
        changed = differences(json.loads(group.attrs["fingerprint"]), identity)
        if changed:
            raise ValueError(
                f"{self.path} was begun with another case: {', '.join(changed)} changed. Give "
                "another path, or what it was, which the attribute `source` of the store shows."
            )

    def _extend(self, group: Any) -> None:
        """Add the values of the axes that the store does not have yet."""
        shape, is_longer = [], False
        for axis in self.axes:
            stored = self._stored(group, axis)
            known = set(rows_of(stored))
            new = [i for i, row in enumerate(axis.rows()) if row not in known]
            shape.append(len(known) + len(new))
            is_longer |= bool(new)
            for name, column in axis.columns.items() if new else ():
                group[name].resize((shape[-1],))
                # The part that the root knows is not touched.
                self._node(name)[len(known) :] = column[new]
        if not is_longer:
            return
        for name, array in group.arrays():
            if name not in self._names:
                array.resize((*shape, *array.shape[len(shape) :]))
        self._consolidate()

    def _node(self, name: str) -> Any:
        import zarr

        return zarr.open_array(self.path / name, mode="r+")

    def _stored(self, group: Any, axis: Axis) -> dict[str, np.ndarray]:
        stored = {name: np.asarray(group[name][:]) for name in axis.columns}
        for name, column in axis.columns.items():
            kinds = _dtype(group[name]), column.dtype
            if kinds[0] != kinds[1] and kinds[0].kind + kinds[1].kind != "UU":
                raise ValueError(
                    f"{name} is {kinds[1]}, in {self.path} {kinds[0]}: give the same kind."
                )
        return stored

    def _positions_of(self, group: Any, axis: Axis) -> list[int]:
        where = {row: i for i, row in enumerate(rows_of(self._stored(group, axis)))}
        return [where[row] for row in axis.rows()]

    def _consolidate(self) -> None:
        import zarr

        with warnings.catch_warnings():
            # That other readers may not know of it: they read the metadata of each array.
            warnings.filterwarnings("ignore", "Consolidated metadata")
            zarr.consolidate_metadata(self.path)


def _dtype(array: Any) -> np.dtype:
    return array.dtype if array.dtype.kind in "biufc" else np.dtype(str)

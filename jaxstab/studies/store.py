"""A store of cases: Zarr, with a chunk to a case, so that no two writers ever meet."""

import os
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from jaxstab.studies import metadata
from jaxstab.studies.axes import Axis, Index
from jaxstab.studies.locks import Claims
from jaxstab.studies.outputs import (
    MARKS,
    MISSING,
    Form,
    decoded_word,
    encoded,
    form_of,
    require_forms,
)


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
        with claims.whole():
            group = metadata.opened(path)
            if group is None:
                group = metadata.create(path, axes, identity, source)
            else:
                metadata.require_same(path, group, axes, identity)
                group = metadata.extend(path, group, axes)
            self._positions = [metadata.positions_of(path, group, axis) for axis in axes]
            self._forms = metadata.forms_of(group, axes)

    @property
    def has_forms(self) -> bool:
        """Whether the outputs of a case are known."""
        return bool(self._forms)

    def index(self, place: Index) -> Index:
        """Return where a place on the axes asked for lies in the store."""
        return tuple(p[i] for p, i in zip(self._positions, place, strict=True))

    def result(self, index: Index) -> str | None:
        """Return the result of a case, or None where it is not done or a part of it is lost."""
        result = self._word("result", index)
        forms = {
            "successful": {**metadata.MARK_FORMS, **self._forms},
            "failed": metadata.MARK_FORMS,
        }.get(result or "", {})
        is_whole = all(self._is_whole(name, index, form) for name, form in forms.items())
        return result if forms and is_whole else None

    def forget(self, index: Index) -> None:
        """Let a case count as not done."""
        self._chunk("result", index, 0).unlink()

    def require_forms(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Raise `ValueError` where outputs are not those of other cases; the first settle them."""
        if not self._forms:
            with self._claims.whole():
                # Another process may have settled them since.
                group = metadata.opened(self.path)
                self._forms = metadata.forms_of(group, self.axes)
                if not self._forms:
                    forms = {name: form_of(array) for name, array in arrays.items()}
                    metadata.add_outputs(self.path, group, self.axes, forms)
                    self._forms = forms
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
            self._write(name, index, np.asarray(value), metadata.MARK_FORMS[name])

    def dataset(self) -> Any:
        """Return what was asked for, in its order; numbers are read as they are looked at."""
        import xarray

        dataset = xarray.open_zarr(self.path, chunks=None, consolidated=True)
        dataset = dataset.isel(
            {axis.name: p for axis, p in zip(self.axes, self._positions, strict=True)}
        )
        # As Python's own words, which xarray can mask and join.
        words = {
            name: x.copy(data=self._words(str(name), x.shape))
            if x.ndim == len(self.axes)
            else x.astype(object)
            for name, x in dataset.items()
            if x.dtype.kind not in "biufc"
        }
        return dataset.assign(words)

    def _words(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """Return the words of all cases asked for; Zarr is slow with chunks this small."""
        missing = "" if name == "error" else MISSING
        words = [self._word(name, index) for index in product(*self._positions)]
        words = [missing if word is None else word for word in words]
        return np.array(words, object).reshape(shape)

    def _word(self, name: str, index: Index) -> str | None:
        try:
            chunk = self._chunk(name, index, 0).read_bytes()
        except FileNotFoundError:
            return None
        return decoded_word(chunk) if chunk else None

    def _is_whole(self, name: str, index: Index, form: Form) -> bool:
        if 0 in form.shape:
            return True
        try:
            size = self._chunk(name, index, len(form.shape)).stat().st_size
        except FileNotFoundError:
            return False
        return size >= form.least_bytes

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

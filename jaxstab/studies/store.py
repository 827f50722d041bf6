"""A store of cases: Zarr, with a chunk to a case, so that no two writers ever meet."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from jaxstab.studies import metadata
from jaxstab.studies.axes import Axis, Index
from jaxstab.studies.outputs import (
    MARKS,
    Form,
    decoded_word,
    encoded,
    error_text,
    form_of,
    require_forms,
)


@dataclass(frozen=True)
class Found:
    """The result of a case.

    Attributes:
        place: where it lies on the axes.
        seconds: how long it took.
        arrays: its outputs by name, or an error if no store can hold them.
        error: the error that it raised.
        result: how it ended, once it is stored.
    """

    place: Index
    seconds: float = 0.0
    arrays: Any = None
    error: str = ""
    result: str | None = None


class Store:
    """The cases of a study on disk; each worker has a copy.

    Arguments:
        path: the folder.
        axes: the axes of the call.
        group: the metadata at the root of the store.
    """

    def __init__(self, path: Path, axes: Sequence[Axis], group: Any):
        self.path, self.axes = path, axes
        self._positions = [metadata.positions_of(path, group, axis) for axis in axes]
        self._forms = metadata.forms_of(group, axes)
        self._has_arrays = bool(self._forms)
        self.add_arrays()

    def add_arrays(self) -> None:
        """Make an array of each output, once a case has determined them."""
        if not self._has_arrays and self._are_settled():
            metadata.add_outputs(self.path, metadata.known(self.path), self.axes, self._forms)
            self._has_arrays = True

    def result(self, place: Index) -> str | None:
        """Return the result of a case, or None where it is not done or a part of it is lost."""
        result = self._word("result", place)
        forms = {
            "successful": {**metadata.MARK_FORMS, **self._forms},
            "failed": metadata.MARK_FORMS,
        }.get(result, {})
        is_whole = all(self._is_whole(name, place, form) for name, form in forms.items())
        return result if forms and is_whole else None

    def forget(self, place: Index) -> None:
        """Let a case count as not done."""
        self._chunk("result", place, 0).unlink()

    def keep(self, found: Found) -> str:
        """Store a case and return its result, which is written last; by that it counts as done.

        Raises:
            TypeError, ValueError: if no store can hold the outputs of the first case.
        """
        arrays, error = found.arrays, found.error
        if not error:
            self._settle(arrays)
            try:
                require_forms(arrays, self._forms)
            except (TypeError, ValueError) as misfit:
                error = error_text(misfit)
        for name, array in {} if error else arrays.items():
            self._write(name, found.place, array, self._forms[name])
        result = "failed" if error else "successful"
        marks = {"error": error, "seconds": found.seconds, "result": result}
        for name, value in marks.items():
            self._write(name, found.place, np.asarray(value), metadata.MARK_FORMS[name])
        return result

    def begin(self, place: Index) -> int:
        """Mark that a process begins a case, and return how many have, this one included."""
        with self._begun(place).open("ab") as file:
            file.write(b".")
            return file.tell()

    def num_begun(self, place: Index) -> int:
        """Return how many processes have begun a case without an end."""
        begun = self._begun(place)
        return begun.stat().st_size if begun.exists() else 0

    def end(self, place: Index) -> None:
        """Take back that a case was begun."""
        self._begun(place).unlink(missing_ok=True)

    def dataset(self) -> Any:
        """Return the cases of the axes, in their order; numbers are read on access."""
        import xarray

        dataset = xarray.open_zarr(self.path, chunks=None, consolidated=True)
        places = {axis.name: p for axis, p in zip(self.axes, self._positions, strict=True)}
        return dataset.isel(places)

    def _settle(self, arrays: Any) -> None:
        """Make the outputs of a case those of all, unless another case was the first."""
        if self._are_settled():
            return
        if isinstance(arrays, Exception):
            raise arrays
        forms = {name: form_of(array) for name, array in arrays.items()}
        text = json.dumps({name: [form.dtype.str, form.shape] for name, form in forms.items()})
        part = self._settled.with_name(f"{uuid4().hex}.partial")
        part.write_text(text)
        try:
            # Neither takes the place of a file that is there.
            (os.rename if os.name == "nt" else os.link)(part, self._settled)
        except FileExistsError:
            pass
        finally:
            part.unlink(missing_ok=True)
        self._are_settled()

    def _are_settled(self) -> bool:
        if not self._forms and self._settled.exists():
            forms = json.loads(self._settled.read_text())
            self._forms = {
                name: Form(np.dtype(kind), tuple(shape)) for name, (kind, shape) in forms.items()
            }
            for name in forms:
                (self.path / name).mkdir(exist_ok=True)
        return bool(self._forms)

    @property
    def _settled(self) -> Path:
        return self.path / MARKS[0] / "outputs.json"

    def _word(self, name: str, place: Index) -> str:
        """Return a word, which Zarr itself takes a hundred times longer to read."""
        try:
            return decoded_word(self._chunk(name, place, 0).read_bytes())
        except FileNotFoundError:
            return ""

    def _is_whole(self, name: str, place: Index, form: Form) -> bool:
        if 0 in form.shape:
            return True
        try:
            return self._chunk(name, place, len(form.shape)).stat().st_size >= form.least_bytes
        except FileNotFoundError:
            return False

    def _write(self, name: str, place: Index, array: np.ndarray, form: Form) -> None:
        """Write a chunk whole, as Zarr does, which takes ten times longer to write a small one."""
        if array.size == 0:
            return
        path = self._chunk(name, place, len(form.shape))
        # Under one name, so that what a process leaves that dies is written over.
        part = path.with_name(f"{path.name}.part")
        part.write_bytes(encoded(array, form))
        os.replace(part, path)

    def _chunk(self, name: str, place: Index, ndim: int) -> Path:
        return self.path / name / ".".join(["c", *self._index(place), *("0" * ndim)])

    def _begun(self, place: Index) -> Path:
        return self.path / MARKS[0] / ".".join(["begun", *self._index(place)])

    def _index(self, place: Index) -> list[str]:
        return [str(p[i]) for p, i in zip(self._positions, place, strict=True)]

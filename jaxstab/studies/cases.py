"""The cases of a study: their coordinates, outputs and files."""

import hashlib
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxstab.core.checked_netcdf import Content, Variable, Variables, write
from jaxstab.core.checks import require_no_unit
from jaxstab.core.enumeration import Enumeration

# The dimension of listed combinations; the columns of each case beside its outputs; the record.
LISTED = "case"
MARKS = ("result", "seconds", "error")
RECORD = "study.json"
# The coordinates of a case by name: numbers and words of Python.
Case = dict[str, Any]


class Cases(NamedTuple):
    """The cases of a study in a folder, with named axes and dimensions of their results."""

    path: Path
    names: tuple[str, ...]
    dims: tuple[str, ...]

    @property
    def taken_names(self) -> set[str]:
        """The names that no output can have."""
        return {*self.dims, *self.names, *MARKS}

    def files(self, axes: Mapping[str, Sequence[object]]) -> dict[Path, Case]:
        """Return all cases by their files, in the order of the product or the list."""
        files = {}
        combine = zip if self.dims == (LISTED,) else itertools.product
        for row in combine(*(axes[name] for name in self.names)):
            case = dict(zip(self.names, row, strict=True))
            if files.setdefault(self.file(case), case) is not case:
                raise ValueError(f"The axes give the case {case} twice: give each value once.")
        return files

    def file(self, case: Case) -> Path:
        """Return the file of a case, named by its coordinates; equal numbers have one name."""
        coordinates = dict(case)
        for name, value in case.items():
            if not isinstance(value, str) and value == int(value):
                coordinates[name] = int(value)
        text = json.dumps(coordinates, sort_keys=True).encode()
        return self.path / f"{hashlib.blake2b(text, digest_size=10).hexdigest()}.nc"

    def write(self, case: Case, outputs: Variables, seconds: float, error: str) -> None:
        """Write the file of a case, of a failed one with its error."""
        attrs = {}
        if self.dims == (LISTED,):
            # By the coordinate of the list xarray combines the files.
            places = {LISTED: self.file(case).stem, **case}
            attrs = {"coordinates": " ".join(places)}
            own = {name: Variable(self.dims, np.array([x])) for name, x in places.items()}
        else:
            own = {name: Variable((name,), np.array([x])) for name, x in case.items()}
        result = "successful"
        if error:
            result = "failed"
        for name, x in zip(MARKS, (result, seconds, error), strict=True):
            own[name] = Variable(self.dims, np.array(x)[(None,) * len(self.dims)], attrs)
        write(self.file(case), Content(own | outputs, {}))

    def outputs_of(self, returned: object) -> Variables:
        """Return a dict of arrays, or a data set, with the axes before other dimensions."""
        if not isinstance(returned, Mapping) or not returned:
            raise TypeError(f"The case returned {type(returned).__name__}: return a dict of arrays")
        given = {}
        outputs = {}
        for name, x in _variables(returned).items():
            if hasattr(x, "dims"):
                given[name] = Variable(x.dims, _array(name, x.values), x.attrs)
            else:
                values = _array(name, x)
                dims = tuple(f"{name}_{i}" for i in range(values.ndim))
                given[name] = Variable(dims, values, {})
        for name, (dims, values, attrs) in given.items():
            for each in (name, *dims):
                is_clash = each in given and each in dims and given[each].dims != (each,)
                if each in self.taken_names or is_clash or not str(each).isidentifier():
                    which = "a name that is taken, or no identifier"
                    raise ValueError(f"The case returned {which}, {each!r}: choose another name.")
            attrs = {key: np.array(x).item() for key, x in attrs.items() if np.isscalar(x)}
            if dims != (name,):
                dims = (*self.dims, *dims)
                values = values[(None,) * len(self.dims)]
            outputs[name] = Variable(dims, values, attrs)
        return outputs


def read_axes(axes: Any) -> tuple[dict[str, list[Any]], tuple[str, ...]]:
    """Return values by name, of a product or of listed combinations, and their dimensions."""
    is_listed = isinstance(axes, list | tuple)
    rows: Any = [axes]
    if is_listed:
        rows = axes
    if not rows or any(not isinstance(x, Mapping) or not x or {*x} != {*rows[0]} for x in rows):
        raise TypeError("The axes are neither a dict of arrays nor dicts with the same names.")
    given = axes
    if is_listed:
        given = {name: [row[name] for row in rows] for name in rows[0]}
    values = {name: _array(name, x) for name, x in given.items()}
    for name, x in values.items():
        is_number = x.dtype.kind in "biuf" and np.isfinite(x).all()
        if x.ndim != 1 or not x.size or not (is_number or x.dtype.kind == "U"):
            raise ValueError(f"{name} is {x!r}: give words or finite numbers in one dimension.")
        if name in (*MARKS, LISTED):
            raise ValueError(f"{name!r} is a name of the study itself: rename the axis.")
    dims = (LISTED,) if is_listed else tuple(values)
    return {name: x.tolist() for name, x in values.items()}, dims


def _variables(returned: Any) -> Mapping[Any, Any]:
    """Return the arrays of a data set, or of a dict; its labelled ones bring their coordinates."""
    if hasattr(returned, "variables"):
        return returned.variables
    labelled = {name: x for name, x in returned.items() if hasattr(x, "coords")}
    if not labelled:
        return returned
    import xarray

    # Places that differ would be filled with NaN.
    merged = xarray.merge([x.rename(name) for name, x in labelled.items()], join="exact")
    twice = [name for name in merged.variables if name in returned and name not in labelled]
    if twice:
        raise ValueError(
            f"The case returned {twice[0]!r} as an output and as a coordinate: rename one of them."
        )
    return {**returned, **merged.variables}


def _array(name: Any, value: Any) -> np.ndarray:
    if isinstance(value, Enumeration):
        value = value.name
    entries = [value]
    if type(value) in (list, tuple):
        entries = value
    for each in entries:
        require_no_unit(each, name)
    try:
        if np.ma.is_masked(value):
            # A missing number is NaN, which integers do not have.
            value = value.filled(math.nan)
        array = np.asarray(value)
        if array.dtype.kind in ("O", "T", "U") and array.size:
            # NumPy makes words of numbers beside words.
            array = np.asarray(value, object)
            if all(isinstance(x, str) for x in array.flat):
                array = array.astype(str)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name} is no array of numbers or words: {error}") from None
    if array.dtype.kind not in "biufcU":
        kind = f"{type(value).__name__} of {array.dtype}"
        raise TypeError(f"{name} is {kind}: give numbers or words, or an array of either.")
    if array.dtype.kind == "f":
        # NetCDF has no other precisions; its library crashes on a half.
        precision = np.float32
        if array.dtype.itemsize > 4:
            precision = np.float64
        return array.astype(precision, copy=False)
    return array

"""The outputs of a case as variables of a file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxstab.core.checks import is_traced
from jaxstab.core.enumeration import Enumeration
from jaxstab.studies.folder import Folder
from jaxstab.studies.netcdf import Variable, Variables


def variables_of(outputs: Any, folder: Folder) -> Variables:
    """Return a dict of arrays, or a data set, with the axes of the study before other dimensions.

    Raises:
        TypeError: for outputs that are neither, or hold something else than arrays.
        ValueError: for names that are taken, or are none.
    """
    is_dataset, axes, variables = hasattr(outputs, "data_vars"), folder.dims, {}
    named = outputs.variables if is_dataset else outputs
    if not (is_dataset or isinstance(outputs, Mapping)) or not len(outputs):
        raise TypeError(
            f"The case returned {type(outputs).__name__}: return a dict of arrays, as in "
            '{"area": equilibrium.contact_area}, or a Dataset.'
        )
    for name, output in named.items():
        values = _array(name, output.values if is_dataset else output)
        dims = getattr(output, "dims", tuple(f"{name}_{i}" for i in range(values.ndim)))
        for each in (name, *dims):
            if not (isinstance(each, str) and each.isidentifier()):
                raise ValueError(f"The case returned {each!r}: name outputs by letters and digits.")
            if each in folder.taken:
                raise ValueError(f"The case returned `{each}`, a name of the study: rename it.")
        if not (is_dataset and dims == (name,)):
            dims, values = (*axes, *dims), values[(None,) * len(axes)]
        attrs = {key: x for key, x in getattr(output, "attrs", {}).items() if np.isscalar(x)}
        variables[name] = Variable(dims, values, attrs)
    used = {dimension for dims, *_ in variables.values() for dimension in dims}
    for name, (dims, *_) in variables.items():
        if name in used and dims != (name,):
            raise ValueError(f"The case returned `{name}`, the name of a dimension: rename it.")
    return variables


def forms_of(case: Variables, folder: Folder) -> dict[str, str]:
    """Return in words what each output has in common in all cases."""
    forms = {}
    for name, (dims, values, _) in case.items():
        if name not in folder.taken:
            kind = "words" if values.dtype.kind == "U" else "numbers"
            is_output = dims[: len(folder.dims)] == folder.dims
            own = list(zip(dims, values.shape, strict=True))[is_output * len(folder.dims) :]
            sizes = ", ".join(f"{dimension} {size}" for dimension, size in own)
            forms[name] = f"{kind} ({sizes})" + ("" if is_output else f" {values.tolist()}")
    return forms


def misfit(found: Mapping[str, str], forms: Mapping[str, str]) -> str:
    """Return how the outputs of a case differ from those of others, empty if they do not."""
    for name in sorted(found.keys() | forms.keys()):
        here, there = found.get(name, "missing"), forms.get(name, "missing")
        if here != there:
            return f"{name} is {here}, in other cases {there}: return the same shapes in all."
    return ""


def blank_of(cases: Sequence[Variables], folder: Folder) -> dict[str, Variable]:
    """Return the outputs of a case without values, in a kind that holds those of all cases."""
    blank = {name: x for name, x in cases[0].items() if name not in folder.taken} if cases else {}
    for name, (dims, values, attrs) in blank.items():
        if dims[: len(folder.dims)] == folder.dims:
            dtype = np.result_type(*{case[name].values.dtype for case in cases})
            least = np.iinfo(dtype).min if dtype.kind in "iu" else np.nan
            none = {"b": False, "U": "missing"}.get(dtype.kind, least)
            none = np.array(none, None if dtype.kind == "U" else dtype)
            blank[name] = Variable(dims, np.broadcast_to(none, values.shape), attrs)
    return blank


def _array(name: str, value: Any) -> np.ndarray:
    if is_traced(value):
        raise TypeError(f"{name} is traced: call js.study outside of JAX transformations.")
    try:
        array = np.ma.asarray(value.name if isinstance(value, Enumeration) else value)
    except ValueError as error:
        raise TypeError(f"{name} is no array: {error}") from None
    if np.ma.is_masked(array) and array.dtype.kind not in "fc":
        raise TypeError(f"{name} is a masked array of {array.dtype}, which has no NaN: fill it.")
    array = np.asarray(array.filled(np.nan) if np.ma.is_masked(array) else array)
    holds_objects = array.dtype.kind in ("O", "T") and array.size
    if holds_objects and all(isinstance(x, str) for x in array.flat):
        array = array.astype(str)
    if array.dtype.kind not in "biufcU":
        kind = type(value).__name__ if array.dtype == object else array.dtype
        raise TypeError(f"{name} is {kind}: return numbers, words, or arrays of them.")
    return array

"""The data set of a study, from the files of its cases."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxstab.studies.axes import LISTED, Axes
from jaxstab.studies.folder import MARKS, SMALL, Damaged, Folder, is_successful
from jaxstab.studies.netcdf import Variables
from jaxstab.studies.outputs import blank_of


def dataset_of(folder: Folder, axes: Axes, found: Mapping[Path, Variables], is_large: bool) -> Any:
    """Return the cases of the axes, in their order; fields of a large study are read on access."""
    import xarray

    files = [folder.file(case) for case in axes.cases()]
    done = [found.get(file) for file in files]
    whole = [case if case and is_successful(case) else None for case in done]
    coordinates = {n: (axes.dims if axes.is_listed else n, x) for n, x in axes.values.items()}
    if axes.is_listed:
        coordinates[LISTED] = (axes.dims, [file.stem for file in files])
    dataset = xarray.Dataset(coords=coordinates)
    shape = tuple(dataset.sizes[name] for name in axes.dims)
    for name, mark in zip(MARKS, ("missing", np.nan, ""), strict=True):
        none = np.array(mark).reshape((1,) * len(shape))
        dataset[name] = axes.dims, _stacked(done, name, none, shape)
    blank = blank_of([case for case in whole if case], folder)
    for name, (dims, none, attrs) in blank.items():
        if dims[: len(shape)] != axes.dims:
            dataset.coords[name] = dims, none, attrs
        elif is_large and none.nbytes > SMALL and none.dtype.kind != "U":
            there = [file if case else None for file, case in zip(files, whole, strict=True)]
            dataset[name] = dims, _lazy(folder, there, name, none, shape), attrs
        else:
            dataset[name] = dims, _stacked(whole, name, none, shape), attrs
    return dataset


def _stacked(cases: Sequence[Any], name: str, none: np.ndarray, shape: tuple[int, ...]) -> Any:
    """Return the values of all cases, `none` where there is no case."""
    values = [case[name].values if case else none for case in cases]
    return np.stack(values).reshape(*shape, *none.shape[len(shape) :])


def _lazy(
    folder: Folder,
    files: Sequence[Path | None],
    name: str,
    none: np.ndarray,
    shape: tuple[int, ...],
) -> Any:
    """Return the same as an array of Dask with a chunk to a case."""
    import dask.array

    def load(number: np.ndarray) -> np.ndarray:
        file = files[number.item()]
        try:
            return folder.read(file, SMALL, name)[name].values.astype(none.dtype) if file else none
        except Damaged as error:
            folder.set_aside(file)
            raise Damaged(f"{error} is damaged: js.study runs its case again.") from error

    each: Any = (1,) * len(files)
    number = dask.array.arange(len(files), chunks=each).reshape(shape)
    chunks = (*number.chunks, *((length,) for length in none.shape[len(shape) :]))
    axes, meta = range(len(shape), none.ndim), np.empty((0,) * none.ndim, none.dtype)
    return dask.array.map_blocks(load, number, chunks=chunks, new_axis=axes, meta=meta)

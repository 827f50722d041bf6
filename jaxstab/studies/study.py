"""The public function: a study, from its axes to its data set."""

from __future__ import annotations

import difflib
import hashlib
import inspect
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import jax
import numpy as np
from jaxtyping import PyTree

from jaxstab.core.atomic_write import write_whole
from jaxstab.core.checked_netcdf import Damaged, Variable, Variables, read
from jaxstab.core.checks import integer, require
from jaxstab.core.interrupts import interrupts_held
from jaxstab.core.optional_packages import require_packages, versions
from jaxstab.core.progress import progress_bar
from jaxstab.core.warn import warn
from jaxstab.studies.cases import LISTED, MARKS, RECORD, Case, Cases, read_axes
from jaxstab.studies.executors import run_tasks
from jaxstab.studies.worker import CaseWorker

if TYPE_CHECKING:
    import xarray

# Fields of more bytes, in all cases, are read on access.
LARGE = 2**30


class StudyInterrupted(UserWarning):
    """A study was interrupted; its folder holds the cases done so far.

    Example:
        A script that is not to go on with part of the cases makes an error of it:

        >>> import warnings
        >>> def case(gap):
        ...     return {"pressure": js.equilibrate(contact, js.MeanGap(gap)).mean_pressure}
        >>> with warnings.catch_warnings(action="error", category=js.exceptions.StudyInterrupted):
        ...     data = js.study(case, {"gap": [0.05, 0.1]}, "study")
        >>> data.pressure.size
        2
    """


def study(
    case: Callable[..., object],
    axes: Mapping[str, object] | Sequence[Mapping[str, object]],
    path: str | Path,
    *,
    executor: Any = None,
    batch: int = 1,
    version: object = None,
    retry: bool = False,
    accept_changes: bool = False,
    progress: bool | None = None,
) -> xarray.Dataset:
    """Run a function for each case of a study, and keep each result in a separate NetCDF file.

    A case is done once its file is in the folder, and never runs again: however a call ends,
    the same call goes on. Values added to an axis extend a study. Cases of damaged files run again,
    with a warning. A case whose outputs have other names or shapes than the others' fails, and its
    `error` names the file that keeps them. Several calls may run one study.

    Arguments:
        case: the function, called by keywords with Python numbers and strings. It returns a dict of
            numbers, strings, members of enumerations such as `jaxstab.VERDICTS`, and arrays, or a
            Dataset, with the same shapes in all cases. Arrays of xarray, such as those of
            `jaxstab.to_dataset`, keep their dimensions and units. A case that raises has failed.
        axes: one-dimensional arrays by name, whose product is run; or a list of dicts, the
            combinations to be run, which lie on the dimension `case`. They carry no units.
        path: the folder of the study, which all processes must see; created if it does not exist.
        executor: where cases run: in this process (None), in a number of processes on this machine,
            on an executor of `concurrent.futures`, or on a Dask `Client`.
        batch: how many cases run at once, by `jax.vmap` of the compiled function; if this raises,
            they run one by one, with a warning.
        version: change it whenever functions or values to which the case refers change.
        retry: run failed cases again; by default they count as done.
        accept_changes: go on if the case, `version` or packages have changed; record the change.
        progress: show a progress bar.

    Returns:
        A data set of the cases in the order of the axes. Each has a `result` ("successful",
        "failed" or "missing"), its `seconds`, in a batch the average, and the text of its `error`.
        Missing values are NaN, the least integer, False or "missing". Fields of more than 1 GB are
        read on access. `xarray.open_mfdataset(f"{path}/*.nc", combine="by_coords")` also reads it.

    Raises:
        ValueError: for a study that was begun with another case, version, packages or axes; for
            axes that are empty or not finite; for a batch that does not fit into memory; for an
            executor whose processes are forks.
        TypeError: for a function that takes other arguments, or does not return a dict of arrays;
            for axes that carry units, and outputs that do, except arrays of xarray.
        OSError, RuntimeError: if the disk is full or read-only, or the executor loses cases.

    Example:
        >>> def case(gap):
        ...     return {"pressure": js.equilibrate(contact, js.MeanGap(gap)).mean_pressure}
        >>> data = js.study(case, {"gap": [0.05, 0.1]}, "study")
        >>> [f"{p:.4f}" for p in data.pressure.values]
        ['-0.1768', '-0.1244']
    """
    require_packages("Studies", "studies", "xarray", "h5netcdf", "h5py", "cloudpickle", "dask")
    values, dims = read_axes(axes)
    require("batch", integer("batch", batch), batch > 0, "give at least 1.")
    is_fit = hasattr(executor, "submit") or (isinstance(executor, int) and executor > 0)
    cure = "give a number, an executor of concurrent.futures, or a Dask Client."
    require("executor", repr(executor), executor is None or is_fit, cure)
    try:
        inspect.signature(case).bind(**values)
    except TypeError as error:
        raise TypeError(f"The axes give the case {', '.join(values)}: {error}.") from None
    cases = Cases(Path(path).absolute(), tuple(values), dims)
    files = cases.files(values)
    try:
        cases = _begin(cases, case, version, accept_changes)
        files = cases.files(values)
        before = _read(sorted(cases.path.iterdir()), files)
        for file in [x for x in before if retry and not _is_successful(before[x])]:
            file.unlink(missing_ok=True)
            del before[file]
        left = [x for file, x in files.items() if file not in before]
        worker = CaseWorker(case, cases, batch, uuid4().hex[:8])
        warned = ""
        tasks = [left[i : i + batch] for i in range(0, len(left), batch)]
        with interrupts_held() as held:
            with progress_bar("study", len(files), "case", shown=progress, done=len(before)) as bar:
                for task, warning in run_tasks(executor, worker, tasks, lambda: bool(held)):
                    bar.update(len(task))
                    if warning and not warned:
                        warn(warned := warning)
            found = before | _read([x for x in files if x not in before], files)
            blank = _agree(cases, files, found, before)
            _remove_marks(cases.path)
    except (OSError, RuntimeError) as error:
        done = f"{sum(file.exists() for file in files)} of {len(files)} cases are in {cases.path}"
        said = f"{getattr(error, 'strerror', None) or error}: {done}. Mend this, then call again."
        number = getattr(error, "errno", None)
        if number:
            raise OSError(number, said) from error
        raise RuntimeError(said) from error
    if len(found) < len(files):
        done = f"{len(found)} of {len(files)} cases are in {cases.path}"
        warn(f"The study was interrupted: {done}. The same call goes on.", StudyInterrupted)
    return _dataset(cases, values, {file: found.get(file) for file in files}, blank)


def _begin(cases: Cases, case: Callable[..., object], version: object, accept: bool) -> Cases:
    """Write `study.json`, or compare it with a call; return the cases with axes in its order."""
    path = cases.path
    file = cases.path / RECORD
    path.mkdir(parents=True, exist_ok=True)
    names = [x.name for x in path.iterdir() if x.suffix not in (".part", ".begun")]
    if names and not any(name == RECORD or name.endswith(".nc") for name in names):
        raise ValueError(f"{path} is no study, it holds {min(names)}: give a new folder.")
    text = ""
    if file.exists():
        text = file.read_text()
    known = {}
    with suppress(ValueError, TypeError):
        known = dict(json.loads(text))
    axes = known.get("axes", cases.names)
    dims = known.get("dims", cases.dims)
    if ({*axes}, {*dims}) != ({*cases.names}, {*cases.dims}):
        asked = f"{', '.join(cases.names)} on {', '.join(cases.dims)}: give another folder."
        raise ValueError(f"{path} has axes {', '.join(axes)} on {', '.join(dims)}, not {asked}")
    now = {"axes": axes, "dims": dims, "version": version, "packages": versions()}
    now |= {"double": jax.config.values["jax_enable_x64"], "source": _source(case, version)}
    now |= {"changes": known.get("changes", [])}
    lines = text.splitlines(), json.dumps(now, indent=1, default=str).splitlines()
    changes = [*difflib.unified_diff(*lines, RECORD, "this call", n=0, lineterm="")]
    if changes and names and not accept:
        listed = "\n".join(changes[:40])
        raise ValueError(
            f"{path} was begun with another case, or {RECORD} is damaged.\n{listed}\nGive another "
            "folder; or, if its cases stay valid, `accept_changes=True` records the change."
        )
    if changes:
        if names:
            now["changes"].append({"when": time.ctime(), "changed": changes})
        write_whole(file, json.dumps(now, indent=1, default=str).encode())
    return cases._replace(names=tuple(axes), dims=tuple(dims))


def _remove_marks(path: Path) -> None:
    """Remove the marks of cases that have been begun, and have ended since."""
    for mark in path.glob("*.begun"):
        if (path / f"{mark.name.split('.')[0]}.nc").exists():
            mark.unlink(missing_ok=True)


def _source(case: Callable[..., object], version: object) -> list[str]:
    """Return the text of a function, or of the class of another callable."""
    lines = []
    while isinstance(case := inspect.unwrap(case), partial):
        lines.append(f"# with {case.args}, {case.keywords}")
        lines += _digests((case.args, case.keywords))
        case = case.func
    described: Any = case
    if not inspect.isroutine(case):
        described = type(case)
    try:
        text = inspect.getsource(described)
    except (OSError, TypeError):
        if version is None:
            raise ValueError("The source of the case is not found: give a `version`.") from None
        text = ""
    return lines + text.splitlines()


def _digests(given: PyTree) -> list[str]:
    """Return a line for each array among arguments, whose text leaves numbers out."""
    lines = []
    for x in jax.tree.leaves(given):
        if isinstance(x, jax.Array | np.ndarray) and getattr(x.dtype, "kind", "O") in "biufcU":
            digest = hashlib.blake2b(np.asarray(x).tobytes(), digest_size=10).hexdigest()
            lines.append(f"# of {x.dtype} {x.shape} {digest}")
    return lines


def _read(paths: Iterable[Path], files: Mapping[Path, Case]) -> dict[Path, Variables]:
    """Return the cases of some files; rename damaged files, remove those left by dead processes."""
    found = {}
    damaged = []
    for path in paths:
        # Another call may rename or remove it.
        with suppress(FileNotFoundError):
            if path.suffix == ".nc":
                try:
                    found[path] = read(path, LARGE // len(files)).variables
                except Damaged as error:
                    damaged.append(str(error))
                    path.rename(f"{path}.{uuid4().hex[:8]}.damaged")
            # After an hour they are of a process that was killed.
            elif path.suffix in (".part", ".begun") and time.time() - path.stat().st_mtime > 3600:
                path.unlink()
    if damaged:
        warn("These files are damaged and set aside; their cases run again.\n" + "\n".join(damaged))
    return {path: found[path] for path in files if path in found}


def _agree(
    cases: Cases, files: Mapping[Path, Case], found: dict[Path, Variables], before: Iterable[Path]
) -> Variables:
    """Set cases with unusual outputs aside as failed; give failed ones the usual outputs, empty.

    Returns these outputs.
    """
    done = {path: case for path, case in found.items() if _is_successful(case)}
    errors = {path: x["error"].values.item() for path, x in found.items() if path not in done}
    forms = {
        path: {name: _form(name, x) for name, x in case.items() if name not in cases.taken_names}
        for path, case in done.items()
    }
    counts = Counter(json.dumps(forms[x]) for x in [x for x in done if x in before] or done)
    usual = json.loads(max(counts, key=lambda text: counts[text], default="{}"))
    for path, form in forms.items():
        for name in sorted(x for x in form.keys() | usual if form.get(x) != usual.get(x)):
            here = form.get(name, "missing")
            there = usual.get(name, "missing")
            errors[path] = f"{name} is {here}, in other cases {there}: return the same in all."
    fit = [case for path, case in done.items() if path not in errors]
    blank = {name: _blank(name, [case[name] for case in fit]) for name in usual}
    kinds = {(name, x.values.dtype.kind) for name, x in blank.items()}
    for path, error in errors.items():
        if path in done or kinds - {(n, x.values.dtype.kind) for n, x in found[path].items()}:
            if path in done:
                # The values have been computed: they are kept under another name.
                kept = path.with_name(f"{path.name}.{uuid4().hex[:8]}.unusual")
                error += f" Its values are in {kept.name}."
                # Another call may have renamed it.
                with suppress(FileNotFoundError):
                    path.rename(kept)
            cases.write(files[path], blank, found[path]["seconds"].values.item(), error)
            found[path] = read(path).variables
    return blank


def _form(name: str, variable: Variable) -> str:
    dims, values, _ = variable
    kind = "words" if values.dtype.kind == "U" else "numbers"
    sizes = ", ".join(f"{n} {size}" for n, size in zip(dims, values.shape, strict=True))
    form = f"{kind} ({sizes})"
    if dims == (name,):
        form += f" {values.tolist()}"
    return form


def _blank(name: str, variables: Sequence[Variable]) -> Variable:
    """Return an output without values, in a kind that holds the values of all cases."""
    dims, values, attrs = variables[0]
    if dims == (name,):
        return variables[0]
    dtype = np.result_type(*{x.values.dtype for x in variables})
    if dtype.kind == "U":
        return Variable(dims, np.full(values.shape, "missing"), attrs)
    none = math.nan
    if dtype.kind == "b":
        none = False
    elif dtype.kind in "iu":
        none = np.iinfo(dtype).min
    return Variable(dims, np.full(values.shape, none, dtype), attrs)


def _dataset(
    cases: Cases, axes: Mapping[str, Any], found: Mapping[Path, Variables | None], blank: Variables
) -> xarray.Dataset:
    """Return the cases in the order of the axes; large fields are read on access."""
    import dask.array
    import xarray
    from dask.delayed import delayed

    dims = cases.dims
    coordinates: dict[str, Any] = {name: (name, axes[name]) for name in cases.names}
    if dims == (LISTED,):
        coordinates = {name: (dims, axes[name]) for name in cases.names}
        coordinates[LISTED] = dims, [path.stem for path in found]
    dataset = xarray.Dataset(coords=coordinates)
    shape = [dataset.sizes[name] for name in dims]
    marks = zip(MARKS, ("missing", math.nan, ""), strict=True)
    none = {name: Variable(dims, np.array(x)[(None,) * len(dims)]) for name, x in marks}
    for name, (own, value, attrs) in (none | blank).items():
        if own == (name,):
            dataset.coords[name] = own, value, attrs
            continue
        is_large = value.nbytes > LARGE // len(found) and value.dtype.kind != "U"
        parts = []
        for path, case in found.items():
            if case is None or not (name in MARKS or _is_successful(case)):
                parts.append(value)
            elif is_large:
                part: Any = delayed(read)(path)
                part = part.variables[name].values.astype(value.dtype)
                parts.append(dask.array.from_delayed(part, value.shape, value.dtype))
            else:
                parts.append(case[name].values)
        if is_large:
            values = dask.array.concatenate(parts)
        else:
            values = np.concatenate(parts)
        dataset[name] = own, values.reshape(*shape, *value.shape[len(shape) :]), attrs
    return dataset


def _is_successful(case: Variables) -> bool:
    return case["result"].values.item() == "successful"

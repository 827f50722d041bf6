"""The public function: a study, from its axes to its data set."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxstab.core.checks import integer
from jaxstab.core.optional_packages import require_packages
from jaxstab.studies import record
from jaxstab.studies.axes import LISTED, WORDS, Axes, read_axes
from jaxstab.studies.dataset import dataset_of
from jaxstab.studies.driver import Driver
from jaxstab.studies.folder import MARKS, Folder
from jaxstab.studies.worker import Worker

if TYPE_CHECKING:
    import xarray


def study(
    case: Callable[..., Any],
    axes: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    path: str | Path,
    *,
    executor: Any = None,
    batch: int = 1,
    version: str | float | None = None,
    retry: bool = False,
    accept_changes: bool = False,
    progress: bool | None = None,
) -> "xarray.Dataset":
    """Run a function for each case of a study, and keep each result in a NetCDF file of its own.

    A case is done once its file is in the folder. Finished cases never run again: after an end of
    any kind the same call goes on. Values added to an axis extend a study. Damaged files are named
    in a warning, and their cases run again. Several calls may run one study; a case may then run
    twice.

    Arguments:
        case: the function, called by names with numbers and words of Python or random keys. It
            returns a dict of numbers, words and arrays, or a Dataset, of the same shapes in all
            cases; members of enumerations such as `jaxstab.VERDICTS` become words. A case that
            raises is recorded as failed, with its message.
        axes: one-dimensional arrays by name, whose product is run; or a list of dicts, the
            combinations to be run, which lie on the dimension `case`.
        path: the folder of the study, which all processes must see; made where it does not exist.
        executor: where cases run: in this process (None), in so many processes of this machine, on
            an executor as those of `concurrent.futures`, or on a Dask `Client`.
        batch: how many cases run at once, by `jax.vmap` of the compiled function. If a batch raises
            an error, its cases are run one by one, with a warning.
        version: a number or word of yours. Change it when functions or values change to which the
            case refers: a study itself compares the source of the case alone.
        retry: run failed cases again; by default they count as done.
        accept_changes: go on if the case, `version` or packages have changed; record the change.
        progress: show a progress bar.

    Returns:
        A data set of the cases in the order of the axes. Each has a `result` ("successful",
        "failed" or "missing"), its `seconds`, in a batch the average, and the text of its `error`.
        Where there is no value, there is NaN, the least integer, False or "missing". Fields of a
        study of more than 1 GB are read on access. Once no case is missing,
        `xarray.open_mfdataset(f"{path}/*.nc", combine="by_coords")` reads the files as well.

    Raises:
        ValueError: for a study that was begun with another case, version, packages or axes; for
            axes that are empty or not finite; for a batch that does not fit into memory.
        TypeError: for a function that takes other arguments, or does not return a dict of arrays.
        OSError: if the disk is full or the folder read-only; finished cases are kept.
        RuntimeError: if the executor takes no more cases, or loses them; finished cases are kept.
        ImportError: without the packages of the extra `studies`.
    """
    require_packages("Studies", "studies", "xarray", "h5netcdf", "h5py")
    asked, path, driver = read_axes(axes), Path(path).absolute(), None
    _require_sense(case, asked, executor, integer("batch", batch), version)
    try:
        asked = record.begin(path, asked, case, version, accept_changes)
        driver = Driver(Folder(path, asked), asked.cases(), retry)
        driver.run(Worker(case, asked.kinds, driver.folder, batch), executor, progress)
    except (OSError, RuntimeError) as error:
        said = f"{getattr(error, 'strerror', None) or error}: {driver.stored if driver else path}. "
        said += "Mend this, then the same call goes on."
        if not isinstance(error, OSError):
            raise RuntimeError(said) from error
        raise OSError(*[error.errno][: error.errno is not None], said) from error
    return dataset_of(driver.folder, asked, driver.found, driver.is_large)


def _require_sense(case: Any, axes: Axes, executor: Any, batch: int, version: Any) -> None:
    number = executor if type(executor) is int else 1
    is_executor = executor is None or type(executor) is int or hasattr(executor, "submit")
    taken = [name for name in axes.values if name in (*MARKS, LISTED)]
    words = [name for name, kind in axes.kinds.items() if kind == WORDS and batch > 1]
    kind = type(case).__name__
    for is_wrong, error, message in (
        (batch < 1, ValueError, f"batch is {batch}: give at least 1."),
        (
            not is_executor,
            TypeError,
            f"executor is {executor!r}: give a number, an executor as "
            "those of concurrent.futures, or a Dask Client.",
        ),
        (number < 1, ValueError, f"executor is {executor}: give at least 1."),
        (
            not isinstance(version, str | int | float | None),
            TypeError,
            f"version is {version!r}: give a number or a word.",
        ),
        (not callable(case), TypeError, f"The case is of type {kind}: give a function."),
        (taken, ValueError, f"An axis cannot be named {taken}, a name of the study: rename it."),
        (words, ValueError, f"{words} are words, which no batch can hold: use batch=1."),
    ):
        if is_wrong:
            raise error(message)
    try:
        inspect.signature(case).bind(**axes.values)
    except TypeError as error:
        names, signature = ", ".join(axes.values), inspect.signature(case)
        raise TypeError(f"The case takes {signature}, the axes give {names}: {error}.") from None

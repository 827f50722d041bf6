"""The public function: a study, from its axes to its data set."""

import inspect
import numbers
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

from jaxstab.core.checks import integer
from jaxstab.core.optional_packages import require_packages
from jaxstab.core.progress import progress_bar
from jaxstab.core.warn import warn
from jaxstab.studies import metadata
from jaxstab.studies.axes import LISTED, Axis, arguments_of, places, read_axes
from jaxstab.studies.driver import Driver
from jaxstab.studies.executors import run_on
from jaxstab.studies.identity import identity_of, innermost, source_of
from jaxstab.studies.lock import held
from jaxstab.studies.outputs import MARKS
from jaxstab.studies.store import Store
from jaxstab.studies.worker import Worker

if TYPE_CHECKING:
    import xarray


class StudyInterrupted(UserWarning):
    """A study was interrupted; its store holds the cases done so far."""


def study(
    case: Callable[..., Mapping[str, Any]],
    axes: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    path: str | Path,
    *,
    executor: Any = None,
    batch: int = 1,
    retry: bool = False,
    accept_changes: bool = False,
    progress: bool = False,
) -> "xarray.Dataset":
    """Run a function for each case of a study, and keep its results in a Zarr store.

    Finished cases are never run again: after an end of any kind, the same call continues from
    there. A case with a lost file is run again. Values added to an axis extend a store; values left
    out stay in it.

    One call at a time drives a store. The processes of an executor share its cases; those of a
    process that dies are dealt again, at most twice.

    Arguments:
        case: the function, called by names with numbers and words of Python or random keys. It
            returns a dict of numbers, words and arrays, the same and of the same shapes in all
            cases; members of enumerations such as `jaxstab.VERDICTS` are kept as words, masked
            floats as NaN. A case that raises is recorded as failed, with its message.
        axes: one-dimensional arrays by name, whose product is run; or a list of dicts, the
            combinations to be run, which lie on the dimension `case`.
        path: the folder of the store; made where it does not exist. All processes write to it.
        executor: where cases run: in so many processes of this machine, or on an executor as
            those of `concurrent.futures`, whose processes are not forked, or a Dask `Client`.
            None: in this process, a thread to a device.
        batch: how many cases run at once, by `jax.vmap` of the compiled function. If a
            batch raises an error, its cases are run one by one, with a warning.
        retry: run failed cases again; by default they count as finished.
        accept_changes: continue a store that was begun with another case, and record the changes in
            it.
        progress: show a progress bar, with the number of failures.

    Returns:
        A data set of the cases in the order of the axes; numbers are read on access. Each case has
        a `result` ("successful", "failed" or "missing"), its `seconds`, of a batch the average, and
        the text of its `error`. Where a case has no value, there is NaN, the least integer, False
        or "missing". `xarray.open_zarr(path)` reads the whole store.

    Raises:
        ValueError: for a store that was begun with another case: the source of the function, all
            that it refers to in its own module, or the versions of packages differ. For a store
            with other axes or a damaged axis, or one that another process drives. For axes that are
            empty or not finite. For a function without source, or, in batches, one that JAX cannot
            trace. For a batch that does not fit into memory.
        TypeError: for a function that takes other arguments, or does not return a dict of arrays.
        OSError: if the disk is full; finished cases are kept, and the same call continues.
        RuntimeError: if the executor takes no more cases; finished cases are kept.
        ImportError: without xarray, zarr and filelock.
    """
    require_packages("Studies", "studies", "xarray", "zarr", "filelock")
    batch = integer("batch", batch)
    if batch < 1:
        raise ValueError(f"batch is {batch}: give at least 1.")
    _require_executor(executor)
    asked, path = read_axes(axes), Path(path)
    _require_arguments(case, asked)
    identity, source = identity_of(case), source_of(case)
    with held(path) as holder:
        group = metadata.begin(path, asked, identity, source, accept_changes)
        store = Store(path.absolute(), asked, group)
        driver = Driver(store, holder, list(places(asked)), retry)
        _run_all(driver, Worker(case, asked, batch), executor, progress)
        return store.dataset()


def _require_executor(executor: Any) -> None:
    if isinstance(executor, numbers.Number) and integer("executor", executor) < 1:
        raise ValueError(f"executor is {executor}: give at least 1 process.")
    if not (executor is None or isinstance(executor, int) or hasattr(executor, "submit")):
        raise TypeError(
            f"executor is of type {type(executor).__name__}: give a number of processes, an "
            "executor as those of concurrent.futures, or a Dask Client."
        )


def _run_all(driver: Driver, worker: Worker, executor: Any, progress: bool) -> None:
    with (
        _stopped_by_interrupt(driver) as was_interrupted,
        progress_bar(driver.num_cases, "case", shown=progress, done=driver.num_done) as bar,
    ):

        def report() -> None:
            bar.set_postfix(failed=driver.num_failed, refresh=False)
            bar.update(driver.num_done - bar.n)

        driver.report = report
        report()
        try:
            if executor is None:
                driver.run(worker)
            else:
                run_on(executor, driver, worker)
        except OSError as error:
            cure = "Fix this, then run the same call to continue."
            message = f"{error.strerror or error}: {driver.stored}. {cure}"
            raise OSError(error.errno, message) from error
    if was_interrupted() and driver.num_done < driver.num_cases:
        message = f"The study was interrupted: {driver.stored}. Run the same call to continue."
        warn(message, StudyInterrupted)


@contextmanager
def _stopped_by_interrupt(driver: Driver) -> Iterator[Callable[[], bool]]:
    """Let Ctrl-C end the block after the cases in hand, a second one at once."""
    count = 0

    def stop(*_: object) -> None:
        nonlocal count
        count += 1
        driver.stop()
        signal.signal(signal.SIGINT, signal.default_int_handler)

    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield lambda: False
        return
    signal.signal(signal.SIGINT, stop)
    try:
        yield lambda: count > 0
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _require_arguments(case: Callable[..., Any], axes: list[Axis]) -> None:
    if not isinstance(inspect.unwrap(innermost(case)), FunctionType):
        raise TypeError(f"The case is of type {type(case).__name__}: give a function.")
    names = arguments_of(axes)
    taken = [name for name in names if name in (*MARKS, LISTED)]
    if taken:
        raise ValueError(f"An axis cannot be named {taken[0]}, a name of the study: rename it.")
    try:
        inspect.signature(case).bind(**dict.fromkeys(names))
    except TypeError as error:
        raise TypeError(
            f"The case takes {inspect.signature(case)}, the axes give {', '.join(names)}: {error}."
        ) from None

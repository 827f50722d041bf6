"""The public function: a study, from its axes to its data set."""

import inspect
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

from jaxstab.core.checks import integer
from jaxstab.core.extras import require_packages
from jaxstab.core.progress import progress_bar
from jaxstab.core.warn import warn
from jaxstab.studies.axes import LISTED, Axis, arguments_of, places, read_axes
from jaxstab.studies.fingerprint import fingerprint, innermost, source_of
from jaxstab.studies.locks import claims_in
from jaxstab.studies.outputs import MARKS
from jaxstab.studies.queue import Queue
from jaxstab.studies.run import Runner
from jaxstab.studies.store import Store, claims_file

if TYPE_CHECKING:
    import xarray


class StudyInterrupted(UserWarning):
    """A study was interrupted; its store holds the cases done so far."""


def study(
    case: Callable[..., Mapping[str, Any]],
    axes: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    path: str | Path,
    *,
    batch: int = 1,
    retry: bool = False,
    progress: bool = False,
) -> "xarray.Dataset":
    """Run a function for each case of a study, and keep what it returns in a Zarr store.

    What is done is never run again: after an end of any kind, the same call goes on from there. A
    case of which a file is lost is not done.
    Several processes can share one store, each started by this same call; the cases of one that
    dies are taken over by the others, and each returns once all are done. On Windows, where the
    system has no such locks, let one process at a time run a store. Values added to an axis extend
    a store; values left out stay in it.

    Arguments:
        case: the function, called by names with numbers and words of Python or random keys. It
            returns a dict of numbers, words and arrays, the same and of the same shapes in all
            cases; members of enumerations such as `jaxstab.VERDICTS` are kept as words, masked
            floats as NaN. A case that raises is recorded as failed, with its message.
        axes: one-dimensional arrays by name, whose product is run; or a list of dicts, the
            combinations to be run, which lie on the dimension `case`.
        path: the folder of the store; made where it does not exist.
        batch: how many cases run at once, by `jax.vmap` of the compiled function; those of
            `jaxstab.cases` in as many lanes, of which none waits for the slowest. Of a batch that
            raises the cases are run one by one, with a warning.
        retry: run cases that failed before again; by default they are done.
        progress: show a progress bar, with the number of failures.

    Returns:
        What was asked for, in its order; numbers are read as they are looked at. Each case has a
        `result` ("successful", "failed" or "missing"), its `seconds`, of a batch the average, and
        the text of its `error`. Where a case has no value, there is NaN, the least integer, False
        or "missing". `xarray.open_zarr(path)` reads the whole store.

    Raises:
        ValueError: for a store that was begun with another case, found by its source and all that
            it refers to in its own module, or that has other axes, or of which an axis is damaged;
            for axes that are empty or not finite; for a function that has no source, or, in
            batches, that JAX cannot trace; for a batch that does not fit into memory.
        TypeError: for a function that takes other arguments, or returns what is no dict of arrays.
        OSError: if the disk is full; what is done stays, and the same call goes on.
        ImportError: without xarray and zarr.
    """
    require_packages("Studies", "studies", "xarray", "zarr")
    batch = integer("batch", batch)
    if batch < 1:
        raise ValueError(f"batch is {batch}: give at least 1.")
    asked, path = read_axes(axes), Path(path)
    _require_arguments(case, asked)
    identity, source = fingerprint(case), source_of(case)
    with claims_in(claims_file(path)) as claims:
        store = Store(path, asked, claims, identity, source)
        queue = Queue(store, claims, list(places(asked)), retry)
        _run_all(case, asked, store, queue, batch, progress)
        return store.dataset()


def _run_all(
    case: Callable[..., Any],
    axes: list[Axis],
    store: Store,
    queue: Queue,
    batch: int,
    progress: bool,
) -> None:
    total = queue.num_cases

    def stored() -> str:
        return f"{queue.num_done} of {total} cases are in {store.path}"

    with (
        _stopped_by_interrupt(queue) as was_interrupted,
        progress_bar(total, "case", shown=progress, done=queue.num_done) as bar,
    ):

        def report() -> None:
            bar.set_postfix(failed=queue.num_failed, refresh=False)
            bar.update(queue.num_done - bar.n)

        try:
            Runner(case, axes, store, queue, batch, report).run()
        except OSError as error:
            cure = "Once that is mended, the same call goes on."
            message = f"{error.strerror or error}: {stored()}. {cure}"
            raise OSError(error.errno, message) from error
        report()
    if was_interrupted() and queue.num_done < total:
        message = f"The study was interrupted: {stored()}. The same call goes on."
        warn(message, StudyInterrupted)


@contextmanager
def _stopped_by_interrupt(queue: Queue) -> Iterator[Callable[[], bool]]:
    """Let Ctrl-C end the block after the cases in hand, a second one at once."""
    count = 0

    def stop(*_: object) -> None:
        nonlocal count
        count += 1
        queue.stop()
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
        raise ValueError(f"An axis cannot be named {taken[0]}, as the study does: rename it.")
    try:
        inspect.signature(case).bind(**dict.fromkeys(names))
    except TypeError as error:
        raise TypeError(
            f"The case takes {inspect.signature(case)}, the axes give {', '.join(names)}: {error}."
        ) from None

"""Cases in other processes, dealt out by an executor of any kind."""

import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager, nullcontext
from functools import cache, lru_cache
from typing import Any

import jax

from jaxstab.core.optional_packages import require_packages
from jaxstab.studies.axes import Index
from jaxstab.studies.driver import Driver
from jaxstab.studies.identity import versions
from jaxstab.studies.lock import Holder
from jaxstab.studies.outputs import error_text
from jaxstab.studies.store import Found, Store
from jaxstab.studies.worker import Worker

# Of a case whose process dies; the last time no other case is in hand.
_TRIES = 3
# How often an executor may lose what it was given before a task comes back.
_PATIENCE = 5
# The tasks in hand at a time.
_WINDOW = 1000
# What cases and disks do.
_TOLD = (OSError, TypeError, ValueError)
_IMPORTED_BY = os.getpid()


def run_on(executor: Any, driver: Driver, worker: Worker) -> None:
    """Run the cases of a study on an executor, a Dask client, or so many processes.

    Raises:
        RuntimeError: if an executor takes no more cases, or loses all of them.
    """
    require_packages("Executors", "studies", "cloudpickle")
    import cloudpickle

    holder = driver.holder
    for mark in holder.folder.glob("begun.*"):
        mark.unlink()
    try:
        content = cloudpickle.dumps((worker, driver.store, versions()))
    except Exception as error:
        raise TypeError(
            f"The case cannot be pickled for other processes ({error_text(error)}): make what it "
            "refers to inside of the function."
        ) from error
    # Arrays are unpickled in the precision that is found first.
    order = pickle.dumps((jax.config.values["jax_enable_x64"], content))
    (holder.folder / "case").write_bytes(order)
    if hasattr(executor, "get_executor"):
        executor = executor.get_executor()
    try:
        _Dealer(driver, worker.batch).run(executor)
    finally:
        (holder.folder / "case").unlink(missing_ok=True)


class _Dealer:
    """Deals cases to executors, and again where they were lost.

    Arguments:
        driver: knows the cases that are left.
        size: how many cases are in a task.
    """

    def __init__(self, driver: Driver, size: int):
        self._driver, self._size = driver, size
        self._alone: deque[Index] = deque()
        self._num_tasks, self._num_lost = 0, 0
        self._error: Exception | None = None

    def run(self, executor: Any) -> None:
        """Deal until no case is left, to a new pool of processes once one of them has died."""
        is_over = False
        while not is_over:
            with _pool(executor) if isinstance(executor, int) else nullcontext(executor) as pool:
                try:
                    self._deal_to(pool)
                    is_over = True
                except BrokenExecutor as error:
                    if pool is executor:
                        raise RuntimeError(
                            "A process of the executor died, so it takes no more cases: "
                            f"{self._driver.stored}. Run the same call with a new executor to "
                            "continue, or give the number of processes."
                        ) from error
        if self._error is not None:
            raise self._error

    def _deal_to(self, pool: Any) -> None:
        in_hand: dict[Future, list[Index]] = {}
        try:
            while True:
                while len(in_hand) < _WINDOW and (places := self._driver.take(self._size)):
                    self._submit(pool, places, in_hand)
                if not in_hand and self._alone:
                    self._submit(pool, [self._alone.popleft()], in_hand)
                if not in_hand:
                    return
                # On Windows, Ctrl-C does not end a wait.
                for future in wait(in_hand, timeout=1, return_when=FIRST_COMPLETED).done:
                    self._receive(future, in_hand[future])
                    del in_hand[future]
        except BrokenExecutor as error:
            self._deal_again([place for places in in_hand.values() for place in places], error)
            raise
        finally:
            for future in in_hand:
                future.cancel()

    def _submit(self, pool: Any, places: list[Index], in_hand: dict[Future, list[Index]]) -> None:
        self._num_tasks += 1
        future: Any = Future()
        try:
            # By its number, Dask does not take a task for one that it has done.
            future = pool.submit(run_cases, self._driver.holder, self._num_tasks, places)
        finally:
            in_hand[future] = places

    def _receive(self, future: Future, places: list[Index]) -> None:
        lost = CancelledError("it was cancelled") if future.cancelled() else future.exception()
        if isinstance(lost, BrokenExecutor):
            raise lost
        heard, error = ([], None) if lost else future.result()
        try:
            for found in heard:
                self._driver.record(found)
        except _TOLD as own:
            error = own
        if error is not None and self._error is None:
            self._error = error
            self._driver.stop()
        known = {found.place for found in heard if isinstance(found, Found)}
        if left := [place for place in places if place not in known]:
            self._deal_again(left, lost)
        else:
            self._num_lost = 0

    def _deal_again(self, places: list[Index], error: BaseException | None) -> None:
        """Put cases back that an executor has lost; where it loses all, that is an error."""
        self._num_lost += 1
        if self._num_lost > _PATIENCE and not self._driver.is_stopped:
            raise RuntimeError(
                f"The executor lost its tasks {self._num_lost} times one after another "
                f"({type(error).__name__}: {error}): its processes must be able to import jaxstab "
                "and what the case imports, and a script must start its study under `if __name__ "
                f'== "__main__":`. {self._driver.stored}. Run the same call to continue.'
            ) from error
        store = self._driver.store
        for place in places:
            if result := store.result(place):
                self._driver.record(Found(place, result=result))
            elif store.num_begun(place) < _TRIES - 1:
                self._driver.put_back(place)
            elif not self._driver.is_stopped:
                self._alone.appendleft(place)


@contextmanager
def _pool(number: int) -> Iterator[ProcessPoolExecutor]:
    """Yield processes that end with this one; if the block raises, they end at once."""
    others = set(multiprocessing.active_children())
    # Its processes share the caller's compilation cache.
    settings = {name: x for name, x in jax.config.values.items() if "_cache_" in name}
    # JAX does not survive a fork.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(number, context, _begin, (settings,))
    try:
        yield pool
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.kill()
        raise
    finally:
        pool.shutdown()


def _begin(settings: dict[str, Any]) -> None:
    _end_with_parent()
    for name, value in settings.items():
        jax.config.update(name, value)


def run_cases(
    holder: Holder, number: int, places: Sequence[Index]
) -> tuple[list[Found | str], Exception | None]:
    """Run and store cases in a worker; return their results, and the error that ended it early."""
    heard: list[Found | str] = []
    try:
        _require_spawned()
        if holder.is_running():
            x64, worker, store = _loaded(holder)
            with jax.enable_x64(x64):
                for found in _run(holder, worker, store, deque(places)):
                    heard.append(found)
    except _TOLD as error:
        # Alone: what caused it, and where, may not survive the way.
        kind = next(kind for kind in _TOLD if isinstance(error, kind))
        return heard, kind(*error.args)
    except Exception:
        return heard, RuntimeError(f"In a worker:\n{traceback.format_exc()}")
    return heard, None


def _run(holder: Holder, worker: Worker, store: Store, left: deque[Index]) -> Iterator[Found | str]:
    """Yield what became of cases, once it is stored."""
    known: list[Found] = []

    def take(number: int) -> list[Index]:
        taken = []
        while left and len(taken) < number and holder.is_running():
            place = left.popleft()
            result = store.result(place)
            if result is None and store.begin(place) > _TRIES:
                error = f"The process of this case died {_TRIES} times."
                result = store.keep(Found(place, error=error))
                store.end(place)
            if result is None:
                taken.append(place)
            else:
                known.append(Found(place, result=result))
        return taken

    for found in worker.run(take):
        # Another driver may have the store by now.
        if not holder.is_current():
            return
        if isinstance(found, Found):
            result = store.keep(found)
            store.end(found.place)
            found = Found(found.place, result=result)
        yield found
    yield from known


@lru_cache(maxsize=1)
def _loaded(holder: Holder) -> tuple[bool, Worker, Store]:
    """Return what runs and stores the cases of a study; it keeps its compiled programs."""
    import cloudpickle

    _end_with_parent()
    x64, content = pickle.loads((holder.folder / "case").read_bytes())
    with jax.enable_x64(x64):
        worker, store, theirs = cloudpickle.loads(content)
    if theirs != versions():
        raise ValueError(
            f"A worker has the packages {versions()}, the study {theirs}: install the same."
        )
    return x64, worker, store


def _require_spawned() -> None:
    if multiprocessing.parent_process() is not None and os.getpid() != _IMPORTED_BY:
        raise ValueError(
            "The executor forks its processes, and JAX fails in a forked process: give it "
            'mp_context=multiprocessing.get_context("spawn").'
        )


@cache
def _end_with_parent() -> None:
    """Let a process of a pool end with the one that made it, and leave Ctrl-C to that."""
    parent = multiprocessing.parent_process()
    if parent is None or threading.current_thread() is not threading.main_thread():
        return

    def end() -> None:
        parent.join()
        os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end, daemon=True).start()

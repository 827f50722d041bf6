"""Cases in other processes, on an executor of any kind."""

import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, ProcessPoolExecutor
from contextlib import nullcontext, suppress
from functools import lru_cache
from queue import Empty, SimpleQueue
from typing import Any

import jax

from jaxstab.core.optional_packages import require_packages
from jaxstab.studies.axes import Coordinates
from jaxstab.studies.record import packages
from jaxstab.studies.worker import Ended, Worker, error_text

# The tasks in hand at a time: of an executor, and of a process of our own.
_WINDOW, _OWN_WINDOW = 1000, 2
# How often a task is submitted again that was lost before it began.
_RETRIES = 2
_X64 = "jax_enable_x64"
_busy = threading.Lock()
Task = tuple[Coordinates, ...]


def run_on(
    executor: Any,
    worker: Worker,
    cases: Sequence[Coordinates],
    settle: Callable[[list[Ended], str], None],
    is_stopped: Callable[[], bool],
) -> None:
    """Run cases in so many processes, on a Dask client, or on anything with `submit`.

    The cases of processes that die are submitted again. After a stop those in hand end.

    Raises:
        TypeError: if the case cannot be pickled.
        RuntimeError: if the executor takes no more cases, or loses some before they begin.
    """
    require_packages("Executors", "studies", "cloudpickle")
    import cloudpickle

    try:
        content = cloudpickle.dumps((worker, packages()))
    except Exception as error:
        raise TypeError(
            f"The case cannot be pickled for other processes ({error_text(error)}): make the "
            "objects that it refers to inside of the function."
        ) from error
    others, is_own = set(multiprocessing.active_children()), isinstance(executor, int)
    # Our own processes share the caller's compilation cache.
    names = [n for n in jax.config.values if n == _X64 or (is_own and "_cache_" in n)]
    settings = {name: jax.config.values[name] for name in names}
    # As bytes, which every executor carries.
    order = pickle.dumps((settings, content))
    if hasattr(executor, "get_executor"):
        executor = executor.get_executor(pure=False)
    # A process of our own is a pool by itself, so that its death costs no other its case.
    pools = [_process() for _ in range(executor)] if is_own else [executor]
    tasks = deque(tuple(cases[i : i + worker.batch]) for i in range(0, len(cases), worker.batch))
    in_hand: dict[Any, tuple[int, Task]] = {}
    counts, num_lost, done = Counter[int](), Counter[int](), SimpleQueue[Any]()

    def submit(place: int) -> None:
        while tasks and counts[place] < (_OWN_WINDOW if is_own else _WINDOW):
            try:
                future = pools[place].submit(_run, order, is_own, pickle.dumps(tasks[0]))
            except Exception as error:
                if is_own:
                    # Its process has died, as the tasks in its hand will tell.
                    return
                message = f"The executor takes no more cases ({error_text(error)})"
                raise RuntimeError(message) from error
            in_hand[future] = place, tasks.popleft()
            counts[place] += 1
            future.add_done_callback(done.put)

    def drop() -> None:
        tasks.clear()
        for future, (_, task) in list(in_hand.items()):
            if not any(map(worker.num_begun, task)):
                # Not every executor can.
                with suppress(NotImplementedError):
                    future.cancel()

    try:
        while tasks or in_hand:
            if is_stopped():
                drop()
            for place in range(len(pools)):
                submit(place)
            try:
                # Now and then look whether to stop.
                future = done.get(timeout=0.2)
            except Empty:
                continue
            place, task = in_hand.pop(future)
            counts[place] -= 1
            error = CancelledError() if future.cancelled() else future.exception()
            if error is None and isinstance(future.result(), Exception):
                raise future.result()
            if error is None:
                settle(*future.result())
            elif not is_stopped():
                num_lost[id(task)] += not any(map(worker.num_begun, task))
                if num_lost[id(task)] > _RETRIES:
                    raise RuntimeError(
                        f"The executor lost a case {_RETRIES + 1} times before it began "
                        f"({error_text(error)}); a script must call js.study under "
                        "`if __name__ == '__main__':`"
                    ) from error
                tasks.appendleft(task)
                if is_own and not counts[place]:
                    pools[place] = _process()
    finally:
        drop()
        if isinstance(sys.exception(), KeyboardInterrupt) and is_own:
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
        for pool in pools if is_own else ():
            pool.shutdown(cancel_futures=True)


def _process() -> ProcessPoolExecutor:
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, context, initializer=_end_with_driver)


def _end_with_driver() -> None:
    """Let a process of our own end once its driver has died, after the case in hand."""

    def wait() -> None:
        multiprocessing.parent_process().join()  # pyright: ignore[reportOptionalMemberAccess]
        with _busy:
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _run(order: bytes, is_own: bool, task: bytes) -> Any:
    """Run a task in a process of an executor; return an error that ends the study."""
    is_main = threading.current_thread() is threading.main_thread()
    if multiprocessing.parent_process() and is_main:
        # Ctrl-C in a terminal reaches all processes; the driver waits for the case in hand.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    with _busy if is_own else nullcontext():
        try:
            return _worker(order).run(pickle.loads(task))
        except OSError as error:
            return OSError(error.errno, error.strerror or str(error))
        except Exception as error:
            return ValueError(str(error))


@lru_cache(maxsize=1)
def _worker(order: bytes) -> Worker:
    import cloudpickle

    # Arrays are unpickled in the precision that is found first.
    settings, content = pickle.loads(order)
    for name, value in settings.items():
        jax.config.update(name, value)
    worker, versions = cloudpickle.loads(content)
    if versions != packages():
        raise ValueError(f"A worker has {packages()}, the study {versions}: install the same.")
    return worker

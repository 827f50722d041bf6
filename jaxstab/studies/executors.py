"""Tasks, batches of cases, on an executor of any kind."""

import multiprocessing
import os
import pickle
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from functools import lru_cache, partial
from typing import Any

import jax

from jaxstab.core.optional_packages import versions
from jaxstab.studies.cases import Case
from jaxstab.studies.worker import MOST_TRIES, CaseWorker

Task = Sequence[Case]
# How many tasks a foreign executor gets at a time.
_WINDOW = 1000


def run_tasks(
    executor: Any, worker: CaseWorker, tasks: Sequence[Task], is_stopped: Callable[[], bool]
) -> Iterator[tuple[Task, str]]:
    """Run tasks here (None), in so many processes, on a Dask client, or anything with `submit`.

    Tasks of processes that die are submitted again. After a stop those that have begun end.

    Yields:
        Tasks and their warnings, as they end.

    Raises:
        RuntimeError: if the executor takes no more tasks, or loses one before it begins.
        ValueError: for an executor whose processes are forks.
    """
    if executor is None:
        yield from ((task, worker.run(task)) for task in tasks if not is_stopped())
        return
    _require_no_fork(executor)
    import cloudpickle

    is_own = isinstance(executor, int)
    left = deque(enumerate(tasks))
    num_lost = Counter[int]()
    # Our own processes share the caller's compilation cache.
    names = [n for n in jax.config.values if "enable_x64" in n or (is_own and "_cache_" in n)]
    settings = {name: jax.config.values[name] for name in names}
    order = pickle.dumps((settings, versions(), cloudpickle.dumps(worker)))
    if hasattr(executor, "get_executor"):
        executor = executor.get_executor(pure=False)
    pools = [executor]
    free = deque([0] * _WINDOW)
    if is_own:
        # Each process is a pool with one task in hand, the only one that its death costs.
        pools = [_process() for _ in range(executor)]
        free = deque(range(executor))
    in_hand = {}
    try:
        while left or in_hand:
            if is_stopped():
                left.clear()
                for future, (_, (_, task)) in in_hand.items():
                    if not worker.is_begun(task):
                        future.cancel()
            while left and free:
                try:
                    future = pools[free[0]].submit(_run, order, pickle.dumps(left[0][1]))
                    in_hand[future] = free.popleft(), left.popleft()
                except futures.BrokenExecutor:
                    if not is_own:
                        raise
                    pools[free[0]] = _process()
            # Now and then look whether to stop.
            for future in futures.wait(in_hand, 0.2, futures.FIRST_COMPLETED).done:
                place, (number, task) = in_hand.pop(future)
                free.append(place)
                error = futures.CancelledError()
                if not future.cancelled():
                    error = future.exception()
                if error is None and isinstance(future.result(), Exception):
                    raise future.result()
                if error is None:
                    yield task, future.result()
                elif not is_stopped():
                    num_lost[number] += not worker.is_begun(task)
                    if num_lost[number] == MOST_TRIES:
                        said = f"The executor lost a task {MOST_TRIES} times before it began"
                        cure = "call a script's code under `if __name__ == '__main__':`"
                        raise RuntimeError(
                            f"{said} ({type(error).__name__}: {error}): {cure}"
                        ) from error
                    left.appendleft((number, task))
    finally:
        for future in in_hand:
            future.cancel()
        if is_own:
            for pool in pools:
                pool.shutdown(cancel_futures=True)


def _require_no_fork(executor: object) -> None:
    """Refuse an executor whose processes are forks: in a copy of a process, JAX waits for ever."""
    context: Any = getattr(executor, "_mp_context", None)
    # A context, or multiprocessing itself.
    if hasattr(context, "get_start_method") and context.get_start_method() == "fork":
        raise ValueError(
            "The processes of this executor are forks of this one, in which JAX hangs: give "
            'ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")), or a number '
            "of processes."
        )


def _begin_process() -> None:
    """Let a process of our own end with its driver, and at the second Ctrl-C."""
    signal.signal(signal.SIGINT, lambda *_: signal.signal(signal.SIGINT, signal.SIG_DFL))
    parent: Any = multiprocessing.parent_process()
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


_spawn = multiprocessing.get_context("spawn")
_process = partial(futures.ProcessPoolExecutor, 1, _spawn, initializer=_begin_process)


def _run(order: bytes, task: bytes) -> str | Exception:
    """Run a task in a process of an executor; return an error of the worker."""
    try:
        return _worker(order).run(pickle.loads(task))
    except Exception as error:
        return error


@lru_cache(maxsize=1)
def _worker(order: bytes) -> CaseWorker:
    # Arrays are unpickled in the precision that is found first.
    settings, expected, content = pickle.loads(order)
    for name, value in settings.items():
        jax.config.update(name, value)
    if expected != versions():
        raise ValueError(f"A worker has {versions()}, its driver {expected}: install the same.")
    return pickle.loads(content)

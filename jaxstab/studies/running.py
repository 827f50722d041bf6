"""Runs cases, one by one or in batches, in this process or on an executor of any kind."""

import errno
import multiprocessing
import os
import pickle
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import numpy as np

from jaxstab.core.optional_packages import versions
from jaxstab.studies.cases import RECORD, Case, Cases

# A case that has ended so many processes has failed, and so has an executor that loses a task.
_MOST_DEATHS = 3


@dataclass
class Worker:
    """Runs cases and writes their files; it marks those that it begins, in its driver's name."""

    case: Callable[..., Any]
    cases: Cases
    batch: int
    driver: str

    def run(self, cases: Sequence[Case]) -> str:
        """Run the cases that have no file yet; return a warning, empty if there is none."""
        left, warning = [case for case in cases if not self.cases.file(case).exists()], ""
        # After a death one by one, to find the case that ends its process.
        if self.batch > 1 and left and not any(map(self.num_begun, left)):
            try:
                return self._run_together(left)
            except Exception as error:
                reason = _text(error).splitlines()[0]
                if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
                    said = (
                        f"A batch of {self.batch} cases needs more memory: give a smaller `batch`"
                    )
                    raise ValueError(f"{said} ({reason}).") from error
                warning = f"A batch raised an error, and its cases are run one by one: {reason}"
        for case in left:
            start, returned = perf_counter(), {}
            message = f"The process of this case died {_MOST_DEATHS} times."
            if self.num_begun(case) < _MOST_DEATHS:
                self._begin([case])
                try:
                    returned, message = jax.block_until_ready(self.case(**case)), ""
                except (Exception, SystemExit) as error:
                    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
                        raise
                    message = _text(error)
            self._keep(case, returned, perf_counter() - start, message)
        return warning

    def num_begun(self, case: Case) -> int:
        """Return how many processes have begun a case without an end."""
        return self._mark(case).stat().st_size if self._mark(case).exists() else 0

    def _mark(self, case: Case) -> Path:
        return self.cases.file(case).with_suffix(f".{self.driver}.begun")

    def _begin(self, cases: Sequence[Case]) -> None:
        for case in cases:
            with self._mark(case).open("ab") as mark:
                mark.write(b".")

    def _run_together(self, cases: Sequence[Case]) -> str:
        self._begin(cases)
        start = perf_counter()
        # Of one length, with copies of the last case, all batches are one program.
        padded = [*cases, *[cases[-1]] * (self.batch - len(cases))]
        values = {name: np.array([case[name] for case in padded]) for name in cases[0]}
        returned = jax.device_get(self._batched(values))
        seconds = (perf_counter() - start) / len(cases)
        for i, case in enumerate(cases):
            self._keep(case, jax.tree.map(lambda leaf, i=i: leaf[i], returned), seconds)
        return ""

    @cached_property
    def _batched(self) -> Callable[..., Any]:
        case = jax.jit(self.case)
        return jax.jit(jax.vmap(lambda values: case(**values)))

    def _keep(self, case: Case, returned: Any, seconds: float, error: str = "") -> None:
        self._mark(case).unlink(missing_ok=True)
        try:
            outputs = {} if error else self.cases.outputs_of(returned)
        except (TypeError, ValueError) as unfit:
            if not any(self.cases.path.glob("*.nc")):
                # The function, once mended, may begin the study anew.
                (self.cases.path / RECORD).unlink(missing_ok=True)
                raise
            outputs, error = {}, str(unfit)
        self.cases.write(case, outputs, seconds, error)


def run_all(
    executor: Any, worker: Worker, cases: Sequence[Case], is_stopped: Callable[[], bool]
) -> Iterator[tuple[int, str]]:
    """Run cases here, in so many processes, on a Dask client, or on anything with `submit`.

    Yield how many have ended and a warning. After a stop those in hand end.
    """
    tasks = deque(cases[i : i + worker.batch] for i in range(0, len(cases), worker.batch))
    while executor is None and tasks and not is_stopped():
        yield len(tasks[0]), worker.run(tasks.popleft())
    if executor is None or not tasks:
        return
    import cloudpickle

    is_own, lost = isinstance(executor, int), Counter[Path]()
    # Our own processes share the caller's compilation cache.
    names = [n for n in jax.config.values if "enable_x64" in n or (is_own and "_cache_" in n)]
    settings = {name: jax.config.values[name] for name in names}
    order = pickle.dumps((settings, versions(), cloudpickle.dumps(worker)))
    if hasattr(executor, "get_executor"):
        executor = executor.get_executor(pure=False)
    # Each process of our own is a pool with one case in hand, the only one that its death costs.
    pools = [_process() for _ in range(executor)] if is_own else [executor]
    free, in_hand = deque([*range(len(pools))] * (1 if is_own else 1000)), {}
    try:
        while tasks or in_hand:
            if is_stopped():
                tasks.clear()
                for future, (_, task) in in_hand.items():
                    if not any(map(worker.num_begun, task)):
                        future.cancel()
            while tasks and free:
                try:
                    future = pools[free[0]].submit(_run, order, pickle.dumps(tasks[0]))
                    in_hand[future] = free.popleft(), tasks.popleft()
                except futures.BrokenExecutor:
                    if not is_own:
                        raise
                    pools[free[0]] = _process()
            # Now and then look whether to stop.
            for future in futures.wait(in_hand, 0.2, futures.FIRST_COMPLETED).done:
                place, task = in_hand.pop(future)
                free.append(place)
                error = futures.CancelledError() if future.cancelled() else future.exception()
                if error is None and isinstance(future.result(), Exception):
                    raise future.result()
                if error is None:
                    yield len(task), future.result()
                elif not is_stopped():
                    file = worker.cases.file(task[0])
                    lost[file] += not any(map(worker.num_begun, task))
                    if lost[file] == _MOST_DEATHS:
                        said = f"The executor lost a case {lost[file]} times before it began"
                        cure = "a script must call js.study under `if __name__ == '__main__':`"
                        raise RuntimeError(f"{said} ({_text(error)}); {cure}") from error
                    tasks.appendleft(task)
    finally:
        for future in in_hand:
            future.cancel()
        for pool in pools if is_own else ():
            pool.shutdown(cancel_futures=True)


def _begin_process() -> None:
    """Let a process of our own end with its driver, and at the second Ctrl-C."""
    signal.signal(signal.SIGINT, lambda *_: signal.signal(signal.SIGINT, signal.SIG_DFL))
    parent: Any = multiprocessing.parent_process()
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


_spawn = multiprocessing.get_context("spawn")
_process = partial(futures.ProcessPoolExecutor, 1, _spawn, initializer=_begin_process)


def _run(order: bytes, task: bytes) -> Any:
    """Run a task in a process of an executor; return an error that ends the study."""
    try:
        return _worker(order).run(pickle.loads(task))
    except Exception as error:
        return error


@lru_cache(maxsize=1)
def _worker(order: bytes) -> Worker:
    # Arrays are unpickled in the precision that is found first.
    settings, expected, content = pickle.loads(order)
    for name, value in settings.items():
        jax.config.update(name, value)
    if expected != versions():
        raise ValueError(f"A worker has {versions()}, the study {expected}: install the same.")
    return pickle.loads(content)


def _text(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"

"""Deals out the cases of a study, and hears what becomes of them."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax

from jaxstab.core.warn import warn
from jaxstab.studies.axes import Index
from jaxstab.studies.lock import Holder
from jaxstab.studies.store import Found, Store
from jaxstab.studies.worker import Worker


class Driver:
    """The cases that are left, and those that are done.

    Arguments:
        store: where they go.
        holder: this process, as workers know it.
        places: all cases of the call.
        retry: whether those that failed before are left, too.

    Attributes:
        num_cases: how many cases there are.
        num_done: how many of them are done.
        num_failed: how many of these failed.
        is_stopped: whether no more are to be begun.
        report: called after each case.
    """

    def __init__(self, store: Store, holder: Holder, places: Sequence[Index], retry: bool):
        self.store, self.holder = store, holder
        self.num_cases, self.num_done, self.num_failed = len(places), 0, 0
        self.is_stopped, self._has_warned = False, False
        self.report: Callable[[], None] = lambda: None
        self._guard = threading.Lock()
        self._left: deque[Index] = deque()
        for place in places:
            result = store.result(place)
            if result == "failed" and retry:
                store.forget(place)
                result = None
            if result is None:
                self._left.append(place)
            else:
                self._count(result)

    @property
    def stored(self) -> str:
        """How much is done, in words."""
        return f"{self.num_done} of {self.num_cases} cases are in {self.store.path}"

    def take(self, number: int) -> list[Index]:
        """Return up to so many cases that are left; none once it was stopped."""
        with self._guard:
            return [self._left.popleft() for _ in range(min(number, len(self._left)))]

    def put_back(self, place: Index) -> None:
        """Let a case be dealt again, after all others."""
        if not self.is_stopped:
            self._left.append(place)

    def record(self, found: Found | str) -> None:
        """Store and count a case; of batches that raise, which are warnings, the first is said."""
        with self._guard:
            if not isinstance(found, str):
                self._count(found.result or self.store.keep(found))
                self.store.add_arrays()
                self.report()
            elif not self._has_warned:
                self._has_warned = True
                warn(found)

    def stop(self) -> None:
        """Let no more cases be begun."""
        self.is_stopped = True
        self._left.clear()
        self.holder.announce()

    def run(self, worker: Worker) -> None:
        """Run the cases in this process, a thread to a device."""
        devices = jax.local_devices()
        if len(devices) == 1:
            self._work(worker)
            return
        with ThreadPoolExecutor(len(devices)) as threads:
            futures = [threads.submit(self._work, worker, device) for device in devices]
            try:
                for future in futures:
                    future.result()
            finally:
                self.stop()

    def _work(self, worker: Worker, device: Any = None) -> None:
        try:
            with jax.default_device(device):
                for found in worker.run(self.take):
                    self.record(found)
        except BaseException:
            self.stop()
            raise

    def _count(self, result: str) -> None:
        self.num_done += 1
        self.num_failed += result == "failed"

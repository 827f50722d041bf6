"""The cases that are left: dealt to the threads of this process, and shared with others."""

import os
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence

from jaxstab.studies.axes import Index
from jaxstab.studies.locks import Claims
from jaxstab.studies.store import Store

# Seconds between looks at what other processes have in hand.
_PAUSE = 0.1
# Its multiples modulo one are far from each other.
_GOLDEN = 0.6180339887498949


class Queue:
    """The cases that are left.

    Arguments:
        store, claims: those of the study.
        places: all cases asked for.
        retry: whether those that failed before are left, too.

    Attributes:
        num_cases: how many cases there are.
        num_done: how many cases were seen to be done.
        num_failed: how many of them failed.
    """

    def __init__(self, store: Store, claims: Claims, places: Sequence[Index], retry: bool = False):
        self._store = store
        self._claims = claims
        self._guard = threading.Lock()
        self._is_stopped = False
        self.num_cases, self.num_done, self.num_failed = len(places), 0, 0
        self._left: deque[Index] = deque()
        for place in places:
            if retry:
                self._forget_failed(store.index(place))
            if not self._is_done(place):
                self._left.append(place)
        self._left.rotate(-int(start(os.environ) * len(self._left)))

    def take(self, number: int, waits: bool = True) -> list[Index]:
        """Claim up to `number` cases; none where all are done, or it was stopped.

        Where others have all that is left in hand, wait for them or for their end, if so asked.
        """
        while not self._is_stopped:
            with self._guard:
                taken = self._claimed(number)
                if taken or not self._left or not waits:
                    return taken
            time.sleep(_PAUSE)
        return []

    def finish(self, places: Sequence[Index]) -> None:
        """Give cases back, done or not."""
        with self._guard:
            for place in places:
                if not self._is_done(place):
                    self._left.append(place)
                self._claims.release(self._store.index(place))

    def stop(self) -> None:
        """Let no more cases be taken."""
        self._is_stopped = True

    def _claimed(self, number: int) -> list[Index]:
        taken = []
        for _ in range(len(self._left)):
            if len(taken) == number:
                break
            place = self._left.popleft()
            if self._is_done(place):
                continue
            index = self._store.index(place)
            if not self._claims.claim(index):
                self._left.append(place)
            # Another process may have done it since.
            elif self._is_done(place):
                self._claims.release(index)
            else:
                taken.append(place)
        return taken

    def _forget_failed(self, index: Index) -> None:
        # A case that another process has in hand is being run again.
        if self._store.result(index) == "failed" and self._claims.claim(index):
            if self._store.result(index) == "failed":
                self._store.forget(index)
            self._claims.release(index)

    def _is_done(self, place: Index) -> bool:
        result = self._store.result(self._store.index(place))
        self.num_done += result is not None
        self.num_failed += result == "failed"
        return result is not None


def start(environment: Mapping[str, str]) -> float:
    """Return the part of the list at which to start, another one in each task of Slurm."""
    task = environment.get("SLURM_ARRAY_TASK_ID") or environment.get("SLURM_PROCID") or ""
    return int(task) * _GOLDEN % 1 if task.isdecimal() else 0.0

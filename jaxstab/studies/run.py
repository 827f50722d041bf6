"""The cases of a study, run one by one or in batches, on each of the devices."""

import errno
import re
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import jax
import numpy as np

from jaxstab.core.warn import warn
from jaxstab.studies.axes import LISTED, Axis, Index, arguments_of, places, stacked_at, values_at
from jaxstab.studies.cases import Case
from jaxstab.studies.lanes.programs import Programs
from jaxstab.studies.lanes.scheduler import Lanes
from jaxstab.studies.outputs import arrays_of
from jaxstab.studies.queue import Queue
from jaxstab.studies.store import Store

_FULL = (errno.ENOSPC, errno.EDQUOT)


@dataclass
class Runner:
    """Runs the cases of a queue.

    Attributes:
        case: the function.
        axes: what it is called with.
        store: where its outputs go.
        queue: the cases.
        batch: how many at once.
        report: called after each batch.
    """

    case: Callable[..., Any]
    axes: Sequence[Axis]
    store: Store
    queue: Queue
    batch: int
    report: Callable[[], None]

    def __post_init__(self) -> None:
        self.together = jax.jit(jax.vmap(lambda values: self.case(**values)))
        self.programs = self.case.programs() if isinstance(self.case, Case) else None
        self._has_warned = False

    def run(self) -> None:
        """Run cases until none is left, a thread to a device."""
        devices = jax.local_devices()
        if len(devices) == 1:
            self.work()
            return
        with ThreadPoolExecutor(len(devices)) as threads:
            futures = [threads.submit(self.work, device) for device in devices]
            try:
                for future in futures:
                    future.result()
            finally:
                self.queue.stop()

    def work(self, device: Any = None) -> None:
        """Run cases until none is left."""
        solve = self.solve if self.batch == 1 else self.solve_together
        try:
            with jax.default_device(device):
                if self.programs and self.batch > 1:
                    self.solve_in_lanes(self.programs)
                    return
                while places := self.queue.take(self.batch):
                    try:
                        solve(places)
                    finally:
                        self.queue.finish(places)
                    self.report()
        finally:
            self.queue.stop()

    def solve(self, places: Sequence[Index]) -> None:
        """Run and store cases one by one."""
        for place in places:
            start = perf_counter()
            try:
                outputs = self.case(**values_at(self.axes, place))
                outputs = jax.block_until_ready(outputs)
            except Exception as error:
                if isinstance(error, OSError) and error.errno in _FULL:
                    raise
                seconds = perf_counter() - start
                self.store.write(self.store.index(place), "failed", seconds, _text(error))
            else:
                self.keep(place, outputs, perf_counter() - start)

    def solve_together(self, places: Sequence[Index]) -> None:
        """Run and store cases at once; one by one where one of them raises."""
        start = perf_counter()
        # Of one length, copies of the last among them, they are one program.
        padded = [*places, *[places[-1]] * (self.batch - len(places))]
        stacked = self.stacked(padded)
        try:
            outputs = jax.device_get(jax.block_until_ready(self.together(stacked)))
        except Exception as error:
            self.solve_alone(places, error)
            return
        seconds = (perf_counter() - start) / len(places)
        for lane, place in enumerate(places):
            self.keep(place, jax.tree.map(lambda leaf, i=lane: leaf[i], outputs), seconds)

    def solve_alone(self, places: Sequence[Index], error: Exception) -> None:
        """Run and store cases one by one after an error of a batch, which does not say whose."""
        reason = _reason(error)
        if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
            raise ValueError(
                f"A batch of {self.batch} cases needs more memory than there is ({reason}): use a "
                "smaller batch."
            ) from error
        if not self._has_warned:
            self._has_warned = True
            warn(
                f"A batch raised an error, and its {len(places)} cases are run one by one to find "
                f"out which failed; so are those of later batches that raise: {reason}"
            )
        self.solve(places)

    def solve_in_lanes(self, programs: Programs) -> None:
        """Run and store cases in lanes, of which none waits for the others."""
        self.stacked([next(places(self.axes))])
        while not self.finished(Lanes(programs, self.batch, self.taken)):
            pass

    def finished(self, lanes: Lanes) -> bool:
        """Run and store cases until none is left, or where one raises those in hand one by one."""
        done = lanes.run()
        try:
            while True:
                try:
                    place, outputs, seconds = next(done)
                except StopIteration:
                    return True
                except Exception as error:
                    if not lanes.in_hand:
                        raise
                    self.solve_alone(lanes.in_hand, error)
                    return False
                self.keep(place, outputs, seconds)
                self.queue.finish([place])
                self.report()
        finally:
            self.queue.finish(lanes.in_hand)

    def taken(self, number: int, waits: bool) -> tuple[Sequence[Index], dict[str, Any]]:
        """Return cases of the queue and their arguments."""
        taken = self.queue.take(number, waits)
        return taken, stacked_at(self.axes, taken) if taken else {}

    def stacked(self, places: Sequence[Index]) -> dict[str, Any]:
        """Return the arguments of a batch, once it is known that the function can be traced."""
        stacked = stacked_at(self.axes, places)
        arrays = {name: x for name, x in stacked.items() if isinstance(x, np.ndarray)}
        words = [name for name, x in arrays.items() if x.dtype.kind == "U"]
        if words:
            raise ValueError(f"{words[0]} are words, which no batch can hold: use batch=1.")
        try:
            jax.eval_shape(self.together, stacked)
        except Exception as error:
            reason = _text(error).splitlines()[0]
            raise ValueError(
                f"The case cannot be run in batches, since JAX cannot trace it ({reason}). Write "
                "it with jax.numpy, and with throw=False in calls of jaxstab; or use batch=1."
            ) from error
        return stacked

    def keep(self, place: Index, outputs: Any, seconds: float) -> None:
        """Store what a case returned; the first must be what a store can hold."""
        is_first = not self.store.has_forms
        index = self.store.index(place)
        try:
            arrays = arrays_of(outputs, {LISTED, *arguments_of(self.axes)})
            self.store.require_forms(arrays)
        except (TypeError, ValueError) as error:
            if is_first:
                raise
            self.store.write(index, "failed", seconds, _text(error))
        else:
            self.store.write(index, "successful", seconds, "", arrays)


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _reason(error: Exception) -> str:
    """Return one line: that of a function called back stands at the end of its traceback."""
    lines = _text(error).splitlines()
    return [lines[0], *(line for line in lines if re.match(r"[\w.]+Error: ", line))][-1]

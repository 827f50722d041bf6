"""The cases of a study, run one by one or in batches, here or in another process."""

import errno
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter
from typing import Any

import jax
import numpy as np

from jaxstab.studies.axes import LISTED, Axis, Index, arguments_of, stacked_at, values_at
from jaxstab.studies.outputs import arrays_of, error_text
from jaxstab.studies.store import Found

_FULL = (errno.ENOSPC, errno.EDQUOT)
# Returns up to so many cases, none where none is left.
Take = Callable[[int], list[Index]]


@dataclass
class Worker:
    """Runs cases.

    Attributes:
        case: the function.
        axes: the values that it is called with.
        batch: how many at once.
    """

    case: Callable[..., Any]
    axes: Sequence[Axis]
    batch: int

    def run(self, take: Take) -> Iterator[Found | str]:
        """Yield each case as it ends, until none is left, and warnings."""
        while places := take(self.batch):
            yield from self._alone(places) if self.batch == 1 else self._together(places)

    def _alone(self, places: Sequence[Index]) -> Iterator[Found]:
        for place in places:
            start = perf_counter()
            try:
                outputs = self.case(**values_at(self.axes, place))
                outputs = jax.block_until_ready(outputs)
            except (Exception, SystemExit) as error:
                if isinstance(error, OSError) and error.errno in _FULL:
                    raise
                yield Found(place, perf_counter() - start, error=error_text(error))
            else:
                yield self._found(place, outputs, perf_counter() - start)

    def _together(self, places: Sequence[Index]) -> Iterator[Found | str]:
        """Run cases at once; one by one where one of them raises."""
        start = perf_counter()
        # Of one length, copies of the last among them, they are one program.
        stacked = self._stacked([*places, *[places[-1]] * (self.batch - len(places))])
        try:
            outputs = jax.device_get(jax.block_until_ready(self._batched(stacked)))
        except Exception as error:
            yield from self._one_by_one(places, error)
            return
        seconds = (perf_counter() - start) / len(places)
        for lane, place in enumerate(places):
            yield self._found(place, jax.tree.map(lambda leaf, i=lane: leaf[i], outputs), seconds)

    def _one_by_one(self, places: Sequence[Index], error: Exception) -> Iterator[Found | str]:
        """Run cases one by one after an error of a batch, which does not say whose."""
        reason = _reason(error)
        if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
            raise ValueError(
                f"A batch of {self.batch} cases needs more memory than there is ({reason}): use a "
                "smaller batch."
            ) from error
        yield (
            f"A batch raised an error, and its {len(places)} cases are run one by one to find "
            f"out which failed, also in later batches that raise an error: {reason}"
        )
        yield from self._alone(places)

    @cached_property
    def _batched(self) -> Callable[..., Any]:
        return jax.jit(jax.vmap(lambda values: self.case(**values)))

    def _stacked(self, places: Sequence[Index]) -> dict[str, Any]:
        """Return the arguments of a batch, once it is known that the function can be traced."""
        stacked = stacked_at(self.axes, places)
        arrays = {name: x for name, x in stacked.items() if isinstance(x, np.ndarray)}
        words = [name for name, x in arrays.items() if x.dtype.kind == "U"]
        if words:
            raise ValueError(f"{words[0]} are words, which no batch can hold: use batch=1.")
        try:
            jax.eval_shape(self._batched, stacked)
        except Exception as error:
            reason = error_text(error).splitlines()[0]
            raise ValueError(
                f"The case cannot be run in batches, since JAX cannot trace it ({reason}). Write "
                "it with jax.numpy, and with throw=False in calls of jaxstab; or use batch=1."
            ) from error
        return stacked

    def _found(self, place: Index, outputs: Any, seconds: float) -> Found:
        try:
            arrays = arrays_of(outputs, {LISTED, *arguments_of(self.axes)})
        except (TypeError, ValueError) as error:
            return Found(place, seconds, type(error)(*error.args))
        return Found(place, seconds, arrays)


def _reason(error: Exception) -> str:
    """Return one line: that of a function called back stands at the end of its traceback."""
    lines = error_text(error).splitlines()
    return [lines[0], *(line for line in lines if re.match(r"[\w.]+Error: ", line))][-1]

"""Runs cases, one by one or in batches, and writes their files."""

import errno
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter
from typing import Any

import jax
import numpy as np

from jaxstab.studies.axes import Coordinates, arguments
from jaxstab.studies.folder import Folder
from jaxstab.studies.outputs import variables_of

_FULL = (errno.ENOSPC, errno.EDQUOT)
# A case that has ended so many processes has failed.
_MOST_DEATHS = 3
# A case, and an error if it returned something that no file can hold.
Ended = tuple[Coordinates, str]


@dataclass
class Worker:
    """Runs cases and writes their files.

    Attributes:
        case: the function.
        kinds: of its arguments.
        folder: of the study.
        batch: how many at once.
        driver: the name under which other processes mark the cases that they begin, or None.
    """

    case: Callable[..., Any]
    kinds: Mapping[str, str]
    folder: Folder
    batch: int
    driver: str | None = None

    def run(self, cases: Sequence[Coordinates]) -> tuple[list[Ended], str]:
        """Run cases, and return how they ended and a warning, empty if there is none."""
        # Another call may have run some in the meantime.
        left = [case for case in cases if not self.folder.file(case).exists()]
        ended, warning = [(case, "") for case in cases if case not in left], ""
        # After a death one by one, to find the case that ends its process.
        if self.batch > 1 and left and not any(map(self.num_begun, left)):
            self._begin(left)
            try:
                return ended + self._together(left), ""
            except Exception as error:
                reason = error_text(error).splitlines()[0]
                if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
                    raise ValueError(
                        f"A batch of {self.batch} cases needs more memory than there is: give a "
                        f"smaller `batch` ({reason})."
                    ) from error
                warning = f"A batch raised an error, and its cases are run one by one: {reason}"
        return ended + [self._alone(case) for case in left], warning

    def num_begun(self, case: Coordinates) -> int:
        """Return how many processes have begun a case without an end."""
        mark = self.folder.mark(case, self.driver)
        return mark.stat().st_size if self.driver and mark.exists() else 0

    def _alone(self, case: Coordinates) -> Ended:
        if self.num_begun(case) >= _MOST_DEATHS:
            return self._kept(case, {}, f"The process of this case died {_MOST_DEATHS} times.")
        self._begin([case])
        start, outputs, message = perf_counter(), {}, ""
        try:
            values = arguments([case], self.kinds)
            outputs = jax.block_until_ready(self.case(**{name: x[0] for name, x in values.items()}))
        except (Exception, SystemExit) as error:
            if isinstance(error, OSError) and error.errno in _FULL:
                raise
            message = error_text(error)
        return self._kept(case, outputs, message, perf_counter() - start)

    def _together(self, cases: Sequence[Coordinates]) -> list[Ended]:
        start = perf_counter()
        # Of one length, with copies of the last case, all batches are one program.
        values = arguments([*cases, *[cases[-1]] * (self.batch - len(cases))], self.kinds)
        stacked = {n: np.asarray(x) if isinstance(x, list) else x for n, x in values.items()}
        outputs = jax.device_get(self._batched(stacked))
        entries = [jax.tree.map(lambda leaf, i=i: leaf[i], outputs) for i in range(len(cases))]
        seconds = (perf_counter() - start) / len(cases)
        return [self._kept(case, x, "", seconds) for case, x in zip(cases, entries, strict=True)]

    @cached_property
    def _batched(self) -> Callable[..., Any]:
        case = jax.jit(self.case)
        return jax.jit(jax.vmap(lambda values: case(**values)))

    def _begin(self, cases: Sequence[Coordinates]) -> None:
        for case in cases if self.driver else ():
            with self.folder.mark(case, self.driver).open("ab") as file:
                file.write(b".")

    def _kept(self, case: Coordinates, outputs: Any, error: str, seconds: float = np.nan) -> Ended:
        self.folder.mark(case, self.driver).unlink(missing_ok=True)
        try:
            variables = {} if error else variables_of(outputs, self.folder)
        except (TypeError, ValueError) as unfit:
            return case, str(unfit)
        self.folder.write(case, variables, seconds, error)
        return case, ""


def error_text(error: BaseException) -> str:
    """Return the kind of an error and its message."""
    return f"{type(error).__name__}: {error}"

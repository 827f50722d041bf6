"""Runs cases, one by one or in batches."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from time import perf_counter

import jax
import numpy as np

from jaxstab.core.compile import memory_mappings
from jaxstab.studies.cases import RECORD, Case, Cases

# How often a case or a task that dies is tried.
MOST_TRIES = 3
# Compiled programs are dropped where they hold this part of the memory mappings.
_MOST_MAPPINGS = 0.7


@dataclass
class CaseWorker:
    """Runs cases and writes their files; it marks those that it begins, in its driver's name."""

    case: Callable[..., object]
    cases: Cases
    batch: int
    driver: str

    def run(self, task: Sequence[Case]) -> str:
        """Run the cases that have no file yet; return a warning, empty if there is none."""
        left = [case for case in task if not self.cases.file(case).exists()]
        warning = ""
        # After a death one by one, to find the case that ends its process.
        if self.batch > 1 and left and not self.is_begun(left):
            try:
                return self._run_together(left)
            except Exception as error:
                reason = f"{type(error).__name__}: {error}".splitlines()[0]
                if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
                    said = f"A batch of {self.batch} cases lacks memory: give a smaller `batch`"
                    raise ValueError(f"{said} ({reason}).") from error
                warning = f"A batch raised an error, and its cases are run one by one: {reason}"
        for case in left:
            _drop_programs()
            start = perf_counter()
            returned = {}
            message = f"The process of this case died {MOST_TRIES} times."
            if self._num_begun(case) < MOST_TRIES:
                self._begin([case])
                try:
                    returned = jax.block_until_ready(self.case(**case))
                    message = ""
                except (Exception, SystemExit) as error:
                    message = f"{type(error).__name__}: {error}"
            self._keep(case, returned, perf_counter() - start, message)
        return warning

    def is_begun(self, task: Sequence[Case]) -> bool:
        """Return whether a process has begun one of some cases without an end."""
        return any(map(self._num_begun, task))

    def _num_begun(self, case: Case) -> int:
        mark = self._mark(case)
        if not mark.exists():
            return 0
        return mark.stat().st_size

    def _mark(self, case: Case) -> Path:
        return self.cases.file(case).with_suffix(f".{self.driver}.begun")

    def _begin(self, cases: Sequence[Case]) -> None:
        for case in cases:
            with self._mark(case).open("ab") as mark:
                mark.write(b".")

    def _run_together(self, cases: Sequence[Case]) -> str:
        # Batches of one length, with copies of the last case, share one program.
        entries = [*cases, *[cases[-1]] * (self.batch - len(cases))]
        values = {name: np.array([case[name] for case in entries]) for name in cases[0]}
        for name, x in values.items():
            _require_kept(name, x)
        self._begin(cases)
        start = perf_counter()
        returned = jax.device_get(self._batch_program(values))
        seconds = (perf_counter() - start) / len(cases)
        for i, case in enumerate(cases):
            self._keep(case, jax.tree.map(lambda leaf, i=i: leaf[i], returned), seconds)
        return ""

    @cached_property
    def _batch_program(self) -> Callable[..., object]:
        return jax.jit(jax.vmap(lambda values: jax.jit(self.case)(**values)))

    def _keep(self, case: Case, returned: object, seconds: float, error: str = "") -> None:
        self._mark(case).unlink(missing_ok=True)
        try:
            outputs = {} if error else self.cases.outputs_of(returned)
        except (TypeError, ValueError) as unfit:
            if not any(self.cases.path.glob("*.nc")):
                # The function, once mended, may begin the study anew.
                (self.cases.path / RECORD).unlink(missing_ok=True)
                raise
            outputs = {}
            error = str(unfit)
        except Exception as failure:
            # Arrays of a data set may be computed, or read from a file, only here.
            outputs = {}
            error = f"{type(failure).__name__}: {failure}"
        self.cases.write(case, outputs, seconds, error)


def _require_kept(name: str, values: np.ndarray) -> None:
    """Raise `OverflowError` for integers that JAX would wrap around to fewer bits."""
    if values.dtype.kind in "iu":
        kept = values.astype(jax.dtypes.canonicalize_dtype(values.dtype))
        if (kept != values).any():
            raise OverflowError(
                f"{name} is {values[kept != values][0]}, which does not fit into {kept.dtype}: "
                'call jax.config.update("jax_enable_x64", True)'
            )


def _drop_programs() -> None:
    """Drop compiled programs before they exhaust the memory mappings, which cases share."""
    number, most = memory_mappings() or (0, 1)
    if number > _MOST_MAPPINGS * most:
        jax.clear_caches()

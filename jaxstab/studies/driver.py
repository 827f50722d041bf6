"""Runs the cases of a study that are left, and collects those that are done."""

import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from jaxstab.core.progress import progress_bar
from jaxstab.core.warn import warn
from jaxstab.studies import record
from jaxstab.studies.axes import Coordinates
from jaxstab.studies.executors import run_on
from jaxstab.studies.folder import SMALL, Damaged, Folder, is_successful
from jaxstab.studies.netcdf import Variables
from jaxstab.studies.outputs import blank_of, forms_of, misfit
from jaxstab.studies.worker import Ended, Worker

# Fields of a study of more bytes are read on access.
LARGE = 2**30


class StudyInterrupted(UserWarning):
    """A study was interrupted; its folder holds the cases done so far."""


class Driver:
    """Runs the cases that are left, and with `retry` those that failed.

    Attributes:
        found: the variables of the cases that are done, by their files.
    """

    def __init__(self, folder: Folder, cases: Sequence[Coordinates], retry: bool):
        self.folder, self._num_bytes = folder, 0
        self.found: dict[Path, Variables] = {}
        self._cases = {folder.file(case): case for case in cases}
        self._has_warned = self._is_stopped = False
        self._report: Callable[[], object] = lambda: None
        there = self._read_all()
        forms = [frozenset(forms_of(x, folder).items()) for x in there.values() if is_successful(x)]
        # Most cases decide, in case that a call was killed before it compared them.
        self._forms = dict(Counter(forms).most_common(1)[0][0]) if forms else {}
        for file, variables in there.items():
            if retry and not is_successful(variables):
                file.unlink()
            else:
                self._accept(file, variables)

    @property
    def is_large(self) -> bool:
        """Whether fields are not kept in memory."""
        return self._num_bytes > LARGE

    @property
    def stored(self) -> str:
        """How much is done, in words."""
        return f"{len(self.found)} of {len(self._cases)} cases are in {self.folder.path}"

    def run(self, worker: Worker, executor: Any, progress: bool | None) -> None:
        """Run the cases that are left, until all are done or Ctrl-C stops it."""
        left = [case for file, case in self._cases.items() if file not in self.found]
        shown = {"shown": progress, "done": len(self.found)}
        with self._stopped_by_ctrl_c(), progress_bar(len(self._cases), "case", **shown) as bar:
            self._report = lambda: bar.update(len(self.found) - bar.n)
            if executor is not None and left:
                marking = replace(worker, driver=uuid4().hex[:8])
                run_on(executor, marking, left, self._settle, lambda: self._is_stopped)
            for i in range(0, len(left) if executor is None else 0, worker.batch):
                if not self._is_stopped:
                    self._settle(*worker.run(left[i : i + worker.batch]))
        if len(self.found) < len(self._cases):
            message = f"The study was interrupted: {self.stored}. The same call goes on."
            warn(message, StudyInterrupted)
        self._complete()

    def _read_all(self) -> dict[Path, Variables]:
        """Return the cases that are there; damaged files get another name, and a warning."""
        found, damaged = {}, []
        for file in self.folder.files():
            try:
                if file in self._cases:
                    found[file] = self._read(file)
                else:
                    self.folder.read(file, SMALL)
            except FileNotFoundError:
                # Another call has just renamed it.
                continue
            except Damaged as error:
                self.folder.set_aside(file)
                damaged.append(str(error))
        if damaged:
            warn(
                "These files are damaged. They are kept under names that end in .damaged, and "
                "their cases run again.\n" + "\n".join(damaged)
            )
        return found

    def _read(self, file: Path) -> Variables:
        self._num_bytes += file.stat().st_size
        return self.folder.read(file, SMALL if self.is_large else np.inf)

    def _settle(self, ended: list[Ended], warning: str) -> None:
        """Read the files of cases that have ended; of warnings the first is given."""
        for case, unfit in ended:
            file = self.folder.file(case)
            if unfit and not self._forms:
                if not self.found:
                    # The function, once mended, may begin the study anew.
                    (self.folder.path / record.NAME).unlink(missing_ok=True)
                raise TypeError(unfit)
            if unfit:
                self.folder.write(case, {}, error=unfit)
            self._accept(file, self._read(file))
        if warning and not self._has_warned:
            self._has_warned = True
            warn(warning)

    def _accept(self, file: Path, variables: Variables) -> None:
        """Count a case as done, as failed if its outputs differ from those of others."""
        self.found[file] = variables
        if is_successful(variables):
            forms = forms_of(variables, self.folder)
            self._forms = self._forms or forms
            if reason := misfit(forms, self._forms):
                self.folder.write(self._cases[file], {}, error=reason)
                self.found[file] = self._read(file)
        self._report()

    def _complete(self) -> None:
        """Give failed cases the outputs of others, without values, so that all files combine."""
        blank = blank_of([x for x in self.found.values() if is_successful(x)], self.folder)
        for file, case in self.found.items():
            kinds = {name: x.values.dtype.kind for name, x in case.items() if name in blank}
            wanted = {name: x.values.dtype.kind for name, x in blank.items()}
            if not is_successful(case) and kinds != wanted:
                error, seconds = (case[name].values.item() for name in ("error", "seconds"))
                self.folder.write(self._cases[file], blank, seconds, error)
                self.found[file] = self._read(file)

    @contextmanager
    def _stopped_by_ctrl_c(self) -> Iterator[None]:
        """Let Ctrl-C end the block after the cases in hand, a second one at once."""

        def stop(*_: object) -> None:
            self._is_stopped = True
            signal.signal(signal.SIGINT, signal.default_int_handler)

        is_main = threading.current_thread() is threading.main_thread()
        if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            yield
            return
        signal.signal(signal.SIGINT, stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, signal.default_int_handler)

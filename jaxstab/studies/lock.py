"""Which process drives a store: one at a time, by a lock on a file of it."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from jaxstab.studies.outputs import MARKS


@dataclass(frozen=True)
class Holder:
    """The process that drives a store, as its workers know it.

    Attributes:
        folder: where the store has the files of its work.
        name: the name of the process, which no other has.
    """

    folder: Path
    name: str

    def is_running(self) -> bool:
        """Return whether it wants more cases to be begun."""
        return self._said() == [self.name]

    def is_current(self) -> bool:
        """Return whether cases that were begun are still its own."""
        return self._said() in ([self.name], [self.name, "stopping"])

    def announce(self, state: str = "stopping") -> None:
        """Record its state; by default, that no more cases are to be begun."""
        # If the disk is full, workers find out by themselves.
        with suppress(OSError), (self.folder / "driver").open("a") as file:
            file.write(f"\n{state}")

    def _said(self) -> list[str]:
        try:
            return (self.folder / "driver").read_text().split("\n")
        except OSError:
            return []


@contextmanager
def held(path: Path) -> Iterator[Holder]:
    """Hold a store until the block ends.

    Raises:
        ValueError: for a file or a folder that is something else, or while another process or
            thread drives the store.
    """
    from filelock import FileLock, Timeout

    folder = path.absolute() / MARKS[0]
    entries = {entry.name for entry in path.iterdir()} if path.is_dir() else set()
    is_free = not path.exists() or (path.is_dir() and entries <= {MARKS[0]})
    # Stores of jaxstab 0.1.0 have a file of claims.
    if not (is_free or any((folder / name).exists() for name in ("driver", "claims"))):
        raise ValueError(f"{path} exists and is no study: give another path.")
    folder.mkdir(parents=True, exist_ok=True)
    lock, file = FileLock(folder / "driver.lock"), folder / "driver"
    try:
        lock.acquire(timeout=0)
    except Timeout:
        name = file.read_text().partition(",")[0] if file.exists() else "another process"
        raise ValueError(
            f"{path} is being run by {name}: wait for its end, or end it; then run the same call "
            "to continue."
        ) from None
    try:
        name = f"process {os.getpid()} on {socket.gethostname()}, {uuid4().hex}"
        file.write_text(name)
        holder = Holder(folder, name)
        try:
            yield holder
        finally:
            holder.announce("ended")
    finally:
        lock.release()

"""Which process drives a store: one at a time, by a lock on a file of it."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from jaxstab.studies.outputs import MARKS

_STOPPING = "stopping"


class Holder:
    """The process that drives a store, as its workers know it.

    A file of the store has its name in its first line, and in further ones what it has come to.

    Arguments:
        path: the folder of the store.
        name: the name, which no other process has.
    """

    def __init__(self, path: Path, name: str):
        self.path, self.name = path, name
        self._file = _file(path)

    def lasts(self) -> bool:
        """Return whether cases that were begun are still its own."""
        return self._states() in ([], [_STOPPING])

    def goes_on(self) -> bool:
        """Return whether it wants more cases to be begun."""
        return self._states() == []

    def stop(self) -> None:
        """Let no more cases be begun."""
        self._say(_STOPPING)

    def _say(self, state: str) -> None:
        # If the disk is full, workers find out by themselves.
        with suppress(OSError), self._file.open("a") as file:
            file.write(f"\n{state}")

    def _states(self) -> list[str] | None:
        try:
            name, *states = self._file.read_text().split("\n")
        except OSError:
            return None
        return states if name == self.name else None


@contextmanager
def held(path: Path) -> Iterator[Holder]:
    """Hold a store until the block ends.

    Raises:
        ValueError: for a file or a folder that is something else, or while another process or
            thread drives the store.
    """
    from filelock import FileLock, Timeout

    file = _file(path)
    entries = {entry.name for entry in path.iterdir()} if path.is_dir() else set()
    is_free = not path.exists() or (path.is_dir() and entries <= {MARKS[0]})
    # Those of jaxstab 0.1.0 have a file of claims.
    if not is_free and not file.exists() and not file.with_name("claims").exists():
        raise ValueError(f"{path} exists and is no study: give another path.")
    file.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(file.with_name("driver.lock"))
    try:
        lock.acquire(timeout=0)
    except Timeout:
        name = file.read_text().partition(",")[0] if file.exists() else "another process"
        raise ValueError(
            f"{path} is being run by {name}: wait for its end, or end it; then run the same call "
            "to continue."
        ) from None
    try:
        holder = Holder(path, f"process {os.getpid()} on {socket.gethostname()}, {uuid4().hex}")
        file.write_text(holder.name)
        try:
            yield holder
        finally:
            holder._say("ended")
    finally:
        lock.release()


def _file(path: Path) -> Path:
    return path / MARKS[0] / "driver"

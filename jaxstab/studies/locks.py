"""Which process runs which case: locks that the system takes back from a process that dies."""

import errno
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

from jaxstab.studies.axes import Index

try:
    import fcntl
except ImportError:
    # On Windows, where there are no such locks, one process runs a store.
    fcntl = None

_WHOLE = 0
_TAKEN = (errno.EACCES, errno.EAGAIN)
_in_use: set[Path] = set()


class Claims:
    """The claims of this process on the cases of a store: locks on bytes of a file.

    Locks belong to a process, so that its threads keep from each other by what it `holds`.
    """

    def __init__(self, file: int, path: Path):
        self._file = file
        self._path = path
        self._held: set[Index] = set()
        self._guard = threading.RLock()

    def claim(self, index: Index) -> bool:
        """Claim a case, or return False where another thread or process has it."""
        with self._guard:
            if index in self._held or not self._locked(_byte(index), waits=False):
                return False
            self._held.add(index)
            return True

    def release(self, index: Index) -> None:
        """Give a case back."""
        with self._guard:
            self._held.remove(index)
            self._unlock(_byte(index))

    @contextmanager
    def whole(self) -> Iterator[None]:
        """Keep others from what all cases share, until the block ends."""
        with self._guard:
            self._locked(_WHOLE, waits=True)
            try:
                yield
            finally:
                self._unlock(_WHOLE)

    def _locked(self, byte: int, *, waits: bool) -> bool:
        if fcntl is None:
            return True
        try:
            fcntl.lockf(self._file, fcntl.LOCK_EX | (0 if waits else fcntl.LOCK_NB), 1, byte)
        except OSError as error:
            if error.errno in _TAKEN:
                return False
            raise OSError(
                f"The file system of {self._path} has no locks ({error.strerror}): put the store "
                "on another one."
            ) from error
        return True

    def _unlock(self, byte: int) -> None:
        if fcntl is not None:
            fcntl.lockf(self._file, fcntl.LOCK_UN, 1, byte)


@contextmanager
def claims_in(path: Path) -> Iterator[Claims]:
    """Yield the claims kept in a file, until the block ends.

    Raises:
        ValueError: if another thread of this process holds them.
    """
    path = path.resolve()
    if path in _in_use:
        raise ValueError(f"Another study of this process is at work in {path.parent.parent}.")
    _in_use.add(path)
    try:
        # To close a file takes back all locks on it: it is opened here only.
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            yield Claims(file, path)
        finally:
            os.close(file)
    finally:
        _in_use.remove(path)


def _byte(index: Index) -> int:
    """Return the byte of a case, which stays the same as axes grow."""
    return 1 + int.from_bytes(sha256(repr(index).encode()).digest()[:7])

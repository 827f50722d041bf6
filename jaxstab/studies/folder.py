"""The files of a study: one for each case, written whole and checked when they are read."""

import hashlib
import json
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

import numpy as np

from jaxstab.studies.axes import LISTED, Axes, Coordinates
from jaxstab.studies.netcdf import Variable, Variables, decode, encode

# What each case has beside its outputs.
MARKS = ("result", "seconds", "error")
# Arrays of more bytes are fields.
SMALL = 1024
# Seconds after which a hidden file is that of a process that was killed.
_STALE = 3600


class Damaged(OSError):
    """A file that is not, or no longer, the one that was written for the case of its name."""


class Folder:
    """The files of a study with some axes, in a folder."""

    def __init__(self, path: Path, axes: Axes):
        self.path, self.dims, self.names = path, axes.dims, tuple(axes.values)
        self.taken = {*self.dims, *self.names, *MARKS}

    def file(self, case: Coordinates) -> Path:
        """Return the file of a case, named by a digest of its coordinates."""
        text = json.dumps({name: case[name] for name in sorted(case)})
        return self.path / f"{hashlib.blake2b(text.encode(), digest_size=10).hexdigest()}.nc"

    def mark(self, case: Coordinates, driver: str | None) -> Path:
        """Return the file to which each process of a driver that begins a case adds a byte."""
        return self.path / f".{self.file(case).stem}.{driver}.begun"

    def files(self) -> Iterator[Path]:
        """Yield all files of cases; remove hidden ones of processes that were killed."""
        for path in sorted(self.path.iterdir()):
            if path.suffix == ".nc":
                yield path
            elif path.suffix in (".part", ".begun"):
                with suppress(OSError):
                    if time.time() - path.stat().st_mtime > _STALE:
                        path.unlink()

    def write(
        self, case: Coordinates, outputs: Variables, seconds: float = np.nan, error: str = ""
    ) -> None:
        """Write the file of a case, of a failed one with its error."""
        file, ones, is_listed = self.file(case), (1,) * len(self.dims), self.dims == (LISTED,)
        # By the coordinate of the list xarray combines the files.
        places = {LISTED: file.stem, **case} if is_listed else case
        own = {
            n: Variable(self.dims if is_listed else (n,), np.array([x])) for n, x in places.items()
        }
        for name, mark in zip(
            MARKS, ("failed" if error else "successful", seconds, error), strict=True
        ):
            own[name] = Variable(self.dims, np.array(mark).reshape(ones))
        write_whole(file, encode({**own, **outputs}, tuple(case) if is_listed else ()))

    def read(self, file: Path, largest: float = np.inf, wanted: str = "") -> Variables:
        """Return the variables of a file; of those of more bytes, values of the wanted one only.

        Raises:
            Damaged: if it is not the file that was written under this name.
            OSError: if it is not there, or cannot be read for another reason.
        """
        try:
            variables = decode(file, largest, wanted)
            case = {name: variables[name].values[0].item() for name in self.names}
            if self.file(case) != file or not variables.keys() >= {*MARKS}:
                raise ValueError(f"it holds {case}")
        except Exception as error:
            is_folder = file.is_dir()
            if isinstance(error, MemoryError) or (getattr(error, "errno", None) and not is_folder):
                raise
            raise Damaged(f"{file} ({'it is a folder' if is_folder else error})") from error
        return variables

    def set_aside(self, file: Path) -> None:
        """Give a damaged file, or whatever has its name, another name."""
        with suppress(FileNotFoundError):
            file.rename(file.with_name(f"{file.name}.{uuid4().hex[:8]}.damaged"))


def is_successful(case: Variables) -> bool:
    """Return whether a case has outputs."""
    return case["result"].values.item() == "successful"


def write_whole(path: Path, content: bytes | memoryview) -> None:
    """Write a file under another name, flush it, and rename it."""
    part = path.with_name(f".{path.stem}.{uuid4().hex}.part")
    try:
        with part.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise

"""Files that are written whole or not at all."""

import os
from pathlib import Path
from uuid import uuid4


def require_writable(folder: Path) -> None:
    """Raise `OSError` unless a file can be made in a folder, which is tried."""
    trial = folder / f".{uuid4().hex}.part"
    try:
        trial.touch()
        trial.unlink()
    except OSError as error:
        raise OSError(f"No file can be written into the folder {folder}: {error.strerror}.") from (
            error
        )


def write_whole(path: Path, content: bytes | memoryview) -> None:
    """Write a file under another name, flush it, and rename it."""
    part = path.with_name(f".{path.name}.{uuid4().hex}.part")
    try:
        with part.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)

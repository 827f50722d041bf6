"""Files of force curves in a ZIP archive."""

import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

# The files of a larger archive [bytes] are not for memory.
_LARGEST = 2**31
# The first line of a file of AFM Workshop.
WORKSHOP = "Force-Distance Curve"


def is_archive(path: Path) -> bool:
    """Whether a file is an archive of files, and not itself one of an instrument.

    Instruments also pack a curve or a map into an archive, with a suffix of their own; AFM Workshop
    does with the suffix .zip.
    """
    if path.suffix.lower() != ".zip" or not zipfile.is_zipfile(path):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            names = members(archive)
            return not names or any(not _is_of_workshop(archive, name) for name in names)
    except (zipfile.BadZipFile, RuntimeError, NotImplementedError, OSError, zlib.error):
        return True


def members(archive: zipfile.ZipFile) -> list[str]:
    """Return the names of the files in an archive, without folders and hidden files.

    Raises:
        ValueError: for more than two gigabytes.
    """
    found = [info for info in archive.infolist() if not info.is_dir() and not _is_hidden(info)]
    size = sum(info.file_size for info in found)
    if size > _LARGEST:
        raise ValueError(
            f"its files have {size / 2**30:.3g} GB, more than {_LARGEST / 2**30:.3g}: unpack it, "
            "and read them one by one."
        )
    return [info.filename for info in found]


@contextmanager
def unpack(archive: zipfile.ZipFile, name: str) -> Iterator[Path]:
    """Yield the path of one file of an archive, in a temporary folder.

    Raises:
        ValueError: if it cannot be unpacked, and for an archive in the archive.
    """
    # The name may lead out of the folder: its last part does not.
    last = PurePosixPath(name.replace("\\", "/")).name
    if last.lower().endswith(".zip"):
        raise ValueError("it is an archive in the archive: unpack it, and read it by itself.")
    try:
        # No more is read than the size of the file, which `members` has bounded.
        content = archive.read(name)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as error:
        raise ValueError(f"it is damaged ({error}).") from None
    except (RuntimeError, NotImplementedError) as error:
        raise ValueError(f"{error}: pack it anew, without a password.") from None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, last)
        path.write_bytes(content)
        yield path


def _is_of_workshop(archive: zipfile.ZipFile, name: str) -> bool:
    if not name.endswith(".csv"):
        return False
    with archive.open(name) as file:
        return file.read(len(WORKSHOP)) == WORKSHOP.encode()


def _is_hidden(info: zipfile.ZipInfo) -> bool:
    folders = info.filename.replace("\\", "/").split("/")
    return "__MACOSX" in folders or folders[-1].startswith(".")

"""`study.json`: the axes of a study, the source of its case, and the versions of packages."""

import difflib
import inspect
import json
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

import jax

from jaxstab.studies.axes import Axes
from jaxstab.studies.folder import write_whole

NAME = "study.json"
_FORMAT = 1
_PACKAGES = ("jaxstab", "jax", "jaxlib", "equinox", "numpy")
_MOST_LINES = 30


def packages() -> dict[str, str]:
    """Return the versions of packages on which numbers depend, and the precision of JAX."""
    precision = "double" if jax.config.values["jax_enable_x64"] else "single"
    return {**{name: version_of(name) for name in _PACKAGES}, "precision": precision}


def begin(path: Path, axes: Axes, case: Callable[..., Any], version: Any, accept: bool) -> Axes:
    """Write the record of a study, or compare it with a call; return the axes in its order.

    Raises:
        ValueError: for a folder of something else, or of a study with another case or other axes.
    """
    now = {"source": _source(case, version), "version": version, "packages": packages()}
    fresh = {"format": _FORMAT, "axes": axes.kinds, "is_listed": axes.is_listed, **now}
    file = path / NAME
    try:
        known = json.loads(file.read_bytes())
        changes = _changes(known, now)
        is_same = (known["axes"], known["is_listed"]) == (axes.kinds, axes.is_listed)
    except (
        FileNotFoundError,
        NotADirectoryError,
        IsADirectoryError,
        ValueError,
        LookupError,
        TypeError,
    ):
        _require_new(path, file, accept)
        known, is_same, changes = fresh, True, ""
        _write(file, known)
    if known["format"] != _FORMAT:
        raise ValueError(f"{file} has format {known['format']}, this jaxstab reads {_FORMAT}.")
    if not is_same:
        raise ValueError(
            f"{path} has the axes {_listed(known)}; this call has {_listed(fresh)}. Give the same, "
            "or another folder."
        )
    if changes and not accept:
        raise ValueError(
            f"{path} was begun with another case.\n{changes}\nGive another folder; or, if the "
            "finished cases stay valid, accept_changes=True goes on and records the change."
        )
    if changes:
        change = {"when": datetime.now(UTC).isoformat(timespec="seconds"), "changed": changes}
        _write(file, {**known, **now, "changes": [*known.get("changes", []), change]})
    return axes._replace(values={name: axes.values[name] for name in known["axes"]})


def _require_new(path: Path, file: Path, accept: bool) -> None:
    """Refuse a folder without a record, unless it is empty or its record may be written anew."""
    if path.exists() and not path.is_dir():
        raise ValueError(f"{path} is a file: give a folder.")
    names = [x.name for x in path.iterdir() if x.suffix != ".part"] if path.exists() else []
    if names and not any(name == file.name or name.endswith(".nc") for name in names):
        raise ValueError(f"{path} is no study, it holds {min(names)}: give a new folder.")
    if names and not accept:
        raise ValueError(
            f"{file} is lost or damaged: put it back from a copy; or, if the case and the axes are "
            "those of the files, accept_changes=True writes it anew."
        )
    if file.is_dir():
        file.rename(f"{file}.damaged")


def _source(case: Any, version: Any) -> str:
    """Return the text of a function, or of the class of another callable."""
    bound = ""
    while isinstance(case, partial):
        bound, case = f"{bound}# with {case.args}, {case.keywords}\n", case.func
    case = inspect.unwrap(case)
    try:
        return inspect.getsource(case if inspect.isroutine(case) else type(case)) + bound
    except (OSError, TypeError):
        if version is None:
            raise ValueError(
                "The source of the case is not found: define it in a file or a notebook, or give "
                "`version`, which you change whenever the case changes."
            ) from None
        return bound


def _changes(known: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Return the differences of two records, empty if there are none."""
    before, after = (x["source"].splitlines() for x in (known, now))
    lines = [*difflib.unified_diff(before, after, "recorded", "this call", n=1, lineterm="")]
    lines[_MOST_LINES:] = ["..."] if len(lines) > _MOST_LINES else []
    pairs = {"version": (known["version"], now["version"])}
    pairs |= {name: (known["packages"].get(name), x) for name, x in now["packages"].items()}
    return "\n".join(lines + [f"{name}: {a}, now {b}" for name, (a, b) in pairs.items() if a != b])


def _listed(record: Mapping[str, Any]) -> str:
    names = ", ".join(f"{name} ({kind})" for name, kind in record["axes"].items())
    return names + (" as a list" if record["is_listed"] else "")


def _write(file: Path, record: Mapping[str, Any]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, (json.dumps(record, indent=1) + "\n").encode())

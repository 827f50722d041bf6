"""Files of instruments, read by the package afmformats."""

import logging
import warnings
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from jaxstab.lab.force_curves.named_columns import common_value
from jaxstab.lab.force_curves.recording import Recording

_UNITS = {"spring constant": "N/m", "sensitivity": "m/V"}
# Without a handler its logger writes tracebacks of errors that are reported here.
logging.getLogger("afmformats").addHandler(logging.NullHandler())


def read_instrument(
    path: Path, spring_constant: float | None, sensitivity: float | None, is_text: bool
) -> tuple[list[Recording], tuple[int, int] | None]:
    """Return the curves of a file, and the columns and rows of the map that they are pixels of.

    Arguments:
        path: the file.
        spring_constant, sensitivity: what the user knows [N/m, m/V].
        is_text: whether it is a text, which the user may make a table of named columns.

    Raises:
        ImportError: without afmformats.
        ValueError: for files that it cannot read, or that lack what the user must state.
    """
    if find_spec("afmformats") is None:
        raise ImportError(
            "Force curves of instruments need afmformats: pip install 'jaxstab[afm]'."
        )
    given = {"spring constant": spring_constant, "sensitivity": sensitivity}
    curves, remarks = _load(path, {k: x for k, x in given.items() if x is not None}, is_text)
    if not curves:
        raise ValueError("it holds no force curve.")
    from afmformats import formats

    signal = "V"
    if formats.get_recipe(path).maker.startswith("NT-MDT"):
        signal = "A"
    try:
        recordings = [
            _recording(curve, given, _source(path, number, len(curves)), remarks, signal)
            for number, curve in enumerate(curves)
        ]
        shapes = {_whole_pair(curve.metadata, "grid shape {}") for curve in curves}
    except (*_errors(), LookupError, TypeError, OSError) as error:
        raise ValueError(f"afmformats: the file is damaged ({_message_of(error)}).") from None
    if len(shapes) > 1:
        return recordings, None
    return recordings, shapes.pop()


def _errors() -> tuple[type[BaseException], ...]:
    """Return the errors of afmformats, some of which are no `Exception`."""
    from afmformats import errors, meta

    return errors.AFMFileFormatError, errors.MissingMetaDataError, meta.MetaDataMissingError


def _load(path: Path, given: dict[str, float], is_text: bool) -> tuple[list[Any], tuple[str, ...]]:
    """Return what afmformats finds in a file, and its warnings."""
    import afmformats
    from afmformats.errors import MissingMetaDataError

    # A file with values of its own keeps them: `common_value` compares.
    for override in ({}, given):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                curves = afmformats.load_data(path, meta_override=dict(override))
                return curves, tuple(f"afmformats: {_message_of(w.message)}" for w in caught)
            except MissingMetaDataError as error:
                missing = [name for name in _UNITS if name in str(error)] or [*_UNITS]
                if override is given or not {*missing} <= {*given}:
                    raise ValueError(_missing_metadata(missing, given)) from None
            except (Exception, *_errors()) as error:
                raise ValueError(_reason(path, error, is_text)) from None
    raise AssertionError("Unreachable.")


def _missing_metadata(missing: list[str], given: dict[str, float]) -> str:
    names = [name for name in missing if name not in given] or missing
    example = {"spring constant": "spring_constant=0.2", "sensitivity": "sensitivity=50e-9"}
    said = " and ".join(f"the {name} [{_UNITS[name]}]" for name in names)
    call = ", ".join(example[name] for name in missing)
    return f"it lacks {said}, without which its voltages are no forces: give read(path, {call})."


def _reason(path: Path, error: BaseException, is_text: bool) -> str:
    import afmformats

    known = ", ".join(afmformats.formats.supported_extensions)
    # The file may lie in a temporary folder.
    reason = f"afmformats cannot read it: {_message_of(error).replace(str(path), path.name)}"
    if path.suffix not in afmformats.formats.supported_extensions:
        reason = f"its suffix {path.suffix!r} is none that afmformats knows, which are {known}."
    if is_text:
        reason += (
            " Text needs a line that names columns with units, as `height [nm],force [nN]`, above "
            "the numbers and in place of another header."
        )
    return reason


def _message_of(error: object) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    if len(text) < 200:
        return text
    return f"{text[:200]}..."


def _recording(
    curve: Any,
    given: dict[str, float | None],
    source: str,
    remarks: tuple[str, ...],
    signal: str,
) -> Recording:
    data = {name: np.asarray(curve[name]).astype(float) for name in curve.columns}
    if "force" not in data:
        raise ValueError(f"it has no force, but only {', '.join(data)}.")
    heights = {name: data[name] for name in ("height (measured)", "height (piezo)") if name in data}
    if not heights:
        raise ValueError(f"it has no height, but only {', '.join(data)}.")
    metadata = curve.metadata
    stated = {name: metadata.get(name) for name in _UNITS}
    known = {name: common_value(name, given[name], stated[name], _UNITS[name]) for name in _UNITS}
    constant = known["spring constant"]
    tip = data.get("tip position")
    name = next(iter(heights))
    if tip is not None and constant is not None:
        # Some instruments call the indentation a height.
        expected = tip - data["force"] / constant
        name = min(heights, key=lambda name: np.nanstd(heights[name] - expected))
    if len(heights) > 1:
        remarks = (*remarks, f"{name} taken as the height")
    return Recording(
        force=data["force"],
        height=heights[name],
        tip=tip,
        time=data.get("time"),
        labels=data.get("segment"),
        speeds=(metadata.get("speed approach"), metadata.get("speed retract")),
        spring_constant=constant,
        sensitivity=known["sensitivity"],
        signal_unit=signal,
        position=_pair(metadata, "position {}"),
        pixel=_whole_pair(metadata, "grid index {}"),
        source=source,
        instrument=str(metadata.get("instrument", "")),
        remarks=remarks,
    )


def _pair(metadata: Any, name: str) -> tuple[float, float] | None:
    pair = [metadata.get(name.format(axis)) for axis in "xy"]
    if None in pair:
        return None
    return pair[0], pair[1]


def _whole_pair(metadata: Any, name: str) -> tuple[int, int] | None:
    pair = _pair(metadata, name)
    if pair is None:
        return None
    return int(pair[0]), int(pair[1])


def _source(path: Path, number: int, count: int) -> str:
    if count == 1:
        return path.name
    return f"{path.name}, curve {number}"

"""Files of Nanosurf (`.nid`), read by the package NSFopen of the maker."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from jaxstab.lab.force_curves.named_columns import common_value
from jaxstab.lab.force_curves.recording import Recording

SUFFIXES = (".nid", ".nhf")
# Names of the height, the measured one first. It grows towards the sample.
_HEIGHTS = ("Z-Axis Sensor", "Z-AxisSensor", "Z-Axis")
_FRAMES = {
    "Forward": ("approach", "Spec forward"),
    "Pause Forward": ("pause", "Spec fwd pause"),
    "Backward": ("retraction", "Spec backward"),
}


def read_nanosurf(path: Path, spring_constant: float | None) -> list[Recording]:
    """Return the curves of a file of Nanosurf.

    The file lists the curves of a map in the order of their measurement, and their places on the
    map are not read.

    Raises:
        ImportError: without NSFopen.
        ValueError: for a file without force curves, of another version or damaged, and deflections
            in a unit that is neither a force nor a length.
    """
    if path.suffix.lower() == ".nhf":
        raise ValueError("it is a .nhf file, which is not read: save the curves as .nid, or text.")
    if find_spec("NSFopen") is None:
        raise ImportError("Force curves of Nanosurf need NSFopen: pip install 'jaxstab[afm]'.")
    from NSFopen.read import nid_read

    try:
        # Numbers as in the file: pandas would leave out rows with a gap.
        file: Any = nid_read(str(path), verbose=False, dataframe=False)
        frames, header = file.data.get("Spec", {}), file.param["HeaderDump"]
    except Exception as error:
        raise ValueError(f"NSFopen cannot read it: {error}") from None
    if "Forward" not in frames and "Backward" not in frames:
        raise ValueError("it holds no force curve: NSFopen finds no spectroscopy in it.")
    stated = file.param.get("Tip", {}).get("Prop0") or {}
    constant = stated.get("Value") if stated.get("Unit") == "N/m" else None
    constant = common_value("spring constant", spring_constant, constant, "N/m")
    parts = {
        label: _columns(frames[name], header, frame, constant)
        for name, (label, frame) in _FRAMES.items()
        if name in frames
    }
    count = max(len(curves) for curves in parts.values())
    return [
        _recording(path, number, count, parts, constant)
        for number in range(count)
        if any(number < len(curves) for curves in parts.values())
    ]


def _columns(
    frame: Any, header: Any, name: str, constant: float | None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return heights and forces of all curves of a frame, in its order."""
    height = next((title for title in _HEIGHTS if title in frame), None)
    if height is None or "Deflection" not in frame:
        raise ValueError(f"its {name} has no deflection or no height: {', '.join(frame)}.")
    units = {
        part.get("Dim2Name"): part.get("Dim2Unit")
        for part in header.values()
        if part.get("Frame") == name
    }
    factor = {"N": 1.0, "m": constant}.get(units.get("Deflection", ""))
    if factor is None:
        raise ValueError(
            f"its deflection has the unit {units.get('Deflection')!r}, or it is a length and the "
            "spring constant is unknown: calibrate the cantilever in the program of the "
            "instrument, or give read(path, spring_constant=0.2)."
        )
    pairs = zip(frame[height], frame["Deflection"], strict=True)
    return [(-np.asarray(z, float), factor * np.asarray(f, float)) for z, f in pairs]


def _recording(
    path: Path,
    number: int,
    count: int,
    parts: dict[str, list[tuple[np.ndarray, np.ndarray]]],
    constant: float | None,
) -> Recording:
    heights, forces, labels = [], [], []
    for label, curves in parts.items():
        if number >= len(curves):
            continue
        height, force = curves[number]
        size = min(len(height), len(force))
        height, force = height[:size], force[:size]
        # Both are written from the far end on.
        if label == "retraction" and size and height[0] > height[-1]:
            height, force = height[::-1], force[::-1]
        heights.append(height)
        forces.append(force)
        labels.append(np.full(size, label))
    source = path.name if count == 1 else f"{path.name}, curve {number}"
    return Recording(
        force=np.concatenate(forces),
        height=np.concatenate(heights),
        labels=np.concatenate(labels),
        spring_constant=constant,
        source=source,
        instrument="Nanosurf",
    )

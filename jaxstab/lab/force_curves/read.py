"""Force curves from files."""

import warnings
import zipfile
from dataclasses import replace
from pathlib import Path

from jaxstab.lab.force_curves.archives import WORKSHOP, is_archive, members, unpack
from jaxstab.lab.force_curves.curves import ForceCurves, all_of
from jaxstab.lab.force_curves.force_curve import ForceCurve, ForceCurveWarning
from jaxstab.lab.force_curves.instruments import read_instrument
from jaxstab.lab.force_curves.named_columns import is_named_table, read_named_columns
from jaxstab.lab.force_curves.nanoscope import BINARY, is_nanoscope_text, read_nanoscope_text
from jaxstab.lab.force_curves.nanosurf import SUFFIXES, read_nanosurf
from jaxstab.surfaces import text_of

_TABLES = (".csv", ".tsv", ".dat")


def read(
    path: str | Path,
    *,
    spring_constant: float | None = None,
    sensitivity: float | None = None,
) -> ForceCurve | ForceCurves:
    """Read the force curves in a file of an instrument, or in text with named columns.

    Files of instruments (JPK, Asylum, NT-MDT, AFM Workshop, Optics11; HDF5 and tab of afmformats)
    are read by the package afmformats, from the extra `afm`.

    Files of Nanosurf (`.nid`) are read by the maker's package NSFopen, from the same extra. Curves
    of Bruker's NanoScope are read from text that its programs have exported, with columns such as
    `Calc_Ramp_Ex_nm` and `Defl_pN_Rt`.

    Text, in UTF-8, UTF-16 or Latin-1, has a line that names its columns with units, as
    `height [nm],force [nN]`, and a line for each point; commas, semicolons, tabs or blanks separate
    them. It needs `force`, or `deflection` in a unit of length or voltage, and `height`,
    `extension` (a height that grows towards the sample) or `tip position`. It may have `time`,
    `segment` (names or numbers), `curve` (names or numbers) and `x`, `y`. Comments state
    `# spring constant: 0.2 N/m` and `# sensitivity: 50 nm/V`. Empty cells and nan are missing
    points. Times that begin anew at zero in each segment are joined to one clock.

    A `.zip` archive is read as one file with the curves of all files in it, up to two gigabytes. A
    file that holds no curve, as one with notes, is left out with a warning that names it.

    Arguments:
        path: the file.
        spring_constant: of the cantilever, where the file states none [N/m].
        sensitivity: its deflection over the voltage of the detector, likewise [m/V];
            m/A for NT-MDT, whose detector measures a current.

    Returns:
        The curve, or for a file with several, or with pixels of a map, all of them in a sequence,
        in metres and newtons. `print` says what they lack. Of several curves those without a force
        or a height are left out, with a warning.

    Raises:
        FileNotFoundError: if there is no such file.
        ImportError: if the format needs afmformats, which is not installed.
        ValueError: if the file holds no force curve, is damaged, or lacks what forces need; for a
            column without unit, repeated or lacking; if the arguments contradict the file.

    Warns:
        ForceCurveWarning: for forces whose sign seems to be wrong, and curves that are left out.

    Example:
        >>> height = np.linspace(2000.0, -1000.0, 400)
        >>> force = 3e-4 * np.maximum(-height, 0) ** 1.5
        >>> titles = "height [nm],force [nN]"
        >>> np.savetxt("curve.csv", np.c_[height, force], delimiter=",", header=titles, comments="")
        >>> curve = js.lab.force_curves.read("curve.csv", spring_constant=0.2)
        >>> f"{curve.approach.height.max():.1e} {curve.unit}"
        '2.0e-06 m'
        >>> f"{curve.approach.force.max():.1e} {curve.force_unit}"
        '9.5e-09 N'
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    try:
        curves, count = _curves(path, spring_constant, sensitivity)
    except ImportError as error:
        raise ImportError(f"{path}: {error}") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    suspicions = [f"{x.source}: {' '.join(x.suspicions)}" for x in curves if x.suspicions]
    if suspicions:
        text = all_of("look wrong", suspicions, count)
        warnings.warn(text, ForceCurveWarning, stacklevel=2)
    if count == 1 and curves.shape is None:
        return curves[0]
    return curves


def _curves(
    path: Path, spring_constant: float | None, sensitivity: float | None
) -> tuple[ForceCurves, int]:
    """Return the curves of a file, and how many it holds with those that are left out."""
    if not path.is_file():
        raise ValueError("this is no file.")
    if is_archive(path):
        curves, failed = _of_archive(path, spring_constant, sensitivity)
    else:
        curves, failed = _of_file(path, spring_constant, sensitivity)
    if not curves:
        raise ValueError(failed[0] if failed else "the archive holds no file.")
    count = len(curves) + len(failed)
    if failed:
        text = all_of("are left out", failed, count)
        warnings.warn(text, ForceCurveWarning, stacklevel=3)
    return curves, count


def _of_file(
    path: Path, spring_constant: float | None, sensitivity: float | None
) -> tuple[ForceCurves, list[str]]:
    """Return the curves of a file, and why others are none."""
    content = path.read_bytes()
    if not content:
        raise ValueError("the file is empty.")
    text = text_of(content)
    shape = None
    if path.suffix.lower() in SUFFIXES:
        recordings = read_nanosurf(path, spring_constant)
    elif text is not None and is_nanoscope_text(text):
        recordings = [read_nanoscope_text(text, path.name, spring_constant, sensitivity)]
    elif content.startswith(BINARY):
        raise ValueError(
            "it is a file of NanoScope, which is not read: export the curve as text, with ramp and "
            "deflection of extension and retraction as columns."
        )
    elif text is not None and _is_table(path, text):
        recordings = read_named_columns(text, path.name, spring_constant, sensitivity)
    else:
        recordings, shape = read_instrument(
            path, spring_constant, sensitivity, is_text=text is not None
        )
    curves = []
    failed = []
    for recording in recordings:
        try:
            curves.append(recording.curve())
        except ValueError as error:
            failed.append(f"{recording.source}: {error}")
    return ForceCurves(tuple(curves), shape), failed


def _of_archive(
    path: Path, spring_constant: float | None, sensitivity: float | None
) -> tuple[ForceCurves, list[str]]:
    """Return the curves of all files in an archive, and why others are none."""
    curves = []
    failed = []
    shapes = set()
    try:
        archive = zipfile.ZipFile(path)
    except zipfile.BadZipFile as error:
        raise ValueError(f"the archive is damaged ({error}).") from None
    with archive:
        names = members(archive)
        for name in names:
            try:
                with unpack(archive, name) as file:
                    found, reasons = _of_file(file, spring_constant, sensitivity)
            except ValueError as error:
                failed.append(f"{name}: {error}")
                continue
            # Folders tell files of the same name apart.
            folder = name[: len(name) - len(file.name)]
            curves += [replace(curve, source=folder + curve.source) for curve in found]
            failed += [folder + reason for reason in reasons]
            shapes.add(found.shape)
    # Pixels of several maps are none of one.
    shape = shapes.pop() if len(names) == 1 and shapes else None
    return ForceCurves(tuple(curves), shape), failed


def _is_table(path: Path, text: str) -> bool:
    # A file of AFM Workshop is no table of named columns.
    if WORKSHOP in text[:200]:
        return False
    return path.suffix.lower() in _TABLES or is_named_table(text)

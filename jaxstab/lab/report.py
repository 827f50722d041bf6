"""The report: how a scanned surface sticks, on one page that needs no other file."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import jax
from tqdm import tqdm

from jaxstab.lab import page
from jaxstab.lab.report_parts import parts, sources
from jaxstab.lab.report_results import Arguments, Results, results_of
from jaxstab.surfaces import Topography

# The results that `results_of` yields one after another.
_STAGES = 8


def _call(arguments: Mapping[str, Any]) -> list[str]:
    given = [f"{name}={value!r}" for name, value in arguments.items() if value is not None]
    return [f"js.lab.report({', '.join(['scan', *given])})"]


@dataclass(frozen=True)
class Wording:
    """How a report names itself, its arguments and the call that makes it.

    Attributes:
        title: of the page.
        call: the words of the call with the arguments that make the same report.
        advice: makes of a remark, in which arguments stand in backticks, what is shown.
        source: a sentence on the source of the scan, "" for none.

    Example:
        >>> wording = js.lab.Wording(title="Adhesion of a seal", source="Scan of 3 March.")
        >>> wording.title
        'Adhesion of a seal'
    """

    title: str = "Adhesion of a scanned surface"
    call: Callable[[Mapping[str, Any]], list[str]] = _call
    advice: Callable[[str], str] = str
    source: str = ""


def report(
    scan: Topography,
    youngs_modulus: float,
    surface_energy: float,
    file: str | Path = "report.html",
    *,
    poisson_ratio: float = 0.5,
    range: float | None = None,
    size: int | None = None,
    detrend: int | None = None,
    periodic: Literal["window", "mirror", "as_is"] | None = None,
    hardness: float | None = None,
    wording: Wording | None = None,
) -> Path:
    """Describe how a scanned surface sticks, on a page of HTML that needs no other file.

    The page has the surface and its spectrum, the loop of approach and retraction, the pull-off
    with its error, patches and verdicts at three loads, what was assumed, the call and the sources
    to cite. The scanned surface is rigid, the other one smooth and an elastic half space. Numbers
    are in SI units and in double precision. The page is written again with every result, so that
    it can be read before the end, and after Ctrl-C.

    Arguments:
        scan: the surface, in a unit, as `jaxstab.surfaces.read` returns it: neither its trend nor
            missing points need be treated.
        youngs_modulus: E [Pa].
        surface_energy: the work of adhesion w, twice gamma of equal surfaces [J/m^2].
        file: the page, a file `.html` that does not exist yet.
        poisson_ratio: nu, by default that of rubber.
        range: the range of an exponential attraction [m]. To one that the grid does not resolve the
            pull-off is extrapolated; by default it is the shortest that the grid resolves.
        size: the number of points along the longest side of the periodic cell, by default those of
            the scan, and at most 128.
        detrend: the order of the trend that is removed, as in `Topography.levelled`.
        periodic: how to make the edges meet, as in `Topography.periodic`: by default "as_is" if
            they meet, "mirror" if they do not.
        hardness: the largest pressure that the softer surface bears [Pa]: summits yield where it is
            reached. The pull-off and the loop are then of the surface that the largest of the three
            loads has left.
        wording: how the page names its arguments and itself; the command line has its own.

    Returns:
        The path of the page.

    Raises:
        ValueError: for a scan without a unit or of few points, and for invalid arguments.
        FileExistsError: if the file exists.

    Example:
        >>> small = js.surfaces.Topography(grid, 0.1 * heights, unit="µm")
        >>> page = js.lab.report(small, youngs_modulus=1e6, surface_energy=0.05, size=16)
        >>> page.name
        'report.html'
    """
    path = _new_page(file)
    wording = wording or Wording()
    arguments = Arguments(
        youngs_modulus, surface_energy, poisson_ratio, range, size, detrend, periodic, hardness
    )
    notes: list[str] = []
    is_silenced = bool(os.environ.get("TQDM_DISABLE"))
    with (
        jax.enable_x64(True),
        tqdm(desc="report", total=_STAGES, disable=is_silenced or None, leave=False) as bar,
    ):
        stages = results_of(scan, arguments)
        while True:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                results = next(stages, None)
            for each in caught:
                note = str(each.message)
                if issubclass(each.category, UserWarning) and note not in notes:
                    notes.append(note)
                    warnings.warn(note, each.category, stacklevel=2)
            if results is None:
                return path
            _write(path, _text(arguments, results, notes, wording))
            bar.update()


def _new_page(file: str | Path) -> Path:
    path = Path(file)
    if path.suffix.lower() != ".html":
        raise ValueError(f"{path} has no ending that can be written: choose .html.")
    if path.exists():
        raise FileExistsError(f"{path} exists, and is not overwritten: choose another name.")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"The folder {path.parent} does not exist: make it first.")
    return path


def _text(arguments: Arguments, results: Results, notes: list[str], wording: Wording) -> str:
    """Return the text of the page with the results that are known."""
    size = max(results.surface.grid.shape)
    same = {**asdict(arguments), "size": size, "range": results.range}
    made = [page.heading("How this report was made"), page.command(wording.call(same))]
    if wording.source:
        made.append(page.paragraph(wording.source))
    body = [*parts(arguments, results, notes, wording.advice), *made, *sources()]
    return page.page(wording.title, body)


def _write(path: Path, text: str) -> None:
    """Replace a file at once, so that it can be read at any time."""
    part = path.with_name(f".{path.name}.part")
    # A name that is no UTF-8 keeps its bytes.
    part.write_bytes(text.encode("utf-8", "surrogateescape"))
    part.replace(path)

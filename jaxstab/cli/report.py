"""`jaxstab report`: how a scanned surface sticks, on one page that needs no other file."""

import argparse
import hashlib
import math
import platform
import shlex
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import jax
import numpy as np
from matplotlib.axes import Axes

import jaxstab as js
from jaxstab.branches.differentiable_limit import CriticalLoad
from jaxstab.cli import page
from jaxstab.cli.options import in_options
from jaxstab.cli.parsing import option_of
from jaxstab.cli.report_results import LoadedState, Results, results_of
from jaxstab.contact.resolution import FOR_JUMPS
from jaxstab.core.atomic_write import write_whole
from jaxstab.core.display import times
from jaxstab.core.optional_packages import versions
from jaxstab.core.results import RESULTS
from jaxstab.core.units import measured, readable_unit, shown_unit
from jaxstab.core.warn import warn
from jaxstab.plots.saving import new_file
from jaxstab.stability import Stability
from jaxstab.surfaces import Topography

_JUMPS = 5
# The end of the figures of the loop, over the largest mean gap in contact.
_SHOWN = 1.3
_FUNCTIONS = (
    js.equilibrate,
    js.assess_stability,
    js.follow,
    js.pull_off,
    js.extrapolate,
    js.patches,
    js.HalfSpace,
    js.potentials.Exponential,
    js.surfaces.power_law,
    js.surfaces.effective_work_of_adhesion,
)


def run(options: argparse.Namespace) -> None:
    """Compute the contact of a surface and write its report."""
    jax.config.update("jax_enable_x64", True)
    # An existing file is refused before the work begins.
    file = new_file(options.output, ["html"], overwrite=False)
    with _noted() as notes:
        results = results_of(options)
    text = page.page(f"Adhesion of {options.file.name}", _parts(options, results, notes))
    write_whole(file, text.encode())
    print(file)


@contextmanager
def _noted() -> Iterator[list[str]]:
    """Yield a list that in the end holds the warnings, each once; they are given again."""
    notes: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        yield notes
    texts = [str(each.message) for each in caught if issubclass(each.category, UserWarning)]
    for text in dict.fromkeys(texts):
        notes.append(in_options(text))
        warn(text)


def _parts(options: argparse.Namespace, results: Results, notes: list[str]) -> Iterator[str]:
    yield page.table(_answers(results))
    if notes:
        yield page.heading("Warnings")
        yield page.bullets(notes)
    yield page.heading("What was assumed")
    yield page.table(_parameters(options, results))
    yield page.bullets(
        [
            "The scanned surface is rigid, the other one smooth and an elastic half space. Two "
            "elastic bodies behave alike if 1/E* is the sum of theirs.",
            "No plasticity, viscosity, friction or inertia.",
            "The surface repeats itself beyond the scan. Waves that are longer than the scan, or "
            "shorter than two spacings of the grid, are left out.",
        ]
    )
    yield page.heading("Surface")
    yield page.table(*_statistics(results))
    yield page.figures(_of_surface(results))
    yield page.heading("Loop of approach and retraction")
    yield page.paragraph(
        "A stiff machine prescribes the mean gap. The contact jumps where a branch of stable "
        "states ends."
    )
    yield page.table(_energies(results))
    yield page.figures(_of_loop(results.loop))
    yield page.paragraph("The jumps that lose most:")
    yield page.table(*_jumps(results.loop))
    yield page.heading("Pull-off, and how well it is known")
    yield page.paragraph(
        "The largest tension of a contact that is unloaded by a dead load from zero pressure."
    )
    yield page.table(*_pull_offs(results))
    yield from _extrapolation(results)
    yield page.heading("Patches and verdicts at three loads")
    yield page.table(*_loads(results))
    yield page.figures(_of_patches(results))
    yield page.heading("How this report was made")
    yield page.command(_command(options, results))
    digest = hashlib.sha256(options.file.read_bytes()).hexdigest()
    yield page.paragraph(f"SHA-256 of {options.file.name}: {digest}")
    yield page.table([*versions().items(), ("Python", platform.python_version())])
    yield page.paragraph(
        "Units are SI, with prefixes. Pressures are positive in compression. Energies per area are "
        "energies over the area of the scan."
    )
    yield page.heading("Sources to cite")
    sources = js.cite(*_FUNCTIONS).sources
    yield page.bullets(f"{source.text} ({source.fields['role']})" for source in sources)


def _answers(results: Results) -> list[tuple[str, str]]:
    """Return the rows for which a report is read."""
    contact = results.contact
    loop = results.loop
    rest = results.states[0]
    first, longer, coarser = results.pull_offs
    touching = f"{100 * float(rest.equilibrium.contact_area):.1f} % of the area in contact"
    return [
        ("pull-off", _uncertain_tension(results)),
        ("… with twice the range", _change(first, longer)),
        ("… on half the points along each side", _change(first, coarser)),
        ("work of separation", _share_of_work(results, float(loop.work_of_separation))),
        ("lost in the loop", _share_of_work(results, float(loop.dissipation / contact.area))),
        ("without load", f"{touching}, {_verdict(rest.stability)}"),
    ]


def _tension(contact: js.Contact, pull_off: CriticalLoad) -> str:
    if pull_off.result != RESULTS.successful:
        return f"not found: {RESULTS[pull_off.result]}"
    return measured(contact.units, -float(pull_off.load.value), "pressure")


def _uncertain_tension(results: Results) -> str:
    """Return the tension of the pull-off at the range of the law, with its error."""
    tension = results.tension
    if math.isnan(tension.error):
        unknown = "" if math.isnan(tension.value) else ", with an unknown error"
        return f"{_tension(results.contact, results.pull_offs[0])}{unknown}"
    divisor, unit = readable_unit(results.contact.units, "pressure", tension.value)
    # To one digit, without an exponent.
    error = float(f"{tension.error / divisor:.1g}")
    return f"{tension.value / divisor:.3g} ± {error:g} {shown_unit(unit)}"


def _extrapolation(results: Results) -> Iterator[str]:
    """Yield how the tension of the pull-off and its error follow."""
    tension = results.tension
    contact = results.contact
    if tension.refusal:
        yield page.paragraph(
            "The pull-off could not be extrapolated from ranges that the grid resolves better, so "
            f"that its error is not known: {in_options(tension.refusal)}"
        )
    elif tension.extrapolation is None and not math.isnan(tension.error):
        yield page.paragraph(
            f"The error is that of the grid, at a resolution of {float(contact.resolution):.3g}."
        )
    elif tension.extrapolation is not None:
        found = tension.extrapolation
        yield page.paragraph(
            f"The value with its error, {_uncertain_tension(results)}, is extrapolated to the "
            "range rho from longer ranges, which the grid resolves better. Its error is that of "
            "the extrapolation and of the grid."
        )
        columns = found.ranges.tolist(), found.resolutions.tolist(), found.values.tolist()
        units = contact.units
        rows = [
            [measured(units, length, "length"), f"{fine:.3g}", measured(units, value, "pressure")]
            for length, fine, value in zip(*columns, strict=True)
        ]
        yield page.table(rows, ["range", "resolution", "tension"])


def _change(pull_off: CriticalLoad, other: CriticalLoad) -> str:
    """Return by how much the tension of another pull-off differs."""
    if not pull_off.result == other.result == RESULTS.successful:
        return "not known"
    return f"{100 * (float(other.load.value / pull_off.load.value) - 1):+.1f} %"


def _share_of_work(results: Results, energy: float) -> str:
    if math.isnan(energy):
        return "not known"
    share = energy / float(results.law.surface_energy)
    return f"{measured(results.contact.units, energy, 'energy/area')}, {100 * share:.3g} % of w"


def _verdict(stability: Stability) -> str:
    return stability.verdict.name.replace("_", " ")


def _parameters(options: argparse.Namespace, results: Results) -> list[tuple[str, str]]:
    contact = results.contact
    units = contact.units
    solid = results.solid
    law = results.law
    length = measured(units, float(law.length), "length")
    if options.range is None:
        length += ", the shortest that the grid resolves: give --range if yours is another"
    points = times(results.surface.grid.shape)
    if results.surface is not results.scan:
        points += f", resampled from {times(results.scan.grid.shape)}: --size takes more"
    return [
        ("Young's modulus E", measured(units, float(solid.youngs_modulus), "pressure")),
        ("Poisson's ratio nu", f"{float(solid.poisson_ratio):g}"),
        ("E* = E / (1 - nu²)", measured(units, float(solid.contact_modulus), "pressure")),
        ("work of adhesion w", measured(units, float(law.surface_energy), "energy/area")),
        ("law of adhesion", "f(g) = -w exp(-g / rho), an energy per area at a gap g"),
        ("range rho", length),
        ("resolution", f"{float(contact.resolution):.3g}, pull-offs and jumps need {FOR_JUMPS:g}"),
        ("sides", " x ".join(measured(units, side, "length") for side in results.scan.lengths)),
        ("points", points),
        *(("processing", remark) for remark in results.surface.remarks),
    ]


def _surfaces(results: Results) -> list[Topography]:
    """Return the scan, and the surface on fewer points if it has been resampled."""
    if results.surface is results.scan:
        return [results.scan]
    return [results.scan, results.surface]


def _statistics(results: Results) -> tuple[list[list[str]], list[str]]:
    units = results.contact.units
    surfaces = _surfaces(results)
    names = [
        "rms height",
        "highest point",
        "lowest point",
        "rms slope",
        "rms curvature",
        "effective work of adhesion",
    ]
    columns = [_statistics_of(results, surface) for surface in surfaces]
    law = results.power_law
    waves = [measured(units, 2 * math.pi / q, "length") for q in (law.rolloff, law.cutoff)]
    rows = [list(row) for row in zip(names, *columns, strict=True)]
    rows += [
        ["Hurst exponent", f"{law.hurst:.2f} ± {law.hurst_error:.2f}"],
        ["its waves", f"{waves[0]} to {waves[1]}"],
    ]
    header = ["", *(f"{times(surface.grid.shape)} points" for surface in surfaces)]
    return rows, header


def _statistics_of(results: Results, surface: Topography) -> list[str]:
    grid = surface.grid
    heights = surface.heights - surface.heights.mean()
    solid = js.HalfSpace(grid, results.solid.contact_modulus)
    work = results.law.surface_energy
    values = (
        (js.surfaces.rms_height(surface), "length"),
        (heights.max(), "length"),
        (heights.min(), "length"),
        (js.surfaces.rms_slope(grid, surface), "1"),
        (js.surfaces.rms_curvature(grid, surface), "1/length"),
        (js.surfaces.effective_work_of_adhesion(solid, surface, work), "energy/area"),
    )
    units = results.contact.units
    return [measured(units, float(value), dimension) for value, dimension in values]


def _of_surface(results: Results) -> list[tuple[Axes, str]]:
    surfaces = _surfaces(results)
    axes = js.plots.surface(results.contact, axes=page.axes_of_figure())
    spectra = [js.surfaces.power_spectrum(surface.grid, surface) for surface in surfaces]
    labels = [f"{times(surface.grid.shape)} points" for surface in surfaces]
    spectrum = js.plots.spectrum(spectra, labels=labels, unit="m", axes=page.axes_of_figure())
    return [
        (axes, "Heights of the surface, without its mean."),
        (spectrum, "Power spectral density, averaged over directions."),
    ]


def _energies(results: Results) -> list[tuple[str, str]]:
    contact = results.contact
    loop = results.loop
    energies = (loop.dissipation, loop.unlocated, loop.unlocated_error)
    lost, small, error = (float(energy / contact.area) for energy in energies)
    divisor, unit = readable_unit(contact.units, "energy/area", max(abs(small), error))
    rows = [
        ("jumps", f"{len(loop.jumps)}, {_share_of_work(results, lost)}"),
        ("in smaller jumps", f"{small / divisor:.2f} ± {error / divisor:.2f} {shown_unit(unit)}"),
        ("work of separation", _share_of_work(results, float(loop.work_of_separation))),
    ]
    if loop.result != RESULTS.successful:
        rows.append(("the loop ended early", str(RESULTS[loop.result])))
    return rows


def _of_loop(loop: js.Path) -> list[tuple[Axes, str]]:
    gaps = np.asarray(loop.equilibrium.mean_gap)
    touches = np.asarray(loop.equilibrium.contact_area) > 0
    last = _SHOWN * gaps[touches].max(initial=gaps.min())
    drawn = []
    for quantity in ("mean_pressure", "contact_area"):
        name = quantity.replace("_", " ")
        axes = js.plots.path(loop, "mean_gap", quantity, axes=page.axes_of_figure())
        axes.set_xlim(right=min(last, axes.get_xlim()[1]))
        drawn.append((axes, f"The {name} over the mean gap; dashed lines are jumps."))
    return drawn


def _jumps(loop: js.Path) -> tuple[list[list[str]], list[str]]:
    losses = np.asarray(loop.jumps.dissipation).tolist()
    units = loop.equilibrium.units
    rows = []
    for number in np.argsort(losses)[::-1][:_JUMPS]:
        jump = loop.jumps[int(number)]
        areas = (100 * float(state.contact_area) for state in (jump.before, jump.after))
        rows.append(
            [
                measured(units, float(jump.load.value), "length"),
                measured(units, losses[number], "energy"),
                jump.kind.name,
                " to ".join(f"{area:.2f} %" for area in areas),
            ]
        )
    return rows, ["mean gap", "loss", "kind", "contact area"]


def _pull_offs(results: Results) -> tuple[list[list[str]], list[str]]:
    contact = results.contact
    units = contact.units
    rows = []
    first = results.pull_offs[0]
    names = ("as above", "twice the range", "half the points along each side")
    for name, pull_off in zip(names, results.pull_offs, strict=True):
        force = measured(units, -float(pull_off.load.value * contact.area), "force")
        change = "" if pull_off is first else _change(first, pull_off)
        rows.append([name, _tension(contact, pull_off), force, pull_off.kind.name, change])
    return rows, ["", "tension", "force on the scan's area", "kind", "change"]


def _loads(results: Results) -> tuple[list[list[str]], list[str]]:
    rows = [_load_row(results.contact, state) for state in results.states]
    names = ("pressure", "contact area", "mean gap", "patches", "largest", "verdict", "barrier")
    return rows, [*names]


def _load_row(contact: js.Contact, state: LoadedState) -> list[str]:
    units = contact.units
    height = float(state.stability.barrier.height)
    barrier = ""
    if math.isfinite(height):
        barrier = measured(units, height, "energy")
    return [
        measured(units, float(state.equilibrium.load.value), "pressure"),
        f"{100 * float(state.equilibrium.contact_area):.1f} %",
        measured(units, float(state.equilibrium.mean_gap), "length"),
        str(int(state.patches.number)),
        f"{100 * float(state.patches.largest / contact.area):.1f} %",
        _verdict(state.stability),
        barrier,
    ]


def _of_patches(results: Results) -> list[tuple[Axes, str]]:
    drawn = []
    for state in results.states:
        pressure = float(state.equilibrium.load.value)
        axes = js.plots.patches(results.contact, state.equilibrium, axes=page.axes_of_figure())
        text = measured(results.contact.units, pressure, "pressure")
        drawn.append((axes, f"Contact patches at a mean pressure of {text}."))
    return drawn


def _command(options: argparse.Namespace, results: Results) -> list[str]:
    """Return the command for the same report, with the defaults that depend on the scan."""
    known = {
        **vars(options),
        "output": None,
        "size": max(results.surface.grid.shape),
        "range": float(results.law.length),
    }
    arguments = [str(known.pop("file"))]
    for name, value in known.items():
        if value is not None:
            values = value if isinstance(value, list) else [value]
            arguments += [option_of(name), *map(str, values)]
    return [shlex.quote(word) for word in ["python", "-m", "jaxstab", "report", *arguments]]

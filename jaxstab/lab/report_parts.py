"""The parts of a report: tables, figures and sentences."""

import math
import platform
from collections.abc import Callable, Iterator
from importlib.metadata import version

import numpy as np
from matplotlib.axes import Axes

import jaxstab as js
from jaxstab.lab import page
from jaxstab.lab.report_results import (
    FOR_JUMPS,
    Arguments,
    LoadedState,
    Results,
    Tension,
    change,
)

_JUMPS = 5
_LATER = "not computed yet"
_EFFECTIVE = "w less the elastic energy of full contact"
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
    js.surfaces.full_contact_energy,
)


def parts(
    arguments: Arguments, results: Results, notes: list[str], advice: Callable[[str], str]
) -> Iterator[str]:
    """Yield the parts of a report on its results; `advice` makes of remarks what is shown."""
    if results.loop is None:
        yield page.paragraph(
            "This page is not complete: its computation is still going on, or has been interrupted."
        )
    yield page.table(_answers(results))
    if notes:
        yield page.heading("Warnings")
        yield page.bullets(map(advice, notes))
    yield page.heading("What was assumed")
    yield page.table(_parameters(arguments, results, advice))
    yield page.bullets(
        [
            "The scanned surface is rigid, the other one smooth and an elastic half space. Two "
            "elastic bodies behave alike if 1/E* is the sum of theirs.",
            f"No {'' if arguments.hardness else 'plasticity, '}viscosity, friction or inertia.",
            "The surface repeats itself beyond its cell. Waves that are longer than the cell, or "
            "shorter than two spacings of the grid, are left out.",
        ]
    )
    yield page.heading("Surface")
    yield page.table(*_statistics(results))
    yield page.figures(_of_surface(results))
    if results.treated:
        yield from _edges(results)
    if results.pull_off is not None:
        yield page.heading("Pull-off, and how well it is known")
        yield page.paragraph(
            "The largest tension of a contact that is unloaded by a dead load from zero pressure."
        )
        if arguments.hardness is not None:
            yield page.paragraph(
                "Summits yield. This is the pull-off, and below the loop, of the surface that the "
                "largest of the three pressures below has left, of which nothing yields further."
            )
        yield page.table(*_pull_offs(results))
        yield from _extrapolation(results, advice)
    if results.states is not None:
        yield page.heading("Patches and verdicts at three loads")
        yield page.table(*_loads(results.contact, results.states))
        yield page.figures(_of_patches(results.contact, results.states))
    if results.loop is not None:
        yield page.heading("Loop of approach and retraction")
        yield page.paragraph(
            "A stiff machine prescribes the mean gap. The contact jumps where a branch of stable "
            "states ends."
        )
        yield page.table(_energies(results, results.loop))
        yield page.figures(_of_loop(results.loop))
        yield page.paragraph("The jumps that lose most:")
        yield page.table(*_jumps(results.loop))


def sources() -> Iterator[str]:
    """Yield the parts on versions, units and sources, which end a report."""
    packages = ("jaxstab", "jax", "jaxlib", "equinox", "numpy")
    yield page.table(
        [*((name, version(name)) for name in packages), ("Python", platform.python_version())]
    )
    yield page.paragraph(
        "Units are SI, with prefixes. Pressures are positive in compression. Energies per area are "
        "energies over the projected area."
    )
    yield page.heading("Sources to cite")
    found = js.cite(*_FUNCTIONS).sources
    yield page.bullets(f"{source.text} ({source.fields['role']})" for source in found)


def _answers(results: Results) -> list[tuple[str, str]]:
    """Return the rows for which a report is read."""
    contact = results.contact
    asked, computed = (
        contact.units.text(length, "length")
        for length in (results.range, float(results.law.length))
    )
    rows = []
    tension = results.tension
    if tension is None:
        rows.append((f"pull-off at the range {asked}", _LATER))
    else:
        known_at = contact.units.text(tension.range, "length")
        if known_at != asked:
            unknown = "not known: the grid does not resolve it, and no extrapolation holds"
            rows.append((f"pull-off at the range {asked}", unknown))
        rows.append((f"pull-off at the range {known_at}", _uncertain_tension(results, tension)))
    if asked != computed:
        resolved = f"the range {computed}, the shortest that the grid resolves"
        rows.append(("all below is at", resolved))
    first = results.pull_off
    for name, other in (
        ("… with twice the range", results.longer),
        ("… on half the points along each side", results.coarser),
    ):
        changed = _LATER if first is None or other is None else _change(first, other)
        rows.append((name, changed))
    separation, lost, touching = _LATER, _LATER, _LATER
    if results.loop is not None:
        loop = results.loop
        separation = _share_of_work(results, float(loop.work_of_separation))
        lost = _share_of_work(results, float(loop.dissipation / contact.area))
    if results.states is not None:
        rest = results.states[0]
        area = 100 * float(rest.equilibrium.contact_area)
        touching = f"{area:.1f} % of the area in contact, {_verdict(rest.stability)}"
    rows += [
        ("work of separation", separation),
        ("lost in the loop", lost),
        ("without load", touching),
    ]
    return rows


def _tension(contact: js.Contact, pull_off: js.results.CriticalLoad) -> str:
    if pull_off.result != js.RESULTS.successful:
        return f"not found: {js.RESULTS[pull_off.result]}"
    return contact.units.text(-float(pull_off.load.value), "pressure")


def _uncertain_tension(results: Results, tension: Tension) -> str:
    """Return the tension of the pull-off with its error by range, grid and edges."""
    assert results.pull_off is not None
    if math.isnan(tension.value):
        return _tension(results.contact, results.pull_off)
    units = results.contact.units
    error = math.hypot(tension.error, tension.value * results.error_by_edges)
    if math.isnan(error):
        return f"{units.text(tension.value, 'pressure')}, with an unknown error"
    return units.text(tension.value, "pressure", error=error)


def _extrapolation(results: Results, advice: Callable[[str], str]) -> Iterator[str]:
    """Yield how the tension of the pull-off and its error follow."""
    tension = results.tension
    contact = results.contact
    if tension is None:
        return
    if results.treated:
        share = 100 * results.error_by_edges
        yield page.paragraph(
            f"The error contains {share:.2g} % by the edges: the largest change of the pull-off if "
            "they are treated in another way that keeps the roughness."
        )
    asked = contact.units.text(results.range, "length")
    if tension.refusal:
        yield page.paragraph(
            f"The pull-off could not be extrapolated to {asked} from ranges that the grid resolves "
            f"better, so that its error is not known: {advice(tension.refusal)}"
        )
    elif tension.extrapolation is None and not math.isnan(tension.error):
        yield page.paragraph(
            f"The error by the grid is that of a resolution of {float(contact.resolution):.3g}."
        )
    elif tension.extrapolation is not None:
        found = tension.extrapolation
        yield page.paragraph(
            f"The value at the range {asked} is extrapolated from longer ranges, which the grid "
            f"resolves better. The extrapolation and the grid give it an error of "
            f"{contact.units.text(tension.error, 'pressure', 1)}."
        )
        columns = found.ranges.tolist(), found.resolutions.tolist(), found.values.tolist()
        units = contact.units
        rows = [
            [units.text(length, "length"), f"{fine:.3g}", units.text(value, "pressure")]
            for length, fine, value in zip(*columns, strict=True)
        ]
        yield page.table(rows, ["range", "resolution", "tension"])


def _edges(results: Results) -> Iterator[str]:
    """Yield what the ways to make the edges meet change."""
    assert results.treated is not None
    first = results.treated[0]
    yield page.heading("Treatment of the edges")
    yield page.paragraph(
        f"The scan was {first.name} to make opposite edges meet, as in the first row. All rows "
        "have the range and the spacing of the contact. A window flattens 36 % of the area, "
        "and raises the pull-off of most surfaces. The inner part is four fifths of each side."
    )
    rows = []
    for one in results.treated:
        values = _statistics_of(results, one.surface)
        change = "" if one is first else _change(first.pull_off, one.pull_off)
        tension = _tension(results.contact, one.pull_off)
        rows.append([one.name, values[0], values[3], values[5], tension, change])
    header = ["", "rms height", "rms slope", _EFFECTIVE, "pull-off", "change"]
    yield page.table(rows, header)


def _change(pull_off: js.results.CriticalLoad, other: js.results.CriticalLoad) -> str:
    """Return by how much the tension of another pull-off differs."""
    share = change(pull_off, other)
    return "not known" if math.isnan(share) else f"{100 * share:+.1f} %"


def _share_of_work(results: Results, energy: float) -> str:
    if math.isnan(energy):
        return "not known"
    share = energy / float(results.law.surface_energy)
    return f"{results.contact.units.text(energy, 'energy/area')}, {100 * share:.3g} % of w"


def _verdict(stability: js.results.Stability) -> str:
    return stability.verdict.name.replace("_", " ")


def _parameters(
    arguments: Arguments, results: Results, advice: Callable[[str], str]
) -> list[tuple[str, str]]:
    contact = results.contact
    units = contact.units
    solid = results.solid
    law = results.law
    length = units.text(float(law.length), "length")
    if results.range != float(law.length):
        asked = units.text(results.range, "length")
        length += f", the shortest that the grid resolves, and pull-offs extrapolated to {asked}"
    elif arguments.range is None:
        length += ", the shortest that the grid resolves: give `range` if yours is another"
    points = _times(results.surface.grid.shape)
    sides = results.surface.lengths / results.scan.lengths * results.scan.grid.shape
    cell = tuple(np.rint(sides).astype(int).tolist())
    if results.surface.grid.shape != cell:
        points += f", resampled from {_times(cell)}: `size` takes more"
    hardness = []
    if arguments.hardness is not None:
        bears = f"{units.text(arguments.hardness, 'pressure')}, the largest pressure that is borne"
        hardness.append(("hardness H", bears))
    return [
        ("Young's modulus E", units.text(float(solid.youngs_modulus), "pressure")),
        ("Poisson's ratio nu", f"{float(solid.poisson_ratio):g}"),
        ("E* = E / (1 - nu²)", units.text(float(solid.contact_modulus), "pressure")),
        *hardness,
        ("work of adhesion w", units.text(float(law.surface_energy), "energy/area")),
        ("law of adhesion", "f(g) = -w exp(-g / rho), an energy per area at a gap g"),
        ("range rho", advice(length)),
        ("resolution", f"{float(contact.resolution):.3g}, pull-offs and jumps need {FOR_JUMPS:g}"),
        ("sides of the scan", _sides(results, results.scan)),
        ("sides of the periodic cell", _sides(results, results.surface)),
        ("points of the cell", advice(points)),
        *(("processing", remark) for remark in results.surface.remarks),
    ]


def _sides(results: Results, surface: js.surfaces.Topography) -> str:
    return " x ".join(results.contact.units.text(side, "length") for side in surface.lengths)


def _times(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def _surfaces(results: Results) -> list[tuple[str, js.surfaces.Topography]]:
    """Return the surface as measured, and in the contact, with their names."""
    named = [("measured", results.measured), ("in the contact", results.surface)]
    return [(f"{name}, {_times(surface.grid.shape)} points", surface) for name, surface in named]


def _statistics(results: Results) -> tuple[list[list[str]], list[str]]:
    units = results.contact.units
    named = _surfaces(results)
    names = [
        "rms height",
        "highest point",
        "lowest point",
        "rms slope",
        "rms curvature",
        _EFFECTIVE,
    ]
    columns = [_statistics_of(results, surface) for _, surface in named]
    rows = [list(row) for row in zip(names, *columns, strict=True)]
    law = results.power_law
    if isinstance(law, str):
        rows.append(["Hurst exponent", law])
    else:
        waves = [units.text(2 * math.pi / q, "length") for q in (law.rolloff, law.cutoff)]
        rows += [
            ["Hurst exponent", f"{law.hurst:.2f} ± {law.hurst_error:.2f}"],
            ["its waves", f"{waves[0]} to {waves[1]}"],
        ]
    return rows, ["", *(name for name, _ in named)]


def _statistics_of(results: Results, surface: js.surfaces.Topography) -> list[str]:
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
        # The law counts the work of adhesion per projected area.
        (work - js.surfaces.full_contact_energy(solid, surface), "energy/area"),
    )
    units = results.contact.units
    return [units.text(float(value), dimension) for value, dimension in values]


def _of_surface(results: Results) -> list[tuple[Axes, str]]:
    axes = js.plots.surface(results.contact, axes=page.axes_of_figure())
    drawn = [(axes, "Heights of the surface in the contact, without its mean.")]
    if results.surface.heights.std() > 0:
        labels, surfaces = zip(*_surfaces(results), strict=True)
        spectra = [js.surfaces.power_spectrum(surface.grid, surface) for surface in surfaces]
        axes = js.plots.spectrum(spectra, labels=labels, unit="m", axes=page.axes_of_figure())
        drawn.append((axes, "Power spectral density, averaged over directions."))
    return drawn


def _energies(results: Results, loop: js.results.Path) -> list[tuple[str, str]]:
    contact = results.contact
    energies = (loop.dissipation, loop.unlocated, loop.unlocated_error)
    lost, small, error = (float(energy / contact.area) for energy in energies)
    smaller = contact.units.text(small, "energy/area", error=error)
    if abs(small) < error:
        smaller = f"less than {contact.units.text(abs(small) + error, 'energy/area', 2)}"
    jumps = "1 jump" if len(loop.jumps) == 1 else f"{len(loop.jumps)} jumps"
    rows = [
        ("lost in jumps", f"{_share_of_work(results, lost)}, in {jumps}"),
        ("lost in jumps too small to be located", smaller),
        ("work of separation", _share_of_work(results, float(loop.work_of_separation))),
    ]
    if loop.result != js.RESULTS.successful:
        rows.append(("the loop ended early", str(js.RESULTS[loop.result])))
    return rows


def _of_loop(loop: js.results.Path) -> list[tuple[Axes, str]]:
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


def _jumps(loop: js.results.Path) -> tuple[list[list[str]], list[str]]:
    losses = np.asarray(loop.jumps.dissipation).tolist()
    units = loop.equilibrium.units
    rows = []
    for number in np.argsort(losses)[::-1][:_JUMPS]:
        jump = loop.jumps[int(number)]
        areas = (100 * float(state.contact_area) for state in (jump.before, jump.after))
        rows.append(
            [
                units.text(float(jump.load.value), "length"),
                units.text(losses[number], "energy"),
                jump.kind.name,
                " to ".join(f"{area:.2f} %" for area in areas),
            ]
        )
    return rows, ["mean gap", "loss", "kind", "contact area"]


def _pull_offs(results: Results) -> tuple[list[list[str]], list[str]]:
    contact = results.contact
    units = contact.units
    rows = []
    first = results.pull_off
    length = float(results.law.length)
    computed = {
        f"range {units.text(length, 'length')}": first,
        f"twice the range, {units.text(2 * length, 'length')}": results.longer,
        "half the points along each side": results.coarser,
    }
    area = float(np.prod(results.scan.lengths))
    for name, pull_off in computed.items():
        if first is None or pull_off is None:
            rows.append([name, _LATER])
            continue
        force = units.text(-float(pull_off.load.value) * area, "force")
        changed = "" if pull_off is first else _change(first, pull_off)
        rows.append([name, _tension(contact, pull_off), force, pull_off.kind.name, changed])
    return rows, ["", "tension", "force on the scan's area", "kind", "change"]


def _loads(contact: js.Contact, states: list[LoadedState]) -> tuple[list[list[str]], list[str]]:
    rows = [_load_row(contact, state) for state in states]
    names = ["pressure", "contact area", "mean gap", "patches", "largest", "verdict", "barrier"]
    if contact.hardness is not None:
        names.append("yielding")
        for row, state in zip(rows, states, strict=True):
            yielded = state.equilibrium.yielded_area
            assert yielded is not None
            row.append(f"{100 * float(yielded):.1f} %")
    return rows, names


def _load_row(contact: js.Contact, state: LoadedState) -> list[str]:
    units = contact.units
    height = float(state.stability.barrier.height)
    barrier = ""
    if math.isfinite(height):
        barrier = units.text(height, "energy")
    return [
        units.text(float(state.equilibrium.load.value), "pressure"),
        f"{100 * float(state.equilibrium.contact_area):.1f} %",
        units.text(float(state.equilibrium.mean_gap), "length"),
        str(int(state.patches.number)),
        f"{100 * float(state.patches.largest / contact.area):.1f} %",
        _verdict(state.stability),
        barrier,
    ]


def _of_patches(contact: js.Contact, states: list[LoadedState]) -> list[tuple[Axes, str]]:
    drawn = []
    for state in states:
        pressure = float(state.equilibrium.load.value)
        axes = js.plots.patches(contact, state.equilibrium, axes=page.axes_of_figure())
        text = contact.units.text(pressure, "pressure")
        drawn.append((axes, f"Contact patches at a mean pressure of {text}."))
    return drawn

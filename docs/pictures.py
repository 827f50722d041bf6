"""The pictures of README and documentation: `python docs/pictures.py`, from the repository's root.

`first` draws the picture of the README, `curves` the page on performance, from the tables
in `benchmarks/results/`, `films` the three films of the gallery, and `questions` the pages in
`docs/questions/`, from the numbers of their recipes. All are written into
`docs/_static/`; without a name all are made.
"""

import argparse
import re
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.animation import PillowWriter
from matplotlib.figure import Figure
from question_pictures import DRAWINGS, drawn

import jaxstab as js
from jaxstab.plots.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILION
from jaxstab.references.elastic_plastic import area_fractions

STATIC = Path(__file__).parent / "_static"
RESULTS = Path(__file__).parents[1] / "benchmarks" / "results"
# Texts that are legible where a picture is as wide as a phone.
LARGE = {"font.size": 17, "lines.linewidth": 2.5, "axes.titlesize": 18}
# A film has few frames and colours, so that it stays small.
FRAMES, FRAMES_A_SECOND = 60, 12


@cache
def loop() -> tuple[js.Contact, js.results.Path]:
    """Return a rough contact, and its loop of approach and retraction through a soft machine."""
    grid = js.Grid(64)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=6, rms_height=0.05)
    solid = js.HalfSpace(grid, youngs_modulus=1.0)
    contact = js.Contact(solid, heights, js.potentials.Exponential(0.06, 0.06))
    machine = js.Spring(jnp.array([0.5, 0.1, 0.5]), 1.0)
    return contact, js.follow(contact, machine, fields=True)


def first() -> None:
    """Draw the surface with its contact, the mode that is about to open, and the loop."""
    contact, path = loop()
    values = np.asarray(path.load.value)
    # Of the jumps on retraction, the one that loses most.
    is_back = np.asarray(path.jumps.state) > np.argmin(values)
    losses = np.where(is_back, np.nan_to_num(np.asarray(path.jumps.dissipation)), -1)
    jump = path.jumps[int(np.argmax(losses))]
    touches = np.asarray(jump.before.gap) == 0
    mode = np.asarray(jump.mode)
    mode = mode * np.sign(mode.flat[np.argmax(np.abs(mode))]) / np.abs(mode).max()
    heights = np.asarray(contact.heights)
    with plt.rc_context(LARGE):
        figure = plt.figure(figsize=(9, 9), layout="constrained")
        panels = figure.subplot_mosaic([["surface", "mode"], ["loop", "loop"]])
        panels["surface"].imshow(heights.T, origin="lower", cmap="Greys_r")
        shown = np.ma.masked_where(~touches, touches).T
        panels["surface"].imshow(shown, origin="lower", cmap="winter", vmin=0, vmax=3)
        panels["surface"].set_title("surface, contact in blue")
        panels["mode"].imshow(mode.T, origin="lower", cmap="RdBu_r", vmin=-1, vmax=1)
        panels["mode"].contour(touches.T, [0.5], colors="black", linewidths=1.5)
        panels["mode"].set_title("where it opens next")
        for name in ("surface", "mode"):
            panels[name].set(xticks=[], yticks=[])
        axes = panels["loop"]
        pressures = np.asarray(path.equilibrium.mean_pressure)
        turn = int(np.argmin(values))
        axes.plot(values[: turn + 1], pressures[: turn + 1], color=BLUE, label="approach")
        axes.plot(values[turn:], pressures[turn:], color=VERMILION, label="retraction")
        at = float(jump.load.value), float(jump.before.mean_pressure)
        axes.plot(*at, "o", color=BLACK, markersize=13)
        axes.annotate("shown above", at, (16, -6), textcoords="offset points")
        axes.set(xlabel="position of the machine", ylabel="mean pressure")
        axes.set_title(f"the loop and its {len(path.jumps)} jumps")
        axes.axhline(0, color="0.7", linewidth=1, zorder=0)
        axes.legend(loc="lower left", frameon=False)
        figure.savefig(STATIC / "first_picture.png", dpi=90)


def curves() -> None:
    """Draw seconds and errors of the tables over the number of points."""
    save(_speed(), "speed")
    save(_closed_forms(), "errors")
    save(_accelerator(), "gpu")
    save(_yielding(), "questions/yielding")


def _speed() -> Figure:
    figure, panels = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained", sharey=True)
    peers = {
        "tamaas": ("Tamaas", VERMILION, "s"),
        "contactmechanics": ("ContactMechanics", ORANGE, "D"),
        "adhesion": ("Adhesion", PURPLE, "v"),
        "numpi": ("NuMPI", GREEN, "^"),
    }
    for axes, problem in zip(panels, ("adhesive", "no adhesion"), strict=True):
        rows = [row for row in table("peers.md") if row[1] == "32" and row[2] == problem]
        ours = {int(row[0]): float(row[5]) for row in rows}
        axes.loglog(list(ours), list(ours.values()), "o-", color=BLUE, label="jaxstab")
        for peer, (label, colour, marker) in peers.items():
            theirs = {int(row[0]): float(row[6]) for row in rows if row[3] == peer}
            if theirs:
                points, seconds = list(theirs), list(theirs.values())
                axes.loglog(points, seconds, marker=marker, color=colour, label=label)
        axes.set_title({"adhesive": "with adhesion"}.get(problem, "without adhesion"))
        axes.set_xticks(list(ours), [f"{points}²" for points in ours])
        axes.minorticks_off()
        axes.set_xlabel("points")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("seconds to an equilibrium")
    panels[0].legend()
    return figure


def _closed_forms() -> Figure:
    figure, axes = plt.subplots(figsize=(5.2, 3.6), layout="constrained")
    rows = table("closed_forms.md", "Johnson's wave, alpha = 0.5: the grid refined")
    errors = [abs(float(row[4].split()[0].rstrip("%"))) for row in rows]
    axes.loglog([float(row[2]) for row in rows], errors, "o-", color=BLUE)
    resolution = np.array([2.0, 16.0])
    axes.loglog(resolution, 20 / resolution**2, "k--", label=r"$20 / \mathrm{resolution}^2$")
    axes.set(xlabel="contact.resolution, in proportion to the points", ylabel="error [%]")
    axes.set_title("pull-off of Johnson's adhesive wave")
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def _accelerator() -> Figure:
    figure, axes = plt.subplots(figsize=(5.2, 3.6), layout="constrained")
    page = (RESULTS.parents[1] / "docs" / "performance.md").read_text()
    rows = rows_of(page.partition("## On a GPU")[2])
    for column, label, colour, style in (
        (1, "equilibrium, H200", BLUE, "o-"),
        (4, "verdict, H200", BLUE, "s--"),
        (2, "equilibrium, two CPU cores", VERMILION, "o-"),
        (5, "verdict, two CPU cores", VERMILION, "s--"),
    ):
        known = [(int(row[0].rstrip("²")), float(row[column])) for row in rows if row[column]]
        axes.loglog(*zip(*known, strict=True), style, color=colour, label=label)
    ticks = [int(row[0].rstrip("²")) for row in rows]
    axes.set_xticks(ticks, [f"{points}²" for points in ticks])
    axes.minorticks_off()
    axes.set(xlabel="points", ylabel="seconds")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    return figure


def _yielding() -> Figure:
    figure, axes = plt.subplots(figsize=(5.2, 3.6), layout="constrained")
    rows = table("hardness.md", "Rough surfaces of rms slope 0.1, 256² points: areas")
    slope = 0.1
    smallest = min(float(row[0]) for row in rows)
    hardness = np.geomspace(smallest, 1.0, 100)
    for share, colour in ((0.1, BLUE), (0.3, ORANGE), (0.6, VERMILION)):
        # The loads of the table: a part of the hardness, or of an elastic contact.
        pressure = share * np.minimum(hardness, slope / 2)
        areas = sum(area_fractions(pressure, slope, 1.0, hardness))
        axes.loglog(hardness / slope, areas * hardness / pressure, color=colour)
        found = [[float(cell) for cell in row[:3]] for row in rows]
        chosen = [
            (own / slope, area / part)
            for own, part, area in found
            if abs(part * own / min(own, slope / 2) - share) < 0.01
        ]
        label = rf"$P = {share:g}\,H$, at most ${share * slope / 2:g}\,E^*$"
        axes.loglog(*zip(*chosen, strict=True), "o", color=colour, label=label)
    axes.axhline(1, color=BLACK, linestyle=":", zorder=0)
    axes.set(xlabel=r"$H / (E^* h')$", ylabel=r"area in contact, over $P / H$")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", title="lines: Persson's theory", title_fontsize="small")
    return figure


def table(name: str, heading: str = "") -> list[list[str]]:
    """Return the cells of a table of benchmarks: the first one below a heading."""
    text = (RESULTS / name).read_text()
    return rows_of(text[text.index(heading) :])


def rows_of(text: str) -> list[list[str]]:
    """Return the cells of the first table of a text, without its head."""
    lines = re.search(r"(?:^\|.*\n?)+", text, re.MULTILINE)[0].strip().splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def save(figure: Figure, name: str) -> None:
    """Write a figure as SVG, the same file each time."""
    with plt.rc_context({"svg.hashsalt": "jaxstab"}):
        figure.savefig(STATIC / f"{name}.svg", metadata={"Date": None})
    plt.close(figure)


def films() -> None:
    """Make the films of a loop, of a pull-off and of a lifetime."""
    (STATIC / "films").mkdir(exist_ok=True)
    contact, path = loop()
    gaps, values = np.asarray(path.equilibrium.gap), np.asarray(path.load.value)
    pressures = np.asarray(path.equilibrium.mean_pressure)
    film("loop", contact, gaps, values, pressures, "position of the machine", "mean pressure")

    contact, path = pull_off()
    gaps, values = np.asarray(path.equilibrium.gap), np.asarray(path.load.value)
    film("pull_off", contact, gaps, values, np.asarray(path.equilibrium.force), "far side", "force")

    contact, run = lifetime()
    is_there = np.isfinite(np.asarray(run.mean_gap))
    gaps, times = np.asarray(run.fields.gap)[is_there], np.asarray(run.times)[is_there]
    areas = 100 * np.asarray(run.contact_area)[is_there]
    film("lifetime", contact, gaps, times, areas, "time", "contact area [%]")


def pull_off() -> tuple[js.Contact, js.results.Path]:
    """Return a tip on a free half space, and its path into contact and off."""
    grid = js.Grid(48, 0.3)
    contact = js.Contact(
        js.FreeHalfSpace(grid, 1.0),
        js.surfaces.paraboloid(grid, radius=1.0),
        js.potentials.Exponential(1e-4, 2e-3),
    )
    far = js.FarDisplacement(jnp.array([0.012, -0.006, 0.016]))
    return contact, js.follow(contact, far, fields=True)


def lifetime() -> tuple[js.Contact, js.results.Evolution]:
    """Return a viscoelastic contact that is held under tension until it detaches."""
    grid = js.Grid(32)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.05)
    rubber = js.Viscoelastic(js.HalfSpace(grid, 1.0), ratios=(2.0, 1.0), times=(0.1, 1.0))
    law = js.potentials.Exponential(0.06, 0.06)
    contact = js.Contact(rubber, heights, law)
    relaxed = js.Contact(rubber.relaxed, heights, law)
    load = js.MeanPressure(1.02 * js.pull_off(relaxed).load.value)
    end = js.lifetime(contact, load)
    times = jnp.append(0.0, end * jnp.linspace(0.01, 0.999, FRAMES - 1))
    start = js.equilibrate(relaxed, js.MeanPressure(0.0))
    held = js.MeanPressure(jnp.full(times.shape, load.value))
    return contact, js.evolve(contact, held, times, initial=start, fields=True)


def film(
    name: str,
    contact: js.Contact,
    gaps: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    x_label: str,
    y_label: str,
) -> None:
    """Write a film: the gap with the contact in black, and a curve with the state on it."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.2, 3.4), layout="constrained")
    colours = plt.get_cmap("viridis", 24).with_extremes(bad="black")
    image = left.imshow(np.zeros_like(gaps[0]), origin="lower", cmap=colours)
    image.set_clim(0, np.quantile(gaps, 0.98))
    left.set(xticks=[], yticks=[], title="gap; contact in black")
    right.plot(x, y, color=BLUE)
    right.set(xlabel=x_label, ylabel=y_label)
    (marker,) = right.plot([], [], "o", color=BLACK, markersize=8)
    frames = np.linspace(0, len(x) - 1, min(FRAMES, len(x))).round().astype(int)
    writer = PillowWriter(fps=FRAMES_A_SECOND)
    with writer.saving(figure, str(STATIC / "films" / f"{name}.gif"), dpi=75):
        for frame in frames:
            image.set_data(np.ma.masked_equal(gaps[frame], 0).T)
            marker.set_data([x[frame]], [y[frame]])
            writer.grab_frame()
    plt.close(figure)


def questions() -> None:
    """Draw the pictures of the pages of questions."""
    (STATIC / "questions").mkdir(exist_ok=True)
    for page in DRAWINGS:
        save(drawn(page), f"questions/{page}")


PICTURES: dict[str, Callable[[], None]] = {
    "first": first,
    "curves": curves,
    "films": films,
    "questions": questions,
}


def main() -> None:
    """Make the pictures that are named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[[], *PICTURES], default=[])
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore", UserWarning)
    for name in parser.parse_args().names or PICTURES:
        PICTURES[name]()


if __name__ == "__main__":
    main()

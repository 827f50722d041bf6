"""Draw the figures of paper.md: two runs of the main job, and two tables of benchmarks.

`python paper/figures.py`, from the root of the repository, writes them beside this file.
"""

import re
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxstab as js
from jaxstab.plots.style import BLUE, GREEN, PURPLE, VERMILION

HERE = Path(__file__).parent
RESULTS = HERE.parent / "benchmarks" / "results"
POINTS = 256
PEERS = {
    "tamaas": ("Tamaas", VERMILION, "s"),
    "adhesion": ("Adhesion", PURPLE, "v"),
    "numpi": ("NuMPI", GREEN, "^"),
}


def draw_verdicts_and_jumps():
    """The unloading study of Rey and Bleyer, and a loop through its jumps on the same contact."""
    grid = js.Grid(POINTS)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=32, rms_height=0.1)
    solid = js.HalfSpace(grid, youngs_modulus=0.001, poisson_ratio=0.0)
    contact = js.Contact(solid, heights, js.potentials.Exponential(0.01, 1.0))
    first, last = 1e-5, 2.0
    gaps = js.MeanGap(np.linspace(first, last, 21))
    states = js.sweep(contact, gaps, order="continuation")
    loop = js.follow(contact, js.MeanGap(np.array([last, first, last])))
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    js.plots.stability_curve(states, axes=left)
    left.legend(loc="lower right")
    js.plots.path(loop, "mean_gap", "contact_area", axes=right)
    right.legend(*right.get_legend_handles_labels(), title="mean gap", loc="upper right")
    print(states, loop, sep="\n")
    save(figure, "verdicts_and_jumps.png")


def draw_speed_and_error():
    """Seconds beside other packages, and the error of a pull-off over the grid's resolution."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    times = [row for row in table("peers.md") if row[1] == "32" and row[2] == "adhesive"]
    ours = {int(row[0]): float(row[5]) for row in times}
    left.loglog(list(ours), list(ours.values()), "o-", color=BLUE, label="jaxstab")
    for peer, (label, colour, marker) in PEERS.items():
        theirs = {int(row[0]): float(row[6]) for row in times if row[3] == peer}
        if theirs:
            points, seconds = list(theirs), list(theirs.values())
            left.loglog(points, seconds, marker=marker, color=colour, label=label)
    left.set_xticks(list(ours), [str(points) for points in ours])
    left.minorticks_off()
    left.set(xlabel="points along a side", ylabel="seconds to an equilibrium")
    left.legend()

    refined = "Johnson's wave, alpha = 0.5: the grid refined"
    errors = {float(row[2]): abs(percent(row[4])) for row in table("closed_forms.md", refined)}
    right.loglog(list(errors), list(errors.values()), "o-", color=BLUE, label="jaxstab")
    resolution = np.array([2.0, 16.0])
    right.loglog(resolution, 0.2 / resolution**2, "k--", label=r"$0.2 / \mathrm{resolution}^2$")
    right.set(xlabel="resolution of the grid", ylabel="error of the pull-off pressure")
    right.legend()
    save(figure, "speed_and_error.png")


def table(name, heading=""):
    """Return the rows of the first table of a file of results below a heading, as words."""
    text = (RESULTS / name).read_text()
    lines = text[text.index(heading) :].splitlines()
    start = next(number for number, line in enumerate(lines) if re.match(r"\|[-|]+$", line))
    rows = []
    for line in lines[start + 1 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def percent(cell):
    """Return the number of a cell such as "+0.30 %"."""
    return float(cell.removesuffix(" %")) / 100


def save(figure, name):
    """Write a figure beside this file, in place of an earlier one."""
    path = HERE / name
    path.unlink(missing_ok=True)
    js.plots.save(figure, path, width="double")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    draw_speed_and_error()
    draw_verdicts_and_jumps()

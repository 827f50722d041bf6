"""The drawings of the documentation, as SVG; `python docs/drawings.py FOLDER` writes them."""

import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

SOLID, SURFACE, FORCE = "#c9dcef", "#5b5b5b", "#b3331d"
STYLE = {"font.size": 11, "svg.fonttype": "path", "svg.hashsalt": "jaxstab"}


def draw(folder: Path) -> None:
    """Write all drawings into a folder, which is made if need be."""
    folder.mkdir(exist_ok=True)
    drawings = {"conventions": conventions, "verdicts": verdicts}
    with matplotlib.rc_context(STYLE):
        for name, drawing in drawings.items():
            # Without a date, the same drawing is the same file.
            drawing().savefig(folder / f"{name}.svg", metadata={"Date": None})


def conventions() -> Figure:
    """Draw a solid on a surface, with what is measured from where."""
    figure, axes = _figure(9, 4.6)
    x = np.linspace(0, 1, 1001)
    h = 0.42 * np.cos(4 * np.pi * x) + 0.06 * np.cos(2 * np.pi * x + 0.9) - 0.75
    u = _draped(h)
    axes.fill_between(x, u, 1.0, color=SOLID, linewidth=0)
    axes.plot(x, u, color="#2f6ba5", linewidth=1.6)
    axes.fill_between(x, -1.9, h, color=SURFACE, linewidth=0)
    axes.axhline(0, color="0.4", linewidth=0.8, linestyle="--")
    axes.text(1.012, 0.03, "height 0", va="bottom", color="0.3")
    axes.text(0.16, 0.75, "elastic solid", ha="center", color="#1d4870")
    axes.text(0.26, -1.7, "rigid rough surface", ha="center", color="white")

    _measure(axes, x[190], 0, u[190], "$u<0$", "#1d4870", side=-1)
    _measure(axes, x[285], 0, h[285], "$h<0$", "black", side=1)
    _measure(axes, x[735], h[735], u[735], "$g=u-h$", FORCE, side=1)
    axes.annotate(
        "contact, $g=0$: the reaction\n$\\mu\\geq 0$ presses the solid away",
        (x[500], h[500]),
        (0.62, 0.5),
        ha="center",
        arrowprops={"arrowstyle": "->", "color": FORCE},
        color=FORCE,
    )
    for place in np.linspace(0.04, 0.96, 12):
        axes.annotate("", (place, 1.01), (place, 1.27), arrowprops={"arrowstyle": "->"})
    axes.text(0.5, 1.33, "mean pressure $p_0>0$: compression", ha="center")
    axes.annotate("", (1.0, -2.0), (0.0, -2.0), arrowprops={"arrowstyle": "<->"})
    axes.text(0.5, -2.1, "one period $L$, points at $x_i=iL/n$", ha="center", va="top")
    axes.set(xlim=(-0.02, 1.12), ylim=(-2.35, 1.55))
    return figure


def verdicts() -> Figure:
    """Draw the three sets of perturbations, and the energy of a state held by contact."""
    figure = Figure(figsize=(10, 4.3), layout="constrained")
    sets, energy = figure.subplots(1, 2, width_ratios=[1.15, 1])
    boxes = [
        (0.0, 0.0, 10.0, 8.0, "#eef3f8", "all that the load allows", "lower_bound"),
        (0.7, 0.6, 8.6, 5.5, "#d5e3f1", "… that do not penetrate the surface", "cone"),
        (1.4, 1.1, 7.2, 2.9, "#b4cde6", "… that do not move points under pressure", "critical"),
    ]
    for left, bottom, width, height, colour, text, name in boxes:
        corner = "round,pad=0,rounding_size=0.35"
        box = FancyBboxPatch((left, bottom), width, height, corner, fc=colour, ec="#2f6ba5")
        sets.add_patch(box)
        sets.text(left + 0.4, bottom + height - 0.3, text, va="top")
        label = f"smallest eigenvalue: {name}"
        sets.text(left + 0.4, bottom + height - 1.0, label, va="top", family="monospace", size=9)
    sets.set(
        xlim=(-0.2, 10.2), ylim=(-0.2, 8.2), title="perturbations: a smaller set, a larger minimum"
    )
    sets.axis("off")

    t = np.linspace(0, 2.35, 200)
    energy.plot(t, 2 * t - t**2, color=FORCE, linewidth=2)
    energy.plot([1, 1], [0, 1], ":", color="0.3")
    energy.plot([0, 1], [1, 1], ":", color="0.3")
    energy.plot(0, 0, "o", color="black", clip_on=False)
    energy.text(0.06, -0.16, "the equilibrium", va="top")
    energy.text(0.5, 1.03, "barrier.height", ha="center", family="monospace", size=9)
    energy.text(1.03, 0.05, "barrier.amplitude", family="monospace", size=9)
    energy.text(0.33, 0.42, r"slope $\mu\cdot x>0$", color=FORCE)
    energy.text(1.95, 0.5, r"curvature" "\n" r"$\lambda<0$", color=FORCE)
    energy.set(
        xlabel="amplitude $t$ along the cone's mode $x$",
        ylabel="energy above the equilibrium",
        xticks=[],
        yticks=[],
        ylim=(-0.75, 1.3),
        xlim=(0, 2.6),
        title="held by contact: $E(t)=t\\,\\mu\\cdot x+t^2\\lambda/2$",
    )
    energy.axhline(0, color="0.6", linewidth=0.8)
    for side in ("top", "right"):
        energy.spines[side].set_visible(False)
    return figure


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    axes.axis("off")
    return figure, axes


def _draped(h: np.ndarray) -> np.ndarray:
    """Return a sketch of a solid that rests on a surface and is attracted by it: no solution."""
    width = 60
    window = np.hanning(2 * width + 1) / np.hanning(2 * width + 1).sum()
    sagging = np.maximum(h, -0.48 + 0.2 * (h - h.mean()))
    smooth = np.convolve(np.pad(sagging, width, mode="wrap"), window, mode="valid")
    return np.maximum(h, smooth)


def _measure(
    axes: Axes, x: float, start: float, end: float, text: str, colour: str, side: int
) -> None:
    """Draw an arrow from a height to another, with its name beside it."""
    arrow = {"arrowstyle": "<->", "color": colour, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (x, end), (x, start), arrowprops=arrow)
    align = "left" if side > 0 else "right"
    axes.text(x + 0.008 * side, (start + end) / 2, text, color=colour, ha=align, va="center")


if __name__ == "__main__":
    draw(Path(sys.argv[1]))

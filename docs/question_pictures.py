"""The pictures of the pages in `questions/`, from the numbers of their recipes."""

import re
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import jaxstab as js
from jaxstab.plots.style import BLACK, BLUE, GREEN, ORANGE, VERMILION

PAGES = Path(__file__).parent / "questions"
FILES = Path(__file__).parents[1] / "tests" / "lab" / "force_curves"
# Of a force curve most is far from the contact [µm].
FARTHEST = 0.5
Names = dict[str, Any]


def recipe(page: str) -> Names:
    """Return the names that the first block of Python of a page defines."""
    block = re.search(r"^```python\n(.*?)^```", (PAGES / f"{page}.md").read_text(), re.M | re.S)
    assert block, page
    names: Names = {}
    # A recipe may read the file that its page offers.
    with chdir(FILES):
        exec(compile(block[1], f"<{page}>", "exec"), names)
    return names


def drawn(page: str) -> Figure:
    """Return the picture of a page."""
    names = recipe(page)
    number = PANELS.get(page, 1)
    # Small, so that letters can be read on a phone.
    size = (8, 3.4) if number == 2 else (5, 3.2)
    figure, panels = plt.subplots(1, number, figsize=size, layout="constrained")
    DRAWINGS[page](names, panels)
    return figure


def modulus(names: Names, axes: Axes) -> None:
    """Draw the forces of both directions, and the fitted curve."""
    curve, fit = names["curve"], names["fit"]
    tip = curve.retraction.height + fit.forces / curve.spring_constant
    for part, colour in ((curve.approach, BLUE), (curve.retraction, VERMILION)):
        near = part.tip_position < FARTHEST
        axes.plot(part.tip_position[near], part.force[near], ".", color=colour, markersize=2)
    near = tip < FARTHEST
    axes.plot(tip[near], fit.forces[near], color=BLACK, label="fit of the retraction")
    axes.plot([], [], ".", color=BLUE, label="approach")
    axes.plot([], [], ".", color=VERMILION, label="retraction")
    axes.axhline(0, color="0.7", linewidth=1, zorder=0)
    axes.set(xlabel="tip position [µm]", ylabel="force [nN]", xlim=(None, FARTHEST))
    axes.legend()


def sticky(names: Names, panels: list[Axes]) -> None:
    """Draw the loop with the pull-off, and the patches that remain before it."""
    curve, patches = panels
    path, contact, pull_off = names["path"], names["contact"], names["pull_off"]
    loads = np.asarray(path.load.value)
    pressures = np.asarray(path.equilibrium.mean_pressure) / 1e3
    turn = int(np.argmin(loads))
    curve.plot(1e6 * loads[: turn + 1], pressures[: turn + 1], color=BLUE, label="approach")
    curve.plot(1e6 * loads[turn:], pressures[turn:], color=VERMILION, label="retraction")
    level = float(pull_off.load.value) / 1e3
    gap = 1e6 * float(pull_off.equilibrium.mean_gap)
    curve.plot([gap], [level], "o", color=BLACK, label=f"pull-off {-level:.0f} kPa")
    curve.axhline(0, color="0.7", linewidth=1, zorder=0)
    curve.set(xlabel="mean gap [µm]", ylabel="mean pressure [kPa]", ylim=(1.3 * level, -level))
    curve.legend()
    js.plots.patches(contact, pull_off.equilibrium, axes=patches)
    patches.set_title("contact before the pull-off")


def seal(names: Names, panels: list[Axes]) -> None:
    """Draw the channels at one pressure, and the leak rate over the pressure."""
    channels, curve = panels
    state = names["states"][1]
    flow = js.leakage(names["contact"], state, names["viscosity"])
    js.plots.flow(names["contact"], flow, state, axes=channels)
    channels.set_title(f"{1e-6 * float(names['pressures'][1]):.1f} MPa, contact in grey")
    pressures = 1e-6 * np.asarray(names["pressures"])
    rates = np.array([float(rate) for rate in names["rates"]])
    curve.semilogy(pressures[rates > 0], rates[rates > 0], "o-", color=BLUE)
    first = pressures[rates == 0].min()
    curve.axvspan(first, pressures.max(), color=GREEN, alpha=0.2, label="tight")
    curve.set(xlabel="pressure of the seal [MPa]", ylabel="leak rate [mL/min]")
    curve.legend()


def wafers(names: Names, axes: Axes) -> None:
    """Draw the contact area over the adhesion parameter."""
    axes.semilogx(names["thetas"], names["areas"], "o-", color=BLUE)
    axes.axvspan(axes.get_xlim()[0], 1, color=GREEN, alpha=0.2, label="bonding")
    axes.axvspan(12, axes.get_xlim()[1], color=VERMILION, alpha=0.2, label="no bonding")
    axes.margins(x=0)
    axes.set(xlabel=r"$\theta$", ylabel="contact without load [%]")
    axes.legend()


def metals(names: Names, panels: list[Axes]) -> None:
    """Draw the contact at 1 N with its yielding points, and the resistance over the force."""
    contact, resistance, forces = names["contact"], names["resistance"], names["forces"]
    js.plots.contact_map(contact, names["states"][1], axes=panels[0])
    for states, colour, label in (("states", VERMILION, "yielding"), ("elastic", BLUE, "elastic")):
        found = [float(resistance(contact, state)) for state in names[states]]
        panels[1].loglog(forces, found, "o-", color=colour, label=label)
    panels[1].set_xticks(forces, [f"{force:g}" for force in forces])
    panels[1].minorticks_off()
    panels[1].set(xlabel="force [N]", ylabel="resistance [mΩ]")
    panels[1].legend()


def loop(names: Names, axes: Axes) -> None:
    """Draw the losses over the duration of the loop."""
    runs = names["runs"]
    durations = list(runs)
    material, jumps = (
        np.array([1e2 * float(getattr(run, name)[-1]) for run in runs.values()])
        for name in ("dissipated", "lost")
    )
    axes.semilogx(durations, material + jumps, "o-", color=BLACK, label="all")
    axes.semilogx(durations, jumps, "s--", color=VERMILION, label="in jumps")
    for (name, path), colour in zip(names["elastic"].items(), (BLUE, ORANGE), strict=True):
        loss = 1e2 * float(path.dissipation)
        axes.axhline(loss, color=colour, linestyle=":", label=f"jumps of the {name} solid")
    axes.set(xlabel="duration of the loop [s]", ylabel="loss [mJ/m²]", ylim=(0, 17))
    axes.legend()


def speed(names: Names, panels: list[Axes]) -> None:
    """Draw the tension over the gap at some speeds, and its maximum over the dwell time."""
    curves, dwell = panels
    runs = names["runs"]
    rested = [key for key in runs if key[0] == 100]
    for key, colour in zip(rested, (BLUE, ORANGE, VERMILION), strict=True):
        tension = -1e3 * np.asarray(runs[key].mean_pressure)
        curves.plot(runs[key].mean_gap, tension, color=colour, label=f"{key[1]:g} µm/s")
    curves.axhline(0, color="0.7", linewidth=1, zorder=0)
    curves.set(xlabel="mean gap [µm]", ylabel="tension [kPa]", title="held for 100 s")
    curves.legend()
    times = sorted(key[0] for key in runs if key[1] == 1)
    largest = [1e3 * float(runs[time, 1].largest_tension) for time in times]
    dwell.semilogx(times, largest, "o-", color=BLUE)
    dwell.set(xlabel="dwell time [s]", ylabel="largest tension [kPa]", title="pulled at 1 µm/s")


def pillars(names: Names, axes: Axes) -> None:
    """Draw the force of n caps beside the square root of n."""
    numbers = np.array(names["numbers"])
    forces = np.array([float(force) for force in names["forces"]])
    axes.loglog(numbers, forces / forces[0], "o", color=BLUE, label="computed")
    axes.loglog(numbers, np.sqrt(numbers), "--", color=BLACK, label=r"$\sqrt{n}$")
    axes.set(xlabel="n, caps on the area of one", ylabel="pull-off, over that of one")
    axes.set_xticks(numbers, [str(number) for number in numbers])
    axes.set_yticks([1, 2, 4, 8], ["1", "2", "4", "8"])
    axes.minorticks_off()
    axes.legend()


def humidity(names: Names, axes: Axes) -> None:
    """Draw the forces over the humidity."""
    percent = 100 * np.array(names["humidities"])
    for (name, forces), colour in zip(names["forces"].items(), (BLUE, VERMILION), strict=True):
        axes.plot(percent, forces, "o-", color=colour, label=name)
    exact = 4 * np.pi * 100 * 0.0727
    axes.axhline(exact, color=BLACK, linestyle="--", label=r"$4 \pi R \gamma$")
    axes.set(xlabel="relative humidity [%]", ylabel="pull-off [nN]", ylim=(0, 1.1 * exact))
    axes.legend()


def particles(names: Names, axes: Axes) -> None:
    """Draw the share of particles that a force removes, and forces to compare."""
    forces = 1e9 * np.asarray(names["forces"])
    weight = 1e9 * float(names["weight"])
    steps = np.concatenate([[weight / 3], forces, [3 * forces.max()]])
    shares = 100 * np.concatenate([[0], np.arange(1, len(forces) + 1), [len(forces)]]) / len(forces)
    axes.step(steps, shares, where="post", color=BLUE)
    for force, name, colour in (
        (weight, "weight", BLACK),
        (1000 * weight, "1000 g", ORANGE),
        (25.0, "largest charge", VERMILION),
    ):
        axes.axvline(force, color=colour, linestyle="--", label=name)
    axes.set(xscale="log", xlabel="force [nN]", ylabel="particles removed [%]")
    axes.legend(loc="center", bbox_to_anchor=(0.38, 0.5))


DRAWINGS: dict[str, Callable[[Names, Any], None]] = {
    "modulus": modulus,
    "sticky": sticky,
    "seal": seal,
    "wafers": wafers,
    "metals": metals,
    "loop": loop,
    "speed": speed,
    "pillars": pillars,
    "humidity": humidity,
    "particles": particles,
}
PANELS = {"sticky": 2, "seal": 2, "speed": 2, "metals": 2}

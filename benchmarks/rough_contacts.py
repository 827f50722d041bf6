"""Rough contacts of the literature, on surfaces of our own, as rows of the table of validation.

Stickiness (Pastewka & Robbins 2014; Persson & Tosatti 2001), several states at one load (Bugnicourt
and others 2018), the contact-mechanics challenge (Müser and others 2017), and the loop of a rough
sphere (Dalvi and others 2019; Sanner and others 2024).
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from rows import Row

import jaxstab as js

NONE = js.potentials.NoAdhesion()
# Files without a date, and with the same names in them at each run.
matplotlib.rcParams["svg.hashsalt"] = "jaxstab"

SLOPES = np.geomspace(0.05, 0.4, 8)
# Ranges and thresholds, both over the work of adhesion and E*.
RANGES = np.array([10.0, 15.0, 25.0, 40.0, 60.0])
WORK = 1e-4
# A contact is called sticky if its pull-off takes this part of the law's largest attraction.
STICKY = 0.01


def save(figure, folder: Path | None, name: str) -> None:
    if folder:
        folder.mkdir(exist_ok=True)
        figure.savefig(folder / f"{name}.svg", metadata={"Date": None}, bbox_inches="tight")
    plt.close(figure)


def stickiness(is_large: bool, figures: Path | None) -> Iterator[Row]:
    """Pull-offs over rms slope and range, beside two criteria."""
    grid = js.Grid(128)
    shape = js.surfaces.self_affine(grid, jax.random.key(0), k_high=16, rms_slope=1.0)
    solid = js.HalfSpace(grid, 1.0)
    stored = float(js.surfaces.full_contact_energy(solid, shape))
    curvature = float(js.surfaces.rms_curvature(grid, shape))

    def tension(slope: float, length: float) -> float:
        law = js.potentials.Exponential(WORK, length)
        off = js.pull_off(js.Contact(solid, slope * shape, law), throw=False)
        return -float(off.load.value) * length / WORK

    lengths = WORK * RANGES
    strength = np.array([[tension(slope, length) for length in lengths] for slope in SLOPES])
    slope, length = np.meshgrid(SLOPES, lengths, indexing="ij")
    # h'^2 / h'' of this surface is its slope over the curvature of unit slope.
    pastewka = slope * length / (2 * WORK) * (slope / (curvature * length)) ** (2 / 3)
    is_short = length < 1.6 * slope / (3 * curvature)
    persson = slope**2 * stored / WORK
    _draw_stickiness(figures, strength, pastewka, persson)
    criteria = [
        ("w above half of the full-contact energy", "Persson and Tosatti 2001", persson < 2, True),
        ("Pastewka and Robbins, all ranges", "Pastewka and Robbins 2014", pastewka < 1, True),
        ("the same, ranges for which it is meant", "the same", pastewka < 1, is_short),
    ]
    for name, source, says_sticky, counts in criteria:
        for threshold in (STICKY, 10 * STICKY):
            agrees = ((strength > threshold) == says_sticky) & counts
            number = int(np.sum(np.broadcast_to(counts, agrees.shape)))
            setting = f"stickiness, pull-off above {threshold:.0%} of the law's strength: {name}"
            yield Row(setting, source, f"{number} settings", f"agrees on {int(agrees.sum())}")


def _draw_stickiness(folder, strength, pastewka, persson):
    figure, axes = plt.subplots(figsize=(4.6, 3.6), layout="constrained")
    ranges, slopes = np.meshgrid(RANGES, SLOPES)
    colours = np.log10(strength)
    image = axes.scatter(ranges, slopes, c=colours, cmap="viridis", s=60, edgecolors="0.3")
    for line, style, name in [
        (pastewka, "--", "Pastewka and Robbins"),
        (persson / 2, "-", "w = half of the full-contact energy"),
    ]:
        axes.contour(ranges, slopes, line, [1.0], colors="black", linestyles=style)
        axes.plot([], [], f"k{style}", label=name)
    axes.set(xscale="log", yscale="log", xlabel="range of the law, rho E* / w", ylabel="rms slope")
    axes.set_xticks(RANGES, [f"{x:g}" for x in RANGES], minor=False)
    axes.set_yticks([0.05, 0.1, 0.2, 0.4], ["0.05", "0.1", "0.2", "0.4"], minor=False)
    axes.minorticks_off()
    axes.set(xlim=(8.5, 70), ylim=(0.043, 0.47))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize="small", frameon=False)
    figure.colorbar(image, ax=axes, label="log10 of pull-off over the law's strength")
    save(figure, folder, "stickiness")


def states(is_large: bool, figures: Path | None) -> Iterator[Row]:
    """The equilibria of one load that are found from three starts."""
    modulus, work, radius = 25e6, 5e-3, 60e-9
    large = (2048,) if is_large else ()
    settings = [(3.0, 4, (512, 1024, *large)), (3.0, 1, (512, 1024, *large)), (0.7, 4, (512, 1024))]
    for tabor, num_waves, sizes in settings:
        length = radius ** (1 / 3) * (work / modulus) ** (2 / 3) / tabor
        for size in sizes:
            grid = js.Grid(size, num_waves * 1e-6)
            waves = {"k_low": num_waves, "k_rolloff": num_waves, "k_high": 10 * num_waves}
            heights = js.surfaces.self_affine(grid, jax.random.key(0), **waves, rms_slope=1.0)
            solid, law = js.HalfSpace(grid, modulus), js.potentials.Exponential(work, length)
            contact = js.Contact(solid, heights, law)
            load = js.MeanGap(0.75 * js.surfaces.rms_height(heights))
            bare = js.equilibrate(js.Contact(solid, heights, NONE), load)
            starts = {"apart": None, "no adhesion": bare, "conformal": jnp.ones_like(heights)}
            found = {
                name: js.equilibrate(contact, load, initial=start) for name, start in starts.items()
            }
            resolution = f"{size}², resolution {float(contact.resolution):.2g}"
            where = f"Tabor {tabor:g}, cell of {num_waves} µm, {resolution}"
            yield from _compared(where, found)
            if size == 1024:
                yield _judged(where, contact, found)


def _compared(where: str, found: dict[str, js.results.Equilibrium]) -> Iterator[Row]:
    areas = {name: 100 * float(state.contact_area) for name, state in found.items()}
    energies = {name: float(state.energy) for name, state in found.items()}
    least = min(energies.values())
    is_theirs = "cell of 4" in where
    source = "Bugnicourt and others 2018" if is_theirs else ""
    published = "about 20 %" if is_theirs else "not published"
    numbers = ", ".join(f"{area:.2f} % from {name}" for name, area in areas.items())
    yield Row(f"states, {where}: contact", source, published, numbers)
    # Less than the solver's tolerance is none.
    above = {name: round(100 * (energy / least - 1), 8) for name, energy in energies.items()}
    numbers = ", ".join(f"{share:.2g} % from {name}" for name, share in above.items())
    yield Row(f"states, {where}: energy above the least", "", "not published", numbers)


def _judged(where: str, contact: js.Contact, found: dict[str, js.results.Equilibrium]) -> Row:
    verdicts = {
        name: js.assess_stability(contact, state).verdict.name for name, state in found.items()
    }
    ours = ", ".join(f"{verdict} from {name}" for name, verdict in verdicts.items())
    return Row(f"states, {where}: verdicts", "", "not published", ours)


def challenge(is_large: bool, figures: Path | None) -> Iterator[Row]:
    """The challenge's cell, spectrum, modulus and load, with a longer shortest wave."""
    side, modulus, pressure, work = 100e-6, 25e6, 250e3, 50e-3
    source = "Müser and others 2017"
    for size in (1024, 2048) if is_large else (1024,):
        grid = js.Grid(size, side)
        waves = size / 8
        heights = js.surfaces.self_affine(
            grid, jax.random.key(0), k_low=1, k_rolloff=5, k_high=waves, rms_slope=1.0
        )
        solid, load = js.HalfSpace(grid, modulus), js.MeanPressure(pressure)
        contact = js.Contact(solid, heights, NONE, unit="m")
        js.equilibrate(contact, load)
        begin = time.perf_counter()
        state = js.equilibrate(contact, load)
        seconds = time.perf_counter() - begin
        where = f"challenge, {size}², shortest wave {1e6 * side / waves:.2g} µm"
        slope = pressure / modulus
        area = js.patches(contact, state).true_area / contact.area
        bounds = (np.sqrt(8 / np.pi), np.sqrt(2 * np.pi))
        theory = "Persson 2001; Bush, Gibson and Thomas 1975"
        yield Row(f"{where}: area E* h' / force", theory, bounds, float(area) / slope)
        yield Row(f"{where}: contact", source, "not at hand", f"{100 * float(area):.3f} %")
        gap = f"{1e6 * float(state.mean_gap):.4g} µm"
        height = f"{1e6 * float(js.surfaces.rms_height(heights)):.3g} µm"
        yield Row(f"{where}: mean gap (rms height {height})", source, "not at hand", gap)
        yield Row(f"{where}: seconds", "", "", f"{seconds:.1f}")
        length = np.sqrt(4 * work / float(solid.max_stiffness))
        sticky = js.Contact(solid, heights, js.potentials.Exponential(work, length))
        held = js.equilibrate(sticky, load)
        adhesive = f"{100 * float(js.patches(sticky, held).true_area / contact.area):.3f} %"
        setting = f"{where}: contact with adhesion of a range of {1e9 * length:.3g} nm"
        yield Row(setting, source, "not at hand (2.07 nm)", adhesive)
    _draw_challenge(figures, contact, state)


def _draw_challenge(folder, contact, state):
    figure, panels = plt.subplots(1, 2, figsize=(7.5, 3.2), layout="constrained")
    for axes, quantity in zip(panels, ("pressure", "gap"), strict=True):
        js.plots.distribution(contact, state, quantity, axes=axes)
        axes.set_ylim(top=1.3 * axes.get_ylim()[1])
        axes.legend(loc="upper right", fontsize="small")
    save(figure, folder, "challenge")


def spheres(is_large: bool, figures: Path | None) -> Iterator[Row]:
    """Loops of a rough sphere, in JKR's units a0 = d0 = 1 for R = E* = 1."""
    size, slope, work, where = 96 if is_large else 54, 1.8, 4 / (3 * np.pi), np.linspace(0, 0.9, 10)
    grid = js.Grid(size, 4.6)
    solid, sphere = js.FreeHalfSpace(grid, 1.0), js.surfaces.paraboloid(grid, 1.0)
    rough = js.surfaces.self_affine(grid, jax.random.key(0), k_low=3, k_high=7, rms_slope=slope)
    length = np.sqrt(4.1 * work / float(solid.max_stiffness))
    found, loops = [], []
    # Effects that are odd in the roughness cancel in the mean over both signs.
    for sign in (0, 1, -1):
        contact = js.Contact(solid, sphere + sign * rough, js.potentials.Exponential(work, length))
        path = js.follow(contact, js.FarDisplacement(jnp.array([2.0, -1.0, 2.0])))
        approach, force = -np.asarray(path.load.value), np.asarray(path.equilibrium.force)
        turn = int(np.argmax(approach))
        ways = slice(None, turn + 1), slice(None, turn, -1)
        found.append([_jkr_adhesion(where, approach[way], force[way]) for way in ways])
        loops.append((np.trapezoid(force, approach), float(path.dissipation)))
    (area, losses), energy = (
        loops[1],
        js.surfaces.full_contact_energy(js.HalfSpace(grid, 1.0), rough),
    )
    way_in, way_out = (np.array(found[1]) + found[2]) / 2 / found[0]
    name = f"rough sphere, {size}², range {length:.2g} and rms slope {slope} in JKR's units"
    yield Row(f"{name}: loss in jumps", "the area of the loop", float(area), losses)
    theory = "Persson and Tosatti 2001; Dalvi and others 2019"
    kept = 1 - float(energy) / work
    yield Row(
        f"{name}: work of adhesion on the way in over a smooth sphere's", theory, kept, way_in
    )
    split = f"{way_out - way_in:+.3f}"
    source = "Sanner and others 2024"
    yield Row(f"{name}: the same, way out less way in", source, "positive, range of zero", split)


def _jkr_adhesion(where, approach, force):
    """Return the mean work of adhesion over w, from approaches and forces alone (JKR)."""
    found = []
    for d, f in zip(where, np.interp(where, approach, force) * 3 / 4, strict=True):
        roots = np.roots([1.0, 0.0, -3 * d, 2 * f])
        a = roots[np.abs(roots.imag) < 1e-9].real.max()
        found.append((a**3 - f) ** 2 / (6 * a**3))
    return np.mean(found)


ROUGH: list[Callable[[bool, Path | None], Iterator[Row]]] = [
    stickiness,
    states,
    challenge,
    spheres,
]

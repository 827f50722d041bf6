"""Viscoelastic contacts in time against published solutions, theorems and another package.

Each row has the number measured, the reference, the deviation with the largest allowed, and PASS or
FAIL. References are computed from sources outside of this package. `--quick` takes smaller grids
and leaves out the longest rows; `--only NAME` runs the rows of one name, `--cost` those of seconds.
"""

import argparse
import os
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

os.environ |= {"OMP_NUM_THREADS": "1"}

import jax
import jax.numpy as jnp
import numpy as np
from closed_forms import wave

import jaxstab as js
from jaxstab.references import persson_brener

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", UserWarning)

NONE = js.potentials.NoAdhesion()
RATIOS, TIMES = (2.0, 1.0), (0.1, 1.0)
HEAD = """| setting | reference | measured | expected | deviation | allowed | | s |
|---|---|---|---|---|---|---|---|"""
# A tolerance that no step misses: a step for each of the given times.
ANY = 1e9


class Row(NamedTuple):
    """A setting and its source, two numbers, and how far they may be apart over the expected one.

    A pair of bounds stands for any number between them; without `allowed` nothing else is judged.
    """

    setting: str
    source: str
    measured: float
    expected: float | tuple[float, float] = np.nan
    allowed: float | None = None

    def text(self, seconds: float) -> str:
        expected, measured, allowed = self.expected, self.measured, self.allowed
        if isinstance(expected, tuple):
            shown, allowed = f"{expected[0]:.5g} to {expected[1]:.5g}", 0.0
            deviation = max(expected[0] - measured, measured - expected[1], 0.0)
        else:
            shown, deviation = f"{expected:.6g}", abs(measured - expected) / (abs(expected) or 1.0)
        verdict = "PASS" if deviation <= (allowed or 0.0) else "FAIL"
        judged = " | " if allowed is None else f"{allowed:g} | {verdict}"
        numbers = f"{measured:.6g} | {shown} | {deviation:.2g} | {judged}".replace("nan", "")
        return f"| {self.setting} | {self.source} | {numbers} | {seconds:.1f} |"


def relaxation(times):
    """Return E(t) over the relaxed modulus."""
    return 1 + np.exp(-np.divide.outer(times, TIMES)) @ RATIOS


def lee_radok(is_quick: bool) -> Iterator[Row]:
    """A growing contact of a sphere without adhesion: F = 4 / (3 R) int E*(t - s) d(a^3)."""
    times = np.linspace(0, 2, 33)
    histories = {
        "ramp": 0.05 * times,
        "slowing": 0.07 * np.sqrt(times),
        "ramp and hold": 0.1 * np.minimum(2 * times, 1),
    }
    for size in (64, 128) if is_quick else (128, 256):
        grid = js.Grid(size)
        solid = js.Viscoelastic(js.FreeHalfSpace(grid, 1.0), RATIOS, TIMES)
        contact = js.Contact(solid, js.surfaces.paraboloid(grid, 1.0), NONE)
        top = float(jnp.max(contact.heights))
        for name, depth in histories.items():
            load = js.FarDisplacement(jnp.array(top - depth))
            found = js.evolve(contact, load, jnp.array(times), rtol=ANY)
            # The same history, linear between the times.
            s = np.linspace(0, 2, 64_001)
            cubes = np.diff(np.interp(s, times, depth) ** 1.5)
            force = 4 / 3 * float(relaxation(2 - (s[1:] + s[:-1]) / 2) @ cubes)
            allowed = {64: 0.02, 128: 0.01, 256: 0.003}[size]
            yield Row(
                f"sphere, {name}, {size}²", "Lee & Radok", float(found.force[-1]), force, allowed
            )


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """Return a result and its seconds, the second time, when all is compiled."""
    call()
    began = time.perf_counter()
    return jax.block_until_ready(call()), time.perf_counter() - began


def rough(size: int, seed: int, law=NONE, k_high: int = 8):
    grid = js.Grid(size)
    key = jax.random.key(seed)
    heights = js.surfaces.self_affine(grid, key, k_low=2, k_high=k_high, rms_height=0.02)
    return js.Contact(js.Viscoelastic(js.HalfSpace(grid, 1.0), RATIOS, TIMES), heights, law)


def tamaas(is_quick: bool) -> Iterator[Row]:
    """A rough surface under a pressure that rises and falls, in backward Euler steps of Tamaas.

    Pressures are given to Tamaas in a unit in which the relaxed shear modulus is one. In others the
    memory of version 2.9 is not that of the moduli: in full contact at a held displacement they
    fall to (1 + r) / (1 + 2 r) where E = 1. A row checks the relaxation in this unit.
    """
    try:
        import tamaas as tm
    except ImportError:
        return
    tm.set_log_level(tm.LogLevel.error)
    size, end = 32 if is_quick else 128, 2.0
    peer = f"Tamaas {version('tamaas')}"

    def solver(heights, dt: float):
        model = tm.Model(tm.model_type.basic_2d, [1.0, 1.0], [size, size])
        model.E, model.nu = 2.0, 0.0
        return model, tm.MaxwellViscoelastic(model, heights, 1e-10, dt, [*RATIOS], [*TIMES])

    grid = js.Grid(size)
    ripple = 1e-3 * np.cos(2 * np.pi * np.asarray(grid.coordinates[0])) * np.ones((size, size))
    model, full = solver(ripple.copy(), 1e-3)
    for _ in range(1000):
        full.solve(0.1)
    relaxing = np.mean(np.asarray(model.traction).reshape(size, size) * ripple) / np.pi / 1e-6
    expected = float(relaxation(1.0))
    yield Row("full contact after t = 1: E(t) of Tamaas", "the series", relaxing, expected, 2e-3)
    contact = rough(size, 0)
    for steps in (50, 200):
        times = np.linspace(0, end, steps + 1)
        pressures = 0.01 + 0.02 * np.sin(np.pi * times / 3)
        pressures[0] = 1e-6
        load = js.MeanPressure(jnp.array(pressures))
        call = partial(js.evolve, contact, load, jnp.array(times), rtol=ANY, max_steps=steps)
        ours, seconds = timed(call)
        model, theirs = solver(np.array(contact.heights), end / steps)
        began = time.perf_counter()
        for pressure in pressures[1:]:
            theirs.solve(2 * float(pressure))
        others = time.perf_counter() - began
        traction = np.asarray(model.traction).reshape(size, size) / 2
        pressure = np.array(ours.instant[1].pressure)
        rms = np.sqrt(np.mean((traction - pressure) ** 2) / np.mean(pressure**2))
        where = f"rough, {size}², {steps} steps"
        allowed = 1e-3 if steps == 200 else None
        area = float(ours.contact_area[-1])
        yield Row(f"{where}: area", peer, area, float(np.mean(traction > 0)), allowed)
        yield Row(f"{where}: rms difference of pressures", peer, float(rms), 0.0, allowed)
        yield Row(f"{where}: seconds, and theirs", peer, seconds, others)


def areas(is_quick: bool) -> Iterator[Row]:
    """Without adhesion the area of contact never falls under a constant load (2511.19402)."""
    times = jnp.concatenate([jnp.zeros(1), jnp.geomspace(1e-3, 30, 40)])
    number = 4 if is_quick else 20
    sticky = js.potentials.Exponential(2e-4, 0.01)
    for law, name in ((NONE, "without adhesion"), (sticky, "with adhesion")):
        for start, word in ((0.01, "loaded"), (0.06, "partly unloaded")):
            fallen, counted = 0, 0
            for seed in range(number):
                contact = rough(64, seed, law)
                relaxed = js.Contact(contact.solid.relaxed, contact.heights, law)
                initial = js.equilibrate(relaxed, js.MeanPressure(start))
                held = js.MeanPressure(jnp.full(times.size, 0.03))
                found = js.evolve(contact, held, times, initial=initial)
                changes = np.diff(np.array(found.contact_area[1:]))
                fallen, counted = fallen + np.sum(changes < 0), counted + changes.size
            judged = 0.0 if law is NONE else None
            setting = f"{number} surfaces, {name}, {word}: falls of the area in {counted} times"
            yield Row(setting, "arXiv 2511.19402", float(fallen), 0.0, judged)


def strip(size: int, per_point: float, thickness: float, ratio: float, speeds: tuple[float, float]):
    """Return speeds of a crack along a layer, and the energies per area that drive it.

    The base of a bonded layer is pulled slowly away, and two cracks run into the contact. Ahead of
    them the energy per area is E u^2 / (2 h), whatever happens at their tips. Lengths are given in
    tip radii, speeds in tip radii over the relaxation time.
    """
    tip = per_point / size
    work, thickness = 1e-4, thickness * tip
    law = js.potentials.Exponential(work, np.sqrt(np.pi * tip * work))
    grid = js.Grid((size,))
    solid = js.Viscoelastic(js.Layer(grid, 1.0, 0.0, thickness), ratio, 1.0)
    contact = js.Contact(solid, jnp.zeros(size), law)
    relaxed = js.Contact(solid.relaxed, contact.heights, law)
    pulled, opened = np.sqrt(2 * thickness * work), 3 * thickness
    is_open = np.abs(np.asarray(grid.coordinates[0]) - 0.5) > (1 - opened) / 2
    begin = jnp.where(is_open, pulled, 0.0)
    start = js.equilibrate(relaxed, js.MeanGap(opened * pulled), initial=begin)
    # The tip radius of a slow crack, by its dissipation to first order in the speed: that of
    # the elastic shape, v r t int u' K u' dx, is w0 (w / w0 - 1) = pi r t v w0 / a0.
    q = 2 * np.pi * np.fft.rfftfreq(size, 1 / size)
    slope = np.fft.irfft(1j * q * np.fft.rfft(np.array(start.gap)), size)
    slow = np.pi * work / float(np.mean(slope * np.array(relaxed.solid.apply(slope))) / 2)
    far = float(jnp.mean(start.gap) - start.mean_pressure * thickness)
    way = np.linspace(0, (1 - opened) / 2 - thickness, 601)
    planned = tip * speeds[0] * (speeds[1] / speeds[0]) ** (way / way[-1])
    works = persson_brener.work(planned, [ratio], [1.0], slow)
    times = np.cumsum(np.diff(way) / np.sqrt(planned[1:] * planned[:-1]))
    times = np.concatenate([[0.0, 10.0], 10 + times])
    values = np.concatenate([[far], np.sqrt(2 * thickness * work * works)])
    load, room = js.FarDisplacement(jnp.array(values)), {"fields": True, "max_steps": 20_000}
    found = js.evolve(contact, load, jnp.array(times), initial=start, **room)
    half = np.array(found.fields.gap)[:, : size // 2]
    place = np.argmax(half < law.length, axis=1)
    above, below = (half[np.arange(half.shape[0]), place - i] for i in (1, 0))
    edges = (place - 1 + (above - law.length) / (above - below)) / size
    # Until the two cracks are near each other.
    near, last = 10, np.argmax(edges > 0.5 - thickness / 4)
    chosen = np.linspace(24, (last or times.size) - near - 1, 15).astype(int)
    ahead, behind = chosen + near, chosen - near
    measured = (edges[ahead] - edges[behind]) / (times[ahead] - times[behind])
    return measured, values[chosen] ** 2 / (2 * thickness * work), slow


def crack(is_quick: bool) -> Iterator[Row]:
    """The effective work of adhesion of a standard linear solid over the speed of the edge."""
    ratio = 4.0
    setting = (2048, 2, 100, ratio, (0.05, 3)) if is_quick else (8192, 1, 800, ratio, (0.05, 2500))
    speeds, works, slow = strip(*setting)
    for speed, found in zip(speeds, works, strict=True):
        expected = float(persson_brener.work(speed, [ratio], [1.0], slow))
        where = f"crack at {speed / slow:.3g} a0 / t: w / w0"
        yield Row(where, "Persson & Brener", found, expected, 0.15)
    if not is_quick:
        yield Row("decades of speed", "", np.log10(speeds[-1] / speeds[0]), (3.0, 9.0))
        yield Row("largest w / w0", "E_glassy / E_relaxed", float(works[-1]), 1 + ratio, 0.1)


def retractions(shape: str, law, ratio: float, size: int, lift: float, speeds) -> tuple[Any, list]:
    """Return the relaxed state of a shape under no load, and its retractions at several speeds."""
    grid = js.Grid((size,))
    x = np.asarray(grid.coordinates[0]) - 0.5
    heights = -(x**2) / 2 if shape == "cylinder" else np.where(np.abs(x) < 0.125, 0.0, -0.05)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), ratio, 1.0)
    contact = js.Contact(solid, jnp.array(heights), law)
    relaxed = js.Contact(solid.relaxed, contact.heights, law)
    initial = js.equilibrate(relaxed, js.MeanPressure(0.0))
    begin = float(jnp.mean(initial.displacement))
    load = js.MeanDisplacement(begin + jnp.linspace(0, lift, 201))
    return initial, [
        js.evolve(
            contact, load, jnp.linspace(0, lift / speed, 201), initial=initial, max_steps=20_000
        )
        for speed in speeds
    ]


def cylinder(is_quick: bool) -> Iterator[Row]:
    """A cylinder is pulled from rest: its work has a maximum, its tension rises (2108.02031)."""
    size = 512 if is_quick else 2048
    law = js.potentials.Exponential(1e-4, 2.5e-2 / np.sqrt(size))
    speeds = np.geomspace(1e-7, 1e1, 5 if is_quick else 9)
    _, runs = retractions("cylinder", law, 9.0, size, 0.04, speeds)
    tensions = np.array([float(run.largest_tension) for run in runs])
    works = np.array([float(run.work[-1]) for run in runs])
    falls, source = max(-np.diff(tensions).min(), 0.0) / tensions.max(), "arXiv 2108.02031"
    yield Row("cylinder: largest fall of the tension with speed", source, falls, (0.0, 1e-3))
    peak = works.max() / max(works[0], works[-1])
    yield Row("cylinder: largest work over that of both ends", source, peak, (1.05, np.inf))
    slow = 3 * (np.pi * 1e-8 / 16) ** (1 / 3)
    margin = 0.1 if is_quick else 0.04
    yield Row("cylinder: tension of a slow pull", "JKR, line contact", tensions[0], slow, margin)


def bell(is_quick: bool) -> Iterator[Row]:
    """Loops of loading and unloading at one speed: bell-shaped between two elastic ones."""
    size = 256 if is_quick else 1024
    elastic, _ = wave(0.3, size, 9.0)
    solid = js.Viscoelastic(elastic.solid, 4.0, 1.0)
    contact = js.Contact(solid, elastic.heights, elastic.potential)
    gaps = np.concatenate([np.linspace(1.6, 0.6, 101), np.linspace(0.6, 1.6, 101)[1:]]) * 0.05
    load = js.MeanGap(jnp.array(gaps))
    speeds = np.geomspace(1e-6, 1e4, 6 if is_quick else 11)
    losses = []
    for speed in speeds:
        times = jnp.linspace(0, 2 / speed, gaps.size)
        losses.append(float(js.evolve(contact, load, times, max_steps=20_000).work[-1]))
    losses = np.array(losses)
    source = "arXiv 2107.03796"
    peak = losses.max() / max(losses[0], losses[-1])
    yield Row("loop: largest loss over that of both ends", source, peak, (1.2, np.inf))
    turns = np.count_nonzero(np.diff(np.diff(losses) > 0))
    yield Row("loop: changes from rising to falling loss", source, turns, (1, 1))
    for name, solid, loss in (
        ("slow", contact.solid.relaxed, losses[0]),
        ("fast", contact.solid.glassy, losses[-1]),
    ):
        elastic = js.Contact(solid, contact.heights, contact.potential)
        path = js.follow(elastic, js.MeanGap(jnp.array([gaps[0], gaps[100], gaps[0]])))
        least, most = (float(path.work / losses.max()) + part for part in (-0.005, 0.005))
        setting = f"loop: loss over the largest, {name}"
        yield Row(setting, "the elastic path", loss / losses.max(), (least, most))


def punch(is_quick: bool) -> Iterator[Row]:
    """A flat punch: between Kendall's pull-offs of both moduli, below the law's strength."""
    size = 512 if is_quick else 2048
    work, ratio = 1e-4, 3.0
    length = 2.5e-2 / np.sqrt(size)
    law = js.potentials.Exponential(work, length)
    speeds = np.geomspace(1e-6, 1e2, 5 if is_quick else 9)
    initial, runs = retractions("punch", law, ratio, size, 0.03, speeds)
    tensions = [float(run.largest_tension) for run in runs]
    # Half of the width: punches side by side, p = sqrt(2 E* w tan(pi a / L) / L).
    share = float(initial.contact_area)
    low, high = (
        np.sqrt(2 * modulus * work * np.tan(np.pi * share / 2)) for modulus in (1, 1 + ratio)
    )
    margin = 0.12 if is_quick else 0.05
    for speed, tension in zip(speeds, tensions, strict=True):
        # The range of the law takes something off both.
        bounds = (1 - margin) * low, min(high, share * work / length)
        yield Row(f"punch, speed {speed:.0e}: tension", "Kendall", tension, bounds)
    yield Row("punch: tension of a slow pull", "Kendall, relaxed", tensions[0], low, margin)
    yield Row("punch: tension of a fast pull", "Kendall, glassy", tensions[-1], high, 4 * margin)


def gel(is_quick: bool) -> Iterator[Row]:
    """JKR with surface tension: pull-off between (3 / 2) pi w R and pi w R (1409.7360).

    Around a contact of radius a the surface under tension s rises at the angle sqrt(2 w / s), so
    that the pull is 2 pi a s (angle - a / R), pi w R at most; in a cell of side L it is that over
    1 - pi a^2 / L^2, since the load acts on the contact too.
    """
    size, allowed = (128, 0.06) if is_quick else (256, 0.03)
    a, angle = np.linspace(0, 0.4, 4000), 0.2
    pulls = 2 * np.pi * a * (angle - a / 2) / (1 - np.pi * a**2)
    in_cell = float(pulls.max() / (np.pi * angle**2))
    reach = 1.22e-2 * np.sqrt(6 / size)

    def short(gap):
        # Without a tail, which raises the pull-off by half as much again.
        return -1e-4 * jnp.maximum(1 - gap / reach, 0) ** 3

    long = js.potentials.Exponential(angle**2 / 2, 0.15 / size)
    for name, side, radius, modulus, tension, law, expected in (
        ("elastic", 0.5, 1.0, 1.0, 1e-6, short, 1.5),
        ("surface tension", 1.0, 2.0, 1e-3, 1.0, long, in_cell),
    ):
        grid = js.Grid(size, side)
        solid = js.SurfaceTension(js.HalfSpace(grid, modulus), tension)
        pull = js.pull_off(js.Contact(solid, js.surfaces.paraboloid(grid, radius), law))
        force = float(pull.load.value * grid.area / law(0.0)) / (np.pi * radius)
        setting = f"sphere, {name}, {size}²: pull-off over pi w R"
        yield Row(setting, "JKR, Young & Dupré", force, expected, allowed)


def cost(is_quick: bool) -> Iterator[Row]:
    """Seconds of a step over those of a warm-started equilibrium of the relaxed solid."""
    size = 128 if is_quick else 256
    contact = rough(size, 0, js.potentials.Exponential(2e-4, 0.01), k_high=32)
    relaxed = js.Contact(contact.solid.relaxed, contact.heights, contact.potential)
    number = 50 if is_quick else 500
    times = jnp.linspace(0, 2, number + 1)
    load = js.MeanPressure(0.02 + 0.01 * jnp.sin(3 * times))
    _, seconds = timed(partial(js.evolve, contact, load, times, rtol=ANY, max_steps=number))
    warm = []
    for i in range(10, number, max(number // 25, 1)):
        before = js.equilibrate(relaxed, load[i - 1])
        warm.append(timed(partial(js.equilibrate, relaxed, load[i], initial=before))[1])
    ratio = seconds / number / np.mean(warm)
    yield Row(f"a step over a warm equilibrium, {size}²", "at most 1.3", ratio, (0.0, 1.3))
    yield Row(f"{number} steps, {size}²: seconds", "", seconds)


ROWS = lee_radok, tamaas, areas, crack, cylinder, bell, punch, gel


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="smaller grids")
    parser.add_argument("--only", choices=[rows.__name__ for rows in ROWS])
    parser.add_argument("--cost", action="store_true", help="seconds alone, on an idle machine")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines = [HEAD]
    print(HEAD, flush=True)
    chosen = [rows for rows in ROWS if options.only in (None, rows.__name__)]
    for rows in [cost] if options.cost else chosen:
        began = time.perf_counter()
        for row in rows(options.quick):
            lines.append(row.text(time.perf_counter() - began))
            print(lines[-1], flush=True)
            began = time.perf_counter()
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

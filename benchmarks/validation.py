"""Published numbers and closed forms beside ours: one table.

Each row computes a number by the public interface and compares it with one that a source gives.
`--quick` leaves out all that takes more than a few seconds, `--large` adds grids of 2048² points.
`--challenge FILE` runs the contact-mechanics challenge alone, on a file of its surface.
"""

import argparse
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from challenge import challenge_rows
from closed_forms import state_at, wave
from rough_contacts import ROUGH
from rows import HEAD, Row

import jaxstab as js
from jaxstab.references import guduru, hertz, jkr, johnson, maugis, westergaard

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", UserWarning)

NONE = js.potentials.NoAdhesion()


def paraboloid(size, force=0.018, radius=2.0):
    """Return a paraboloid pressed on a free half space, and its equilibrium."""
    grid = js.Grid(size)
    x, y = grid.coordinates
    heights = -((x - 0.5) ** 2 + (y - 0.5) ** 2) / (2 * radius)
    contact = js.Contact(js.FreeHalfSpace(grid, 1.0), heights, NONE)
    return contact, js.equilibrate(contact, js.MeanPressure(force))


def discs(is_quick: bool) -> Iterator[Row]:
    for size in (64, 128) if is_quick else (64, 128, 256):
        contact, state = paraboloid(size)
        radius = hertz.contact_radius(0.018, 2.0, 1.0)
        found = js.conductance(contact, state, (1.0, 2.0))
        where = f"{size}²"
        stiffness, current = float(found.incremental_stiffness), float(found.conductance)
        yield Row(f"disc: stiffness K, {where}", "2 E* a", 2 * radius, stiffness)
        yield Row(
            f"disc: conductance, {where}", "Holm: 4 a / (rho1 + rho2)", 4 * radius / 3, current
        )
        patches, area = js.patches(contact, state), np.pi * radius**2
        yield Row(f"sphere: area as counted, {where}", "Hertz", area, float(patches.area))
        yield Row(f"sphere: corrected area, {where}", "Hertz", area, float(patches.true_area))
        peak = hertz.peak_pressure(0.018, 2.0, 1.0)
        yield Row(f"sphere: peak pressure, {where}", "Hertz", peak, float(state.pressure.max()))


def waves(is_quick: bool) -> Iterator[Row]:
    for size in (256, 1024):
        grid = js.Grid((size,))
        heights = 0.05 * jnp.cos(2 * jnp.pi * grid.coordinates[0])
        contact = js.Contact(js.HalfSpace(grid, 1.0), heights, NONE)
        pressure = 0.4 * westergaard.full_contact_pressure(0.05, 1.0, 1.0)
        state = js.equilibrate(contact, js.MeanPressure(pressure))
        share = westergaard.contact_fraction(pressure, 0.05, 1.0, 1.0)
        where = f"wave, {size} points"
        yield Row(f"{where}: contact fraction", "Westergaard", share, float(state.contact_area))
        strips = np.pi / (2 * np.log(1 / np.sin(np.pi * share / 2)))
        found = js.conductance(contact, state, (0.5, 0.5))
        source = "Westergaard: pi / ln(1 / sin)"
        yield Row(f"{where}: conductance", source, 2 * strips, float(found.conductance))


def flows(is_quick: bool) -> Iterator[Row]:
    grid = js.Grid(128)
    gap = 1 - 0.9 * jnp.cos(2 * jnp.pi * grid.coordinates[0])
    # Nothing touches or attracts, so that the solid stays flat.
    contact = js.Contact(js.HalfSpace(grid, 1.0), -gap, NONE)
    state = js.equilibrate(contact, js.MeanGap(1.0), initial=gap)
    across, along = np.diag(js.leakage(contact, state).permeability)
    given = np.asarray(gap)
    yield Row("leakage across a wave", "1 / (12 <g^-3>)", 1 / np.mean(12 / given**3), float(across))
    yield Row("leakage along a wave", "<g^3> / 12", np.mean(given**3) / 12, float(along))


def plates(is_quick: bool) -> Iterator[Row]:
    grid, (voltage, permittivity, stiffness, dielectric) = js.Grid(8), (0.3, 0.8, 0.5, 0.05)
    law = js.potentials.Electrostatic(voltage, permittivity, dielectric)
    contact = js.Contact(js.HalfSpace(grid, 10.0), jnp.zeros(grid.shape), law)
    distance = (27 * permittivity * voltage**2 / (8 * stiffness)) ** (1 / 3)
    spring = js.Spring(distance - dielectric + jnp.array([0.1, -0.05]), stiffness)
    found = js.critical_load(contact, spring, initial=jnp.full(grid.shape, distance))
    ours = float(found.load.value) + dielectric
    source = "(27 eps V² / 8 k)^(1/3)"
    yield Row("plates on a spring: distance at pull-in", source, distance, ours)
    gap = float(found.equilibrium.gap.min()) + dielectric
    yield Row("plates on a spring: gap there", "2 d / 3", 2 / 3 * distance, gap)


def layers(is_quick: bool) -> Iterator[Row]:
    grid, thickness, modulus = js.Grid((4096,), (300.0,)), 1.0, 3.0
    law = js.potentials.Exponential(0.1, 1.0)
    layer = js.Layer(grid, modulus, 0.5, thickness)
    contact = js.Contact(layer, jnp.zeros(grid.shape), law)
    state = js.equilibrate(contact, js.MeanGap(0.5))
    lowest = js.assess_stability(contact, state).lower_bound
    softening = float(contact.curvature(state.gap)[0])
    needed = (float(lowest.eigenvalue) - softening) * thickness / (modulus / 3)
    yield Row(
        "bonded layer, nu = 0.5: curvature of the law at the end, over mu / h", "6.22", 6.22, needed
    )
    waves = np.argmax(np.abs(np.fft.rfft(np.asarray(lowest.mode))))
    source = "2.96; experiments about 3 (PRL 97, 018303)"
    yield Row("bonded layer: its wavelength over h", source, 2.96, 300 / waves)


def pull_offs(is_quick: bool) -> Iterator[Row]:
    for alpha in (0.3, 0.5):
        contact, problem = wave(alpha, 1024, 9.0)
        off = johnson.pull_off(*problem)
        begin = state_at(contact, problem, float(off.contact_fraction) + 0.2)
        ours = float(js.pull_off(contact, initial=begin).load.value)
        setting = f"adhesive wave, alpha = {alpha}: pull-off pressure"
        yield Row(setting, "Johnson 1995", float(off.mean_pressure), ours)
    if is_quick:
        return
    contact, sphere, unit = dugdale_sphere(js.HalfSpace, 256, 12, 1.0, 0.05)
    force = float(js.pull_off(contact).load.value * contact.area / unit.force)
    exact = float(maugis.pull_off(*sphere).force / unit.force)
    yield Row("sphere, lambda = 1: pull-off over pi w R, 256²", "Maugis 1992", exact, force)


def dugdale_sphere(
    solid: type, size: int, width: float, parameter: float, smoothing: float
) -> tuple[js.Contact, tuple[float, ...], jkr.Scales]:
    """Return a sphere on a cell so many JKR radii wide, and the terms and units of its theory."""
    work = 1e-4
    unit = jkr.units(1.0, 1.0, work)
    strength = parameter / float(maugis.transition_parameter(1.0, 1.0, work, 1.0))
    grid = js.Grid(size, width * float(unit.contact_radius))
    law = js.potentials.Dugdale(work, work / strength, smoothing)
    contact = js.Contact(solid(grid, 1.0), js.surfaces.paraboloid(grid, 1.0), law)
    return contact, (1.0, 1.0, work, strength), unit


def barriers(is_quick: bool) -> Iterator[Row]:
    """Barriers, beside integrals of force and pressure along the curves of theories."""
    if is_quick:
        return
    grid, height, alpha = js.Grid((512,)), 0.02, 0.3
    problem = height, 1.0, 1.0, (alpha * np.pi * height) ** 2 / 2
    heights = height * jnp.cos(2 * jnp.pi * grid.coordinates[0])
    law = js.potentials.Dugdale(problem[3], 0.1 * height)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, law)
    curve = johnson.curve(np.linspace(0.02, 0.9995, 20_000), *problem)
    pressure, gap = curve.mean_pressure, curve.mean_gap
    # Halfway between the least pressure and the greatest, where the curve turns unstable.
    last = np.argmax(pressure)
    least = np.argmin(pressure[:last])
    held = (pressure[least] + pressure[last]) / 2
    between = slice(
        least + np.argmax(pressure[least:] > held), last + np.argmax(pressure[last:] < held)
    )
    exact = -np.trapezoid(pressure[between] - held, gap[between])
    before = js.equilibrate(contact, js.MeanGap(1.3 * float(gap[last])))
    load = js.MeanPressure(held)
    start = js.equilibrate(contact, load, initial=before)
    found = js.transition(contact, load, start, jnp.zeros_like(heights), num_images=32)
    yield Row(
        "adhesive wave, alpha = 0.3: barrier to full contact",
        "Johnson 1995",
        exact,
        float(found.barrier.there),
    )
    yield from sphere_barriers()


def sphere_barriers() -> Iterator[Row]:
    contact, sphere, unit = dugdale_sphere(js.FreeHalfSpace, 128, 4, 2.0, 0.1)
    touch = float(maugis.first_touch(*sphere).outer_radius)
    radius = float(unit.contact_radius)
    parts = [
        maugis.without_contact(np.linspace(1e-4, 1, 4000) * touch, *sphere),
        maugis.curve(np.linspace(1e-4, 1.3, 8000) * radius, *sphere),
    ]
    displacement = np.concatenate([part.displacement for part in parts])
    force = np.concatenate([part.force for part in parts])
    energy = np.append(0, np.cumsum((force[1:] + force[:-1]) / 2 * np.diff(displacement)))
    held = -0.85 * float(unit.displacement)
    unstable, stable = np.flatnonzero(np.diff(np.sign(displacement - held)))
    ends = (js.equilibrate(contact, js.FarDisplacement(far)) for far in (-1.7 * held, 0.0))
    load = js.FarDisplacement(-held)
    apart, closed = (js.equilibrate(contact, load, initial=end) for end in ends)
    found = js.transition(contact, load, apart, closed)
    scale = float(unit.force * unit.displacement)
    setting = "sphere, lambda = 2, held at -0.85 of JKR's displacement"
    for name, exact, ours in (
        ("barrier to contact", energy[unstable], found.barrier.there),
        ("barrier to detachment", energy[unstable] - energy[stable], found.barrier.back),
    ):
        yield Row(f"{setting}: {name}", "Maugis 1992", exact / scale, float(ours) / scale)


def wavy_spheres(is_quick: bool) -> Iterator[Row]:
    """A sphere with concentric waves, in contact up to a radius, pulled off under a dead load."""
    work, sharpness, wavelengths, width = 1e-4, 2.0, 0.7, 6.0
    unit = jkr.units(1.0, 1.0, work)
    length = wavelengths * float(unit.contact_radius)
    amplitude = np.sqrt(2 * work * length) / (np.pi * sharpness)
    problem = 1.0, 1.0, work, amplitude, length
    radii = np.linspace(0.02, 2.4, 4000) * unit.contact_radius
    exact = float(guduru.curve(radii, *problem).force.min() / unit.force)
    begin = 1.9 * float(unit.contact_radius)
    pressed = float(guduru.curve(begin, *problem).force)
    for size in () if is_quick else (128, 256):
        grid = js.Grid(size, width * float(unit.contact_radius))
        x, y = grid.coordinates
        r = jnp.hypot(x - grid.lengths[0] / 2, y - grid.lengths[1] / 2)
        heights = -(r**2) / 2 - amplitude * (1 - jnp.cos(2 * jnp.pi * r / length))
        # The shortest range that the grid resolves.
        law = js.potentials.Exponential(work, np.sqrt(8 * work * grid.spacing[0] / np.pi))
        contact = js.Contact(js.FreeHalfSpace(grid, 1.0), heights, law)
        start = jnp.where(r < begin, 0, jnp.maximum(-heights - begin**2 / 2, 0) / 2 + 1e-6)
        load = js.MeanPressure(pressed / jnp.prod(grid.lengths))
        state = js.equilibrate(contact, load, initial=start)
        force = js.pull_off(contact, initial=state).load.value * jnp.prod(grid.lengths)
        setting = f"wavy sphere, alpha = {sharpness:g}: pull-off over pi w R, {size}²"
        yield Row(setting, "Guduru 2007", exact, float(force / unit.force))


def rough(is_quick: bool) -> Iterator[Row]:
    """Area over load in the linear regime: between Persson's and Bush's, at three resolutions."""
    for size in (128, 256) if is_quick else (128, 256, 512):
        grid = js.Grid(size)
        heights = js.surfaces.self_affine(
            grid, jax.random.key(0), k_low=2, k_rolloff=2, k_high=16, rms_height=0.02
        )
        slope = float(js.surfaces.rms_slope(grid, heights))
        contact = js.Contact(js.HalfSpace(grid, 1.0), heights, NONE)
        state = js.equilibrate(contact, js.MeanPressure(0.02 * slope))
        patches = js.patches(contact, state)
        for name, area in [("counted", patches.area), ("corrected", patches.true_area)]:
            setting = f"rough, {size // 16} points a wave: area E* h' / force, {name}"
            source = "Persson 2001; Bush, Gibson and Thomas 1975"
            bounds = (np.sqrt(8 / np.pi), np.sqrt(2 * np.pi))
            yield Row(setting, source, bounds, float(area) / 0.02)


def leaks(contact: js.Contact, pressure: float) -> tuple[np.ndarray, float]:
    """Return whether it leaks along x and y at a pressure, and the corrected contact fraction."""
    state = js.equilibrate(contact, js.MeanPressure(pressure))
    fraction = float(js.patches(contact, state).true_area / contact.area)
    return np.diag(js.leakage(contact, state).permeability) > 0, fraction


def sealing(seed: int, steps: int = 7) -> list[float]:
    """Return the contact fractions at which a rough contact seals along x and along y."""
    grid = js.Grid(256)
    heights = js.surfaces.self_affine(
        grid, jax.random.key(seed), k_low=4, k_rolloff=4, k_high=32, rms_height=0.01
    )
    slope = float(js.surfaces.rms_slope(grid, heights))
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights, NONE)
    found = []
    for side in (0, 1):
        low, high, fractions = 0.1 * slope, 0.4 * slope, [0.0, 1.0]
        for _ in range(steps):
            middle = (low + high) / 2
            leaking, fraction = leaks(contact, middle)
            low, high = (middle, high) if leaking[side] else (low, middle)
            fractions[0 if leaking[side] else 1] = fraction
        found.append(sum(fractions) / 2)
    return found


def percolation(is_quick: bool) -> Iterator[Row]:
    number = 2 if is_quick else 20
    fractions = np.array([sealing(seed) for seed in range(number)])
    error = fractions.std() / np.sqrt(fractions.size)
    setting = f"contact fraction at which {number} rough surfaces seal, ± {error:.2g}"
    yield Row(setting, "Dapp, Lücke, Persson and Müser 2012", 0.42, fractions.mean())


SECTIONS: list[Callable[[bool], Iterator[Row]]] = [
    discs,
    waves,
    flows,
    plates,
    layers,
    pull_offs,
    barriers,
    wavy_spheres,
    rough,
    percolation,
]


def rows(is_quick: bool, is_large: bool, figures: Path | None) -> Iterator[Row]:
    for section in SECTIONS:
        yield from section(is_quick)
    for section in () if is_quick else ROUGH:
        yield from section(is_large, figures)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="leave out the larger cases")
    parser.add_argument("--large", action="store_true", help="add the largest cases")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--figures", type=Path, help="a folder for the figures")
    parser.add_argument("--challenge", type=Path, help="the challenge's surface, a file of it")
    parser.add_argument(
        "--reference", type=Path, help="its published numbers, as challenge.py says"
    )
    parser.add_argument("--points", type=int, help="points a side, for its Fourier coefficients")
    parser.add_argument("--invert", action="store_true", help="if low points touch first")
    options = parser.parse_args()
    lines = list(HEAD)
    print("\n".join(lines), flush=True)
    start = time.perf_counter()
    if options.challenge:
        chosen = challenge_rows(
            options.challenge, options.reference, options.points, options.invert
        )
    else:
        chosen = rows(options.quick, options.large, options.figures)
    for row in chosen:
        lines.append(str(row))
        print(row, flush=True)
    print(f"{time.perf_counter() - start:.0f} s")
    if options.out:
        options.out.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

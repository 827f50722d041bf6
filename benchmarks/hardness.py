"""Contacts that yield: beside peers, closed forms and theories.

Tamaas' `KatoSaturated` and the conjugate gradients of ContactMechanics with a hardness, on the same
surfaces without adhesion; ContactMechanics near the hardness; a sphere from first yield on; areas
of rough surfaces from elastic to plastic; conductances beside a correlation; the pull-off of a
sphere after a load; the time beside an elastic contact. Names of tables choose some of them.

Each solver has the loosest power of ten as its tolerance with which no pressure is off by more than
1e-6 of the hardness; the pressures are those of jaxstab at a tolerance of 1e-12. One thread, on one
core; jaxstab and the peer run in turn, of which medians are taken; compilation is apart.
"""

import os

# Before any library starts its threads. It is the pinning that holds XLA to one of them.
os.environ |= {
    "JAX_PLATFORMS": "cpu",
    "OMP_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import time
import warnings
from statistics import median

import jax
import jax.numpy as jnp
import numpy as np
from chosen_tables import make_tables

import jaxstab as js
from jaxstab.references import elastic_plastic, jkr

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)
warnings.simplefilter("ignore", js.exceptions.WindowWarning)
warnings.simplefilter("ignore", js.exceptions.ContactWarning)

NONE = js.potentials.NoAdhesion()
HARDNESS = 0.1
# Of the hardness: what a pressure may be off.
ACCURACY = 1e-6
# Peers that take longer run once.
LONG = 5.0
REPEATS = 3


def rough(n, hardness, rms_slope=0.1, seed=0, k_high=32, k_low=2):
    """Return a self-affine surface on the unit square, on a half space of E* = 1."""
    grid = js.Grid(n)
    heights = js.surfaces.self_affine(
        grid, jax.random.key(seed), k_low=k_low, k_rolloff=k_low, k_high=k_high, rms_slope=rms_slope
    )
    return js.Contact(js.HalfSpace(grid, 1.0), heights, NONE, hardness=hardness)


def timed(call):
    start = time.perf_counter()
    result = jax.block_until_ready(call())
    return result, time.perf_counter() - start


def solved(contact, pressure, tolerance):
    solver = js.solvers.PreconditionedConjugateGradient(tolerance)
    return js.equilibrate(contact, js.MeanPressure(pressure), solver)


class NotConvergedError(Exception):
    pass


# Each takes a contact, the mean pressure, a tolerance and a limit of steps, and returns the
# pressures, the number of steps, if it tells, and the seconds without what is set up before.
def by_jaxstab(contact, pressure, tolerance, _):
    state, seconds = timed(lambda: solved(contact, pressure, tolerance))
    return np.asarray(state.pressure), int(state.num_steps), seconds


def by_tamaas(contact, pressure, tolerance, max_steps):
    import tamaas

    tamaas.initialize(1)
    tamaas.set_log_level(tamaas.LogLevel.error)
    shape = list(contact.grid.shape)
    model = tamaas.Model(tamaas.model_type.basic_2d, [1.0, 1.0], shape)
    model.E, model.nu = 1.0, 0.0
    surface = np.array(contact.heights)
    solver = tamaas.KatoSaturated(model, surface, tolerance, float(contact.hardness))
    solver.max_iter = max_steps
    _, seconds = timed(lambda: solver.solve(pressure))
    return np.array(model.traction).reshape(shape), "", seconds


def by_contact_mechanics(contact, pressure, tolerance, max_steps):
    from ContactMechanics import PeriodicFFTElasticHalfSpace
    from ContactMechanics.Optimization import constrained_conjugate_gradients
    from SurfaceTopography import Topography

    heights = np.array(contact.heights)
    solid = PeriodicFFTElasticHalfSpace(heights.shape, 1.0, (1.0, 1.0))
    surface = Topography(heights, (1.0, 1.0), periodic=True)
    start = time.perf_counter()
    result = constrained_conjugate_gradients(
        solid,
        surface,
        hardness=float(contact.hardness) * solid.area_per_pt,
        external_force=pressure,
        pentol=tolerance * heights.std(),
        forcetol=tolerance * pressure * solid.area_per_pt,
        thermotol=tolerance,
        maxiter=max_steps,
    )
    seconds = time.perf_counter() - start
    if not result.success:
        raise NotConvergedError(f"not converged after {result.nit} steps")
    return result.jac / solid.area_per_pt, result.nit, seconds


# With the first tolerance to try.
SOLVERS = {
    "jaxstab": (by_jaxstab, 1e-6),
    "Tamaas": (by_tamaas, 1e-7),
    "ContactMechanics": (by_contact_mechanics, 1e-6),
}


def tuned(name, contact, pressure, exact):
    """Return the loosest tolerance that is accurate, and what was found with it."""
    solve, tolerance = SOLVERS[name]
    while True:
        found = solve(contact, pressure, tolerance, 20_000)
        error = float(np.max(np.abs(found[0] - exact)) / HARDNESS)
        if error <= ACCURACY:
            return tolerance, error, found
        if tolerance < 1e-11:
            raise NotConvergedError(f"off by {error:.0e} at a tolerance of {tolerance:.0e}")
        tolerance /= 10


def peer_rows():
    for n in (128, 256, 512):
        contact = rough(n, HARDNESS, rms_slope=0.17)
        for share in (0.01, 0.1, 0.3, 0.6, 0.9):
            pressure = share * HARDNESS
            jax.clear_caches()
            state, first = timed(lambda c=contact, p=pressure: solved(c, p, 1e-12))
            exact = np.asarray(state.pressure)
            areas = f"{float(state.contact_area):.3f}, {float(state.yielded_area):.3f}"
            tolerance, error, (_, steps, _) = tuned("jaxstab", contact, pressure, exact)
            for peer in ("Tamaas", "ContactMechanics"):
                row = n, share, areas, peer, f"{first:.1f}"
                # It takes minutes for each, and many of them on more points.
                if peer == "Tamaas" and (n > 256 or (n == 256 and share != 0.3)):
                    continue
                try:
                    strict, off, (_, theirs, seconds) = tuned(peer, contact, pressure, exact)
                except NotConvergedError as end:
                    yield *row, "", "", "", "", f"{error:.0e}", f"{end}"
                    continue
                times = {"jaxstab": [], peer: [seconds]}
                for _ in range(REPEATS):
                    times["jaxstab"].append(by_jaxstab(contact, pressure, tolerance, 0)[2])
                    if seconds < LONG:
                        times[peer].append(SOLVERS[peer][0](contact, pressure, strict, 20_000)[2])
                ours, other = median(times["jaxstab"]), median(times[peer])
                counts = f"{steps}, {theirs}" if theirs else f"{steps}"
                yield (
                    *row,
                    f"{ours:.3f}",
                    f"{other:.2f}",
                    f"{other / ours:.1f}",
                    counts,
                    f"{error:.0e}",
                    f"{off:.0e}",
                )


def near_rows():
    contact = rough(128, HARDNESS, rms_slope=0.08, k_high=16)
    for pressure in (0.05, 0.07, 0.08, 0.09, 0.095):
        state = solved(contact, pressure, 1e-9)
        assert float(state.residual) <= 1e-9
        try:
            found, steps, _ = by_contact_mechanics(contact, pressure, 1e-8, 1000)
            error = np.max(np.abs(found - np.asarray(state.pressure))) / HARDNESS
            theirs = f"{steps} steps, pressures within {error:.0e} of ours"
        except (NotConvergedError, ValueError, RuntimeError) as end:
            theirs = f"{end}"
        yield (
            pressure,
            f"{float(state.contact_area):.4f}, {float(state.yielded_area):.4f}",
            int(state.num_steps),
            f"{float(state.residual):.0e}",
            theirs,
        )


# A sphere of radius 1 on E* = 1.
FIRST = elastic_plastic.first_yield(1.0, 1.0, HARDNESS)


def sphere(points, force, law=NONE, is_square=False, width=1.3):
    """Return a sphere and its mean pressure, on a disc or a square wider than its contact."""
    a = max(np.sqrt(force / (np.pi * HARDNESS)), float(FIRST.contact_radius))
    if is_square:
        grid = js.Grid((points, points), (2 * width * a, 2 * width * a))
        solid, area = js.FreeHalfSpace(grid, 1.0), (2 * width * a) ** 2
    else:
        grid = js.Rings(points, width * a)
        solid, area = js.solids.AxisymmetricHalfSpace(grid, 1.0), np.pi * (width * a) ** 2
    heights = js.surfaces.paraboloid(grid, 1.0)
    return js.Contact(solid, heights, law, hardness=HARDNESS), js.MeanPressure(force / area), area


def first_yield_load(points, is_square):
    low, high = 0.8, 1.25
    for _ in range(12):
        middle = (low + high) / 2
        contact, load, _ = sphere(points, middle * FIRST.force, is_square=is_square)
        yields = js.equilibrate(contact, load).yielded_area > 0
        low, high = (low, middle) if yields else (middle, high)
    return middle


def sphere_rows():
    for is_square, numbers in ((False, (100, 200, 400)), (True, (64, 128))):
        for points in numbers:
            row = [f"{points}²" if is_square else f"{points} rings"]
            row.append(f"{100 * (first_yield_load(points, is_square) - 1):+.2f} %")
            for multiple in (2, 5, 20, 100):
                contact, load, area = sphere(points, multiple * FIRST.force, is_square=is_square)
                state = js.equilibrate(
                    contact, load, js.solvers.PreconditionedConjugateGradient(1e-11)
                )
                disc = float(state.contact_area) * area
                row.append(f"{multiple * FIRST.force / (disc * HARDNESS):.4f}")
            row.append(f"{retraced(contact, state):.0e}")
            yield row
    row = ["a Hertzian pressure cut at H", ""]
    for multiple in (2, 5, 20, 100):
        square = FIRST.contact_radius**2 * (multiple - 1 / 3) * 2 / 3
        row.append(f"{multiple * FIRST.force / (np.pi * square * HARDNESS):.4f}")
    yield *row, ""


def retraced(contact, state):
    """Return how far pressures of a way back are from those of the way down, over the hardness."""
    tight = js.solvers.PreconditionedConjugateGradient(1e-11)
    left = contact.after(state)
    shares = (0.8, 0.5, 0.2, 0.05)
    down, last = [], state.gap
    for share in shares:
        last = js.equilibrate(left, js.MeanPressure(share * state.load.value), tight, initial=last)
        down.append(last)
    worst = float(jnp.max(left.heights - left.after(last).heights))
    for before in reversed(down):
        last = js.equilibrate(left, before.load, tight, initial=last)
        worst = max(worst, float(jnp.max(jnp.abs(last.pressure - before.pressure))) / HARDNESS)
    last = js.equilibrate(left, state.load, tight, initial=last)
    return max(worst, float(jnp.max(jnp.abs(last.pressure - state.pressure))) / HARDNESS)


def area_rows():
    for hardness in (1.0, 0.3, 0.1, 0.05, 0.03, 0.01, 0.003, 0.001):
        for share in (0.1, 0.3, 0.6):
            pressure = share * min(hardness, 0.05)
            state = solved(rough(256, hardness), pressure, 1e-8)
            elastic, yielding = elastic_plastic.area_fractions(pressure, 0.1, 1.0, hardness)
            areas = float(state.contact_area), float(state.yielded_area)
            yield (
                hardness,
                f"{pressure / hardness:.3g}",
                *(f"{area:.4f}" for area in areas),
                f"{float(elastic + yielding):.4f}",
                f"{float(yielding):.4f}",
                f"{100 * (areas[0] / (pressure / hardness) - 1):+.2f} %",
            )


def conductance_rows():
    """The conductance of a unit square over the correlation, k = 2 and k_high = 8 to 32."""
    for hardness in (0.003, 0.03):
        for share in (0.003, 0.01, 0.03, 0.1, 0.3):
            row = [hardness, share]
            for n, k_high in ((128, 8), (128, 16), (256, 32)):
                ratios = []
                for seed in range(3):
                    contact = rough(n, hardness, seed=seed, k_high=k_high, k_low=4)
                    state = solved(contact, share * hardness, 1e-8)
                    found = js.conductance(contact, state).conductance
                    slope = js.surfaces.rms_slope(contact.grid, contact.heights) / np.sqrt(np.pi)
                    height = js.surfaces.rms_height(contact.heights)
                    ratios.append(
                        float(found) / elastic_plastic.conductance(share, 1.0, height, slope, 2.0)
                    )
                row.append(f"{np.mean(ratios):.2f} ± {np.std(ratios):.2f}")
            yield row


WORK, RANGES, RINGS = 4e-4, (8e-3, 4e-3), 400


def pull_off_rows():
    elastic = float(jkr.pull_off(1.0, 1.0, WORK).force)
    for multiple in (5, 20, 100, 500):
        forces = []
        for length in RANGES:
            law = js.potentials.Exponential(WORK, length)
            contact, load, area = sphere(RINGS, multiple * FIRST.force, law, width=1.15)
            state = js.equilibrate(contact, load)
            left = contact.after(state).elastic
            pull = js.pull_off(left, initial=js.equilibrate(left, load, initial=state.gap))
            forces.append(float(pull.equilibrium.force))
        radius = np.sqrt(float(state.contact_area) * area / np.pi)
        exact = elastic_plastic.pull_off(radius, 1.0, HARDNESS, WORK)
        yield (
            multiple,
            f"{radius:.3f}",
            f"{float(state.yielded_area / state.contact_area):.3f}",
            *(f"{force / elastic:.3f}" for force in forces),
            f"{float(exact.force) / elastic:.3f}",
            f"{float(exact.contact_radius) / radius:.3f}",
        )


def cost_rows():
    for n in (128, 256, 512):
        for share in (0.1, 0.5):
            contact = rough(n, HARDNESS, rms_slope=0.17)
            row = [n, share]
            times = []
            for one in (contact, contact.elastic):
                state = solved(one, share * HARDNESS, 1e-8)
                seconds = [by_jaxstab(one, share * HARDNESS, 1e-8, 0)[2] for _ in range(REPEATS)]
                times.append(seconds)
                row.append(int(state.num_steps))
            yielding, elastic = map(median, times)
            yield *row, f"{yielding:.3f}", f"{elastic:.3f}", f"{yielding / elastic:.2f}"


TABLES = {
    "peers": (
        "Rough surfaces of rms slope 0.17, H = 0.1 E*, without adhesion; errors are the largest of "
        "a pressure, over H",
        (
            "points a side",
            "P / H",
            "area in contact, yielding",
            "peer",
            "compile + first [s]",
            "jaxstab [s]",
            "peer [s]",
            "peer / jaxstab",
            "steps",
            "error of jaxstab",
            "error of the peer",
        ),
        peer_rows,
    ),
    "near": (
        "Towards the hardness: rms slope 0.08, H = 0.1 E*, 128² points; ContactMechanics with at "
        "most 1000 steps",
        ("P / E*", "area in contact, yielding", "steps of jaxstab", "residual", "ContactMechanics"),
        near_rows,
    ),
    "sphere": (
        "A sphere, H = 0.1 E*: the load of first yield, F over area and hardness at multiples of "
        "it, and how far pressures are from a retraced unloading from the largest, over H",
        ("points", "first yield", "2", "5", "20", "100", "retraced within"),
        sphere_rows,
    ),
    "areas": (
        "Rough surfaces of rms slope 0.1, 256² points: areas beside Persson's theory and P / H",
        (
            "H / E*",
            "P / H",
            "area in contact",
            "yielding",
            "Persson, in contact",
            "yielding",
            "area over P / H",
        ),
        area_rows,
    ),
    "conductance": (
        "Conductance over the correlation 1.25 k (m / sigma) (P / H)^0.95: means of three surfaces "
        "of rms slope 0.1, with their scatter",
        ("H / E*", "P / H", "waves 4 to 8, 128²", "4 to 16, 128²", "4 to 32, 256²"),
        conductance_rows,
    ),
    "pull-off": (
        "The pull-off of a sphere after a load, over JKR's of a sphere that has not yielded; "
        f"w = {WORK} E* R, {RINGS} rings",
        (
            "load over that of first yield",
            "largest contact radius / R",
            "part that yielded",
            *(f"range {length} R" for length in RANGES),
            "closed form, all yielded",
            "contact radius at pull-off / largest",
        ),
        pull_off_rows,
    ),
    "cost": (
        "An equilibrium that yields beside an elastic one of the same surface and pressure",
        ("points a side", "P / H", "steps", "elastic steps", "seconds", "elastic", "ratio"),
        cost_rows,
    ),
}


if __name__ == "__main__":
    make_tables(__doc__, TABLES)

"""Rings against closed forms, against squares, and their times.

Hertz' sphere, Sneddon's cone and a flat punch; Maugis' sphere under Dugdale's law, its pull-off
under a dead load, where it jumps under a held far side, and its whole branch; the limit of short
range of a sphere, a cone and a punch; the jumps of Guduru's wavy sphere; a half space and layers on
squares. Names of tables choose some of them. Times are medians without compilation.
"""

import os
import time
import warnings
from statistics import median

import jax
import jax.numpy as jnp
import numpy as np
from chosen_tables import make_tables

import jaxstab as js
from jaxstab.references import guduru, jkr, maugis

jax.config.update("jax_enable_x64", True)
warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)
warnings.simplefilter("ignore", js.exceptions.WindowWarning)

NONE = js.potentials.NoAdhesion()
REPEATS = 3
# A sphere of radius 1.
WORK, MODULUS = 1e-3, 0.75
SPHERE = (1.0, MODULUS, WORK)
UNIT = jkr.units(*SPHERE)
SMOOTHING = 0.05


def percent(value, exact, digits=2):
    return f"{100 * (float(value) / float(exact) - 1):+.{digits}f} %"


def half_space(num_points, radius, profile, law, modulus=1.0):
    """Return the contact of a tip on rings."""
    rings = js.Rings(num_points, radius)
    solid = js.solids.AxisymmetricHalfSpace(rings, modulus)
    return js.Contact(solid, profile(rings), law)


def paraboloid(grid):
    return js.surfaces.paraboloid(grid, 1.0)


def contact_radius(contact, state):
    return float(contact.grid.radius * jnp.sqrt(state.contact_area))


# Contact radii, over the radius of the disc, which end within rings or at their edges.
RADII = np.linspace(0.38, 0.42, 5)
SLOPE = 0.2
NUMBERS = (100, 200, 500, 1000)


def sphere_state(num_points, a):
    contact = half_space(num_points, 1.0, paraboloid, NONE)
    return contact, js.equilibrate(contact, js.FarDisplacement(-(a**2))), 4 / 3 * a**3


def cone_state(num_points, a):
    approach = np.pi / 2 * a * SLOPE
    contact = half_space(num_points, 1.0, lambda rings: js.surfaces.cone(rings, SLOPE), NONE)
    force = 2 * approach**2 / (np.pi * SLOPE)
    return contact, js.equilibrate(contact, js.FarDisplacement(-approach)), force


def punch_state(num_points, a):
    # The punch ends at the edge of a ring.
    edge = (round(a**2 * num_points) / num_points) ** 0.5
    contact = half_space(
        num_points, 1.0, lambda rings: jnp.where(rings.radii < edge, 0.0, -1.0), NONE
    )
    return contact, js.equilibrate(contact, js.FarDisplacement(-0.05)), 2 * edge * 0.05


SHAPES = {"sphere (Hertz)": sphere_state, "cone (Sneddon)": cone_state, "flat punch": punch_state}


# Force and contact radius are those of N rings, and those extrapolated from N / 2 and N rings where
# the error falls as 1 / N. The contact radius without a ring's width follows from the pressures,
# whose square falls linearly with r^2 to zero at the edge of a smooth tip.
def radius_by_pressure(contact, state):
    held = int(np.sum(state.in_contact))
    # The last ring is in contact in part.
    places = np.arange(held - 5, held - 1)
    squares = np.asarray(contact.grid.squared_distances)[places]
    slope, level = np.polyfit(squares, np.asarray(state.pressure)[places] ** 2, 1)
    return (-level / slope) ** 0.5


def shape_rows():
    for name, solve in SHAPES.items():
        is_punch = solve is punch_state
        before = None
        for number in NUMBERS:
            errors = {"force": [], "extrapolated": [], "counted": [], "fitted": []}
            for a in RADII:
                contact, state, force = solve(number, a)
                errors["force"].append(float(state.force / force) - 1)
                if is_punch:
                    _, finer, exact = solve(2 * number, a)
                    errors["extrapolated"].append(
                        2 * float(finer.force / exact) - float(state.force / force) - 1
                    )
                else:
                    errors["fitted"].append(radius_by_pressure(contact, state) / a - 1)
                    errors["counted"].append(contact_radius(contact, state) / a - 1)
            largest = {key: max(map(abs, each)) for key, each in errors.items() if each}
            order = ""
            if before is not None:
                fall = before[1] / largest["force"]
                order = f"{np.log(fall) / np.log(number / before[0]):.1f}"
            before = number, largest["force"]
            shown = (f"{largest[key]:.1e}" if key in largest else "" for key in errors)
            force, *others = shown
            yield name, number, force, order, *others


def strength_of(parameter):
    return parameter / float(maugis.transition_parameter(*SPHERE, 1.0))


# The radius of the disc in units of a0, so that the attraction ends within it.
DISCS = {0.2: 6.0, 0.5: 4.0, 1.0: 3.0, 2.0: 2.5, 5.0: 2.3}


def dugdale(parameter, num_points):
    """Return Maugis' sphere on rings."""
    law = js.potentials.Dugdale(WORK, WORK / strength_of(parameter), SMOOTHING)
    radius = DISCS[parameter] * float(UNIT.contact_radius)
    return half_space(num_points, radius, paraboloid, law, MODULUS)


def dead_rows():
    for parameter, number in (
        (0.2, 200),
        (0.5, 200),
        (1.0, 200),
        (2.0, 200),
        (2.0, 400),
        (5.0, 400),
        (5.0, 800),
    ):
        contact = dugdale(parameter, number)
        exact = maugis.pull_off(*SPHERE, strength_of(parameter))
        pull = js.pull_off(contact)
        force = pull.equilibrium.force
        yield (
            parameter,
            number,
            f"{float(contact.resolution):.2g}",
            pull.kind.name,
            f"{float(force) / UNIT.force:.4f}",
            f"{exact.force / UNIT.force:.4f}",
            percent(force, exact.force),
        )


# Under a held far side less contact is left before the jump than under a dead load, where rings are
# wider: the disc is as small as the attraction allows. A small Maugis parameter has its fold within
# the width over which the law is smoothed, which is therefore shorter.
HELD = (
    (0.2, 800, 6.0, 0.02),
    (0.5, 800, 4.0, 0.02),
    (1.0, 800, 2.2, SMOOTHING),
    (2.0, 800, 1.8, SMOOTHING),
    (5.0, 500, 1.4, SMOOTHING),
)


def held_dugdale(parameter, number, disc, smoothing):
    law = js.potentials.Dugdale(WORK, WORK / strength_of(parameter), smoothing)
    return half_space(number, disc * float(UNIT.contact_radius), paraboloid, law, MODULUS)


def held_rows():
    for parameter, number, disc, smoothing in HELD:
        contact = held_dugdale(parameter, number, disc, smoothing)
        exact = maugis.pull_off(*SPHERE, strength_of(parameter), np.inf)
        ends = js.FarDisplacement(-exact.displacement * jnp.array([0.2, 1.05]))
        path = js.follow(contact, ends, initial=js.equilibrate(contact, ends[0]))
        if len(path.jumps) == 0:
            yield parameter, number, "no jump", "", "", "", ""
            continue
        jump = path.jumps[int(jnp.argmax(path.jumps.dissipation))]
        place, force = -float(jump.load.value), float(jump.before.force)
        yield (
            parameter,
            number,
            jump.kind.name,
            f"{place / UNIT.displacement:.4f}",
            percent(place, exact.displacement),
            f"{force / UNIT.force:.4f}",
            percent(force, exact.force),
        )


# Where the branch begins, in units of d0, and how many states it may have.
BRANCH_START, BRANCH_STATES = -0.2, 1000
BRANCHES = ((0.5, 400, 4.0, 0.02), (1.0, 400, 2.2, 0.02), (2.0, 400, 1.8, SMOOTHING))


def maugis_points(parameter):
    """Return closely spaced points of Maugis' curve, approach and force in units of d0 and F0."""
    problem = (*SPHERE, strength_of(parameter))
    radii = np.geomspace(1e-3, 3, 20000) * UNIT.contact_radius
    outer = np.linspace(0, float(maugis.first_touch(*problem).outer_radius) * (1 - 1e-9), 20000)
    pieces = [
        np.stack([p.displacement / UNIT.displacement, p.force / UNIT.force], 1)
        for p in (maugis.curve(radii, *problem), maugis.without_contact(outer, *problem))
    ]
    # Beyond its range the law does not attract.
    apart = pieces[1][0, 0] - np.linspace(0, 10, 20000)
    return np.concatenate([*pieces, np.stack([apart, 0 * apart], 1)])


def branch_rows():
    for parameter, number, disc, smoothing in BRANCHES:
        contact = held_dugdale(parameter, number, disc, smoothing)
        near = BRANCH_START * float(UNIT.displacement)
        far = 1.2 * float(UNIT.displacement) + 1.6 * WORK / strength_of(parameter)
        start = js.equilibrate(contact, js.FarDisplacement(-near))
        loads = js.FarDisplacement(jnp.array([-near, far]))
        began = time.perf_counter()
        branch = js.continuation(contact, loads, initial=start, max_states=BRANCH_STATES)
        seconds = time.perf_counter() - began
        exact = maugis_points(parameter)
        approach = -np.asarray(branch.load.value) / float(UNIT.displacement)
        force = np.asarray(branch.equilibrium.force) / float(UNIT.force)
        distances = np.array(
            [np.hypot(*(exact - point).T).min() for point in zip(approach, force, strict=True)]
        )
        is_unstable = np.asarray(branch.index) > 0
        # Where surfaces only attract, the smoothed edge of the law matters.
        touches = np.asarray(branch.equilibrium.contact_area) > 0
        kinds = (touches & ~is_unstable, touches & is_unstable, ~touches)
        yield (
            parameter,
            number,
            len(branch),
            int(is_unstable.sum()),
            len(branch.turns),
            *(f"{distances[kind].max():.4f}" if kind.any() else "" for kind in kinds),
            branch.end.name,
            f"{seconds:.0f}",
        )


# Tips of E* = 1, their contact radius and force at pull-off without a range, and heights.
CONE_RADIUS = 18 * WORK / (np.pi * SLOPE**2)


def punch_radius(number):
    return (round(0.5 * number) / number) ** 0.5


def sphere_limit(number):
    radius = (9 * np.pi * WORK / 8) ** (1 / 3)
    return radius, 1.9 * radius, -1.5 * np.pi * WORK, paraboloid


def cone_limit(number):
    # D. Maugis, M. Barquins, J. Phys. D: Appl. Phys. 11, 1989 (1978).
    force = -54 * WORK**2 / (np.pi * SLOPE**3)
    return CONE_RADIUS, 1.9 * CONE_RADIUS, force, lambda rings: js.surfaces.cone(rings, SLOPE)


def punch_limit(number):
    # K. Kendall, J. Phys. D: Appl. Phys. 4, 1186 (1971).
    a = punch_radius(number)
    force = -((8 * np.pi * WORK * a**3) ** 0.5)
    return a, 1.0, force, lambda rings: jnp.where(rings.radii < a, 0.0, -1.0)


# The resolution at the shortest range. Contact edges lie at half the radius of the disc.
SHORTEST, RATIO = 64.0, 1.3


def limit_rows():
    tips = {"sphere (JKR)": sphere_limit, "cone (Maugis & Barquins)": cone_limit}
    for name, tip in tips.items():
        number = 800
        radius, disc, exact, profile = tip(number)
        contact = half_space(number, disc, profile, js.potentials.Exponential(WORK, 1e-3 * disc))
        ranges = float(js.resolved_range(contact, SHORTEST)) * RATIO ** np.arange(4)

        def pull_off(contact, radius=radius, exact=exact):
            pulled = js.MeanPressure(0.7 * exact / float(contact.area))
            pressed = jnp.where(contact.grid.radii < 1.4 * radius, 0, -contact.heights)
            start = js.equilibrate(contact, pulled, initial=pressed)
            return js.pull_off(contact, initial=start).equilibrium.force

        limit = js.extrapolate(pull_off, contact, ranges=ranges, to=0.0)
        yield (
            name,
            f"{number} rings, Exponential",
            percent(limit.values[0], exact),
            percent(limit.value, exact),
            f"{100 * float(limit.error / abs(exact)):.1f} %",
        )
    # A punch's edge stays where it is: the cohesive zone alone is to be short.
    number = 500
    radius, disc, exact, profile = punch_limit(number)
    width = 1 / (2 * number * radius)
    length = (ZONE_OF_PUNCH * width * 8 * WORK / np.pi) ** 0.5
    contact = half_space(number, disc, profile, js.potentials.Dugdale(WORK, length, SMOOTHING))
    force = js.pull_off(contact).equilibrium.force
    yield "flat punch (Kendall)", f"{number} rings, Dugdale", percent(force, exact), "", ""


# Widths of rings in the cohesive zone (pi / 8) E* w / s^2 of Dugdale's law.
ZONE_OF_PUNCH = 4.0

# Guduru's wavy sphere: radius, amplitude, wavelength, alpha; the cohesive zone and the smoothing.
WAVY_RADIUS, AMPLITUDE, WAVELENGTH = 1.0, 2.5e-3, 0.1
WAVY_ZONE, WAVY_SMOOTHING = 1e-3, 0.2


# Contact radii from and to which it is withdrawn, the disc's radius and rings: the last contact is
# small, and rings are wide within a large disc.
LEGS = ((0.34, 0.13, 0.4, 1000), (0.115, 0.07, 0.16, 600))


def wavy_rows():
    work = np.pi**2 * AMPLITUDE**2 / (2 * WAVELENGTH)
    radii = np.linspace(0.02, 0.45, 40000)
    exact = guduru.curve(radii, WAVY_RADIUS, 1.0, work, AMPLITUDE, WAVELENGTH)
    d = exact.displacement
    folds = np.flatnonzero((d[1:-1] < d[:-2]) & (d[1:-1] < d[2:])) + 1
    deepest = abs(d[folds[0]])
    length = (8 * WAVY_ZONE * work / np.pi) ** 0.5
    law = js.potentials.Dugdale(work, length, WAVY_SMOOTHING)
    for first, last, disc, number in LEGS:
        contact = half_space(
            number,
            disc,
            lambda rings: js.surfaces.wavy_sphere(rings, WAVY_RADIUS, AMPLITUDE, WAVELENGTH),
            law,
        )
        pressed = jnp.where(contact.grid.radii < first, 0.0, AMPLITUDE)
        begin = d[np.argmin(abs(radii - first))]
        between = folds[(radii[folds] > last) & (radii[folds] < first)]
        # Beyond the last fold of the leg, but not at the next one.
        ends = js.FarDisplacement(-jnp.array([begin, d[between[0]] - 0.3 * deepest]))
        start = js.equilibrate(contact, ends[0], initial=pressed)
        jumps = js.follow(contact, ends, initial=start).jumps
        # Contact edges that are pinned to rings jump as well, and lose little.
        most = jumps[int(np.argmax(jumps.dissipation))].dissipation
        for jump in jumps:
            if jump.dissipation < 0.3 * most:
                continue
            place, force = -float(jump.load.value), float(jump.before.force)
            i = folds[np.argmin(abs(d[folds] - place))]
            yield (
                number,
                jump.kind.name,
                f"{place:.5f}",
                f"{d[i]:.5f}",
                f"{100 * (place - d[i]) / deepest:+.2f} %",
                f"{force:.6f}",
                f"{exact.force[i]:.6f}",
                percent(force, exact.force[i]),
            )


# A sphere of radius 1 that adheres, and the load under which it is judged.
SQUARES_LAW = js.potentials.Exponential(2e-3, 0.02)
JUDGED = js.FarDisplacement(-0.03)
WINDOW = 1.2


def angular_order(grid, mode):
    """Return the order m of the largest Fourier coefficient of a mode over the angle."""
    x, y = (np.asarray(c) - WINDOW / 2 for c in grid.coordinates)
    angle = np.arctan2(y, x)
    return int(np.argmax([abs(np.sum(mode * np.exp(1j * m * angle))) for m in range(9)]))


def square_rows():
    contact = half_space(400, WINDOW / 2, paraboloid, SQUARES_LAW)
    state = js.equilibrate(contact, JUDGED)
    stability = js.assess_stability(contact, state, orders=4)
    eigenvalues = [float(stability.critical.eigenvalue), *map(float, stability.angular.eigenvalue)]
    pulled = float(js.pull_off(contact, initial=state).equilibrium.force)
    order = int(np.argmin(eigenvalues))
    force = float(state.force)
    verdict = stability.verdict.name
    yield "400 rings", f"{force:.6f}", "", verdict, order, f"{pulled:.6f}", ""
    for n in (64, 128):
        grid = js.Grid(n, WINDOW)
        squares = js.Contact(js.FreeHalfSpace(grid, 1.0), paraboloid(grid), SQUARES_LAW)
        other = js.equilibrate(squares, JUDGED)
        judged = js.assess_stability(squares, other)
        end = float(js.pull_off(squares, initial=other).equilibrium.force)
        yield (
            f"{n}²",
            f"{float(other.force):.6f}",
            percent(other.force, force),
            judged.verdict.name,
            angular_order(grid, np.asarray(judged.critical.mode)),
            f"{end:.6f}",
            percent(end, pulled),
        )


# A window must be so wide that its images do not act on each other: an incompressible layer pushes
# up what a tip displaces.
LAYERS = (
    ("layer", 1.6, lambda grid: js.Layer(grid, 1.0, 0.3, 0.2)),
    ("incompressible layer", 1.6, lambda grid: js.Layer(grid, 1.0, 0.5, 0.2)),
    ("incompressible layer", 2.4, lambda grid: js.Layer(grid, 1.0, 0.5, 0.2)),
)
COATING = {"layer": (10.0, 0.3), "thickness": 0.05, "base": (1.0, 0.3)}


def layer_rows():
    for name, window, solid_on in LAYERS:
        rings = js.Rings(400, 0.6)
        layer = js.solids.Axisymmetric(rings, solid_on(js.Grid(8)))
        contact = js.Contact(layer, paraboloid(rings), NONE)
        state = js.equilibrate(contact, js.FarDisplacement(-0.03))
        force = float(state.force)
        yield name, "400 rings", f"{force:.6f}", "0.03", ""
        for n in (128, 256):
            grid = js.Grid(n, window)
            solid = solid_on(grid)
            squares = js.Contact(solid, paraboloid(grid), NONE)
            # The base is held: the mean displacement is that under the mean pressure.
            pressure = force / float(grid.area)
            other = js.equilibrate(squares, js.MeanPressure(pressure))
            base = float(jnp.mean(other.displacement)) - pressure / float(solid.uniform_stiffness)
            yield name, f"{n}², {window}", f"{force:.6f}", f"{-base:.6f}", percent(-base, 0.03, 3)
    # On a half space below, far displacements of rings and of a window differ: contact radii at
    # one force do not.
    rings = js.Rings(400, 0.4)
    coated = js.solids.Axisymmetric(rings, js.CoatedHalfSpace(js.Grid(8), **COATING))
    contact = js.Contact(coated, paraboloid(rings), NONE)
    state = js.equilibrate(contact, js.FarDisplacement(-0.02))
    force, middle = float(state.force), float(jnp.max(state.pressure))
    yield "coating, largest pressure", "400 rings", f"{force:.6f}", f"{middle:.5f}", ""
    for n, window in ((128, 1.0), (256, 1.0), (256, 2.0)):
        grid = js.Grid(n, window)
        squares = js.Contact(js.CoatedHalfSpace(grid, **COATING), paraboloid(grid), NONE)
        other = js.equilibrate(squares, js.MeanPressure(force / float(grid.area)))
        largest = float(jnp.max(other.pressure))
        yield (
            "coating, largest pressure",
            f"{n}², {window}",
            f"{force:.6f}",
            f"{largest:.5f}",
            percent(largest, middle, 2),
        )


def timed(call):
    """Return the median seconds of a call, without the first one."""
    seconds = []
    for _ in range(1 + REPEATS):
        start = time.perf_counter()
        jax.block_until_ready(jax.tree.leaves(call()))
        seconds.append(time.perf_counter() - start)
    return median(seconds[1:])


def time_rows():
    hertz = half_space(500, 1.0, paraboloid, NONE)
    law = js.potentials.Exponential(2e-3, 0.02)
    sticky = half_space(500, 1.0, paraboloid, law)
    small = half_space(200, 1.0, paraboloid, law)
    load = js.FarDisplacement(-0.1)
    runs = {
        "equilibrium, 500 rings, no adhesion": lambda: js.equilibrate(hertz, load),
        "equilibrium, 500 rings, exponential law": lambda: js.equilibrate(sticky, load),
        "pull_off, 200 rings, exponential law": lambda: js.pull_off(small),
    }
    for parameter in (1.0, 2.0):
        contact = dugdale(parameter, 200)
        far = 1.6 * WORK / strength_of(parameter) + 2 * float(UNIT.displacement)
        turns = js.FarDisplacement(jnp.array([far, -0.5 * float(UNIT.displacement), far]))
        runs[f"pull_off, 200 rings, Dugdale, lambda {parameter:g}"] = lambda c=contact: js.pull_off(
            c
        )
        runs[f"follow in and out, 200 rings, Dugdale, lambda {parameter:g}"] = (
            lambda c=contact, t=turns: js.follow(c, t)
        )
    for name, call in runs.items():
        before = os.getloadavg()[0]
        yield name, f"{timed(call):.3g}", f"{before:.1f}"


TABLES = {
    "shapes": (
        "Without adhesion: the largest errors of five approaches, and the order of convergence",
        (
            "tip",
            "rings",
            "force",
            "order",
            "force, from N and 2 N",
            "contact radius, counted",
            "contact radius, from pressures",
        ),
        shape_rows,
    ),
    "dead": (
        "Maugis' sphere pulled off by a dead load, in units of pi w R",
        ("lambda", "rings", "resolution", "kind", "force", "closed form", "error"),
        dead_rows,
    ),
    "held": (
        "Maugis' sphere, its far side held, where it jumps off, in units of d0 and of pi w R",
        ("lambda", "rings", "kind", "place", "error", "force", "error"),
        held_rows,
    ),
    "branch": (
        "Maugis' branch: the largest distances from his curve, in units of d0 and of pi w R",
        (
            "lambda",
            "rings",
            "states",
            "unstable",
            "turns",
            "in contact, stable",
            "in contact, unstable",
            "apart",
            "end",
            "seconds, with compilation",
        ),
        branch_rows,
    ),
    "limits": (
        "The pull-off of a dead load: errors against closed forms of zero range",
        ("tip", "points and law", "at the shortest range", "extrapolated", "error estimated"),
        limit_rows,
    ),
    "wavy": (
        "Guduru's wavy sphere, withdrawn by its far side: where it jumps; errors of the approach "
        "are parts of the last one",
        ("rings", "kind", "approach", "closed form", "error", "force", "closed form", "error"),
        wavy_rows,
    ),
    "squares": (
        "An adhering sphere on a free half space, rings beside squares: the force at an approach "
        "of 0.03, the verdict, the order m of the softest mode, and the pull-off by a dead load",
        ("points", "force", "difference", "verdict", "order", "pull-off", "difference"),
        square_rows,
    ),
    "layers": (
        "A sphere on layers and on a coating, at one force, rings beside squares and their windows",
        ("solid", "points", "force", "approach or pressure", "difference"),
        layer_rows,
    ),
    "times": (
        "Seconds, and the load of the machine before each",
        ("call", "seconds", "load"),
        time_rows,
    ),
}


if __name__ == "__main__":
    make_tables(__doc__, TABLES)

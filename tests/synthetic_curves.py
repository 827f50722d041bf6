"""Force curves made of a closed form, with all that an instrument adds."""

import numpy as np
from scipy.interpolate import CubicSpline

import jaxstab as js

RADIUS, MODULUS, WORK = 20.0, 0.5, 0.05
# nm, nN, GPa and J/m^2.
UNITS = ("nm", "nN")


def hertz(depth=8.0, points=4000):
    """Return indentations and forces of a sphere without adhesion."""
    indentation = np.linspace(0, depth, points)
    return indentation, 4 / 3 * MODULUS * np.sqrt(RADIUS) * indentation**1.5


def dmt(depth=8.0, points=4000):
    """Return them with a constant attraction in contact."""
    indentation, force = hertz(depth, points)
    return indentation, force - 2 * np.pi * WORK * RADIUS


def jkr(radius=2.0):
    """Return them for JKR's sphere, up to so many times the radius at zero load."""
    unit = js.references.jkr.units(RADIUS, MODULUS, WORK)
    state = js.references.jkr.curve(
        np.linspace(0.1, radius, 4000) * unit.contact_radius, RADIUS, MODULUS, WORK
    )
    return np.asarray(state.displacement), np.asarray(state.force)


def maugis(tabor, modulus=MODULUS, work=WORK, depth=8.0, points=8000):
    """Return them for Maugis' sphere, from where the attraction or the branch begins."""
    length = np.cbrt(RADIUS * (work / modulus) ** 2) / tabor
    law = RADIUS, modulus, work, work / length
    touch = js.references.maugis.first_touch(*law)
    end = js.references.maugis.pull_off(*law, np.inf)
    unit = js.references.jkr.units(*law[:3])
    most = 2 * np.sqrt(RADIUS * depth) + 4 * unit.contact_radius
    radii = np.linspace(max(float(end.contact_radius), 1e-6), most, points)
    states = js.references.maugis.curve(radii, *law)
    indentation = np.asarray(states.displacement)
    force = np.asarray(states.force)
    if end.contact_radius == 0:
        outer = np.linspace(float(end.outer_radius), float(touch.outer_radius), points)[:-1]
        before = js.references.maugis.without_contact(outer, *law)
        indentation = np.append(before.displacement, indentation)
        force = np.append(before.force, force)
    is_shown = indentation <= depth
    return indentation[is_shown], force[is_shown]


def maugis_with_approach(tabor, modulus=MODULUS, work=WORK, depth=8.0, points=4000):
    """Return all of Maugis' equilibria, from where the attraction begins, stable or not."""
    length = np.cbrt(RADIUS * (work / modulus) ** 2) / tabor
    law = RADIUS, modulus, work, work / length
    touch = js.references.maugis.first_touch(*law)
    outer = np.linspace(0, float(touch.outer_radius), points // 4)
    before = js.references.maugis.without_contact(outer, *law)
    unit = js.references.jkr.units(*law[:3])
    most = 2 * np.sqrt(RADIUS * depth) + 4 * unit.contact_radius
    radii = most * np.linspace(0, 1, points + 1)[1:] ** 1.5
    states = js.references.maugis.curve(radii, *law)
    is_shown = np.asarray(states.displacement) <= depth
    indentation = np.append(before.displacement, states.displacement[is_shown])
    return indentation, np.append(before.force, states.force[is_shown])


def recorded(
    law,
    seed,
    *,
    constant=0.5,
    contact=3.0,
    drift=0.5,
    tilt=2e-3,
    offsets=(0.3, 0.4),
    force_drift=0.0,
    noise=0.05,
    height_noise=0.0,
    points=2000,
    speed=100.0,
    reach=150.0,
    parts=("approach", "retraction"),
):
    """Return what an instrument records of a law: ascending indentations with forces.

    The tip jumps where the cantilever is softer than the law. Before the first indentation no force
    acts; a law that begins with a pull-off is one of contact, which the approach meets at no
    indentation. Heights are off by the contact point, by a drift from the end of the approach and
    perhaps by noise; forces by an offset of each segment, a tilt, a drift and noise.
    """
    random = np.random.default_rng(seed)
    indentation, force = law
    if len(force) < 1000:
        fine = np.linspace(indentation[0], indentation[-1], 8000)
        force = CubicSpline(indentation, force)(fine)
        indentation = fine
    height = -indentation - force / constant
    lowest = height[-1]
    # Of a law of the contact alone the approach sees what lies beyond no indentation.
    is_contact = abs(force[0]) > 1e-3 * np.max(np.abs(force))
    seen = indentation >= 0 if is_contact else np.full(len(force), True)
    is_new = np.minimum.accumulate(height[seen]) == height[seen]
    down = height[seen][is_new][::-1], force[seen][is_new][::-1]
    is_new = np.maximum.accumulate(height[::-1]) == height[::-1]
    up = height[::-1][is_new], force[::-1][is_new]
    time = (reach - lowest) / speed * np.linspace(-1, 1, 2 * points)
    machine = lowest + speed * np.abs(time)
    segments = []
    for number, part in enumerate(parts):
        is_part = time < 0 if part == "approach" else time >= 0
        own = machine[is_part]
        # The sample moves, and is then deeper or less deep than at the turn.
        above = own - drift * time[is_part]
        true = np.interp(above, *(down if part == "approach" else up), right=0.0)
        total = true + offsets[number] + tilt * own + noise * random.normal(size=own.size)
        total += force_drift * time[is_part]
        read = own + contact
        if height_noise:
            read = read + height_noise * random.normal(size=own.size)
        segments.append(
            js.lab.force_curves.Segment(
                force=total,
                height=read,
                tip=read + total / constant,
                time=time[is_part] - time[0],
            )
        )
    named = dict(zip(parts, segments, strict=True))
    return js.lab.force_curves.ForceCurve(
        named.get("approach"),
        named.get("retraction"),
        spring_constant=constant,
        unit=UNITS[0],
        force_unit=UNITS[1],
    )

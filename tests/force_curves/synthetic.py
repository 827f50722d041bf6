"""Force curves made of a closed form, with all that an instrument adds."""

import numpy as np

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


def recorded(
    law,
    seed,
    *,
    constant=0.5,
    contact=3.0,
    drift=0.5,
    tilt=2e-3,
    offsets=(0.3, 0.4),
    noise=0.05,
    points=2000,
    speed=100.0,
    reach=150.0,
    parts=("approach", "retraction"),
):
    """Return what an instrument records of a law: indentations with forces, in contact.

    Out of contact no force acts. The approach touches at no indentation, the retraction follows the
    law until the cantilever pulls the tip off. Heights are off by the contact point, and by a drift
    from the end of the approach; forces by an offset of each segment, a tilt and noise.
    """
    random = np.random.default_rng(seed)
    indentation, force = law
    height = -indentation - force / constant
    last = int(np.argmax(height))
    height, force, indentation = height[last:], force[last:], indentation[last:]
    touch = np.interp(0, indentation, height)
    lowest = height[-1]
    time = (reach - lowest) / speed * np.linspace(-1, 1, 2 * points)
    machine = lowest + speed * np.abs(time)
    segments = []
    for number, part in enumerate(parts):
        is_part = time < 0 if part == "approach" else time >= 0
        own = machine[is_part]
        # The sample moves, and is then deeper or less deep than at the turn.
        above = own - drift * time[is_part]
        end = touch if part == "approach" else height[0]
        true = np.interp(above, height[::-1], force[::-1])
        true = np.where(above < end, true, 0)
        total = true + offsets[number] + tilt * own + noise * random.normal(size=own.size)
        segments.append(
            js.force_curves.Segment(
                force=total,
                height=own + contact,
                tip=own + contact + total / constant,
                time=time[is_part] - time[0],
            )
        )
    named = dict(zip(parts, segments, strict=True))
    return js.force_curves.ForceCurve(
        named.get("approach"),
        named.get("retraction"),
        spring_constant=constant,
        unit=UNITS[0],
        force_unit=UNITS[1],
    )

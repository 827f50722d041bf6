"""Force curves of a viscoelastic sample without adhesion, by the solution of Ting."""

import numpy as np

import jaxstab as js

RADIUS, RELAXED, RATIO, TIME, STIFFNESS = 5e-6, 1e3, 1.5, 0.4, 0.05


def ting(height, time, ratio=RATIO, relaxation=TIME, steps=1500):
    """Return the force of a paraboloid on a Prony series, pressed in and pulled out once.

    Ratios and times may be numbers or lists, one for each mode.

    While the contact grows F = 4 sqrt(R) / 3 int E*(t - s) d(d^(3/2)), later the integral ends at
    the time at which the contact was as large, which follows from int E*(t - s) d'(s) ds = 0 from
    there on (T. C. T. Ting, J. Appl. Mech. 33, 845 (1966)). The cantilever bends by F / k.
    """
    fine = np.linspace(time[0], time[-1], steps)
    below = -np.interp(fine, time, height)
    decay = np.exp(-np.divide.outer(fine - fine[0], np.atleast_1d(relaxation)))
    kernel = RELAXED / 0.75 * (1 + decay @ np.atleast_1d(ratio))
    depth, force = np.zeros((2, steps))

    def force_at(number, last):
        """Return the force if the last indentation is this one."""
        trial = np.append(depth[:number], last)
        moduli = (kernel[1 : number + 1] + kernel[:number])[::-1] / 2
        ends = trial
        if last < depth[:number].max():
            # The integral from each time on, and between which two it is zero.
            flow = np.append(np.cumsum((moduli * np.diff(trial))[::-1])[::-1], 0.0)
            place = int(np.argmax(flow < 0)) - 1
            if place < 0:
                return 0.0
            share = flow[place] / (flow[place] - flow[place + 1])
            ends = np.append(trial[: place + 1], np.interp(share, [0, 1], trial[place : place + 2]))
        powers = np.maximum(ends, 0) ** 1.5
        return 4 / 3 * np.sqrt(RADIUS) * np.sum(moduli[: len(powers) - 1] * np.diff(powers))

    for number in range(1, steps):
        low, high = below[number] - 2 * max(force[number - 1], 1e-12) / STIFFNESS, below[number]
        if high <= 0 and depth.max() == 0:
            continue
        for _ in range(24):
            middle = (low + high) / 2
            is_above = middle + force_at(number, middle) / STIFFNESS > below[number]
            low, high = (low, middle) if is_above else (middle, high)
        depth[number], force[number] = middle, max(force_at(number, middle), 0.0)
    return np.interp(time, fine, force)


def recorded(height, time, force, seed, noise=2e-11, contact=4e-8):
    """Return what an instrument records of approach, dwell and retraction of a second each."""
    random = np.random.default_rng(seed)
    measured = force + noise * random.normal(size=len(force)) + 3e-10 + 1e-5 * height
    parts = []
    for first in (0.0, 1.0, 2.0):
        own = (time >= first) & ((time < first + 1) | (first == 2))
        shown = height[own] + contact
        tip = shown + measured[own] / STIFFNESS
        parts.append(js.lab.force_curves.Segment(measured[own], shown, tip, time[own]))
    return js.lab.force_curves.ForceCurve(
        parts[0], parts[2], (parts[1],), spring_constant=STIFFNESS
    )


def program(points=600):
    """Return heights and times of an approach, a dwell and a retraction of a second each."""
    time = np.linspace(0, 3, 3 * points)
    return np.interp(time, [0, 1, 2, 3], [1e-6, -8e-7, -8e-7, 1e-6]), time


def sticky(height, time, work, length, ratio=RATIO, relaxation=TIME, rings=300):
    """Return the force with an exponential attraction, on finer rings than those of the fit."""
    grid = js.Rings(rings, 3.4e-6)
    half_space = js.solids.AxisymmetricHalfSpace(grid, RELAXED, 0.5)
    solid = js.Viscoelastic(half_space, np.array([ratio]), np.array([relaxation]))
    law = js.potentials.Exponential(work, length)
    contact = js.Contact(solid, js.surfaces.paraboloid(grid, RADIUS), law)
    load = js.Spring.cantilever(height, STIFFNESS, grid)
    return np.asarray(js.evolve(contact, load, time, progress=False).force)
